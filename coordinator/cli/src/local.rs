//! A coordinator and a worker in this process, which render a scene that is loaded already.

use crate::client::Client;
use crate::kept::{self, Spent};
use anyhow::{Context, Result, bail};
use photonfarm_coordinator::scheduler::{Deadlines, SchedulerConfig};
use photonfarm_coordinator::{Config, Coordinator};
use photonfarm_proto::job::JobSpec;
use photonfarm_worker::{BundleFiles, CancellationToken, Credentials, LoadedScene, Renderer, Worker, WorkerConfig};
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;

/// How long a lease should take \[ms\]: short, so that progress shows.
const LEASE_TARGET_MS: u64 = 1000;
/// How long a lease lasts without a heartbeat \[ms\]: the worker shares the coordinator's fate, and cannot be lost alone.
const LEASE_TTL_MS: u64 = 24 * 3600 * 1000;
/// How long the worker may take to say goodbye.
const FAREWELL: Duration = Duration::from_secs(5);

/// A farm of one worker.
pub(crate) struct LocalFarm<'a> {
    /// Its data folder, in which an earlier one may have left a job.
    pub(crate) folder: &'a Path,
    /// The scene of its jobs.
    pub(crate) scene: Arc<dyn LoadedScene>,
    /// Threads of its worker.
    pub(crate) threads: usize,
    /// When its jobs end [milliseconds since 1970], in place of what an earlier farm was told.
    pub(crate) deadline_ms: Option<u64>,
    /// Counts the time of the work.
    pub(crate) spent: Spent,
}

/// Threads to render with: as many as are asked for, or one per processor.
pub(crate) fn threads(asked: Option<NonZeroUsize>) -> usize {
    let processors = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    asked.map_or_else(processors, NonZeroUsize::get)
}

impl LocalFarm<'_> {
    /// Does `work` with a client of the farm. The worker may end what it is at only if the work `is_whole`.
    pub(crate) async fn run<T>(
        self,
        work: impl AsyncFnOnce(&Client) -> Result<T>,
        is_whole: impl Fn(&T) -> bool,
    ) -> Result<T> {
        let listener = TcpListener::bind("127.0.0.1:0")
            .await
            .context("cannot listen on the loopback interface")?;
        let scheduler = SchedulerConfig {
            lease_target_ms: LEASE_TARGET_MS,
            lease_ttl_ms: LEASE_TTL_MS,
            reconnect_ms: 0,
            deadlines: Deadlines::Replaced(self.deadline_ms),
            ..SchedulerConfig::default()
        };
        let config = Config {
            scheduler,
            ..Config::new(self.folder)
        };
        let coordinator = Coordinator::start(config, listener).await?;
        let scenes = kept::temporary()?;
        let worker = Worker::new(WorkerConfig {
            threads: self.threads,
            renderer: Arc::new(Ready(self.scene)),
            ..WorkerConfig::new(coordinator.url(), scenes.path())
        })?;
        let client = Client::new(&coordinator.url(), Credentials::default())?;
        let drain = CancellationToken::new();
        let mut working = tokio::spawn(worker.run(drain.clone()));
        let result = tokio::select! {
            result = work(&client) => result,
            never = self.spent.keep() => match never {},
            ended = &mut working => match ended? {
                Ok(()) => bail!("the worker ended before the job did"),
                Err(error) => Err(error.into()),
            },
        };
        self.spent.note();
        drain.cancel();
        if result.as_ref().is_ok_and(is_whole) {
            let _ = tokio::time::timeout(FAREWELL, &mut working).await;
        }
        working.abort();
        // What it was lent goes back, without blame.
        let service = coordinator.service();
        for worker in service.workers().await? {
            service.leave(worker.id).await?;
        }
        coordinator.shutdown().await;
        result
    }
}

/// The scene of the one job, loaded before it was submitted.
struct Ready(Arc<dyn LoadedScene>);

impl Renderer for Ready {
    fn load(&self, _files: &BundleFiles, _spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String> {
        Ok(self.0.clone())
    }
}
