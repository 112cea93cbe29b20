//! `photonfarm submit` sends a scene to a farm; `photonfarm wait` waits for a job.

use crate::args::{SubmitArgs, unique};
use crate::client::{Client, other_farm};
use crate::frames::picture_of;
use crate::job::PreparedJob;
use crate::output::PictureFiles;
use crate::progress::{Progress, is_shown_live, transfer};
use crate::say;
use crate::steer_args::{FetchArgs, WaitArgs};
use anyhow::{Context, Result, bail, ensure};
use photonfarm_core::picture;
use photonfarm_core::scene::Scene;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobState, JobStatus};
use std::cell::{Cell, RefCell};
use std::convert::Infallible;
use std::path::Path;
use std::time::Duration;

/// Iterations after which the noise of a picture is first looked at: an error is estimated from their scatter.
const FIRST_NOISE: u64 = 4;
/// Least time between two looks.
const NOISE_PAUSE: Duration = Duration::from_secs(1);

/// Runs the command.
pub(crate) fn run(args: SubmitArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(submit(args))
}

async fn submit(args: SubmitArgs) -> Result<()> {
    let frames: Vec<Option<u32>> = match &args.frames {
        Some(frames) => frames.0.iter().copied().map(Some).collect(),
        None => vec![None],
    };
    let path_of = |frame: Option<u32>| {
        let output = args.output.as_deref();
        output.map(|output| frame.map_or(output.to_owned(), |frame| picture_of(frame, output)))
    };
    let outputs = frames.iter().map(|frame| {
        let path = path_of(*frame);
        path.as_deref().map(PictureFiles::check).transpose()
    });
    let outputs = outputs.collect::<Result<Vec<_>>>()?;
    let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
    let (mut farm, mut sent) = (None, Vec::new());
    for frame in &frames {
        let told = |error| told_at(*frame, &sent, error);
        let (job, scene) = prepare(&args, *frame).map_err(told)?;
        if farm.is_none() {
            farm = Some(client.connect().await?.farm.farm);
        }
        let asked = send(&client, &job).await.map_err(told)?;
        if !args.json {
            match say::line(asked.id) {
                // The picture is what was asked for, whether or not somebody reads the number.
                Err(error) if args.wait && error.is::<say::ReaderLeft>() => {}
                said => said?,
            }
        }
        sent.push((asked, frames.len().eq(&1).then_some(scene)));
    }
    let farm = farm.unwrap_or_default();
    if !args.wait {
        return if args.json {
            tell_all(sent.into_iter().map(|(job, _)| job).collect())
        } else {
            Ok(())
        };
    }
    let (mut worst, mut ended) = (Ok(()), Vec::new());
    for (((asked, scene), output), frame) in sent.iter().zip(outputs).zip(frames) {
        let id = asked.id;
        let again = again(id, &args.farm.coordinator, &farm, path_of(frame).as_deref());
        say::tell(format_args!("job {id}; if this is interrupted, go on with: {again}"));
        match await_picture(&client, asked, output, scene.as_ref(), &again).await {
            // The other frames are waited for all the same.
            Err(error) if error.is::<JobEnded>() => worst = worst.and(Err(error)),
            result => result?,
        }
        if args.json {
            ended.push(client.status(id).await?);
        }
    }
    if args.json {
        tell_all(ended)?;
    }
    worst
}

/// A job as it is to be sent, of a frame where the scene has several.
fn prepare(args: &SubmitArgs, frame: Option<u32>) -> Result<(PreparedJob, Scene)> {
    let mut asked = args.job.clone();
    if frame.is_some() {
        ensure!(
            args.job.scene != Path::new("-"),
            "--frames reads the scene again for each frame, which standard input does not allow: name a file"
        );
        asked.frame = frame.map(f64::from);
    }
    let (mut job, scene) = PreparedJob::new(&asked)?;
    job.spec.schedule = args.schedule.schedule()?;
    job.spec.labels = unique("--label", &args.label)?;
    job.spec.after = args.after;
    job.spec.webhook = args.webhook.clone();
    job.spec.name = args.name.clone().unwrap_or_else(|| job.name.clone());
    job.key = args.key.clone().unwrap_or(job.key);
    if let Some(frame) = frame {
        let label = job.spec.labels.entry("frame".to_owned());
        label.or_insert_with(|| frame.to_string());
        job.spec.name += &format!(" {frame:04}");
        job.key += &format!(" frame {frame}");
    }
    Ok((job, scene))
}

/// An error, with what is to be known where not all frames were sent.
fn told_at(frame: Option<u32>, sent: &[(JobStatus, Option<Scene>)], error: anyhow::Error) -> anyhow::Error {
    let Some(frame) = frame else { return error };
    let numbers: Vec<String> = sent.iter().map(|(job, _)| job.id.to_string()).collect();
    error.context(match numbers.as_slice() {
        [] => format!("frame {frame} was not sent"),
        numbers => format!(
            "frame {frame} was not sent, nor those after it; the jobs {} go on",
            numbers.join(" ")
        ),
    })
}

/// Prints one job as JSON, several as a list.
fn tell_all(mut jobs: Vec<JobStatus>) -> Result<()> {
    match jobs.len() {
        1 => say::json(&jobs.remove(0)),
        _ => say::json(&jobs),
    }
}

/// Runs the command `wait`.
pub(crate) fn wait(args: WaitArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(async {
        let output = args.output.as_deref().map(PictureFiles::check).transpose()?;
        let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
        let farm = client.connect().await?.farm.farm;
        if let Some(expected) = args.identity.filter(|expected| *expected != farm) {
            bail!(other_farm(&farm, &expected));
        }
        ensure!(
            output.is_none() || args.jobs.len() == 1,
            "-o takes the picture of one job"
        );
        let mut output = output;
        let mut worst = Ok(());
        for job in &args.jobs {
            let asked = client.status(*job).await?;
            let again = again(*job, &args.farm.coordinator, &farm, args.output.as_deref());
            match await_picture(&client, &asked, output.take(), None, &again).await {
                // The other jobs are waited for all the same.
                Err(error) if args.jobs.len() > 1 && error.is::<JobEnded>() => {
                    say::tell(format_args!("error: {error}"));
                    worst = worst.and(Err(error));
                }
                result => result?,
            }
        }
        worst
    })
}

/// Runs the command `fetch`.
pub(crate) fn fetch_picture(args: FetchArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(async {
        let output = PictureFiles::check(&args.output)?;
        let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
        client.connect().await?;
        fetch(&client, &client.status(args.job).await?, &output, None).await
    })
}

/// A job ended without all of its iterations.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobEnded {
    /// It failed.
    #[error("job {0} failed: {1}")]
    Failed(JobId, String),
    /// Somebody cancelled it.
    #[error("job {0} was cancelled after {1} iterations{2}")]
    Cancelled(JobId, u64, String),
}

/// The command that goes on waiting.
fn again(id: JobId, coordinator: &str, farm: &str, output: Option<&Path>) -> String {
    let output = output.map(|path| format!(" -o {}", quoted(&path.display().to_string())));
    let (coordinator, farm) = (quoted(coordinator), quoted(farm));
    format!(
        "photonfarm wait {id} --coordinator {coordinator} --farm {farm}{}",
        output.unwrap_or_default()
    )
}

/// As a shell reads it.
fn quoted(text: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:@%+=,".contains(c);
    match !text.is_empty() && text.chars().all(plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', "'\\''")),
    }
}

/// Waits for a job and writes its picture; `again` is the command that does so.
async fn await_picture(
    client: &Client,
    asked: &JobStatus,
    output: Option<PictureFiles>,
    scene: Option<&Scene>,
    again: &str,
) -> Result<()> {
    let id = asked.id;
    let status = tokio::select! {
        status = follow(client, asked) => status?,
        signal = tokio::signal::ctrl_c() => {
            signal?;
            say::tell(format_args!("interrupted; job {id} goes on; to go on waiting: {again}"));
            return Err(crate::Interrupted.into());
        }
    };
    match output {
        Some(output) => fetch(client, &status, &output, scene).await,
        None => Ok(()),
    }
}

/// Sends what the farm lacks of the bundle, then the job. Returns the job as the farm has taken it.
pub(crate) async fn send(client: &Client, job: &PreparedJob) -> Result<JobStatus> {
    let reply = client.announce(&job.manifest).await?;
    let contents = reply.missing.iter().filter_map(|hash| job.contents.get(hash));
    let bar = transfer("sending", contents.map(|bytes| bytes.len() as u64).sum());
    for hash in reply.missing {
        let Some(bytes) = job.contents.get(&hash) else {
            bail!("the coordinator asks for {hash}, which is no file of the scene");
        };
        let named = job.manifest.files.iter().find(|(_, file)| file.hash == hash);
        let name = named.map_or("a file", |(name, _)| name.as_str());
        let context = || format!("cannot send {name} ({} bytes)", bytes.len());
        client.upload(hash, bytes).await.with_context(context)?;
        bar.inc(bytes.len() as u64);
    }
    bar.finish_and_clear();
    client.submit(&job.spec, &job.key).await
}

/// Shows progress until the job is done.
pub(crate) async fn follow(client: &Client, asked: &JobStatus) -> Result<JobStatus> {
    ended_well(follow_to_end(client, asked, is_shown_live()).await?)
}

/// Shows progress until the job ends, however it does; with the noise of the picture where that is `measured`.
pub(crate) async fn follow_to_end(client: &Client, asked: &JobStatus, measured: bool) -> Result<JobStatus> {
    let progress = RefCell::new(Progress::start(asked.spec.iterations));
    let done = Cell::new(0);
    let watch = |status: &JobStatus| {
        check_same(asked, status)?;
        done.set(status.iterations_done);
        progress.borrow_mut().update(status);
        Ok(())
    };
    let status = tokio::select! {
        status = client.follow(asked.id, watch) => status,
        never = measure_noise(client, asked.id, &done, &progress), if measured => match never {},
    };
    progress.borrow().finish();
    status
}

/// Looks at the noise of the picture whenever the number of iterations in it has doubled.
async fn measure_noise(client: &Client, job: JobId, done: &Cell<u64>, progress: &RefCell<Progress>) -> Infallible {
    let mut next = FIRST_NOISE;
    loop {
        tokio::time::sleep(NOISE_PAUSE).await;
        if done.get() < next {
            continue;
        }
        next = 2 * done.get();
        match client.noise(job).await {
            Ok(Some(noise)) => progress.borrow_mut().note_noise(noise),
            Ok(None) => {}
            Err(error) => tracing::debug!("the noise is not known: {error:#}"),
        }
    }
}

/// A job that is done; else an error that says how it ended.
pub(crate) fn ended_well(status: JobStatus) -> Result<JobStatus> {
    let id = status.id;
    match status.state {
        JobState::Done => Ok(status),
        JobState::Cancelled => {
            let reason = status.failure.as_ref().map(|reason| format!(": {reason}"));
            Err(JobEnded::Cancelled(id, status.iterations_done, reason.unwrap_or_default()).into())
        }
        _ => Err(JobEnded::Failed(id, failure(&status)).into()),
    }
}

/// Writes the picture of a finished job.
async fn fetch(client: &Client, status: &JobStatus, output: &PictureFiles, scene: Option<&Scene>) -> Result<()> {
    let exr = client.image(status.id, "exr").await?;
    let png = client.image(status.id, "png").await?;
    // The farm may have been restored between the job's end and now.
    check_same(status, &client.status(status.id).await?)?;
    output.write(&exr, &png)?;
    say::tell(format_args!("{}: {}", output.names(), in_words(&exr)?));
    tell_if_black(&exr, scene)
}

/// Says of a black picture that it is, and why if the scene is at hand.
pub(crate) fn tell_if_black(exr: &[u8], scene: Option<&Scene>) -> Result<()> {
    let picture = picture::decode_exr(exr, usize::MAX)?;
    if picture.pixels.iter().all(|pixel| pixel.is_black()) {
        let why = scene.zip(picture.metadata).map_or(String::new(), |(scene, metadata)| {
            format!(": {}", scene.why_black(&metadata.integrator))
        });
        say::tell(format_args!("warning: the picture is black{why}"));
    }
    Ok(())
}

/// Iterations and noise of a picture.
pub(crate) fn in_words(exr: &[u8]) -> Result<String> {
    let metadata = picture::read_metadata(exr)?.context("the coordinator sent a picture without metadata")?;
    let noise = metadata.noise.map(|noise| format!(", noise {noise:.4}"));
    Ok(format!(
        "{} iterations{}",
        metadata.iterations,
        noise.unwrap_or_default()
    ))
}

/// Refuses a job that has the number of the one that was asked for, and is another one.
fn check_same(asked: &JobStatus, found: &JobStatus) -> Result<()> {
    // What may change while a job goes on.
    let spec = JobSpec {
        iterations: asked.spec.iterations,
        schedule: asked.spec.schedule.clone(),
        ..found.spec.clone()
    };
    if spec != asked.spec || found.created_ms != asked.created_ms {
        bail!(
            "job {} is not the one that was asked for: the farm was restored from a backup, or another one answers now; \
             submit again",
            asked.id
        );
    }
    Ok(())
}

fn failure(status: &JobStatus) -> String {
    let poisoned = || {
        let iteration = status.poisoned.first()?;
        let attempt = iteration.attempts.last()?;
        Some(format!("iteration {}: {}", iteration.iteration, attempt.message))
    };
    status
        .failure
        .clone()
        .or_else(poisoned)
        .unwrap_or_else(|| "no reason was given".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a farm that was restored, or another one, may say of the same number.
    #[test]
    fn another_job_of_the_same_number_is_refused() {
        let asked: JobStatus = serde_json::from_value(serde_json::json!({
            "id": 10, "created_ms": 5, "state": "queued", "iterations_done": 0, "iterations_rendered": 0,
            "poisoned": [], "totals": photonfarm_proto::job::Totals::default(), "workers": 0, "spec": {
                "scene": "0".repeat(64), "main": "scene.xml", "iterations": 4, "seed": 1,
                "integrator": {"type": "path"}}}))
        .unwrap();
        let mut found = asked.clone();
        found.spec.iterations = 8;
        found.state = JobState::Done;
        check_same(&asked, &found).unwrap();
        let other = JobStatus {
            created_ms: 6,
            ..found.clone()
        };
        assert!(
            check_same(&asked, &other)
                .unwrap_err()
                .to_string()
                .contains("job 10 is not the one")
        );
        found.spec.seed = 2;
        assert!(check_same(&asked, &found).is_err());
    }

    #[test]
    fn commands_are_quoted_for_the_shell() {
        assert_eq!(
            again(JobId(3), "http://[::1]:7800", "ab12", Some(Path::new("it's mine.exr"))),
            "photonfarm wait 3 --coordinator 'http://[::1]:7800' --farm ab12 -o 'it'\\''s mine.exr'"
        );
        assert_eq!(
            again(JobId(3), "https://farm:7800", "ab12", None),
            "photonfarm wait 3 --coordinator https://farm:7800 --farm ab12"
        );
    }
}
