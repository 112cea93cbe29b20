//! Failures between bytes, row and acknowledgement.

use super::*;
use crate::access::Caller;
use crate::scheduler::Delivered;
use crate::scheduler::record::Origin;
use crate::store::memory::{MemoryStore, NextCommit};
use crate::store::{self, FolderStore, ObjectBlobs, StoreError};
use axum::body::Bytes;
use futures_util::stream;
use photonfarm_core::film::Node;
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::RENDERER;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::{BlobHash, WorkerId};
use photonfarm_proto::job::{JobSpec, JobState, Totals};
use photonfarm_proto::node::{NodeHeader, encode_node};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::waiting::Waiting;
use photonfarm_proto::worker::{
    Heartbeat, Lease, LeaseProgress, LeaseRequest, MOST_LEASES, NodePlace, NodeUpload, Register, frame_upload,
};
use photonfarm_test_servers::S3;
use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;
use tempfile::TempDir;
use tokio::io::AsyncReadExt;

pub(super) struct World {
    folder: TempDir,
    state: Arc<MemoryStore>,
    pub(super) service: Arc<Service>,
    worker: WorkerId,
    pub(super) job: JobId,
}

fn stores(folder: &Path, state: &Arc<MemoryStore>) -> Stores {
    let open = |name: &str| Arc::new(FolderStore::open(&folder.join(name), false).unwrap());
    Stores {
        state: state.clone(),
        scenes: open("scenes"),
        nodes: open("nodes"),
    }
}

async fn open(folder: &Path, state: &Arc<MemoryStore>) -> Arc<Service> {
    Service::open(Limits::default(), SchedulerConfig::default(), stores(folder, state))
        .await
        .unwrap()
}

/// Two hours pass for the files of a folder.
pub(crate) fn age(folder: &Path) {
    age_by(folder, Duration::from_secs(7200));
}

fn age_by(folder: &Path, time: Duration) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            age_by(&path, time);
        } else {
            let file = std::fs::File::options().append(true).open(path).unwrap();
            file.set_modified(SystemTime::now() - time).unwrap();
        }
    }
}

/// Requests for work are numbered, whichever worker sends them.
fn next_serial() -> u64 {
    static SERIAL: AtomicU64 = AtomicU64::new(1);
    SERIAL.fetch_add(1, Ordering::Relaxed)
}

impl World {
    async fn new(iterations: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let state = Arc::new(MemoryStore::default());
        let stores = stores(folder.path(), &state);
        Self::with(iterations, folder, state, stores).await
    }

    pub(super) async fn with(iterations: u32, folder: TempDir, state: Arc<MemoryStore>, stores: Stores) -> Self {
        let service = Service::open(Limits::default(), SchedulerConfig::default(), stores)
            .await
            .unwrap();
        let files = [("scene.xml".to_owned(), FileEntry::of(b"scene"))].into();
        let bundle = service
            .submit_bundle(BundleManifest { files }, &Caller::anyone())
            .await
            .unwrap()
            .bundle;
        store::put(&*service.stores.scenes, b"scene", 0).await.unwrap();
        let spec = JobSpec {
            scene: bundle,
            main: "scene.xml".into(),
            defines: Default::default(),
            sensor: None,
            integrator: IntegratorSettings::Path(PathSettings::default()).into(),
            iterations,
            seed: 0,
            schedule: Default::default(),
        };
        let job = service.submit_job(spec, None, &Caller::anyone()).await.unwrap().0.id;
        let register = Register {
            name: "w".into(),
            threads: 1,
            renderer: RENDERER.into(),
            tags: Default::default(),
        };
        let worker = service.register(register, Origin::default()).await.unwrap();
        Self {
            folder,
            state,
            service,
            worker,
            job,
        }
    }

    pub(super) async fn lease(&self) -> Lease {
        let request = LeaseRequest {
            worker: self.worker,
            serial: next_serial(),
            held: vec![],
            wait_ms: 0,
        };
        let mut granted = self.service.lease(request.clone()).await.unwrap();
        if granted.is_none() {
            // An iteration that failed is lent again after a while.
            let wait_ms = 30_000;
            granted = self.service.lease(LeaseRequest { wait_ms, ..request }).await.unwrap();
        }
        granted.unwrap().lease
    }

    /// What a worker announces, and the image.
    pub(super) fn rendered(&self, lease: &Lease) -> (NodeUpload, Vec<u8>) {
        let node = Node::leaf(
            lease.node.index,
            2,
            1,
            &[Spectrum::splat(0.5 + lease.node.index as f32); 2],
        )
        .unwrap();
        let image = encode_node(self.job, &node);
        let upload = NodeUpload {
            token: lease.token,
            worker: self.worker,
            job: self.job,
            node: lease.node,
            width: 2,
            height: 1,
            digest: BlobHash::of(&image),
            totals: Totals::default(),
        };
        (upload, image)
    }

    pub(super) async fn upload(&self, lease: &Lease) -> Result<Delivered, ServiceError> {
        let (upload, image) = self.rendered(lease);
        self.send(&upload, &image).await
    }

    async fn send(&self, upload: &NodeUpload, image: &[u8]) -> Result<Delivered, ServiceError> {
        let body = [frame_upload(upload).unwrap().as_slice(), &image[NodeHeader::BYTES..]].concat();
        self.service
            .upload(stream::iter([Ok::<_, Infallible>(Bytes::from(body))]), "")
            .await
    }

    fn next_commit(&self, next: NextCommit) {
        *self.state.next.lock().unwrap() = next;
    }

    pub(super) async fn done(&self) -> u64 {
        self.service.status(self.job).await.unwrap().iterations_done
    }

    /// The same worker, which asks another coordinator.
    pub(super) fn through(self, service: Arc<Service>) -> Self {
        Self { service, ..self }
    }

    async fn blobs(&self) -> usize {
        self.service.stores.nodes.list().await.unwrap().len()
    }
}

#[tokio::test]
async fn bytes_without_a_row_do_not_count_and_go_at_the_next_start_once_they_are_old() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    world.next_commit(NextCommit::Fails);
    let error = world.upload(&lease).await.unwrap_err().into_problem();
    assert!(error.retryable && error.status == 500);
    assert_eq!(world.done().await, 0);
    let World {
        folder, state, service, ..
    } = world;
    drop(service);
    let stores = stores(folder.path(), &state);
    store::put(&*stores.nodes, b"left behind", 7).await.unwrap();
    drop(stores);
    let service = open(folder.path(), &state).await;
    assert_eq!(
        service.stores.nodes.list().await.unwrap().len(),
        2,
        "they may be those of a row that is about to come"
    );
    drop(service);
    age(&folder.path().join("nodes"));
    let service = open(folder.path(), &state).await;
    assert_eq!(service.stores.nodes.list().await.unwrap(), []);
}

#[tokio::test]
async fn pixels_that_cannot_be_are_a_failure_of_who_sent_them_and_damaged_bytes_are_not() {
    let world = World::new(2).await;
    let lease = world.lease().await;
    let (mut upload, mut image) = world.rendered(&lease);
    let failures = || world.state.rows().jobs[&world.job].failures.clone();
    let sound = image.clone();
    image[NodeHeader::BYTES..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let problem = world.send(&upload, &image).await.unwrap_err().into_problem();
    assert_eq!((problem.code, failures().len()), (ErrorCode::ContentMismatch, 0));

    upload.digest = BlobHash::of(&image);
    let problem = world.send(&upload, &image).await.unwrap_err().into_problem();
    assert_eq!(problem.code, ErrorCode::Invalid);
    let (leaf, attempt) = failures()[0].clone();
    assert_eq!((leaf, attempt.attempt.worker), (lease.node.index, world.worker));
    upload.digest = BlobHash::of(&sound);
    let problem = world.send(&upload, &sound).await.unwrap_err().into_problem();
    assert_eq!(problem.code, ErrorCode::StaleLease, "a failure ends the lease");
    assert_eq!((world.done().await, world.blobs().await), (0, 0));
}

#[tokio::test]
async fn a_failed_commit_is_made_good_by_a_repeat() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    world.next_commit(NextCommit::Fails);
    assert!(world.upload(&lease).await.is_err());
    assert_eq!(world.upload(&lease).await.unwrap(), Delivered::Counted);
    assert_eq!(world.done().await, 1);
    age(&world.folder.path().join("nodes"));
    world.service.sweep().await.unwrap();
    assert_eq!(
        world.blobs().await,
        1,
        "what nobody can say of whether it counts goes when it is old"
    );
}

#[tokio::test]
async fn a_commit_that_succeeded_unnoticed_counts_once() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    world.next_commit(NextCommit::SucceedsUnnoticed);
    assert!(world.upload(&lease).await.is_err());
    assert_eq!(world.upload(&lease).await.unwrap(), Delivered::Duplicate);
    assert_eq!(world.done().await, 1);
}

#[tokio::test]
async fn a_panic_between_commit_and_apply_loses_nothing() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    world.next_commit(NextCommit::SucceedsAndPanics);
    assert!(world.upload(&lease).await.is_err());
    assert_eq!(world.done().await, 1, "the state was loaded again");
    assert_eq!(world.upload(&lease).await.unwrap(), Delivered::Duplicate);
}

#[tokio::test]
async fn a_message_names_a_bounded_number_of_leases() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    let mut request = LeaseRequest {
        worker: world.worker,
        serial: next_serial(),
        held: vec![lease.token; MOST_LEASES + 1],
        wait_ms: 0,
    };
    let refused = world.service.lease(request.clone()).await.unwrap_err().into_problem();
    assert_eq!(refused.code, ErrorCode::Limit);
    let progress = LeaseProgress {
        token: lease.token,
        leaves_done: 0,
    };
    let mut beat = Heartbeat {
        worker: world.worker,
        leases: vec![progress; MOST_LEASES + 1],
    };
    let refused = world.service.heartbeat(&beat).await.unwrap_err().into_problem();
    assert_eq!(refused.code, ErrorCode::Limit);
    beat.leases.pop();
    assert_eq!(world.service.heartbeat(&beat).await.unwrap(), []);
    request.held.pop();
    assert!(world.service.lease(request).await.is_ok());
}

#[tokio::test]
async fn a_poll_that_a_later_one_has_overtaken_ends_with_nothing_and_takes_nothing() {
    let world = World::new(4).await;
    let request = LeaseRequest {
        worker: world.worker,
        serial: next_serial(),
        held: vec![],
        wait_ms: 0,
    };
    let lease = world.lease().await;
    assert_eq!(world.service.lease(request).await.unwrap(), None);
    assert_eq!(
        world.upload(&lease).await.unwrap(),
        Delivered::Counted,
        "its successor's lease is held"
    );
}

#[tokio::test]
async fn a_lease_whose_commit_is_in_doubt_never_shares_its_token() {
    let world = World::new(4).await;
    world.next_commit(NextCommit::SucceedsUnnoticed);
    let request = LeaseRequest {
        worker: world.worker,
        serial: next_serial(),
        held: vec![],
        wait_ms: 0,
    };
    assert!(world.service.lease(request).await.is_err());
    let doubtful = world.state.rows().jobs[&world.job].leases[0].token;
    assert!(world.lease().await.token > doubtful);
}

/// The machine sleeps for an hour: its clock goes on, and no worker could be heard meanwhile.
#[tokio::test]
async fn a_coordinator_that_was_suspended_does_not_hold_it_against_workers() {
    let world = World::new(4).await;
    let lease = world.lease().await;
    world.service.clock.suspend(3_600_000);
    world.service.tick().await.unwrap();
    assert_eq!(world.upload(&lease).await.unwrap(), Delivered::Counted);
}

#[tokio::test]
async fn merges_left_undone_are_done_after_the_next_start() {
    let world = World::new(2).await;
    for _ in 0..2 {
        let folding = world.service.folding.lock().await;
        let lease = world.lease().await;
        world.upload(&lease).await.unwrap();
        if lease.node.index == 1 {
            world.service.stop();
            std::mem::forget(folding);
        }
    }
    assert_eq!(world.service.status(world.job).await.unwrap().state, JobState::Running);
    let service = open(world.folder.path(), &world.state).await;
    let running = tokio::spawn(service.clone().run(Duration::from_millis(10), Keep::default()));
    let mut progress = service.progress();
    while !service.status(world.job).await.unwrap().state.ended() {
        progress.changed().await.unwrap();
    }
    service.stop();
    running.await.unwrap();
    let status = service.status(world.job).await.unwrap();
    assert_eq!((status.state, status.iterations_done), (JobState::Done, 2));
}

#[tokio::test]
async fn a_lost_image_is_rendered_again() {
    let world = World::new(2).await;
    let first = world.lease().await;
    world.upload(&first).await.unwrap();
    let image = world.service.stores.nodes.list().await.unwrap()[0].0;
    world.service.stores.nodes.remove(image).await.unwrap();
    world.service.at_hand.forget(image.hash);
    let second = world.lease().await;
    world.upload(&second).await.unwrap();
    world.service.fold_all().await;
    assert_eq!(world.done().await, 1);
    let again = world.lease().await;
    assert_eq!(again.node, first.node);
    world.upload(&again).await.unwrap();
    world.service.fold_all().await;
    let status = world.service.status(world.job).await.unwrap();
    assert_eq!((status.state, status.iterations_done), (JobState::Done, 2));
}

/// A farm whose workers put nodes into an object store.
async fn world_of_objects(iterations: u32, s3: &S3) -> World {
    let folder = tempfile::tempdir().unwrap();
    let state = Arc::new(MemoryStore::default());
    let variables = s3.environment().map(|(name, value)| (name.to_owned(), value));
    let objects = ObjectBlobs::open_with("farm", "", variables.into_iter()).await.unwrap();
    let stores = Stores {
        state: state.clone(),
        scenes: Arc::new(objects.below("scenes")),
        nodes: Arc::new(objects.below("nodes")),
    };
    World::with(iterations, folder, state, stores).await
}

/// Puts bytes where the coordinator says, and says so.
pub(super) async fn put_and_say_so(
    world: &World,
    upload: &NodeUpload,
    bytes: Vec<u8>,
) -> Result<Delivered, ServiceError> {
    let NodePlace::Url(url) = world.service.place(upload).await? else {
        panic!("a place in the object store");
    };
    let http = reqwest::Client::builder().no_proxy().build().unwrap();
    let status = http.put(url).body(bytes).send().await.unwrap().status();
    assert!(status.is_success(), "{status}");
    world.service.stored(upload.clone()).await
}

#[tokio::test]
async fn nodes_that_workers_store_are_believed_only_when_read() {
    let s3 = S3::start();
    let world = world_of_objects(2, &s3).await;
    let first = world.lease().await;
    let (upload, image) = world.rendered(&first);

    let problem = world.service.stored(upload.clone()).await.unwrap_err().into_problem();
    assert_eq!(problem.code, ErrorCode::ContentMismatch, "nothing was put");
    let mut lie = image.clone();
    lie[40] ^= 1;
    let problem = put_and_say_so(&world, &upload, lie).await.unwrap_err().into_problem();
    assert_eq!(
        problem.code,
        ErrorCode::ContentMismatch,
        "the first node is read at once"
    );
    let failures = world.state.rows().jobs[&world.job].failures.clone();
    assert_eq!((failures.len(), failures[0].1.attempt.worker), (1, world.worker));
    assert_eq!((world.done().await, world.blobs().await), (0, 0));
    let stale = world.service.place(&upload).await.unwrap_err().into_problem();
    assert_eq!(stale.code, ErrorCode::StaleLease, "a failure ends the lease");

    let first = world.lease().await;
    let (upload, image) = world.rendered(&first);
    assert_eq!(
        put_and_say_so(&world, &upload, image.clone()).await.unwrap(),
        Delivered::Counted
    );
    assert_eq!(world.service.place(&upload).await.unwrap(), NodePlace::Known);
    assert_eq!(world.service.stored(upload).await.unwrap(), Delivered::Duplicate);

    let second = world.lease().await;
    let (upload, image) = world.rendered(&second);
    let mut lie = image.clone();
    lie[40] ^= 1;
    assert_eq!(put_and_say_so(&world, &upload, lie).await.unwrap(), Delivered::Counted);
    world.service.fold_all().await;
    assert_eq!(world.done().await, 1, "the lie was found when it was to be merged");
    let failures = world.state.rows().jobs[&world.job].failures.clone();
    assert_eq!(
        (failures[1].0, failures[1].1.attempt.worker),
        (second.node.index, world.worker)
    );

    let second = world.lease().await;
    let (upload, image) = world.rendered(&second);
    assert_eq!(
        put_and_say_so(&world, &upload, image).await.unwrap(),
        Delivered::Counted
    );
    world.service.fold_all().await;
    let status = world.service.status(world.job).await.unwrap();
    assert_eq!((status.state, status.iterations_done), (JobState::Done, 2));
}

/// A full disk is said of each job that it keeps from going on, and is over as soon as something was stored.
#[tokio::test]
async fn a_full_disk_is_what_jobs_wait_for() {
    let world = World::new(2).await;
    let service = &world.service;
    let waiting = async || {
        let status = service.status(world.job).await.unwrap();
        (status.waiting_reason, status.waiting.unwrap_or_default())
    };
    let before = waiting().await;
    let fails = |kind: std::io::ErrorKind| {
        let (path, source) = ("x".into(), kind.into());
        Err::<(), _>(ServiceError::from(StoreError::Io { path, source }))
    };
    service.note(Part::Images, &fails(std::io::ErrorKind::StorageFull));
    assert_eq!(
        waiting().await,
        (Some(Waiting::DiskFull), "the disk of the images is full".into())
    );
    service.note(Part::Images, &fails(std::io::ErrorKind::Other));
    assert_eq!(
        waiting().await,
        (Some(Waiting::StoreAway), "images cannot be stored".into())
    );
    assert_eq!(service.failures(Part::Images), [1, 1]);
    service.note(
        Part::Images,
        &Err::<(), _>(Problem::new(ErrorCode::Malformed, "").into()),
    );
    assert_eq!(
        service.found_obstacles().len(),
        1,
        "a bad request says nothing of the disk"
    );
    service.note(Part::Images, &Ok(()));
    service.note(Part::Scenes, &fails(std::io::ErrorKind::StorageFull));
    assert_eq!(waiting().await, before, "no job needs room for scenes");
    let away = StoreError::Connection("refused".into());
    service.note(Part::Images, &Err::<(), _>(ServiceError::from(away)));
    assert_eq!(
        waiting().await,
        (Some(Waiting::StoreAway), "the state cannot be written".into())
    );
}

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
        service.picture(job, ImageFormat::Exr, None).await.err().unwrap(),
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
        PictureFile::Known => Vec::new(),
        PictureFile::Made(bytes) => bytes,
        PictureFile::Kept(length, mut reader) => {
            let mut bytes = Vec::new();
            reader.read_to_end(&mut bytes).await.unwrap();
            assert_eq!(bytes.len() as u64, length);
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
        let picture = service.picture(job, ImageFormat::Exr, None).await.unwrap();
        assert_eq!(matches!(picture.file, PictureFile::Made(_)), made);
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
    let fetch = async |format| bytes_of(service.picture(job, format, None).await.unwrap()).await;
    let before = fetch(ImageFormat::Exr).await;
    assert_eq!(world.blobs().await, 1, "a job that goes on has no picture to keep");
    service.cancel_job(job).await.unwrap();
    assert_eq!(fetch(ImageFormat::Exr).await, before);
    let png = fetch(ImageFormat::Png).await;
    assert_eq!((fetch(ImageFormat::Png).await, world.blobs().await), (png, 3));
    service.delete_job(job).await.unwrap();
    assert_eq!(world.blobs().await, 0);
}
