//! The scheduler at work: decisions are committed, then applied, then answered.

mod arrival;
mod at_hand;
mod checks;
mod clock;
mod counts;
#[cfg(test)]
mod ended_tests;
mod error;
mod fold;
mod garbage;
mod glance;
mod history;
mod image;
mod jobs;
mod journal;
mod kept;
mod log;
mod merge;
mod nodes;
mod noise;
mod obstacles;
mod partial;
mod preview;
mod raw;
mod retention;
mod scenes;
mod section;
mod shared;
#[cfg(test)]
mod shared_tests;
mod stored;
mod telling;
#[cfg(test)]
pub(crate) mod tests;
mod trace;
mod transact;
mod upload;
mod views;
mod waiters;
#[cfg(test)]
mod window_tests;
mod workers;

pub(crate) use checks::CheckFigures;
pub(crate) use counts::{Durations, LEASE_SECONDS};
pub use error::ServiceError;
pub(crate) use glance::Glance;
pub use image::{ImageFormat, Picture, PictureFile};
pub(crate) use jobs::{PAGE, read_cursor};
pub(crate) use obstacles::Part;
pub use retention::Keep;
pub(crate) use scenes::SceneFile;
pub use section::{Section, Wanted};

use crate::scheduler::{Farm, Job, NonceKey, Refusal, SchedulerConfig};
use crate::store::{BlobStore, StateStore};
use crate::webhook::Webhooks;
use clock::Clock;
use photonfarm_proto::api::FarmIdentity;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::limits::Limits;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::trace::Tracer;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, Notify, RwLock, Semaphore, watch};
use transact::FarmCell;

pub use photonfarm_proto::VERSION;

/// Node images held in memory at once that workers stored.
const UPLOADS: usize = 4;
/// Time between two searches for garbage.
const SWEEP: Duration = Duration::from_secs(3600);
/// Pictures encoded at once.
const PICTURES: usize = 2;

/// The stores of a farm.
#[derive(Clone)]
pub struct Stores {
    /// Jobs, leases, nodes, workers, bundles.
    pub state: Arc<dyn StateStore>,
    /// Files of bundles.
    pub scenes: Arc<dyn BlobStore>,
    /// Images of nodes.
    pub nodes: Arc<dyn BlobStore>,
}

/// The service behind every interface.
pub struct Service {
    pub(crate) limits: Limits,
    pub(crate) stores: Stores,
    farm: Mutex<FarmCell>,
    clock: Clock,
    /// Rises whenever a status may have changed.
    progress: watch::Sender<u64>,
    waiters: waiters::Waiters,
    stopping: watch::Sender<bool>,
    submitting: Mutex<()>,
    folding: Mutex<()>,
    at_hand: at_hand::AtHand,
    checks: checks::Checks,
    uploads: Semaphore,
    pictures: Semaphore,
    views: views::Views,
    glances: glance::Glances,
    /// Held while the picture of a job that has ended is made.
    finishing: Mutex<()>,
    shared: shared::Shared,
    obstacles: obstacles::Obstacles,
    missing_files: scenes::MissingFiles,
    partials: partial::Partials,
    pub(crate) counts: counts::Counts,
    histories: history::Histories,
    log: log::Log,
    /// URLs that are told when jobs end, if any are.
    webhooks: Option<Webhooks>,
    /// There is something to tell.
    told: Notify,
    tracer: Tracer,
    /// Connections that were refused, since their address had too many.
    pub(crate) refused_connections: Arc<AtomicU64>,
    /// Lines of the audit log that could not be written.
    pub(crate) audit_lost: Arc<AtomicU64>,
    /// Shared from the publication of bytes to the commit of their row; alone for the removal of bytes.
    publishing: RwLock<()>,
    /// Shared while a client learns which files of a bundle are missing; alone for the removal of one.
    naming: RwLock<()>,
}

impl Service {
    /// Goes on from what the stores hold; spans go to the tracer.
    pub(crate) async fn open(
        limits: Limits,
        scheduler: SchedulerConfig,
        stores: Stores,
        webhooks: Option<Webhooks>,
        tracer: Tracer,
    ) -> Result<Arc<Self>, ServiceError> {
        let clock = Clock::new();
        clock.measure(&*stores.state).await?;
        let scheduler = SchedulerConfig {
            secret: secret()?,
            ..scheduler
        };
        let (sequence, snapshot) = stores.state.load().await?;
        let farm = Farm::restore(scheduler, snapshot, clock.now());
        let log = log::Log::new(clock.now());
        let service = Arc::new(Self {
            limits,
            stores,
            farm: Mutex::new(FarmCell::new(farm, sequence)),
            clock,
            progress: watch::Sender::new(0),
            waiters: waiters::Waiters::default(),
            stopping: watch::Sender::new(false),
            submitting: Mutex::default(),
            folding: Mutex::default(),
            at_hand: at_hand::AtHand::default(),
            checks: checks::Checks::default(),
            uploads: Semaphore::new(UPLOADS),
            pictures: Semaphore::new(PICTURES),
            views: views::Views::default(),
            glances: glance::Glances::default(),
            finishing: Mutex::default(),
            shared: shared::Shared::default(),
            obstacles: obstacles::Obstacles::default(),
            missing_files: scenes::MissingFiles::default(),
            partials: partial::Partials::default(),
            counts: counts::Counts::default(),
            histories: history::Histories::default(),
            log,
            webhooks,
            told: Notify::new(),
            tracer,
            refused_connections: Arc::default(),
            audit_lost: Arc::default(),
            publishing: RwLock::default(),
            naming: RwLock::default(),
        });
        if !service.stores.state.is_shared() {
            service.transact(|farm, _| Ok(farm.restarted())).await?;
        }
        if service.take_lead().await? {
            service.sweep().await?;
        }
        service.look_at_stores().await;
        Ok(service)
    }

    /// Runs the clockwork until the service stops; first of all it merges what was left undone. Jobs that have ended are
    /// kept as `keep` says.
    pub async fn run(self: Arc<Self>, step: Duration, keep: Keep) {
        let mut stopping = self.stopping.subscribe();
        let follower = tokio::spawn(self.clone().follow());
        let looker = tokio::spawn(self.clone().look_around());
        let teller = tokio::spawn(self.clone().tell());
        let mut swept = Instant::now();
        loop {
            let step = async {
                if let Err(error) = self.tick().await {
                    tracing::error!(%error, "leases could not be expired");
                }
                if self.leads() && swept.elapsed() > SWEEP {
                    swept = Instant::now();
                    if let Err(error) = self.retain(keep).await {
                        tracing::warn!(%error, "jobs are left to be deleted later");
                    }
                    if let Err(error) = self.sweep().await {
                        tracing::warn!(%error, "garbage is left for later");
                    }
                    if let Err(error) = self.forget_deliveries().await {
                        tracing::warn!(%error, "deliveries of long ago are forgotten later");
                    }
                }
                tokio::time::sleep(step).await;
            };
            tokio::select! {
                _ = stopping.wait_for(|stop| *stop) => break,
                () = step => {}
            }
        }
        follower.abort();
        looker.abort();
        teller.abort();
    }

    /// What the clock makes happen. Where several coordinators share the farm, one of them does it.
    async fn tick(self: &Arc<Self>) -> Result<(), ServiceError> {
        self.exchange_beats().await?;
        self.watch_clock().await?;
        let now = self.clock.now();
        self.fresh_farm().await?.farm.pass_time(now);
        self.checks.pass_time(now);
        if self.take_lead().await? {
            self.transact(|farm, now| Ok(farm.expire(now))).await?;
            self.fold_all().await;
        }
        // What rested may be tried again, and what takes too long be given to others.
        self.waiters.wake();
        Ok(())
    }

    /// Ends waiting requests and the clockwork.
    pub fn stop(&self) {
        self.stopping.send_replace(true);
    }

    /// Which farm it is.
    pub(crate) fn identity(&self) -> FarmIdentity {
        self.stores.state.identity()
    }

    /// Lets go of the state, so that another coordinator can open it; work in the background ends with an error.
    pub(crate) async fn close(&self) {
        self.stores.state.close().await;
    }

    pub(crate) fn stopping(&self) -> watch::Receiver<bool> {
        self.stopping.subscribe()
    }

    /// Notices changes of any status.
    pub(crate) fn progress(&self) -> watch::Receiver<u64> {
        self.progress.subscribe()
    }

    /// A job, whether it goes on or has ended.
    async fn find_job(self: &Arc<Self>, id: JobId) -> Result<Job, ServiceError> {
        self.with_job(id, Job::clone).await
    }

    /// What is to be known of a job, whether it goes on or has ended.
    async fn with_job<T>(self: &Arc<Self>, id: JobId, read: impl FnOnce(&Job) -> T) -> Result<T, ServiceError> {
        let cell = self.fresh_farm().await?;
        if let Some(job) = cell.farm.job(id) {
            return Ok(read(job));
        }
        let config = cell.farm.config().clone();
        drop(cell);
        let record = self.stores.state.job(id).await?.ok_or(Refusal::UnknownJob(id))?;
        Ok(read(&Job::from_record(record, &config)))
    }

    /// How far a job has come.
    pub async fn status(self: &Arc<Self>, id: JobId) -> Result<JobStatus, ServiceError> {
        let cell = self.fresh_farm().await?;
        if let Some(job) = cell.farm.job(id) {
            return Ok(self.held_up(cell.farm.status(job, self.clock.now())));
        }
        drop(cell);
        self.with_job(id, Job::status).await
    }
}

fn secret() -> Result<NonceKey, Problem> {
    Ok(NonceKey(random_bits()?))
}

fn random_bits() -> Result<[u8; 32], Problem> {
    let mut bits = [0; 32];
    getrandom::fill(&mut bits).map_err(|error| {
        tracing::error!(%error, "the system gives no random numbers");
        Problem::new(ErrorCode::Internal, "the system gives no random numbers")
    })?;
    Ok(bits)
}
