//! `photonfarm jobs`, `pause`, `resume`, `cancel`, `delete`, `resubmit`, `extend`, `priority`, `workers`: looks at a farm and steers it.

use crate::client::Client;
use crate::farm_args::CredentialArgs;
use crate::say;
use crate::steer_args::{DeleteArgs, ExtendArgs, JobArg, JobsArgs, PriorityArgs, WorkersArgs, WorkersCommand};
use anyhow::{Context, Result, ensure};
use photonfarm_proto::api::{Extend, Quarantine, SetPriority, WorkerStatus};
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::schedule::StopReason;

fn block_on(work: impl Future<Output = Result<()>>) -> Result<()> {
    tokio::runtime::Runtime::new()?.block_on(work)
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
            None if args.json => say::json(&client.jobs(args.limit).await?),
            None => {
                let jobs = client.jobs(args.limit).await?;
                jobs.iter().try_for_each(|job| say::line(job_line(job)))
            }
        }
    })
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
            false => workers.iter().try_for_each(|worker| say::line(worker_line(worker))),
        }
    })
}

fn show(job: &JobStatus, json: bool) -> Result<()> {
    if json {
        return say::json(job);
    }
    say::line(job_line(job))?;
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

fn job_line(job: &JobStatus) -> String {
    let schedule = &job.spec.schedule;
    let state = match job.state {
        _ if schedule.paused && !job.state.ended() => "paused",
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Done => "done",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    };
    let mut line = format!(
        "{}  {state}  {} of {}",
        job.id, job.iterations_done, job.spec.iterations
    );
    if !job.owner.is_empty() {
        line += &format!("  owner: {}", job.owner);
    }
    if !job.state.ended() {
        line += &format!("  priority: {}  workers: {}", schedule.priority, job.workers);
    }
    if let Some(stop) = job.stop {
        let reason = match stop.reason {
            StopReason::Noise => "noise target",
            StopReason::Deadline => "deadline",
        };
        line += &format!("  stopped by its {reason}, of {}", stop.asked);
    }
    if let Some(waiting) = job.waiting.as_ref().filter(|_| !schedule.paused) {
        line += &format!("  waits: {waiting}");
    }
    line
}

fn worker_line(worker: &WorkerStatus) -> String {
    let mut line = format!(
        "{}  {}  threads: {}  leases: {}",
        worker.id, worker.name, worker.threads, worker.leases
    );
    line += &format!(
        "  silent: {:.0} s  confirmed: {}",
        worker.silent_ms as f64 / 1e3,
        worker.verified
    );
    let origin = [&worker.token, &worker.machine].map(String::as_str);
    line += &match origin {
        ["", machine] => format!("  from: {machine}"),
        [token, machine] => format!("  from: {token}@{machine}"),
    };
    if !worker.tags.is_empty() {
        let tags: Vec<&str> = worker.tags.iter().map(String::as_str).collect();
        line += &format!("  tags: {}", tags.join(","));
    }
    if worker.faults > 0 {
        line += &format!("  faults: {}", worker.faults);
    }
    if let Some(reason) = &worker.quarantine {
        line += &format!("  in quarantine: {reason}");
    }
    line
}
