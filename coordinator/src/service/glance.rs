//! The farm at a glance, for all who watch it: it is looked up once for all of them.

use super::{Part, Service, ServiceError};
use crate::store::{JobFilter, Room, StoreError, image_bytes};
use photonfarm_proto::api::{FarmFigures, Obstacle, StoreRoom, WorkerStatus};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

/// The newest jobs are shown.
const JOBS: u32 = 100;
/// Time for which a look is new enough, whatever happens meanwhile.
const NEW: Duration = Duration::from_millis(400);
/// Time for which it is new enough if nothing happens: workers fall silent.
const SAME: Duration = Duration::from_secs(2);
/// Least time between two counts of the bytes that jobs hold,
const COUNT: Duration = Duration::from_secs(10);
/// and how often as long as the last one took, where that is longer.
const COUNT_RESTS: u32 = 100;
/// How long a disk may take to be looked at.
const PATIENCE: Duration = Duration::from_secs(5);

/// What is there at one time.
pub(crate) struct Glance {
    /// How often a status had changed.
    pub(crate) version: u64,
    /// The newest jobs.
    pub(crate) jobs: BTreeMap<JobId, Arc<JobStatus>>,
    pub(crate) workers: Vec<WorkerStatus>,
    pub(crate) figures: FarmFigures,
    pub(crate) obstacles: Vec<Obstacle>,
    at: Instant,
}

/// The latest look at the farm, and what of it is looked up now and then.
#[derive(Default)]
pub(super) struct Glances {
    latest: tokio::sync::Mutex<Option<Arc<Glance>>>,
    followed: tokio::sync::Mutex<Followed>,
    stored: std::sync::Mutex<Stored>,
}

/// Jobs that were looked up since a status last changed, and how often one had changed then.
#[derive(Default)]
struct Followed {
    version: u64,
    jobs: BTreeMap<JobId, Arc<JobStatus>>,
}

/// What is known of the stores.
#[derive(Default)]
struct Stored {
    rooms: Vec<StoreRoom>,
    job_bytes: Option<u64>,
    /// When jobs are to be counted again.
    count_at: Option<Instant>,
}

impl Service {
    /// The farm as it is, or was a moment ago.
    pub(crate) async fn glance(self: &Arc<Self>) -> Result<Arc<Glance>, ServiceError> {
        let mut latest = self.glances.latest.lock().await;
        let version = *self.progress.borrow();
        if let Some(glance) = latest.as_ref() {
            let age = glance.at.elapsed();
            if age < NEW || (glance.version == version && age < SAME) {
                return Ok(glance.clone());
            }
        }
        let page = self.list_jobs(JobFilter::default(), Some(JOBS)).await?;
        let obstacles = self.found_obstacles().into_iter().map(|(_, obstacle)| obstacle);
        let glance = Arc::new(Glance {
            version,
            jobs: page.jobs.into_iter().map(|job| (job.id, Arc::new(job))).collect(),
            workers: self.workers().await?,
            figures: self.farm_figures().await?,
            obstacles: obstacles.collect(),
            at: Instant::now(),
        });
        *latest = Some(glance.clone());
        Ok(glance)
    }

    /// How far a job has come, looked up once for all who follow it after each change.
    pub(crate) async fn followed(self: &Arc<Self>, id: JobId) -> Result<Arc<JobStatus>, ServiceError> {
        let mut followed = self.glances.followed.lock().await;
        let version = *self.progress.borrow();
        if followed.version != version {
            *followed = Followed {
                version,
                jobs: BTreeMap::new(),
            };
        }
        if let Some(status) = followed.jobs.get(&id) {
            return Ok(status.clone());
        }
        let status = Arc::new(self.status(id).await?);
        followed.jobs.insert(id, status.clone());
        Ok(status)
    }

    /// The farm in figures.
    pub(crate) async fn farm_figures(self: &Arc<Self>) -> Result<FarmFigures, ServiceError> {
        let figures = self.figures().await?;
        let workers = self.workers().await?;
        let (stores, job_bytes) = self.room();
        let speeds = workers.iter().filter_map(|worker| worker.iterations_per_second);
        Ok(FarmFigures {
            jobs_queued: figures.queued,
            jobs_running: figures.jobs - figures.queued,
            workers: workers.len() as u64,
            workers_at_work: workers.iter().filter(|worker| worker.leases > 0).count() as u64,
            pending_iterations: figures.pending_iterations,
            // The sum of nothing is to be 0, not the -0 that the library has for it.
            iterations_per_second: speeds.fold(0.0, |sum, speed| sum + speed),
            job_bytes,
            stores,
        })
    }

    /// Room in the stores and bytes of jobs, when they were last looked up.
    pub(crate) fn room(&self) -> (Vec<StoreRoom>, Option<u64>) {
        let stored = self.glances.stored.lock().unwrap_or_else(PoisonError::into_inner);
        (stored.rooms.clone(), stored.job_bytes)
    }

    /// Looks up the room in the stores, and now and then what jobs hold of it.
    pub(super) async fn look_at_stores(self: &Arc<Self>) {
        let stores = &self.stores;
        let [state, images, scenes] = tokio::join!(
            known(stores.state.room()),
            known(stores.nodes.room()),
            known(stores.scenes.room())
        )
        .into();
        let parts = [(Part::State, state), (Part::Images, images), (Part::Scenes, scenes)];
        let rooms =
            parts.map(|(part, room)| StoreRoom::new(part.name(), room.map(|Room { free, total }| [free, total])));
        let due = {
            let mut stored = self.glances.stored.lock().unwrap_or_else(PoisonError::into_inner);
            stored.rooms = rooms.into();
            stored.count_at.is_none_or(|at| Instant::now() > at)
        };
        let begun = Instant::now();
        if due && let Ok(bytes) = self.job_bytes().await {
            let rest = COUNT.max(begun.elapsed().saturating_mul(COUNT_RESTS));
            let mut stored = self.glances.stored.lock().unwrap_or_else(PoisonError::into_inner);
            (stored.job_bytes, stored.count_at) = (Some(bytes), Some(Instant::now() + rest));
        }
    }

    /// Bytes of the images and pictures of all jobs.
    async fn job_bytes(self: &Arc<Self>) -> Result<u64, ServiceError> {
        let ended = self.stores.state.ended_jobs().await?;
        let cell = self.fresh_farm().await?;
        let going_on = cell.farm.jobs().map(|job| {
            let nodes = job.live_nodes().count() as u64;
            nodes.saturating_mul(image_bytes(&job.head().spec, job.resolution()))
        });
        let all = going_on.chain(ended.iter().map(|job| job.bytes));
        Ok(all.fold(0, u64::saturating_add))
    }
}

/// The room that a store tells within a while.
async fn known(room: impl Future<Output = Result<Option<Room>, StoreError>>) -> Option<Room> {
    let room = tokio::time::timeout(PATIENCE, room).await;
    room.unwrap_or(Ok(None)).unwrap_or_else(|error| {
        tracing::warn!(%error, "the room on a disk cannot be looked up");
        None
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::Stores;
    use crate::service::tests::opened;
    use crate::store::faulty::FaultyState;
    use crate::store::memory::MemoryStore;
    use crate::store::{BlobStore, FolderStore, SqliteStore, StateStore};

    async fn open(folder: &std::path::Path, state: Arc<dyn StateStore>) -> Arc<Service> {
        let blobs =
            |name: &str| -> Arc<dyn BlobStore> { Arc::new(FolderStore::open(&folder.join(name), false).unwrap()) };
        let stores = Stores {
            state,
            scenes: blobs("scenes"),
            nodes: blobs("nodes"),
        };
        opened(stores).await.unwrap()
    }

    #[tokio::test]
    async fn many_who_watch_the_farm_cause_one_look() {
        let folder = tempfile::tempdir().unwrap();
        let inner: Arc<dyn StateStore> = Arc::new(MemoryStore::default());
        let state = Arc::new(FaultyState {
            inner: inner.into(),
            faults: Arc::default(),
        });
        let service = open(folder.path(), state.clone()).await;
        let before = state.inner.calls();
        let all = futures_util::future::join_all((0..20).map(|_| service.glance())).await;
        let looks = state.inner.calls() - before;
        let all: Vec<Arc<Glance>> = all.into_iter().collect::<Result<_, _>>().unwrap();
        assert!(all.iter().all(|glance| Arc::ptr_eq(glance, &all[0])));
        service.list_jobs(JobFilter::default(), None).await.unwrap();
        assert_eq!(state.inner.calls() - before, 2 * looks, "as much as one list of jobs");
    }

    #[tokio::test]
    async fn room_is_known_of_folders_and_files_and_of_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = SqliteStore::open(&folder.path().join("farm.sqlite")).unwrap();
        for (state, known) in [
            (Arc::new(file) as Arc<dyn StateStore>, true),
            (Arc::new(MemoryStore::default()), false),
        ] {
            let figures = open(folder.path(), state).await.farm_figures().await.unwrap();
            let parts: Vec<&str> = figures.stores.iter().map(|room| room.part.as_str()).collect();
            assert_eq!((parts, figures.job_bytes), (vec!["state", "images", "scenes"], Some(0)));
            for room in &figures.stores {
                let bytes = room.free_bytes.zip(room.total_bytes);
                assert_eq!(bytes.is_some(), known || room.part != "state");
                assert!(bytes.is_none_or(|(free, total)| free <= total && total > 0), "{room:?}");
                assert_eq!(room.low, bytes.is_some_and(|(free, _)| free < StoreRoom::WARNED));
            }
        }
    }
}
