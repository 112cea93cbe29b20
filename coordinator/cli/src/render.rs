//! `photonfarm render`: a coordinator and a worker in one process, with a temporary data folder.

use crate::args::RenderArgs;
use crate::client::Client;
use crate::job::PreparedJob;
use crate::kept::{self, FarmFolder};
use crate::output::{OutputFile, PictureFiles};
use crate::say;
use crate::stats::Stats;
use crate::steer_args::deadline;
use crate::{Interrupted, submit};
use anyhow::{Context, Result, bail};
use photonfarm_coordinator::scheduler::SchedulerConfig;
use photonfarm_coordinator::{Config, Coordinator};
use photonfarm_core::picture;
use photonfarm_core::scene::Scene;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_worker::{
    BundleFiles, CancellationToken, CoreScene, Credentials, LoadedScene, Renderer, Worker, WorkerConfig,
};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
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
    let output = Output::check(&args)?;
    let stats = args.stats.as_deref().map(OutputFile::check).transpose()?;
    let (mut job, scene) = PreparedJob::new(&args.job)?;
    job.spec.schedule.deadline_ms = args.within.map(deadline).transpose()?;
    let load_seconds = started.elapsed().as_secs_f64();
    let farm = FarmFolder::beside(args.job.from.as_deref())?;
    let runtime = tokio::runtime::Runtime::new()?;
    let threads = args.threads.map_or_else(default_threads, NonZeroUsize::get);
    let interrupt = tokio::signal::ctrl_c();
    let layers = job.spec.layers()?;
    let scene = Arc::new(CoreScene { scene, layers });
    let preview = async |client: &Client, job: JobId| match args.preview {
        Some(seconds) => previews(client, job, Duration::from_secs_f64(seconds), &output, &scene.scene).await,
        None => std::future::pending().await,
    };
    let result = runtime.block_on(render(&job, scene.clone(), farm.path(), threads, preview, interrupt));
    // An iteration that was interrupted need not come to its end.
    runtime.shutdown_background();
    let rendered = match result? {
        Ending::Complete(rendered) => rendered,
        Ending::Interrupted(partial) => return keep_partial(&args, farm, partial.as_ref()),
    };
    output.write(&rendered, &scene.scene)?;
    farm.remove()?;
    say::tell(format_args!("{}: {}", output.names, submit::in_words(&rendered.exr)?));
    submit::tell_if_black(&rendered.exr, Some(&scene.scene))?;
    if let Some(stats) = stats {
        let wall_seconds = started.elapsed().as_secs_f64();
        stats.write(&Stats::new(&rendered.status, threads, wall_seconds, load_seconds).to_json()?)?;
    }
    Ok(())
}

/// What is written of a finished render.
struct Output {
    picture: Option<PictureFiles>,
    tables: Vec<OutputFile>,
    /// All names, for messages.
    names: String,
}

impl Output {
    /// Checks that all files can be written: the picture, or a table where its name asks for one, and a table beside it.
    fn check(args: &RenderArgs) -> Result<Self> {
        let is_table = args
            .output
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case("csv"));
        let picture = match is_table {
            true => None,
            false => Some(PictureFiles::check(&args.output)?),
        };
        let tables: Vec<&Path> = [Some(&args.output).filter(|_| is_table), args.csv.as_ref()]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path)
            .collect();
        let names: Vec<String> = picture
            .iter()
            .map(PictureFiles::names)
            .chain(tables.iter().map(|path| path.display().to_string()))
            .collect();
        Ok(Self {
            picture,
            tables: tables.into_iter().map(OutputFile::check).collect::<Result<_>>()?,
            names: names.join(" and "),
        })
    }

    fn write(&self, rendered: &Rendered, scene: &Scene) -> Result<()> {
        if let Some(picture) = &self.picture {
            picture.write(&rendered.exr, &rendered.png)?;
        }
        if self.tables.is_empty() {
            return Ok(());
        }
        let decoded = picture::decode_exr(&rendered.exr, usize::MAX)?;
        let table = picture::encode_csv(scene, decoded.width, &decoded.pixels);
        self.tables.iter().try_for_each(|file| file.write(table.as_bytes()))
    }
}

/// Keeps what an interrupted render has, and says how to go on.
fn keep_partial(args: &RenderArgs, farm: FarmFolder, partial: Option<&Rendered>) -> Result<()> {
    let Some(Rendered { exr, png, .. }) = partial else {
        say::tell("interrupted before the first iteration was complete: nothing is kept");
        return Err(Interrupted.into());
    };
    let picture = kept::partial(&args.output);
    kept::keep(farm, &picture, exr, png)?;
    let metadata = picture::read_metadata(exr)?.context("the picture has no metadata")?;
    let done = metadata.iterations;
    let all = metadata.iterations_asked.map_or(done, u64::from);
    let (scene, picture, output) = (args.job.scene.display(), picture.display(), args.output.display());
    say::tell(format_args!(
        "interrupted after {done} of {all} iterations, which {picture} holds. To go on:\n    \
         photonfarm render {scene} --from {picture} -o {output}"
    ));
    Err(Interrupted.into())
}

fn default_threads() -> usize {
    std::thread::available_parallelism().map_or(1, NonZeroUsize::get)
}

/// How a render ended.
enum Ending {
    Complete(Rendered),
    /// With what there was, if any iteration was complete.
    Interrupted(Option<Rendered>),
}

/// A picture as files.
struct Rendered {
    status: JobStatus,
    exr: Vec<u8>,
    png: Vec<u8>,
}

/// Writes the picture of a job again and again, whenever it has come further.
async fn previews(client: &Client, job: JobId, every: Duration, output: &Output, scene: &Scene) -> Result<()> {
    let mut written = 0;
    loop {
        tokio::time::sleep(every).await;
        let status = client.status(job).await?;
        if status.iterations_done > written && !status.state.ended() {
            written = status.iterations_done;
            let rendered = fetch(client, status).await?;
            tokio::task::block_in_place(|| output.write(&rendered, scene))?;
        }
    }
}

/// Renders a job in the data folder `farm`, in which an earlier render may have left a part of it, until it is done or `interrupt`
/// comes.
async fn render(
    job: &PreparedJob,
    scene: Arc<dyn LoadedScene>,
    farm: &Path,
    threads: usize,
    preview: impl AsyncFnOnce(&Client, JobId) -> Result<()>,
    interrupt: impl Future<Output = std::io::Result<()>>,
) -> Result<Ending> {
    let listener = TcpListener::bind("127.0.0.1:0")
        .await
        .context("cannot listen on the loopback interface")?;
    let scheduler = SchedulerConfig {
        lease_target_ms: LEASE_TARGET_MS,
        lease_ttl_ms: LEASE_TTL_MS,
        reconnect_ms: 0,
        ..SchedulerConfig::default()
    };
    let config = Config {
        scheduler,
        ..Config::new(farm)
    };
    let coordinator = Coordinator::start(config, listener).await?;
    let scenes = kept::temporary()?;
    let worker = Worker::new(WorkerConfig {
        threads,
        renderer: Arc::new(Ready(scene)),
        ..WorkerConfig::new(coordinator.url(), scenes.path())
    })?;
    let client = Client::new(&coordinator.url(), Credentials::default())?;
    let drain = CancellationToken::new();
    let mut work = tokio::spawn(worker.run(drain.clone()));
    let picture = async {
        let asked = begin(&client, job, farm).await?;
        let status = tokio::select! {
            status = submit::follow(&client, &asked) => status?,
            Err(error) = preview(&client, asked.id) => return Err(error),
        };
        fetch(&client, status).await.map(Ending::Complete)
    };
    let result = tokio::select! {
        result = picture => result,
        ended = &mut work => match ended? {
            Ok(()) => bail!("the worker ended before the job did"),
            Err(error) => Err(error.into()),
        },
        signal = interrupt => match signal {
            Ok(()) => interrupted(&client).await.map(Ending::Interrupted),
            Err(error) => Err(error.into()),
        },
    };
    drain.cancel();
    if let Ok(Ending::Complete(_)) = &result {
        let _ = tokio::time::timeout(FAREWELL, &mut work).await;
    }
    work.abort();
    // What it was lent goes back, without blame.
    let service = coordinator.service();
    for worker in service.workers().await? {
        service.leave(worker.id).await?;
    }
    coordinator.shutdown().await;
    result
}

/// Sends the job, or finds it where an earlier render has begun with it.
async fn begin(client: &Client, job: &PreparedJob, farm: &Path) -> Result<JobStatus> {
    let Some(begun) = client.jobs(1, |_| true).await?.pop() else {
        return submit::send(client, job).await;
    };
    let spec = JobSpec {
        schedule: job.spec.schedule.clone(),
        ..begun.spec.clone()
    };
    if spec != job.spec {
        let farm = farm.display();
        bail!("{farm} holds a part of another picture: remove it, and the picture is rendered from the beginning");
    }
    let (done, all) = (begun.iterations_done, spec.iterations);
    say::tell(format_args!("going on after {done} of {all} iterations"));
    Ok(begun)
}

/// What there is of the picture. One worker delivers iterations in their order, so that they are the first ones.
async fn interrupted(client: &Client) -> Result<Option<Rendered>> {
    match client
        .jobs(1, |_| true)
        .await?
        .pop()
        .filter(|job| job.iterations_done > 0)
    {
        Some(status) => fetch(client, status).await.map(Some),
        None => Ok(None),
    }
}

async fn fetch(client: &Client, status: JobStatus) -> Result<Rendered> {
    let exr = client.image(status.id, "exr").await?;
    let png = client.image(status.id, "png").await?;
    Ok(Rendered { status, exr, png })
}

/// The scene of the one job, loaded before it was submitted.
struct Ready(Arc<dyn LoadedScene>);

impl Renderer for Ready {
    fn load(&self, _files: &BundleFiles, _spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String> {
        Ok(self.0.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use photonfarm_core::integrator::{Iteration, Observer, RenderError};
    use photonfarm_core::scene::Wishes;
    use photonfarm_core::settings::IntegratorSettings;
    use photonfarm_proto::job::BandwidthRange;
    use std::future::pending;

    /// A scene that stays at iteration `last` until its lease is lost, and says so.
    struct Stuck {
        scene: CoreScene,
        last: u32,
        reached: CancellationToken,
    }

    impl LoadedScene for Stuck {
        fn resolution(&self) -> [u32; 2] {
            self.scene.resolution()
        }

        fn wishes(&self) -> Wishes {
            self.scene.wishes()
        }

        fn bandwidth(&self, settings: &IntegratorSettings, iteration: u32, before: &[f32]) -> Option<BandwidthRange> {
            self.scene.bandwidth(settings, iteration, before)
        }

        fn render(
            &self,
            settings: &IntegratorSettings,
            seed: u64,
            iteration: u32,
            before: &[f32],
            observer: &dyn Observer,
        ) -> Result<Iteration, RenderError> {
            if iteration >= self.last {
                self.reached.cancel();
                while !observer.cancelled() {
                    std::thread::yield_now();
                }
            }
            self.scene.render(settings, seed, iteration, before, observer)
        }
    }

    const SCENE: &str = r#"<scene version="3.0.0">
        <sensor type="perspective">
            <float name="fov" value="50"/>
            <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/></film>
        </sensor>
        <shape type="sphere">
            <point name="center" x="0" y="0" z="4"/>
            <emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>
        </shape>
        <shape type="rectangle">
            <transform name="to_world">
                <scale value="9"/><rotate y="1" angle="180"/><translate x="0" y="0" z="8"/>
            </transform>
        </shape>
    </scene>"#;

    fn prepare(folder: &Path, options: &str) -> (PreparedJob, CoreScene) {
        let scene = folder.join("scene.xml");
        std::fs::write(&scene, SCENE).unwrap();
        let line = format!("photonfarm render {} -o a.exr {options}", scene.display());
        let crate::args::Command::Render(args) = crate::args::Cli::parse_from(line.split_whitespace()).command else {
            panic!("{line}")
        };
        let (job, scene) = PreparedJob::new(&args.job).unwrap();
        let layers = job.spec.layers().unwrap();
        (job, CoreScene { scene, layers })
    }

    /// No preview.
    async fn none(_: &Client, _: JobId) -> Result<()> {
        std::future::pending().await
    }

    fn complete(ending: Ending) -> Rendered {
        match ending {
            Ending::Complete(rendered) => rendered,
            Ending::Interrupted(_) => panic!("it was interrupted"),
        }
    }

    /// By the twentieth iteration at least one was delivered: leases grow only with what is delivered, and few wait for delivery.
    #[tokio::test(flavor = "multi_thread")]
    async fn an_interrupted_render_goes_on_to_the_same_bits() {
        for integrator in ["path", "sppm --set photons=100"] {
            let folder = kept::temporary().unwrap();
            let options = format!("--iterations 40 --integrator {integrator}");
            let (job, scene) = prepare(folder.path(), &options);
            let whole = render(&job, Arc::new(scene), &folder.path().join("whole"), 1, none, pending()).await;
            let whole = complete(whole.unwrap());
            let work = folder.path().join("a.partial.farm");
            let mut done = 0;
            for last in [20, 30] {
                let (_, scene) = prepare(folder.path(), &options);
                let reached = CancellationToken::new();
                let stuck = Stuck {
                    scene,
                    last,
                    reached: reached.clone(),
                };
                let interrupt = async move {
                    reached.cancelled().await;
                    Ok(())
                };
                let ending = render(&job, Arc::new(stuck), &work, 1, none, interrupt).await.unwrap();
                let Ending::Interrupted(Some(partial)) = ending else {
                    panic!("it was interrupted after the first iteration")
                };
                let metadata = picture::read_metadata(&partial.exr).unwrap().unwrap();
                assert_eq!(metadata.iterations_asked, Some(40));
                assert!(
                    (done..u64::from(last)).contains(&metadata.iterations),
                    "nothing is lost"
                );
                done = metadata.iterations;
                let picture = folder.path().join("a.partial.exr");
                std::fs::write(&picture, &partial.exr).unwrap();
            }
            let from = format!("--from {}", folder.path().join("a.partial.exr").display());
            let (job, scene) = prepare(folder.path(), &from);
            let farm = FarmFolder::beside(Some(&folder.path().join("a.partial.exr"))).unwrap();
            assert!(matches!(farm, FarmFolder::Kept(_)));
            let rest = complete(
                render(&job, Arc::new(scene), farm.path(), 1, none, pending())
                    .await
                    .unwrap(),
            );
            assert!(
                rest.exr == whole.exr && rest.png == whole.png,
                "{integrator}: other bits"
            );
            let counts = |rendered: &Rendered| rendered.status.totals.counts;
            assert_eq!(counts(&rest), counts(&whole), "every iteration counts once");
            let (other, scene) = prepare(folder.path(), "--iterations 41");
            let error = render(&other, Arc::new(scene), farm.path(), 1, none, pending()).await;
            let error = error.err().unwrap().to_string();
            assert!(error.contains("another picture"), "{error}");
        }
    }
}
