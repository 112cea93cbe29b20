//! `photonfarm submit` sends a scene to a farm; `photonfarm wait` waits for a job.

use crate::args::SubmitArgs;
use crate::client::{Client, other_farm};
use crate::job::PreparedJob;
use crate::output::PictureFiles;
use crate::progress::Progress;
use crate::say;
use crate::steer_args::{FetchArgs, WaitArgs};
use anyhow::{Context, Result, bail, ensure};
use photonfarm_core::picture;
use photonfarm_core::scene::Scene;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobState, JobStatus, NAME_BYTES};
use std::ffi::OsStr;
use std::path::Path;

/// Runs the command.
pub(crate) fn run(args: SubmitArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(submit(args))
}

async fn submit(args: SubmitArgs) -> Result<()> {
    let output = args.output.as_deref().map(PictureFiles::check).transpose()?;
    let client = Client::new(&args.farm.coordinator, args.farm.credentials.load()?)?;
    let (mut job, scene) = PreparedJob::new(&args.job)?;
    job.spec.schedule = args.schedule.schedule()?;
    job.spec.name = args.name.unwrap_or_else(|| name_of(&args.job.scene));
    job.key = args.key.unwrap_or(job.key);
    let farm = client.connect().await?.farm.farm;
    let asked = send(&client, &job).await?;
    let id = asked.id;
    let said = say::line(id);
    if !args.wait {
        return said;
    }
    // The picture is what was asked for, whether or not somebody reads the number.
    match said {
        Err(error) if !error.is::<say::ReaderLeft>() => return Err(error),
        _ => {}
    }
    let again = again(id, &args.farm.coordinator, &farm, args.output.as_deref());
    say::tell(format_args!("job {id}; if this is interrupted, go on with: {again}"));
    await_picture(&client, &asked, output, Some(&scene), &again).await
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

/// A name for a job that renders a scene file: the file's own, or its folder's where that says nothing.
fn name_of(scene: &Path) -> String {
    let part = |part: Option<&OsStr>| part.map(|part| part.to_string_lossy().into_owned());
    let file = part(scene.file_stem()).unwrap_or_default();
    let folder = scene.canonicalize().ok();
    let folder = folder.and_then(|scene| part(scene.parent()?.file_name()));
    let mut name = match file.as_str() {
        "scene" | "main" | "index" => folder.unwrap_or(file),
        _ => file,
    };
    name.retain(|c| !c.is_control());
    while name.len() > NAME_BYTES {
        name.pop();
    }
    name
}

/// A job ended without all of its iterations.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JobEnded {
    /// It failed.
    #[error("job {0} failed: {1}")]
    Failed(JobId, String),
    /// Somebody cancelled it.
    #[error("job {0} was cancelled after {1} iterations")]
    Cancelled(JobId, u64),
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
    for hash in reply.missing {
        let Some(bytes) = job.contents.get(&hash) else {
            bail!("the coordinator asks for {hash}, which is no file of the scene");
        };
        let named = job.manifest.files.iter().find(|(_, file)| file.hash == hash);
        let name = named.map_or("a file", |(name, _)| name.as_str());
        let context = || format!("cannot send {name} ({} bytes)", bytes.len());
        client.upload(hash, bytes).await.with_context(context)?;
    }
    client.submit(&job.spec, &job.key).await
}

/// Shows progress until the job is done.
pub(crate) async fn follow(client: &Client, asked: &JobStatus) -> Result<JobStatus> {
    let id = asked.id;
    let mut progress = Progress::start(asked.spec.iterations);
    let watch = |status: &JobStatus| {
        check_same(asked, status)?;
        progress.update(status);
        Ok(())
    };
    let status = client.follow(id, watch).await;
    progress.finish();
    let status = status?;
    match status.state {
        JobState::Done => Ok(status),
        JobState::Cancelled => Err(JobEnded::Cancelled(id, status.iterations_done).into()),
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
    fn jobs_are_called_as_their_scenes() {
        for (scene, name) in [
            ("glass.pbrt", "glass"),
            ("a/ring.xml", "ring"),
            ("a/b\u{7}.glb", "b"),
            ("/nowhere/scene.xml", "scene"),
        ] {
            assert_eq!(name_of(Path::new(scene)), name);
        }
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("kitchen/scene.xml");
        std::fs::create_dir(scene.parent().unwrap()).unwrap();
        std::fs::write(&scene, "").unwrap();
        assert_eq!(name_of(&scene), "kitchen");
        assert_eq!(name_of(Path::new(&"ä".repeat(300))).len(), NAME_BYTES);
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
