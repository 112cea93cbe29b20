//! `photonfarm render`: a coordinator and a worker in one process, with a temporary data folder.

use crate::args::RenderArgs;
use crate::client::Client;
use crate::job::PreparedJob;
use crate::output::{OutputFile, PictureFiles};
use crate::stats::Stats;
use crate::{Interrupted, submit};
use anyhow::{Context, Result, bail};
use photonfarm_coordinator::scheduler::SchedulerConfig;
use photonfarm_coordinator::{Config, Coordinator};
use photonfarm_proto::job::JobStatus;
use photonfarm_worker::{
    BundleFiles, CancellationToken, CoreScene, Credentials, LoadedScene, Renderer, Worker, WorkerConfig,
};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;

/// How long a lease should take [ms]: short, so that progress shows.
const LEASE_TARGET_MS: u64 = 1000;
/// How long a lease lasts without a heartbeat [ms]: the worker shares the coordinator's fate, and cannot be lost alone.
const LEASE_TTL_MS: u64 = 24 * 3600 * 1000;
/// How long the worker may take to say goodbye.
const FAREWELL: Duration = Duration::from_secs(5);

/// Runs the command.
pub(crate) fn run(args: RenderArgs) -> Result<()> {
    let started = Instant::now();
    let output = PictureFiles::check(&args.output)?;
    let stats = args.stats.as_deref().map(OutputFile::check).transpose()?;
    let (job, scene) = PreparedJob::new(&args.job)?;
    let load_seconds = started.elapsed().as_secs_f64();
    let folder = tempfile::tempdir().context("cannot make a temporary folder; TMPDIR says where")?;
    let runtime = tokio::runtime::Runtime::new()?;
    let threads = args.threads.map_or_else(default_threads, NonZeroUsize::get);
    let result = runtime.block_on(render(job, CoreScene(scene), folder.path(), threads, &output));
    // An iteration that was interrupted need not come to its end.
    runtime.shutdown_background();
    let status = result?;
    if let Some(stats) = stats {
        let wall_seconds = started.elapsed().as_secs_f64();
        stats.write(&Stats::new(&status, threads, wall_seconds, load_seconds).to_json()?)?;
    }
    Ok(())
}

fn default_threads() -> usize {
    std::thread::available_parallelism().map_or(1, NonZeroUsize::get)
}

async fn render(
    job: PreparedJob,
    scene: CoreScene,
    folder: &Path,
    threads: usize,
    output: &PictureFiles,
) -> Result<JobStatus> {
    let listener = TcpListener::bind("127.0.0.1:0")
        .await
        .context("cannot listen on the loopback interface")?;
    let scheduler = SchedulerConfig {
        lease_target_ms: LEASE_TARGET_MS,
        lease_ttl_ms: LEASE_TTL_MS,
        ..SchedulerConfig::default()
    };
    let config = Config {
        scheduler,
        ..Config::new(folder.join("farm"))
    };
    let coordinator = Coordinator::start(config, listener).await?;
    let worker = Worker::new(WorkerConfig {
        threads,
        renderer: Arc::new(Ready(Arc::new(scene))),
        ..WorkerConfig::new(coordinator.url(), folder.join("scenes"))
    })?;
    let client = Client::new(&coordinator.url(), Credentials::default())?;
    let drain = CancellationToken::new();
    let mut work = tokio::spawn(worker.run(drain.clone()));
    let picture = async {
        let id = submit::send(&client, &job).await?;
        let status = submit::follow(&client, id, job.spec.iterations).await?;
        submit::fetch(&client, &status, output).await?;
        anyhow::Ok(status)
    };
    let result = tokio::select! {
        result = picture => result,
        ended = &mut work => match ended? {
            Ok(()) => bail!("the worker ended before the job did"),
            Err(error) => Err(error.into()),
        },
        signal = tokio::signal::ctrl_c() => signal.map_err(Into::into).and(Err(Interrupted.into())),
    };
    drain.cancel();
    if result.is_ok() {
        let _ = tokio::time::timeout(FAREWELL, &mut work).await;
    }
    work.abort();
    coordinator.shutdown().await;
    result
}

/// The scene of the one job, loaded before it was submitted.
struct Ready(Arc<CoreScene>);

impl Renderer for Ready {
    fn load(
        &self,
        _files: &BundleFiles,
        _main: &str,
        _defines: &BTreeMap<String, String>,
    ) -> Result<Arc<dyn LoadedScene>, String> {
        Ok(self.0.clone())
    }
}
