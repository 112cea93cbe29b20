//! What goes with a job that is deleted or goes on, and what is forgotten later.

use super::tests::{Kept, head, short_life, stores};
use super::*;
use photonfarm_proto::bundle::FileEntry;
use photonfarm_proto::job::JobState;
use photonfarm_test_servers::Postgres;

fn bundle_of(files: &[&str]) -> BundleManifest {
    let entry = |name: &&str| ((*name).to_owned(), FileEntry::of(name.as_bytes()));
    BundleManifest {
        files: files.iter().map(entry).collect(),
    }
}

#[tokio::test]
async fn bundles_are_forgotten_that_no_job_and_lately_no_client_names() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let [first, second] = [bundle_of(&["a", "b"]), bundle_of(&["b", "c"])];
        let put = async |bundle: &BundleManifest| store.put_bundle(bundle.clone(), "ann".into(), 9, 5).await.unwrap();
        let left = async |files: &[&str]| {
            let expected: BTreeSet<BlobHash> = files.iter().map(|file| BlobHash::of(file.as_bytes())).collect();
            assert_eq!(store.bundled_files().await.unwrap(), expected);
            let usage = store.usage("ann".into()).await.unwrap();
            assert_eq!(
                usage.bundle_bytes,
                files.len() as u64,
                "what is forgotten counts for nobody"
            );
        };
        put(&first).await;
        assert_eq!(put(&second).await.fresh, [BlobHash::of(b"c")].into());
        let mut head = head(1, None);
        head.spec.scene = first.hash();
        let ended = Change::JobEnded {
            job: JobId(1),
            state: JobState::Cancelled,
            failure: None,
            ended_ms: 6,
        };
        let (sequence, _) = store.load().await.unwrap();
        let changes = vec![Change::JobSubmitted(head.into()), ended];
        let Commit::Kept(sequence) = store.commit(sequence, changes).await.unwrap() else {
            panic!("nobody else was there");
        };
        assert_eq!(store.forget_bundles(5).await.unwrap(), 0);
        assert_eq!(store.name_bundle(second.hash(), 9).await.unwrap(), Some(second.clone()));
        assert_eq!(store.forget_bundles(9).await.unwrap(), 0);
        left(&["a", "b", "c"]).await;
        assert_eq!(store.forget_bundles(10).await.unwrap(), 1);
        left(&["a", "b"]).await;
        assert_eq!(store.name_bundle(second.hash(), 10).await.unwrap(), None);
        let deleted = Change::JobDeleted {
            job: JobId(1),
            ended_ms: 6,
            owner: "ann".into(),
            iterations: 9,
        };
        store.commit(sequence, vec![deleted]).await.unwrap();
        assert_eq!(store.forget_bundles(10).await.unwrap(), 1);
        left(&[]).await;
        assert_eq!(put(&first).await.fresh.len(), 2);
    }
}

#[tokio::test]
async fn pictures_are_kept_until_their_job_goes_on_or_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let commit = async |changes: Vec<Change>| {
            let (sequence, _) = store.load().await.unwrap();
            store.commit(sequence, changes).await.unwrap();
        };
        let picture = |copy: u64| PictureRecord {
            etag: format!("{copy}"),
            image: BlobName {
                hash: BlobHash::of(b"picture"),
                copy,
            },
            bytes: 7,
        };
        let put = async |ended_ms, format, copy| {
            let put = store.put_picture(JobId(4), ended_ms, format, picture(copy));
            put.await.unwrap().map(|name| name.copy)
        };
        let ended_ms = 1_700_000_000_010;
        assert_eq!(put(ended_ms, "exr", 1).await, Some(1), "there is no such job");
        commit(short_life()).await;
        let bytes = store.ended_jobs().await.unwrap()[0].bytes;
        assert_eq!(put(1, "exr", 2).await, Some(2), "it ended at another time");
        assert_eq!(put(ended_ms, "exr", 3).await, None);
        assert_eq!(put(ended_ms, "png", 4).await, None);
        assert_eq!(put(ended_ms, "exr", u64::MAX).await, Some(3));
        assert_eq!(store.picture(JobId(4), "exr").await.unwrap(), Some(picture(u64::MAX)));
        assert_eq!(store.pictures(JobId(4)).await.unwrap().len(), 2);
        assert_eq!(store.live_images().await.unwrap().len(), 3, "a node and two pictures");
        assert_eq!(store.ended_jobs().await.unwrap()[0].bytes, bytes + 14);

        let record = Box::new(JobRecord {
            state: JobState::Running,
            ended_ms: None,
            ..store.job(JobId(4)).await.unwrap().unwrap()
        });
        commit(vec![Change::JobReopened { record, ended_ms }]).await;
        assert_eq!(store.pictures(JobId(4)).await.unwrap(), []);
        commit(short_life().split_off(3)).await;
        assert_eq!(put(ended_ms, "exr", 5).await, None);
        commit(vec![Change::JobDeleted {
            job: JobId(4),
            ended_ms,
            owner: "ann".into(),
            iterations: 9,
        }])
        .await;
        assert_eq!(store.live_images().await.unwrap(), []);
    }
}

#[tokio::test]
async fn what_comes_too_late_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for kept in [
        Kept::Sqlite(folder.path()),
        Kept::Postgres(Postgres::shared().database()),
    ] {
        let store = kept.open().await;
        store.commit(0, short_life()).await.unwrap();
        let before = store.job(JobId(4)).await.unwrap();
        let (sequence, _) = store.load().await.unwrap();
        let deleted = Change::JobDeleted {
            job: JobId(4),
            ended_ms: 1,
            owner: "ann".into(),
            iterations: 9,
        };
        let outcome = store.commit(sequence, vec![deleted]).await;
        assert!(matches!(outcome, Err(StoreError::TooLate)), "{outcome:?}");
        assert_eq!(store.job(JobId(4)).await.unwrap(), before);
        assert_eq!(store.load().await.unwrap().0, sequence);
        assert_eq!(store.usage("ann".into()).await.unwrap().iterations, 9);
    }
}
