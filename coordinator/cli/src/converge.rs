//! `photonfarm converge`: the error of a picture against a reference, after more and more iterations.
//!
//! The job is asked for one iteration, then extended to 2, 4, 8, ...: each step keeps the iterations that are done, and its
//! picture has the bits of a job with that number from the start. Between the steps nothing is rendered, so that looking costs
//! no time that counts.

use crate::args::{JobArgs, positive};
use crate::client::Client;
use crate::compare::{read, read_exr};
use crate::job::PreparedJob;
use crate::kept::{self, FarmFolder, Spent};
use crate::local::{self, LocalFarm};
use crate::metrics::{EPSILON, Errors, Pixels};
use crate::output::OutputFile;
use crate::plot::{self, Chart};
use crate::steer_args::duration;
use crate::{Interrupted, say, submit};
use anyhow::{Result, bail, ensure};
use clap::Args;
use indicatif::HumanDuration;
use photonfarm_proto::api::Extend;
use photonfarm_proto::id::BlobHash;
use photonfarm_worker::CoreScene;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::convert::Infallible;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm render scene.xml -o reference.exr --integrator path --iterations 65536
  photonfarm converge scene.xml --reference reference.exr --iterations 1024 -o pcf.csv --plot pcf.png
      The error after 1, 2, 4, ... 1024 iterations, as a table and as curves.
  photonfarm converge scene.xml --reference reference.exr --integrator pppm --probe 120,80 --probe 3,9
      With the radiance of two pixels, to standard output.
  photonfarm converge scene.xml --reference reference.exr --iterations 100000 --within 10m
      As many as fit into ten minutes of rendering.

Columns: iterations; seconds of rendering; mse, the mean of (a - b)^2 over pixels and channels; relmse,
that of (a - b)^2 / (b^2 + epsilon), where b is the reference; red, green and blue of each probe. Seconds
count no reading of the scene and no making of pictures. After Ctrl-C or a crash the same command with -o goes
on where it was, in OUT.converge.farm beside the table. A reference by the same integrator and seed has
the same noise: give it another seed.";

/// The curve in the folder of its farm, as JSON.
const CURVE: &str = "curve.json";

#[derive(Debug, Args)]
pub(crate) struct ConvergeArgs {
    #[command(flatten)]
    job: JobArgs,
    /// Picture of the same view that errors are told against
    #[arg(long, value_name = "REF.exr")]
    reference: PathBuf,
    /// Write the radiance of this pixel as well, counted from 0 at the top left (repeatable)
    #[arg(long, value_name = "X,Y", value_parser = pixel)]
    probe: Vec<[u32; 2]>,
    /// Table to write [default: standard output]
    #[arg(short, long, value_name = "OUT.csv")]
    output: Option<PathBuf>,
    /// Picture of the curves to write, as PNG
    #[arg(long, value_name = "OUT.png")]
    plot: Option<PathBuf>,
    /// What is added to the square of the reference in relMSE
    #[arg(long, value_name = "E", default_value_t = EPSILON, value_parser = positive)]
    epsilon: f64,
    /// Begin no step once rendering has taken this time, such as 90s, 30m or 8h; that before an interruption counts
    #[arg(long, value_name = "TIME", value_parser = duration)]
    within: Option<Duration>,
    /// Threads to render with [default: one per processor]
    #[arg(long, value_name = "T")]
    threads: Option<NonZeroUsize>,
}

/// A pixel: column and row.
fn pixel(text: &str) -> Result<[u32; 2], String> {
    let numbers = text.split_once(',').map(|(x, y)| (x.trim().parse(), y.trim().parse()));
    match numbers {
        Some((Ok(x), Ok(y))) => Ok([x, y]),
        _ => Err("expected column and row of a pixel, such as 120,80".to_owned()),
    }
}

/// The picture after a number of iterations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Row {
    iterations: u32,
    seconds: f64,
    errors: Errors,
    probes: Vec<[f32; 3]>,
}

/// Runs the command.
pub(crate) fn run(args: ConvergeArgs) -> Result<()> {
    let output = args.output.as_deref().map(OutputFile::check).transpose()?;
    let plot = args.plot.as_deref().map(OutputFile::check).transpose()?;
    let reference = read(&args.reference)?.pixels;
    let (job, scene) = PreparedJob::new(&args.job)?;
    check_sizes(&args, &reference, scene.film.size())?;
    let layers = job.spec.layers()?;
    let work = work(&args, &job, &reference)?;
    let farm = Curve::folder(args.output.as_deref(), &work)?;
    let curve = RefCell::new(Curve::kept_in(farm.path(), work));
    let runtime = tokio::runtime::Runtime::new()?;
    let local = LocalFarm {
        folder: farm.path(),
        scene: Arc::new(CoreScene::new(scene, layers)),
        threads: local::threads(args.threads),
        deadline_ms: None,
        spent: Spent::on(farm.path(), &())?,
    };
    let ended = runtime.block_on(async {
        let work = async |client: &Client| {
            tokio::select! {
                ended = measure(client, job, &args, &reference, &curve) => ended,
                never = Curve::keep(&curve) => match never {},
                signal = tokio::signal::ctrl_c() => signal.map_err(Into::into).and(Err(Interrupted.into())),
            }
        };
        local.run(work, |()| true).await
    });
    runtime.shutdown_background();
    let curve = curve.into_inner();
    let interrupted = ended.as_ref().is_err_and(|error| error.is::<Interrupted>());
    match &ended {
        Ok(()) => farm.remove()?,
        Err(_) if interrupted && args.output.is_some() => {
            curve.note();
            say::tell("interrupted; to go on, give the same command again");
        }
        // Nothing comes of a job that has failed.
        Err(error) if error.is::<submit::JobEnded>() => farm.remove()?,
        Err(_) => {}
    }
    let rows = curve.rows;
    if interrupted && rows.is_empty() {
        return ended;
    }
    if !interrupted {
        ended?;
    }
    let table = table(&args.probe, &rows);
    match output {
        Some(file) => file.write(table.as_bytes())?,
        None => say::line(table.trim_end())?,
    }
    if let Some(file) = plot {
        file.write(&plot::png(&charts(&args, &rows))?)?;
    }
    match interrupted {
        true => Err(Interrupted.into()),
        false => Ok(()),
    }
}

fn check_sizes(args: &ConvergeArgs, reference: &Pixels, resolution: [u32; 2]) -> Result<()> {
    let (name, [width, height]) = (args.reference.display(), resolution);
    ensure!(
        [reference.width, reference.height] == resolution,
        "{name} has {} by {} pixels and pictures of the scene {width} by {height}: render the reference from the same scene, \
         with the same -D",
        reference.width,
        reference.height
    );
    for [x, y] in &args.probe {
        ensure!(
            *x < width && *y < height,
            "--probe {x},{y} lies outside the picture: columns are 0 to {}, rows 0 to {}",
            width - 1,
            height - 1
        );
    }
    Ok(())
}

/// 1, 2, 4, ... and at last `all`.
fn steps(all: u32) -> impl Iterator<Item = u32> {
    let powers = (0..u32::BITS).map(|level| 1 << level);
    powers.take_while(move |power| *power < all).chain([all])
}

/// What makes a curve the same: what is rendered, and what it is held against and how.
fn work(args: &ConvergeArgs, job: &PreparedJob, reference: &Pixels) -> Result<String> {
    let values = reference.values.iter().flat_map(|pixel| pixel.to_rgb());
    let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
    let work = (&job.spec, BlobHash::of(&bytes), args.epsilon, &args.probe);
    Ok(BlobHash::of(&serde_json::to_vec(&work)?).to_string())
}

/// A curve as far as it has come. An interrupted command leaves it in the folder of its farm.
#[derive(Debug)]
struct Curve {
    path: PathBuf,
    /// Hash of what makes it the same.
    work: String,
    rows: Vec<Row>,
    /// Seconds of rendering, but for those since `step`.
    seconds: f64,
    /// When the step at hand began.
    step: Option<Instant>,
}

/// A curve in its file.
#[derive(Serialize, Deserialize)]
struct CurveFile {
    work: String,
    rows: Vec<Row>,
    seconds: f64,
}

impl Curve {
    /// The folder of the farm: beside the table, where that is a file. What another curve left there is removed.
    fn folder(output: Option<&Path>, work: &str) -> Result<FarmFolder> {
        let Some(output) = output else {
            return FarmFolder::beside(None);
        };
        let farm = FarmFolder::at(output.with_extension("converge.farm"))?;
        let known = Self::read(&farm.path().join(CURVE)).is_some_and(|file| file.work == work);
        if farm.path().exists() && !known {
            let folder = farm.path().display().to_string();
            farm.remove()?;
            say::tell(format_args!("{folder} held a part of another curve, which is left out"));
            return Self::folder(Some(output), work);
        }
        Ok(farm)
    }

    fn read(path: &Path) -> Option<CurveFile> {
        serde_json::from_slice(&std::fs::read(path).ok()?).ok()
    }

    /// As far as an earlier command came.
    fn kept_in(folder: &Path, work: String) -> Self {
        let path = folder.join(CURVE);
        let known = Self::read(&path);
        if let Some(last) = known.as_ref().and_then(|known| known.rows.last()) {
            say::tell(format_args!("going on after {} iterations", last.iterations));
        }
        let (rows, seconds) = known.map_or((Vec::new(), 0.0), |known| (known.rows, known.seconds));
        let step = None;
        Self {
            path,
            work,
            rows,
            seconds,
            step,
        }
    }

    /// Seconds of rendering by now.
    fn seconds(&self) -> f64 {
        self.seconds + self.step.map_or(0.0, |step| step.elapsed().as_secs_f64())
    }

    /// Writes it down. A folder that cannot be written shows soon enough by other means.
    fn note(&self) {
        let file = CurveFile {
            work: self.work.clone(),
            rows: self.rows.clone(),
            seconds: self.seconds(),
        };
        if let Err(error) = kept::write(&self.path, &file) {
            tracing::debug!("the curve is not kept: {error:#}");
        }
    }

    /// Writes it down again and again.
    async fn keep(curve: &RefCell<Self>) -> Infallible {
        loop {
            tokio::time::sleep(kept::NOTED_EVERY).await;
            curve.borrow().note();
        }
    }
}

/// Renders step by step, from where the curve ends.
async fn measure(
    client: &Client,
    mut job: PreparedJob,
    args: &ConvergeArgs,
    reference: &Pixels,
    curve: &RefCell<Curve>,
) -> Result<()> {
    let all = job.spec.iterations;
    let done = curve.borrow().rows.last().map_or(0, |row| row.iterations);
    for iterations in steps(all).filter(|iterations| *iterations > done) {
        let seconds = curve.borrow().seconds();
        if args.within.is_some_and(|most| seconds >= most.as_secs_f64()) {
            say::tell(format_args!("the time is up before {iterations} iterations"));
            break;
        }
        curve.borrow_mut().step = Some(Instant::now());
        let asked = match client.jobs(1, &[]).await?.pop() {
            None => {
                job.spec.iterations = iterations;
                submit::send(client, &job).await?
            }
            Some(known) => client.post_job(known.id, "extend", &Extend { iterations }).await?,
        };
        let status = client.follow(asked.id, |_| Ok(())).await?;
        let seconds = curve.borrow().seconds();
        {
            let mut curve = curve.borrow_mut();
            (curve.seconds, curve.step) = (seconds, None);
        }
        let status = submit::ended_well(status)?;
        let picture = read_exr(&client.image(status.id, "exr").await?)?.pixels;
        if (picture.width, picture.height) != (reference.width, reference.height) {
            bail!("the picture has another size than the reference");
        }
        picture.check("the picture")?;
        let errors = picture.errors(reference, args.epsilon);
        let at = |[x, y]: &[u32; 2]| picture.values[(y * picture.width + x) as usize].to_rgb();
        let time = HumanDuration(Duration::from_secs_f64(seconds));
        let (mse, relmse) = (errors.mse, errors.relmse);
        say::tell(format_args!(
            "{iterations}/{all} iterations, {time}, MSE {mse:.3e}, relMSE {relmse:.3e}"
        ));
        let row = Row {
            iterations,
            seconds,
            errors,
            probes: args.probe.iter().map(at).collect(),
        };
        curve.borrow_mut().rows.push(row);
        curve.borrow().note();
    }
    Ok(())
}

/// The rows as CSV (RFC 4180, with LF).
fn table(probes: &[[u32; 2]], rows: &[Row]) -> String {
    let mut text = "iterations,seconds,mse,relmse".to_owned();
    for [x, y] in probes {
        for channel in ["red", "green", "blue"] {
            text += &format!(",{channel}_{x}_{y}");
        }
    }
    text.push('\n');
    for row in rows {
        let Errors { mse, relmse } = row.errors;
        text += &format!("{},{:.6},{mse:e},{relmse:e}", row.iterations, row.seconds);
        row.probes
            .iter()
            .flatten()
            .for_each(|value| text += &format!(",{value:e}"));
        text.push('\n');
    }
    text
}

fn charts(args: &ConvergeArgs, rows: &[Row]) -> [Chart; 2] {
    let scene = args.job.scene.file_name().unwrap_or_default().to_string_lossy();
    let chart = |x: &'static str, at: fn(&Row) -> f64| Chart {
        title: format!("{scene} against {x}"),
        x,
        curves: vec![
            ("relMSE", rows.iter().map(|row| (at(row), row.errors.relmse)).collect()),
            ("MSE", rows.iter().map(|row| (at(row), row.errors.mse)).collect()),
        ],
    };
    [
        chart("iterations", |row| f64::from(row.iterations)),
        chart("seconds", |row| row.seconds),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_double_and_end_with_all() {
        assert_eq!(steps(1).collect::<Vec<_>>(), [1]);
        assert_eq!(steps(8).collect::<Vec<_>>(), [1, 2, 4, 8]);
        assert_eq!(steps(9).collect::<Vec<_>>(), [1, 2, 4, 8, 9]);
    }

    #[test]
    fn pixels_are_read_as_column_and_row() {
        assert_eq!(pixel("120, 80"), Ok([120, 80]));
        for bad in ["", "1", "1,", "1,-2", "a,b"] {
            assert!(pixel(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_curve_is_gone_on_with_and_another_one_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("a.csv");
        let open = |work: &str| {
            let farm = Curve::folder(Some(&output), work).unwrap();
            Curve::kept_in(farm.path(), work.to_owned())
        };
        let row = Row {
            iterations: 2,
            seconds: 0.5,
            errors: Errors { mse: 0.25, relmse: 2.0 },
            probes: vec![[0.5, 1.0, 2.0]],
        };
        let mut first = open("a");
        std::fs::create_dir(folder.path().join("a.converge.farm")).unwrap();
        std::fs::write(folder.path().join("a.converge.farm/farm.sqlite"), "").unwrap();
        first.rows.push(row.clone());
        (first.seconds, first.step) = (1.0, Some(Instant::now()));
        first.note();
        let second = open("a");
        assert_eq!(second.rows, [row]);
        assert!(
            (1.0..60.0).contains(&second.seconds),
            "the step that was interrupted counts"
        );
        let other = open("b");
        assert_eq!((other.rows.len(), other.seconds), (0, 0.0));
        assert!(!folder.path().join("a.converge.farm").exists());
    }

    #[test]
    fn rows_become_lines() {
        let row = Row {
            iterations: 2,
            seconds: 0.5,
            errors: Errors { mse: 0.25, relmse: 2.0 },
            probes: vec![[1.0, 0.5, 0.0]],
        };
        assert_eq!(
            table(&[[3, 4]], &[row]),
            "iterations,seconds,mse,relmse,red_3_4,green_3_4,blue_3_4\n2,0.500000,2.5e-1,2e0,1e0,5e-1,0e0\n"
        );
    }
}
