//! `photonfarm jobs`, `pause`, `resume`, `cancel`, `delete`, `resubmit`, `retry`, `extend`, `priority`, `workers`, `drain`: looks at a farm and steers it.

use crate::client::Client;
use crate::farm_args::CredentialArgs;
use crate::say;
use crate::steer_args::{
    DeleteArgs, DrainArgs, ExtendArgs, JobArg, JobsArgs, PriorityArgs, WorkersArgs, WorkersCommand,
};
use crate::table;
use anyhow::{Context, Result, ensure};
use photonfarm_proto::api::{Extend, Quarantine, SetPriority};
use photonfarm_proto::job::JobStatus;
use std::io::IsTerminal;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Time between two looks of `jobs --watch`.
const STEP: Duration = Duration::from_secs(2);
/// What makes a terminal empty, with the cursor at its top (ECMA-48: CUP, ED).
const CLEAR: &str = "\x1b[H\x1b[2J";

fn block_on(work: impl Future<Output = Result<()>>) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(work)
}

/// Milliseconds since 1970, UTC.
fn now_ms() -> Result<u64> {
    Ok(SystemTime::now().duration_since(UNIX_EPOCH)?.as_millis() as u64)
}

async fn connect(coordinator: &str, credentials: &CredentialArgs) -> Result<Client> {
    let client = Client::new(coordinator, credentials.load()?)?;
    client.connect().await?;
    Ok(client)
}

/// Lists jobs, newest first, or shows one.
pub(crate) fn jobs(args: JobsArgs) -> Result<()> {
    block_on(async {
        let client = connect(&args.farm.coordinator, &args.farm.credentials).await?;
        match args.job {
            Some(job) => show(&client.status(job).await?, args.json),
            None if args.watch => watch_jobs(&client, &args).await,
            None => {
                let jobs = list(&client, &args).await?;
                match args.json {
                    true => say::json(&jobs),
                    false if jobs.is_empty() => say::none("jobs"),
                    false => say::line(table::jobs(&jobs, now_ms()?)),
                }
            }
        }
    })
}

/// The jobs that are asked for, in their order.
async fn list(client: &Client, args: &JobsArgs) -> Result<Vec<JobStatus>> {
    let mut jobs = client.jobs(args.limit, &args.query()).await?;
    if let Some(field) = args.sort {
        table::sort(&mut jobs, field);
    }
    if args.reverse {
        jobs.reverse();
    }
    Ok(jobs)
}

/// Lists jobs again and again: in place of the list before on a terminal, else whenever something has changed.
async fn watch_jobs(client: &Client, args: &JobsArgs) -> Result<()> {
    let live = std::io::stdout().is_terminal() && !args.json;
    let mut before = None;
    loop {
        let jobs = list(client, args).await?;
        if live || before.as_ref() != Some(&jobs) {
            let text = match args.json {
                true => serde_json::to_string(&jobs)?,
                false if jobs.is_empty() => "no jobs".to_owned(),
                false => table::jobs(&jobs, now_ms()?),
            };
            match live {
                true => say::line(format_args!("{CLEAR}{text}"))?,
                false => say::line(text)?,
            }
        }
        before = Some(jobs);
        tokio::time::sleep(STEP).await;
    }
}

/// Hands out no new work of a job, goes on with it, or cancels it.
pub(crate) fn act(args: JobArg, action: &'static str) -> Result<()> {
    steer(&args, async |client: Client| {
        client.post_job(args.job, action, &serde_json::json!({})).await
    })
}

/// Deletes jobs that have ended; one that cannot be deleted keeps no other from it.
pub(crate) fn delete(args: DeleteArgs) -> Result<()> {
    block_on(async {
        let client = connect(&args.farm.coordinator, &args.farm.credentials).await?;
        let mut failed = 0;
        for job in &args.jobs {
            match client.delete_job(*job).await {
                Ok(()) => say::line(format_args!("job {job} is deleted"))?,
                Err(error) => {
                    say::tell(format_args!("job {job} is not deleted: {}", say::causes(&error)));
                    failed += 1;
                }
            }
        }
        ensure!(failed == 0, "{failed} of {} jobs are not deleted", args.jobs.len());
        Ok(())
    })
}

/// Gives a worker no new work, or work again.
pub(crate) fn drain(args: DrainArgs) -> Result<()> {
    block_on(async {
        let client = connect(&args.farm.coordinator, &args.farm.credentials).await?;
        let action = if args.undo { "resume" } else { "drain" };
        let worker = client.post_worker(args.worker, action, &serde_json::json!({})).await?;
        match args.json {
            true => say::json(&worker),
            false => say::line(table::workers(&[worker])),
        }
    })
}

/// Asks for more iterations.
pub(crate) fn extend(args: ExtendArgs) -> Result<()> {
    let iterations = args.iterations.get();
    steer(&args.job, async |client: Client| {
        client.post_job(args.job.job, "extend", &Extend { iterations }).await
    })
}

/// Submits what a job asks for again, as a new job, and cancels the old one if it goes on. Repetition is harmless: the new
/// job's key is the old one's number.
pub(crate) fn resubmit(args: JobArg) -> Result<()> {
    steer(&args, async |client: Client| {
        let old = client.status(args.job).await?;
        let mut spec = old.spec;
        spec.schedule.paused = false;
        if spec.schedule.deadline_ms.take().is_some() {
            say::tell(format_args!("job {} had a deadline, which is left out", args.job));
        }
        if let Some(first) = spec.after.take() {
            say::tell(format_args!(
                "job {} came after job {first}, which is left out: `submit --after` makes one that does",
                args.job
            ));
        }
        if let Some(stop) = old.stop {
            spec.iterations = stop.asked;
        }
        let key = format!("photonfarm resubmit {}", args.job);
        let new = client.submit(&spec, &key).await?;
        if !old.state.ended() {
            client.post_job(args.job, "cancel", &serde_json::json!({})).await?;
            say::tell(format_args!(
                "job {} is cancelled; job {} takes its place",
                args.job, new.id
            ));
        }
        Ok(new)
    })
}

/// Sets a job's priority.
pub(crate) fn priority(args: PriorityArgs) -> Result<()> {
    let priority = args.priority;
    steer(&args.job, async |client: Client| {
        client.set_priority(args.job.job, &SetPriority { priority }).await
    })
}

fn steer(args: &JobArg, request: impl AsyncFnOnce(Client) -> Result<JobStatus>) -> Result<()> {
    block_on(async {
        let client = connect(&args.farm.coordinator, &args.farm.credentials).await?;
        show(&request(client).await?, args.json)
    })
}

/// Lists workers, puts one into quarantine, or lets it out.
pub(crate) fn workers(args: WorkersArgs) -> Result<()> {
    block_on(async {
        let coordinator = args
            .coordinator
            .context("give --coordinator, or set PHOTONFARM_COORDINATOR")?;
        let client = connect(&coordinator, &args.credentials).await?;
        let workers = match args.command {
            None => client.workers().await?,
            Some(WorkersCommand::Quarantine { worker, reason }) => {
                vec![client.post_worker(worker, "quarantine", &Quarantine { reason }).await?]
            }
            Some(WorkersCommand::Release { worker }) => {
                vec![client.post_worker(worker, "release", &serde_json::json!({})).await?]
            }
        };
        match args.json {
            true => say::json(&workers),
            false if workers.is_empty() => say::none("workers"),
            false => say::line(table::workers(&workers)),
        }
    })
}

/// Prints a job: its line, and what else is to be known of it.
pub(crate) fn show(job: &JobStatus, json: bool) -> Result<()> {
    if json {
        return say::json(job);
    }
    say::line(table::jobs(std::slice::from_ref(job), now_ms()?))?;
    let noise = job.checkpoint.map(|at| at.to_string());
    let doubt = (job.iterations_in_doubt > 0).then(|| format!("{} iterations are repeated", job.iterations_in_doubt));
    let poisoned = job.poisoned.iter().map(|iteration| {
        let message = iteration.attempts.last().map_or("", |attempt| &attempt.message);
        format!("iteration {} was given up: {message}", iteration.iteration)
    });
    for line in noise
        .into_iter()
        .chain(doubt)
        .chain(poisoned)
        .chain(job.failure.clone())
        .chain(job.warnings.iter().map(|warning| format!("warning: {warning}")))
    {
        say::line(format_args!("    {line}"))?;
    }
    Ok(())
}
