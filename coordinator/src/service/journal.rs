//! What the log says of changes of the farm: sentences, with the names that people know.

use crate::scheduler::Farm;
use crate::scheduler::record::{Change, JobControl, LeaseRecord, Loss, Standing};
use photonfarm_proto::id::{JobId, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobState};
use photonfarm_proto::schedule::StopReason;

/// Logs a change that is about to be applied to the farm.
pub(super) fn note(farm: &Farm, change: &Change) {
    let named = |worker: &WorkerId| farm.worker_named(*worker);
    match change {
        Change::WorkerRegistered(worker) => tracing::info!(
            worker = %worker.id, name = worker.name, threads = worker.threads, renderer = worker.renderer,
            token = worker.origin.token, machine = worker.origin.machine,
            "worker registered"
        ),
        Change::WorkerJudged { worker, standing } => judged(&named(worker), standing),
        Change::WorkerForgotten(worker) => tracing::info!("{} is gone", named(worker)),
        Change::JobSubmitted(head) => {
            let owner = owner(&head.owner);
            tracing::info!(job = %head.id, "{owner} submitted a job of {} iterations", head.spec.iterations);
        }
        Change::LeaseGranted(LeaseRecord {
            job,
            node,
            worker,
            token,
            attempt,
            ..
        }) => tracing::debug!(%job, %node, %token, attempt, "lease granted to {}", named(worker)),
        Change::JobChanged { job, control } => {
            let before = farm.job(*job).map(|job| job.control());
            for text in differences(before, control) {
                tracing::info!(%job, "{text}");
            }
        }
        Change::JobReopened { record, .. } => {
            tracing::info!(job = %record.head.id, "it goes on to {} iterations", record.control.iterations);
        }
        Change::JobDeleted { job, .. } => tracing::info!(%job, "it was deleted"),
        Change::NoticeAdded(notice) => tracing::debug!(job = %notice.job, delivery = notice.id, "a URL is to be told"),
        Change::LeasesRenewed(renewals) => tracing::debug!(leases = renewals.len(), "leases renewed"),
        Change::LeaseEnded { job, token } => tracing::debug!(%job, %token, "lease ended"),
        Change::NodeAdded { job, node, .. } => tracing::debug!(%job, %node, "node counts"),
        Change::NodeJudged { job, node, record } => {
            tracing::debug!(%job, %node, opinions = record.opinions.len(), verified = record.verified, "node judged");
        }
        Change::NodeMerged { .. } => {}
        Change::NodeLost { job, node, loss } => match loss {
            Loss::Damaged => tracing::error!(%job, %node, "node lost: its image is missing or damaged"),
            Loss::Untrusted => tracing::warn!(%job, %node, "node given up: a worker in quarantine had a part in it"),
            Loss::Replaced => tracing::debug!(%job, %node, "node replaced by one that contains it"),
            Loss::Left => tracing::debug!(%job, %node, "node left out: the job stopped before it"),
        },
        Change::FailuresForgotten { job } => {
            tracing::info!(%job, "what failed of it is tried again, as if for the first time");
        }
        Change::LeafFailed { job, leaf, attempt } => {
            let attempt = &attempt.attempt;
            failed(*job, *leaf, attempt, &named(&attempt.worker));
        }
        Change::JobEnded {
            job, state, failure, ..
        } => {
            let done = farm.job(*job).map_or(0, |job| job.done());
            let reason = failure.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
            tracing::info!(%job, "it {} with {done} iterations{reason}", ended(*state));
        }
    }
}

fn owner(name: &str) -> &str {
    if name.is_empty() { "somebody" } else { name }
}

fn ended(state: JobState) -> &'static str {
    match state {
        JobState::Done => "is done",
        JobState::Failed => "failed",
        JobState::Cancelled => "was cancelled",
        JobState::Queued | JobState::Running => "ended",
    }
}

fn judged(worker: &str, standing: &Standing) {
    match &standing.quarantine {
        Some(reason) => tracing::error!("{worker} is in quarantine: {reason}"),
        None if standing.drained => tracing::info!("{worker} is drained: it finishes what it holds and gets no more"),
        None => tracing::debug!(
            "{worker} has {} nodes confirmed and {} faults",
            standing.verified,
            standing.faults
        ),
    }
}

fn failed(job: JobId, leaf: u32, attempt: &Attempt, worker: &str) {
    let (iteration, message) = (leaf + 1, &attempt.message);
    match attempt.kind {
        FailureKind::Lost => tracing::warn!(
            %job, iteration,
            "iteration failed, and its lease expired: {worker} was lost while rendering it; the lease goes to others"
        ),
        FailureKind::Scene => {
            tracing::warn!(%job, iteration, "iteration failed on {worker}: the scene is at fault: {message}")
        }
        FailureKind::Panic => tracing::warn!(%job, iteration, "iteration failed on {worker}: it panicked: {message}"),
        FailureKind::Render => tracing::warn!(%job, iteration, "iteration failed on {worker}: {message}"),
    }
}

/// What is different in how a job goes on, in words.
pub(super) fn differences(before: Option<&JobControl>, now: &JobControl) -> Vec<String> {
    let mut texts = Vec::new();
    let mut tell = |changed: bool, text: String| {
        if changed {
            texts.push(text);
        }
    };
    let schedule = &now.schedule;
    let other = |differs: fn(&JobControl, &JobControl) -> bool| before.is_some_and(|before| differs(before, now));
    tell(
        other(|a, b| a.schedule.paused != b.schedule.paused),
        if schedule.paused {
            "it is paused"
        } else {
            "it is resumed"
        }
        .to_owned(),
    );
    tell(
        other(|a, b| a.schedule.priority != b.schedule.priority),
        format!("its priority is {} now", schedule.priority),
    );
    if let Some(renderer) = &now.renderer {
        let bound = other(|a, b| a.renderer != b.renderer);
        tell(bound, format!("it is bound to the renderer {renderer}"));
    }
    if let Some(integrator) = &now.integrator {
        let settled = other(|a, b| a.integrator != b.integrator);
        tell(settled, format!("with its scene's settings it is {integrator:?}"));
    }
    if let Some(checkpoint) = now.checkpoint {
        let measured = other(|a, b| a.checkpoint != b.checkpoint);
        tell(measured, format!("its {checkpoint}"));
    }
    tell(
        other(|a, b| a.after != b.after),
        "the job that was to be done first is done".to_owned(),
    );
    match now.stop {
        Some(stop) => {
            let reason = match stop.reason {
                StopReason::Noise => "its noise target is met",
                StopReason::Deadline => "its deadline has passed",
            };
            let text = format!("it stops at {} of {} iterations: {reason}", now.iterations, stop.asked);
            tell(other(|a, b| a.stop != b.stop), text);
        }
        None => tell(
            other(|a, b| a.iterations != b.iterations),
            format!("it has {} iterations now", now.iterations),
        ),
    }
    texts
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::schedule::{Checkpoint, Stop};

    fn control() -> JobControl {
        JobControl {
            iterations: 64,
            schedule: Default::default(),
            renderer: None,
            checkpoint: None,
            stop: None,
            integrator: None,
            warnings: vec![],
            after: None,
        }
    }

    #[test]
    fn changes_of_a_job_are_told_one_by_one_in_words() {
        let before = control();
        let mut now = control();
        assert!(differences(Some(&before), &now).is_empty());
        now.schedule.paused = true;
        now.schedule.priority = 70;
        now.renderer = Some("1.0 abc".into());
        now.checkpoint = Some(Checkpoint {
            iterations: 16,
            noise: Some(0.25),
        });
        now.iterations = 16;
        now.stop = Some(Stop {
            reason: StopReason::Noise,
            asked: 64,
        });
        assert_eq!(
            differences(Some(&before), &now),
            [
                "it is paused",
                "its priority is 70 now",
                "it is bound to the renderer 1.0 abc",
                "its noise is 0.2500 at 16 iterations",
                "it stops at 16 of 64 iterations: its noise target is met",
            ]
        );
    }
}
