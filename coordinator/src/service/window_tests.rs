//! The windows between bytes, row and answer, one by one, on stores of every kind: what happens if something fails or
//! takes long there, or if garbage is collected meanwhile.

use super::tests::{World, age, opened, put_and_say_so};
use super::*;
use crate::scheduler::Delivered;
use crate::store::faulty::{Faults, FaultyBlobs, FaultyState, Step};
use crate::store::{FolderStore, ObjectBlobs, PostgresStore, SqliteStore};
use photonfarm_proto::job::JobState;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::worker::Lease;
use photonfarm_test_servers::{Postgres, S3};
use std::path::PathBuf;
use tempfile::TempDir;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// A database file and a folder.
    File,
    /// PostgreSQL and a folder.
    Folder,
    /// PostgreSQL and an object store, to which workers send images themselves.
    Objects,
}

impl Kind {
    /// Whether a failure there is another test than with the other kinds.
    fn may_fail_at(self, step: Step) -> bool {
        match self {
            Self::File => true,
            Self::Folder => step == Step::Commit || step == Step::Committed,
            // Workers write themselves.
            Self::Objects => step != Step::Write,
        }
    }
}

const KINDS: [Kind; 3] = [Kind::File, Kind::Folder, Kind::Objects];

/// Where a farm is kept, whose stores do what a test says.
struct Ground {
    folder: TempDir,
    s3: Option<S3>,
    url: Option<String>,
}

impl Ground {
    fn new(kind: Kind) -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            s3: (kind == Kind::Objects).then(S3::start),
            url: (kind != Kind::File).then(|| Postgres::shared().database()),
        }
    }

    /// Where the images lie as files.
    fn images(&self) -> PathBuf {
        match &self.s3 {
            Some(s3) => s3.file("nodes"),
            None => self.folder.path().join("nodes"),
        }
    }

    async fn stores(&self, faults: &Arc<Faults>) -> Stores {
        let inner: Arc<dyn StateStore> = match &self.url {
            Some(url) => Arc::new(PostgresStore::open(url.parse().unwrap(), "the test's").await.unwrap()),
            None => Arc::new(SqliteStore::open(&self.folder.path().join("farm.sqlite")).unwrap()),
        };
        let faults = faults.clone();
        let state = Arc::new(FaultyState {
            inner: inner.into(),
            faults: faults.clone(),
        });
        let folder = |name: &str| FolderStore::open(&self.folder.path().join(name), self.url.is_some()).unwrap();
        let inner: Arc<dyn BlobStore> = match &self.s3 {
            Some(s3) => {
                let variables = s3.environment().map(|(name, value)| (name.to_owned(), value));
                let objects = ObjectBlobs::open_with("farm", "", variables.into_iter()).await.unwrap();
                Arc::new(objects.below("nodes"))
            }
            None => Arc::new(folder("nodes")),
        };
        Stores {
            state,
            scenes: Arc::new(folder("scenes")),
            nodes: Arc::new(FaultyBlobs {
                inner: inner.into(),
                faults,
            }),
        }
    }

    async fn world(&self, iterations: u32) -> (World, Arc<Faults>) {
        let faults = Arc::new(Faults::default());
        let stores = self.stores(&faults).await;
        let folder = tempfile::tempdir().unwrap();
        let world = World::with(iterations, folder, Arc::default(), stores).await;
        (world, faults)
    }
}

impl World {
    /// A node arrives, in the way of the farm.
    async fn arrive(&self, lease: &Lease) -> Result<Delivered, ServiceError> {
        if !self.service.workers_store() {
            return self.upload(lease).await;
        }
        let (upload, image) = self.rendered(lease);
        put_and_say_so(self, &upload, image).await
    }

    /// Exactly the images that count are there, and all can be read; how many.
    async fn images(&self) -> usize {
        let stores = &self.service.stores;
        let mut live = stores.state.live_images().await.unwrap();
        let mut there: Vec<_> = stores
            .nodes
            .list()
            .await
            .unwrap()
            .into_iter()
            .map(|(name, _)| name)
            .collect();
        live.sort_unstable();
        there.sort_unstable();
        assert_eq!(there, live);
        for name in &live {
            stores.nodes.read(*name, u64::MAX).await.unwrap();
        }
        live.len()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_sweep_between_bytes_and_row_removes_nothing() {
    for kind in KINDS {
        let ground = Ground::new(kind);
        let (world, faults) = ground.world(4).await;
        let lease = world.lease().await;
        let gate = faults.wait(Step::Commit);
        let (arrived, ()) = tokio::join!(world.arrive(&lease), async {
            gate.reached().await;
            age(&ground.images());
            let service = world.service.clone();
            let mut sweep = tokio::spawn(async move { service.sweep().await });
            // A sweep that does not wait for the row has all the time to do harm.
            let _waits = tokio::time::timeout(Duration::from_millis(100), &mut sweep).await;
            gate.open();
            if !sweep.is_finished() {
                sweep.await.unwrap().unwrap();
            }
        });
        assert_eq!(arrived.unwrap(), Delivered::Counted, "{kind:?}");
        assert_eq!(world.images().await, 1, "{kind:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failure_at_any_step_is_made_good_by_a_repeat_and_leaves_nothing() {
    for kind in KINDS {
        for step in [
            Step::Write,
            Step::Publish,
            Step::Published,
            Step::Commit,
            Step::Committed,
        ] {
            if !kind.may_fail_at(step) {
                continue;
            }
            let ground = Ground::new(kind);
            let (world, faults) = ground.world(4).await;
            let lease = world.lease().await;
            faults.fail(step);
            let error = world.arrive(&lease).await.unwrap_err().into_problem();
            assert!(error.retryable, "{kind:?}, {step:?}: {error}");
            age(&ground.images());
            world.service.sweep().await.unwrap();
            let counted = usize::from(step == Step::Committed);
            assert_eq!(world.images().await, counted, "{kind:?}, {step:?}");
            let again = match step {
                Step::Committed if kind == Kind::Objects => {
                    let (upload, _) = world.rendered(&lease);
                    world.service.stored(upload, None).await
                }
                _ => world.arrive(&lease).await,
            };
            let expected = [Delivered::Counted, Delivered::Duplicate][counted];
            assert_eq!(again.unwrap(), expected, "{kind:?}, {step:?}");
            assert_eq!(world.images().await, 1, "{kind:?}, {step:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_merge_that_fails_at_any_step_is_made_again() {
    for kind in KINDS {
        for step in [
            Step::Read,
            Step::Publish,
            Step::Published,
            Step::Commit,
            Step::Committed,
        ] {
            if !kind.may_fail_at(step) {
                continue;
            }
            let ground = Ground::new(kind);
            let (world, faults) = ground.world(2).await;
            for _ in 0..2 {
                let folding = world.service.folding.lock().await;
                let lease = world.lease().await;
                world.arrive(&lease).await.unwrap();
                // The merge waits for the second node, and then for the fault.
                if lease.node.index == 1 {
                    let live = world.service.stores.state.live_images().await.unwrap();
                    live.iter().for_each(|image| world.service.at_hand.forget(image.hash));
                    faults.fail(step);
                }
                drop(folding);
            }
            while !world.service.status(world.job).await.unwrap().state.ended() {
                world.service.fold_all().await;
            }
            let status = world.service.status(world.job).await.unwrap();
            assert_eq!(
                (status.state, status.iterations_done),
                (JobState::Done, 2),
                "{kind:?}, {step:?}"
            );
            age(&ground.images());
            world.service.sweep().await.unwrap();
            assert_eq!(world.images().await, 1, "{kind:?}, {step:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_picture_whose_nodes_are_merged_while_they_are_read_is_begun_anew() {
    for kind in KINDS {
        let ground = Ground::new(kind);
        let (world, faults) = ground.world(2).await;
        world.arrive(&world.lease().await).await.unwrap();
        let gate = faults.wait(Step::Read);
        let wanted = Wanted::default();
        let (picture, ()) = tokio::join!(world.service.picture(world.job, ImageFormat::Exr, &wanted), async {
            gate.reached().await;
            world.arrive(&world.lease().await).await.unwrap();
            world.service.fold_all().await;
            gate.open();
        });
        assert!(!matches!(picture.unwrap().file, PictureFile::Known), "{kind:?}");
        let status = world.service.status(world.job).await.unwrap();
        assert_eq!((status.state, status.iterations_done), (JobState::Done, 2), "{kind:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn many_viewers_of_a_job_cause_one_reading_of_its_nodes() {
    for kind in KINDS {
        let ground = Ground::new(kind);
        let (world, faults) = ground.world(2).await;
        world.arrive(&world.lease().await).await.unwrap();
        let gate = faults.wait(Step::Read);
        // A second reading would fail.
        faults.fail(Step::Read);
        let format = ImageFormat::Raw(vec![]);
        let all = Wanted::default();
        let viewers = (0..8).map(|_| world.service.picture(world.job, format.clone(), &all));
        let (pictures, ()) = tokio::join!(futures_util::future::join_all(viewers), async {
            gate.reached().await;
            gate.open();
        });
        let mut seen = Vec::new();
        for picture in pictures {
            let Picture { etag, file } = picture.unwrap();
            let PictureFile::Made(_, bytes) = file else {
                panic!("{kind:?}: made for all")
            };
            seen.push((etag, bytes));
        }
        assert!(seen.windows(2).all(|pair| pair[0] == pair[1]), "{kind:?}");
        let known = Wanted {
            known: Some(seen[0].0.as_str()),
            ..all
        };
        let again = world.service.picture(world.job, format.clone(), &known).await.unwrap();
        assert!(matches!(again.file, PictureFile::Known), "{kind:?}");
        let refused = world.service.picture(world.job, ImageFormat::Raw(vec![0]), &all).await;
        let problem = refused.err().unwrap().into_problem();
        assert_eq!(
            (problem.code, problem.field.as_deref()),
            (ErrorCode::Invalid, Some("layers"))
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_picture_of_a_job_that_is_deleted_while_its_nodes_are_read_is_not_found() {
    for kind in KINDS {
        let ground = Ground::new(kind);
        let (world, faults) = ground.world(2).await;
        world.arrive(&world.lease().await).await.unwrap();
        world.service.cancel_job(world.job).await.unwrap();
        let gate = faults.wait(Step::Read);
        let wanted = Wanted::default();
        let (picture, ()) = tokio::join!(world.service.picture(world.job, ImageFormat::Exr, &wanted), async {
            gate.reached().await;
            world.service.delete_job(world.job).await.unwrap();
            gate.open();
        });
        assert_eq!(
            picture.err().unwrap().into_problem().code,
            ErrorCode::NotFound,
            "{kind:?}"
        );
        assert_eq!(world.images().await, 0, "{kind:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_row_is_committed_soon_after_its_bytes_or_never() {
    for kind in KINDS {
        let ground = Ground::new(kind);
        let (world, faults) = ground.world(4).await;
        let lease = world.lease().await;
        let gate = faults.wait(Step::Published);
        let clock = &world.service.clock;
        let (arrived, ()) = tokio::join!(world.arrive(&lease), async {
            gate.reached().await;
            // The coordinator is suspended for a quarter of an hour; its clock goes on.
            clock.suspend(900_000);
            gate.open();
        });
        let problem = arrived.unwrap_err().into_problem();
        assert_eq!(
            (problem.code, problem.retryable),
            (ErrorCode::Unavailable, true),
            "{kind:?}"
        );
        assert_eq!(world.done().await, 0, "{kind:?}");
        assert_eq!(world.arrive(&lease).await.unwrap(), Delivered::Counted, "{kind:?}");
    }
}

/// One coordinator gives a node up; an honest worker renders it again and delivers the same bits to another one; only
/// then does the first remove what it gave up.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_one_coordinator_gave_up_is_not_what_another_has_counted_since() {
    for kind in [Kind::Folder, Kind::Objects] {
        let ground = Ground::new(kind);
        let (a, faults) = ground.world(4).await;
        let first = a.lease().await;
        a.arrive(&first).await.unwrap();
        let stores = ground.stores(&Arc::default()).await;
        let b = opened(stores).await;
        let image = a.service.stores.state.live_images().await.unwrap()[0];

        let gate = faults.wait(Step::Remove);
        a.service
            .give_up(a.job, (first.node, image), "unreadable".into())
            .await
            .unwrap();
        gate.reached().await;
        let b = a.through(b.unwrap());
        b.service.catch_up(&mut *b.service.farm.lock().await).await.unwrap();
        let again = b.lease().await;
        assert_eq!(again.node, first.node, "{kind:?}");
        assert_eq!(b.arrive(&again).await.unwrap(), Delivered::Counted, "{kind:?}");
        gate.open();
        let nodes = &b.service.stores.nodes;
        while nodes.size(image).await.unwrap().is_some() {
            tokio::task::yield_now().await;
        }
        assert_eq!(b.images().await, 1, "{kind:?}");
    }
}
