//! `photonfarm submit`: sends a scene to a farm.

use crate::args::SubmitArgs;
use crate::client::Client;
use crate::job::PreparedJob;
use crate::output::PictureFiles;
use crate::progress::Progress;
use anyhow::{Result, bail};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobState, JobStatus};

/// Runs the command.
pub(crate) fn run(args: SubmitArgs) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(submit(args))
}

async fn submit(args: SubmitArgs) -> Result<()> {
    let output = args.output.as_deref().map(PictureFiles::check).transpose()?;
    let client = Client::new(&args.coordinator, args.credentials.load()?)?;
    let (mut job, _) = PreparedJob::new(&args.job)?;
    job.spec.schedule = args.schedule.schedule()?;
    client.connect().await?;
    let id = send(&client, &job).await?;
    println!("{id}");
    if !args.wait {
        return Ok(());
    }
    let status = tokio::select! {
        status = follow(&client, id, job.spec.iterations) => status?,
        signal = tokio::signal::ctrl_c() => {
            signal?;
            eprintln!("interrupted; job {id} goes on at {}", args.coordinator);
            return Err(crate::Interrupted.into());
        }
    };
    if let Some(output) = output {
        fetch(&client, &status, &output).await?;
    }
    Ok(())
}

/// Sends what the farm lacks of the bundle, then the job.
pub(crate) async fn send(client: &Client, job: &PreparedJob) -> Result<JobId> {
    let reply = client.announce(&job.manifest).await?;
    for hash in reply.missing {
        let Some(bytes) = job.contents.get(&hash) else {
            bail!("the coordinator asks for {hash}, which is no file of the scene");
        };
        client.upload(hash, bytes).await?;
    }
    Ok(client.submit(&job.spec, &job.key).await?.id)
}

/// Shows progress until the job is done.
pub(crate) async fn follow(client: &Client, id: JobId, iterations: u32) -> Result<JobStatus> {
    let mut progress = Progress::start(iterations);
    let status = client.follow(id, |status| progress.update(status)).await;
    progress.finish();
    let status = status?;
    match status.state {
        JobState::Done => Ok(status),
        JobState::Cancelled => bail!("job {id} was cancelled after {} iterations", status.iterations_done),
        _ => bail!("job {id} failed: {}", failure(&status)),
    }
}

/// Writes the picture of a finished job.
pub(crate) async fn fetch(client: &Client, status: &JobStatus, output: &PictureFiles) -> Result<()> {
    let exr = client.image(status.id, "exr").await?;
    let png = client.image(status.id, "png").await?;
    output.write(&exr, &png)?;
    eprintln!("{}: {} iterations", output.names(), status.iterations_done);
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
