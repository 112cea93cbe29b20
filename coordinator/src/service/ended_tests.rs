//! What becomes of jobs that have ended: their pictures are kept, they are deleted, and what only they named goes.

use super::tests::{World, age, age_by};
use super::*;
use crate::access::Caller;
use axum::body::Bytes;
use futures_util::stream;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::BlobHash;
use std::convert::Infallible;
use tokio::io::AsyncReadExt;

#[tokio::test]
async fn a_deleted_job_leaves_nothing_behind_and_its_scene_goes_a_day_after_it_was_last_named() {
    let day = Duration::from_secs(86_400);
    let world = World::new(4).await;
    world.upload(&world.lease().await).await.unwrap();
    let (service, job) = (&world.service, world.job);
    let problem = service.delete_job(job).await.unwrap_err().into_problem();
    assert_eq!(problem.code, ErrorCode::JobGoesOn);
    assert!(problem.detail.contains("cancel it first"), "{problem}");
    service.cancel_job(job).await.unwrap();
    assert_eq!(world.blobs().await, 1);
    service.delete_job(job).await.unwrap();
    assert_eq!(world.blobs().await, 0);
    assert!(world.state.rows().jobs.is_empty());
    for error in [
        service.delete_job(job).await.unwrap_err(),
        service.status(job).await.unwrap_err(),
        service
            .picture(job, ImageFormat::Exr, &Wanted::default())
            .await
            .err()
            .unwrap(),
    ] {
        assert_eq!(error.into_problem().code, ErrorCode::NotFound);
    }

    let files = async || service.stores.scenes.list().await.unwrap().len();
    age_by(&world.folder.path().join("scenes"), day + Duration::from_secs(60));
    service.clock.suspend(day.as_millis() as i64 - 60_000);
    service.sweep().await.unwrap();
    assert_eq!(files().await, 1, "a client named it less than a day ago");
    service.clock.suspend(120_000);
    service.sweep().await.unwrap();
    assert_eq!(files().await, 0);
}

#[tokio::test]
async fn a_file_that_is_about_to_be_removed_is_missing() {
    let world = World::new(1).await;
    let service = &world.service;
    service.cancel_job(world.job).await.unwrap();
    service.delete_job(world.job).await.unwrap();
    assert_eq!(service.stores.state.forget_bundles(u64::MAX).await.unwrap(), 1);
    let manifest = BundleManifest {
        files: [("scene.xml".to_owned(), FileEntry::of(b"scene"))].into(),
    };
    let announce = async || {
        service
            .submit_bundle(manifest.clone(), &Caller::anyone())
            .await
            .unwrap()
            .missing
    };
    let file = BlobHash::of(b"scene");
    assert_eq!(announce().await, [file], "it is still there, and nobody named it");
    let body = stream::iter([Ok::<_, Infallible>(Bytes::from_static(b"scene"))]);
    service.put_blob(file, body).await.unwrap();
    assert_eq!(announce().await, []);
    age_by(&world.folder.path().join("scenes"), Duration::from_secs(90_000));
    service.sweep().await.unwrap();
    assert_eq!(announce().await, [], "a file that is named stays, however old");
}

#[tokio::test]
async fn an_upload_that_nobody_goes_on_with_is_removed_after_a_day() {
    let world = World::new(1).await;
    let (service, caller) = (&world.service, Caller::anyone());
    let manifest = BundleManifest {
        files: [("a.xml".to_owned(), FileEntry::of(b"abcdef"))].into(),
    };
    service.submit_bundle(manifest, &caller).await.unwrap();
    let (file, scenes) = (BlobHash::of(b"abcdef"), world.folder.path().join("scenes"));
    let append = async |offset, bytes| {
        let body = stream::iter([Ok::<_, Infallible>(Bytes::from_static(bytes))]);
        let sent = service.append_blob(file, (offset, None), false, body, &caller);
        sent.await.unwrap().offset
    };
    let kept = async || service.upload_state(file, &caller).await.unwrap().offset;
    assert_eq!(append(0, b"abc").await, 3);
    age_by(&scenes, Duration::from_secs(80_000));
    service.sweep().await.unwrap();
    assert_eq!(append(kept().await, b"de").await, 5);
    age_by(&scenes, Duration::from_secs(80_000));
    service.sweep().await.unwrap();
    assert_eq!(kept().await, 5, "it grew less than a day ago");
    age_by(&scenes, Duration::from_secs(90_000));
    service.sweep().await.unwrap();
    assert_eq!(kept().await, 0);
}

#[tokio::test]
async fn jobs_that_have_ended_are_deleted_once_they_are_old_or_take_too_much_room() {
    let day = 86_400_000;
    let world = World::new(2).await;
    world.upload(&world.lease().await).await.unwrap();
    let (service, first) = (&world.service, world.job);
    let image = service.stores.nodes.list().await.unwrap()[0].0;
    let bytes = service.stores.nodes.size(image).await.unwrap().unwrap();
    let spec = service.status(first).await.unwrap().spec;
    let second = service.submit_job(spec, None, &Caller::anyone()).await.unwrap().0.id;
    let keep = |longest_ms, most_bytes| Keep { longest_ms, most_bytes };
    let left = async |keep, jobs: &[JobId]| {
        service.retain(keep).await.unwrap();
        let known: Vec<JobId> = world.state.rows().jobs.keys().copied().collect();
        assert_eq!(known, jobs);
    };
    service.clock.suspend(2 * day);
    left(keep(Some(0), Some(0)), &[first, second]).await;
    service.cancel_job(first).await.unwrap();
    left(keep(None, Some(bytes)), &[first, second]).await;
    service.clock.suspend(day - 60_000);
    left(keep(Some(day as u64), None), &[first, second]).await;
    service.clock.suspend(120_000);
    left(keep(Some(day as u64), None), &[second]).await;
    assert_eq!(world.blobs().await, 0);
    service.cancel_job(second).await.unwrap();
    left(keep(None, Some(b"scene".len() as u64)), &[second]).await;
    left(keep(None, Some(b"scene".len() as u64 - 1)), &[]).await;
}

async fn bytes_of(picture: Picture) -> Vec<u8> {
    match picture.file {
        PictureFile::Known | PictureFile::Beyond(_) => Vec::new(),
        PictureFile::Made(_, bytes) => bytes.into(),
        PictureFile::Kept(section, mut reader) => {
            let mut bytes = Vec::new();
            reader.read_to_end(&mut bytes).await.unwrap();
            assert_eq!(bytes.len() as u64, section.of);
            bytes
        }
    }
}

#[tokio::test]
async fn the_picture_of_a_job_that_has_ended_is_made_once_and_anew_where_it_is_damaged() {
    let world = World::new(1).await;
    world.upload(&world.lease().await).await.unwrap();
    let (service, job) = (&world.service, world.job);
    while !service.status(job).await.unwrap().state.ended() {
        service.fold_all().await;
    }
    let fetch = async |made: bool| {
        let picture = service
            .picture(job, ImageFormat::Exr, &Wanted::default())
            .await
            .unwrap();
        assert_eq!(matches!(picture.file, PictureFile::Made(..)), made);
        bytes_of(picture).await
    };
    let kept = async || service.stores.state.pictures(job).await.unwrap();
    let picture = fetch(true).await;
    assert_eq!((fetch(false).await, world.blobs().await), (picture.clone(), 2));
    let digits = kept().await[0].to_string();
    let file = world.folder.path().join("nodes").join(&digits[..2]).join(&digits[2..]);
    let mut damaged = picture.clone();
    damaged[picture.len() / 2] ^= 1;
    std::fs::write(&file, damaged).unwrap();
    assert_eq!(fetch(true).await, picture);
    service.stores.nodes.remove(kept().await[0]).await.unwrap();
    assert_eq!(fetch(true).await, picture);
    age(&world.folder.path().join("nodes"));
    service.sweep().await.unwrap();
    assert_eq!(world.blobs().await, 2, "what took its place is no garbage");

    let node = world.state.rows().jobs[&job].nodes[0].1.image();
    service.stores.nodes.remove(node).await.unwrap();
    assert_eq!(fetch(false).await, picture, "no node is read for it");
    service.extend_job(job, 2, &Caller::anyone()).await.unwrap();
    assert!(kept().await.is_empty());
    while world.blobs().await > 0 {
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn pictures_go_with_their_job() {
    let world = World::new(2).await;
    world.upload(&world.lease().await).await.unwrap();
    let (service, job) = (&world.service, world.job);
    let fetch = async |format| bytes_of(service.picture(job, format, &Wanted::default()).await.unwrap()).await;
    let before = fetch(ImageFormat::Exr).await;
    assert_eq!(world.blobs().await, 1, "a job that goes on has no picture to keep");
    service.cancel_job(job).await.unwrap();
    assert_eq!(fetch(ImageFormat::Exr).await, before);
    let png = fetch(ImageFormat::Png).await;
    assert_eq!((fetch(ImageFormat::Png).await, world.blobs().await), (png, 3));
    service.delete_job(job).await.unwrap();
    assert_eq!(world.blobs().await, 0);
}
