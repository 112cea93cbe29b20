//! `photonfarm render`: a coordinator and a worker in one process.

use crate::args::RenderArgs;
use crate::client::Client;
use crate::job::PreparedJob;
use crate::kept::{self, FarmFolder};
use crate::local::{self, LocalFarm};
use crate::output::{OutputFile, PictureFiles};
use crate::say;
use crate::stats::Stats;
use crate::steer_args::deadline;
use crate::{Interrupted, submit};
use anyhow::{Context, Result, bail};
use photonfarm_core::picture;
use photonfarm_core::scene::Scene;
use photonfarm_proto::RENDERER;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobState, JobStatus};
use photonfarm_worker::{CoreScene, LoadedScene};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Runs the command.
pub(crate) fn run(args: RenderArgs) -> Result<()> {
    let started = Instant::now();
    let output = Output::check(&args)?;
    let stats = args.stats.as_deref().map(OutputFile::check).transpose()?;
    let (mut job, scene) = PreparedJob::new(&args.job)?;
    job.spec.schedule.deadline_ms = args.within.map(deadline).transpose()?;
    job.spec.schedule.noise_target = args.noise_target;
    let load_seconds = started.elapsed().as_secs_f64();
    // A deadline is one of this process: there is nothing to go on with later.
    let (farm, earlier) = match (&args.job.from, args.within) {
        (None, None) => (FarmFolder::of(&args.output)?, Earlier::Replaced),
        (from, _) => (FarmFolder::beside(from.as_deref())?, Earlier::Expected),
    };
    let runtime = tokio::runtime::Runtime::new()?;
    let threads = local::threads(args.threads);
    let interrupt = tokio::signal::ctrl_c();
    let layers = job.spec.layers()?;
    let scene = Arc::new(CoreScene { scene, layers });
    let preview = async |client: &Client, job: JobId| match args.preview {
        Some(seconds) => previews(client, job, Duration::from_secs_f64(seconds), &output, &scene.scene).await,
        None => std::future::pending().await,
    };
    let place = (farm.path(), earlier);
    let result = runtime.block_on(render(&job, scene.clone(), place, threads, preview, interrupt));
    // An iteration that was interrupted need not come to its end.
    runtime.shutdown_background();
    let rendered = match result {
        Err(error) => {
            // Nothing comes of a job that has failed.
            if error.is::<submit::JobEnded>() {
                farm.remove()?;
            }
            return Err(error);
        }
        Ok(ending) => ending,
    };
    let rendered = match rendered {
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
        farm.remove()?;
        return Err(Interrupted.into());
    };
    let picture = kept::partial(&args.output);
    kept::keep(farm, &picture, exr, png)?;
    let metadata = picture::read_metadata(exr)?.context("the picture has no metadata")?;
    let done = metadata.iterations;
    let all = metadata.iterations_asked.map_or(done, u64::from);
    let (scene, picture, output) = (args.job.scene.display(), picture.display(), args.output.display());
    say::tell(format_args!(
        "interrupted after {done} of {all} iterations, which {picture} holds. To go on, give the same command again, or:\n    \
         photonfarm render {scene} --from {picture} -o {output}"
    ));
    Err(Interrupted.into())
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

/// What is in the folder of a render's farm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Earlier {
    /// A part of this picture, or nothing.
    Expected,
    /// Whatever an earlier render of a picture of this name left: of another picture it counts no more.
    Replaced,
}

/// Renders a job in the data folder `farm`, in which an earlier render may have left a part of it, until it is done or `interrupt`
/// comes.
async fn render(
    job: &PreparedJob,
    scene: Arc<dyn LoadedScene>,
    (farm, earlier): (&Path, Earlier),
    threads: usize,
    preview: impl AsyncFnOnce(&Client, JobId) -> Result<()>,
    interrupt: impl Future<Output = std::io::Result<()>>,
) -> Result<Ending> {
    let work = async |client: &Client| {
        let picture = async {
            let asked = begin(client, job, farm, earlier).await?;
            let status = tokio::select! {
                status = submit::follow(client, &asked) => status?,
                Err(error) = preview(client, asked.id) => return Err(error),
            };
            fetch(client, status).await.map(Ending::Complete)
        };
        tokio::select! {
            result = picture => result,
            signal = interrupt => match signal {
                Ok(()) => interrupted(client).await.map(Ending::Interrupted),
                Err(error) => Err(error.into()),
            },
        }
    };
    let local = LocalFarm {
        folder: farm,
        scene,
        threads,
    };
    local.run(work, |ending| matches!(ending, Ending::Complete(_))).await
}

/// Sends the job, or finds it where an earlier render has begun with it.
async fn begin(client: &Client, job: &PreparedJob, farm: &Path, earlier: Earlier) -> Result<JobStatus> {
    let Some(begun) = client.jobs(1, &[]).await?.pop() else {
        return submit::send(client, job).await;
    };
    let (done, all) = (begun.iterations_done, job.spec.iterations);
    let is_same = match earlier {
        Earlier::Expected => {
            let schedule = job.spec.schedule.clone();
            job.spec
                == JobSpec {
                    schedule,
                    ..begun.spec.clone()
                }
        }
        Earlier::Replaced => {
            let built_alike = begun.renderer.as_ref().is_none_or(|build| build == RENDERER);
            let goes_on = !begun.state.ended() || begun.state == JobState::Done;
            begun.spec == job.spec && built_alike && goes_on
        }
    };
    if is_same {
        say::tell(format_args!("going on after {done} of {all} iterations"));
        return Ok(begun);
    }
    let farm = farm.display();
    if earlier == Earlier::Expected {
        bail!("{farm} holds a part of another picture: remove it, and the picture is rendered from the beginning");
    }
    say::tell(format_args!("{farm} held a part of another picture, which is left out"));
    if !begun.state.ended() {
        client.post_job(begun.id, "cancel", &serde_json::json!({})).await?;
    }
    client.delete_job(begun.id).await?;
    submit::send(client, job).await
}

/// What there is of the picture. One worker delivers iterations in their order, so that they are the first ones.
async fn interrupted(client: &Client) -> Result<Option<Rendered>> {
    match client
        .jobs(1, &[])
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use photonfarm_core::integrator::{Iteration, Observer, RenderError};
    use photonfarm_core::scene::Wishes;
    use photonfarm_core::settings::IntegratorSettings;
    use photonfarm_proto::job::BandwidthRange;
    use photonfarm_worker::CancellationToken;
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
            let whole = render(
                &job,
                Arc::new(scene),
                (&folder.path().join("whole"), Earlier::Expected),
                1,
                none,
                pending(),
            )
            .await;
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
                let ending = render(&job, Arc::new(stuck), (&work, Earlier::Replaced), 1, none, interrupt)
                    .await
                    .unwrap();
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
                render(
                    &job,
                    Arc::new(scene),
                    (farm.path(), Earlier::Expected),
                    1,
                    none,
                    pending(),
                )
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
            let error = render(
                &other,
                Arc::new(scene),
                (farm.path(), Earlier::Expected),
                1,
                none,
                pending(),
            )
            .await;
            let error = error.err().unwrap().to_string();
            assert!(error.contains("another picture"), "{error}");
            let place = (farm.path(), Earlier::Replaced);
            let (other, scene) = prepare(folder.path(), "--iterations 41");
            let anew = complete(
                render(&other, Arc::new(scene), place, 1, none, pending())
                    .await
                    .unwrap(),
            );
            assert_eq!(anew.status.iterations_done, 41, "what was there is left out");
        }
    }
}
