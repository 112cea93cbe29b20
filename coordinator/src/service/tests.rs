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
    Heartbeat, Lease, LeaseProgress, LeaseRequest, MOST_LEASES, NodePlace, NodeUpload, Register, Release, frame_upload,
};
use photonfarm_test_servers::S3;
use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;
use tempfile::TempDir;

/// A service with the usual limits and schedule upon some stores.
pub(crate) async fn opened(stores: Stores) -> Result<Arc<Service>, ServiceError> {
    Service::open(
        Limits::default(),
        SchedulerConfig::default(),
        stores,
        None,
        Tracer::default(),
    )
    .await
}

pub(super) struct World {
    pub(super) folder: TempDir,
    pub(super) state: Arc<MemoryStore>,
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
    Service::open(
        Limits::default(),
        SchedulerConfig::default(),
        stores(folder, state),
        None,
        Tracer::default(),
    )
    .await
    .unwrap()
}

/// Two hours pass for the files of a folder.
pub(crate) fn age(folder: &Path) {
    age_by(folder, Duration::from_secs(7200));
}

pub(super) fn age_by(folder: &Path, time: Duration) {
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
    pub(super) async fn new(iterations: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let state = Arc::new(MemoryStore::default());
        let stores = stores(folder.path(), &state);
        Self::with(iterations, folder, state, stores).await
    }

    pub(super) async fn with(iterations: u32, folder: TempDir, state: Arc<MemoryStore>, stores: Stores) -> Self {
        let service = opened(stores).await.unwrap();
        let files = [("scene.xml".to_owned(), FileEntry::of(b"scene"))].into();
        let bundle = service
            .submit_bundle(BundleManifest { files }, &Caller::anyone())
            .await
            .unwrap()
            .bundle;
        store::put(&*service.stores.scenes, Bytes::from_static(b"scene"), 0)
            .await
            .unwrap();
        let spec = JobSpec {
            scene: bundle,
            main: "scene.xml".into(),
            defines: Default::default(),
            sensor: None,
            integrator: IntegratorSettings::Path(PathSettings::default()).into(),
            iterations,
            seed: 0,
            schedule: Default::default(),
            layers: Vec::new(),
            crop: None,
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        let job = service.submit_job(spec, None, &Caller::anyone()).await.unwrap().0.id;
        let register = Register {
            name: "w".into(),
            threads: 1,
            renderer: RENDERER.into(),
            tags: Default::default(),
            memory_mb: None,
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
        let mut granted = self.service.lease(request.clone()).await.unwrap().assignment;
        if granted.is_none() {
            // An iteration that failed is lent again after a while.
            let wait_ms = 30_000;
            let again = self.service.lease(LeaseRequest { wait_ms, ..request }).await;
            granted = again.unwrap().assignment;
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
            memory_mb: None,
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
            .upload(stream::iter([Ok::<_, Infallible>(Bytes::from(body))]), "", None)
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

    pub(super) async fn blobs(&self) -> usize {
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
    store::put(&*stores.nodes, Bytes::from_static(b"left behind"), 7)
        .await
        .unwrap();
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
        checking: Default::default(),
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
    assert_eq!(world.service.lease(request).await.unwrap().assignment, None);
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

/// The URL of a place in the object store.
async fn place_url(world: &World, upload: &NodeUpload) -> Result<String, ServiceError> {
    match world.service.place(upload).await? {
        NodePlace::Url(url) => Ok(url),
        other => panic!("a place in the object store, not {other:?}"),
    }
}

async fn put_to(url: &str, bytes: Vec<u8>) {
    let http = reqwest::Client::builder().no_proxy().build().unwrap();
    let status = http.put(url).body(bytes).send().await.unwrap().status();
    assert!(status.is_success(), "{status}");
}

/// Puts bytes where the coordinator says, and says so.
pub(super) async fn put_and_say_so(
    world: &World,
    upload: &NodeUpload,
    bytes: Vec<u8>,
) -> Result<Delivered, ServiceError> {
    put_to(&place_url(world, upload).await?, bytes).await;
    world.service.stored(upload.clone(), None).await
}

#[tokio::test]
async fn nodes_that_workers_store_are_believed_only_when_read() {
    let s3 = S3::start();
    let world = world_of_objects(2, &s3).await;
    let first = world.lease().await;
    let (upload, image) = world.rendered(&first);

    let problem = world
        .service
        .stored(upload.clone(), None)
        .await
        .unwrap_err()
        .into_problem();
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
    assert_eq!(world.service.stored(upload, None).await.unwrap(), Delivered::Duplicate);

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

/// The URL of a place outlives the answer to whether the node counts.
#[tokio::test]
async fn what_was_put_for_a_node_that_is_known_or_refused_is_removed() {
    let s3 = S3::start();
    let world = world_of_objects(2, &s3).await;
    let put_there = || std::fs::read_dir(s3.file("nodes/incoming")).unwrap().count();
    let lease = world.lease().await;
    let (upload, image) = world.rendered(&lease);
    let url = place_url(&world, &upload).await.unwrap();
    put_to(&url, image.clone()).await;
    let stored = || world.service.stored(upload.clone(), None);
    assert_eq!((stored().await.unwrap(), put_there()), (Delivered::Counted, 0));

    put_to(&url, image.clone()).await;
    assert_eq!(put_there(), 1);
    assert_eq!((stored().await.unwrap(), put_there()), (Delivered::Duplicate, 0));

    put_to(&url, image).await;
    let place = world.service.place(&upload).await.unwrap();
    assert_eq!((place, put_there()), (NodePlace::Known, 0));

    let lease = world.lease().await;
    let (upload, image) = world.rendered(&lease);
    put_to(&place_url(&world, &upload).await.unwrap(), image).await;
    let release = Release {
        token: lease.token,
        worker: world.worker,
        job: world.job,
    };
    world.service.release(release).await.unwrap();
    assert_eq!(put_there(), 1);
    let refused = world.service.stored(upload, None).await.unwrap_err().into_problem();
    assert_eq!((refused.code, put_there()), (ErrorCode::StaleLease, 0));
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
