//! What has happened to jobs lately, for people who look at them. It is kept in memory, within bounds, and nothing is decided by it.

use super::{Service, ServiceError};
use crate::scheduler::record::{Change, LeaseRecord, Millis};
use crate::scheduler::{Farm, Job};
use photonfarm_proto::history::{JobHistory, LeaseOutcome, LeaseSpan, NoiseSample, ProgressSample};
use photonfarm_proto::id::{JobId, LeaseToken};
use photonfarm_proto::job::FailureKind;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most jobs whose history is kept; those with the lowest numbers go first.
const JOBS: usize = 256;
/// Most samples of a kind of a job.
const SAMPLES: usize = 512;
/// Most leases of a job.
const LEASES: usize = 512;
/// Least time between two samples of a job's progress \[ms\].
const STEP_MS: Millis = 500;

/// The histories of the newest jobs.
#[derive(Debug, Default)]
pub(super) struct Histories {
    jobs: Mutex<BTreeMap<JobId, History>>,
}

#[derive(Debug, Default)]
struct History {
    progress: Vec<ProgressSample>,
    noise: Vec<NoiseSample>,
    leases: VecDeque<(LeaseToken, LeaseSpan)>,
}

impl Histories {
    fn jobs(&self) -> MutexGuard<'_, BTreeMap<JobId, History>> {
        // Whatever was being noted is of no consequence.
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with(&self, job: JobId, note: impl FnOnce(&mut History)) {
        let mut jobs = self.jobs();
        note(jobs.entry(job).or_default());
        while jobs.len() > JOBS {
            jobs.pop_first();
        }
    }

    /// Notes changes that are about to be applied.
    pub(super) fn before(&self, farm: &Farm, changes: &[Change], now: Millis) {
        for change in changes {
            match change {
                Change::LeaseGranted(lease) => self.granted(farm, lease),
                Change::LeaseEnded { job, token } => {
                    let outcome = farm.job(*job).map(|job| outcome(job, *token, changes));
                    self.with(*job, |history| history.end(*token, outcome, now));
                }
                Change::JobEnded { job, .. } => self.with(*job, |history| history.end_all(now)),
                Change::JobDeleted { job, .. } => _ = self.jobs().remove(job),
                _ => {}
            }
        }
    }

    /// Notes how far jobs have come by changes that were applied.
    pub(super) fn after(&self, farm: &Farm, changes: &[Change], now: Millis) {
        let mut last = None;
        for change in changes {
            let (Change::NodeAdded { job, .. } | Change::JobEnded { job, .. }) = change else {
                continue;
            };
            if last.replace(*job) != Some(*job)
                && let Some(done) = farm.job(*job).map(Job::done)
            {
                self.with(*job, |history| history.progressed(now, done));
            }
        }
    }

    /// Notes the noise of a job's image.
    pub(super) fn measured(&self, job: JobId, at_ms: Millis, iterations: u64, noise: Option<f64>) {
        let Some(noise) = noise.filter(|noise| noise.is_finite()) else {
            return;
        };
        self.with(job, |history| {
            if history.noise.last().is_none_or(|last| last.iterations != iterations) {
                history.noise.push(NoiseSample {
                    at_ms,
                    iterations,
                    noise,
                });
                thin(&mut history.noise);
            }
        });
    }

    fn granted(&self, farm: &Farm, lease: &LeaseRecord) {
        let span = LeaseSpan {
            worker: lease.worker,
            name: farm.worker_name(lease.worker).unwrap_or_default().to_owned(),
            first: lease.node.first() as u32 + 1,
            last: lease.node.end() as u32,
            attempt: lease.attempt,
            verifies: lease.verifies,
            from_ms: lease.granted_ms,
            to_ms: None,
            outcome: LeaseOutcome::Held,
        };
        self.with(lease.job, |history| {
            history.leases.push_back((lease.token, span));
            if history.leases.len() > LEASES {
                history.leases.pop_front();
            }
            // The rate is known from the first lease on.
            if history.progress.is_empty() {
                let done = farm.job(lease.job).map_or(0, Job::done);
                history.progressed(lease.granted_ms, done);
            }
        });
    }
}

impl History {
    fn progressed(&mut self, at_ms: Millis, iterations: u64) {
        let sample = ProgressSample { at_ms, iterations };
        // The first and the latest are always there.
        match self.progress.as_mut_slice() {
            [.., before, last] if last.at_ms < before.at_ms + STEP_MS => *last = sample,
            _ => self.progress.push(sample),
        }
        thin(&mut self.progress);
    }

    fn end(&mut self, token: LeaseToken, outcome: Option<LeaseOutcome>, now: Millis) {
        let mut latest = self.leases.iter_mut().rev();
        if let Some((_, span)) = latest.find(|(other, _)| *other == token) {
            (span.to_ms, span.outcome) = (Some(now), outcome.unwrap_or(LeaseOutcome::Ended));
        }
    }

    fn end_all(&mut self, now: Millis) {
        for (_, span) in self.leases.iter_mut().filter(|(_, span)| span.to_ms.is_none()) {
            (span.to_ms, span.outcome) = (Some(now), LeaseOutcome::Ended);
        }
    }
}

/// Leaves every second sample out where there are too many.
fn thin<T>(samples: &mut Vec<T>) {
    if samples.len() > SAMPLES {
        let mut index = 0;
        samples.retain(|_| {
            index += 1;
            index % 2 == 1 || index > SAMPLES
        });
    }
}

/// What becomes of a lease that ends with these changes.
pub(super) fn outcome(job: &Job, token: LeaseToken, changes: &[Change]) -> LeaseOutcome {
    let Some(lease) = job.lease_record(token) else {
        return LeaseOutcome::Ended;
    };
    let block = lease.node;
    let mut outcome = LeaseOutcome::Ended;
    for change in changes {
        match change {
            Change::LeafFailed { leaf, attempt, .. }
                if attempt.attempt.worker == lease.worker
                    && (block.first()..block.end()).contains(&u64::from(*leaf)) =>
            {
                return match attempt.attempt.kind {
                    FailureKind::Lost => LeaseOutcome::Lost,
                    _ => LeaseOutcome::Failed,
                };
            }
            Change::NodeAdded { node, .. } if node.contains(block) || block.contains(*node) => {
                outcome = LeaseOutcome::Delivered;
            }
            Change::NodeJudged { node, .. } if lease.verifies && *node == block => outcome = LeaseOutcome::Delivered,
            _ => {}
        }
    }
    outcome
}

impl Service {
    /// What has happened to a job.
    pub(crate) async fn history(self: &Arc<Self>, id: JobId) -> Result<JobHistory, ServiceError> {
        let failures = self.with_job(id, Job::failed_attempts).await?;
        let jobs = self.histories.jobs();
        let Some(history) = jobs.get(&id) else {
            return Ok(JobHistory {
                failures,
                ..JobHistory::default()
            });
        };
        Ok(JobHistory {
            progress: history.progress.clone(),
            noise: history.noise.clone(),
            leases: history.leases.iter().map(|(_, span)| span.clone()).collect(),
            failures,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_bounded_and_keep_the_first_and_the_latest() {
        let mut history = History::default();
        for number in 0..5000 {
            history.progressed(1000 * number, number);
        }
        assert!(history.progress.len() <= SAMPLES, "{}", history.progress.len());
        let ends = [history.progress.first(), history.progress.last()];
        assert_eq!(ends.map(|sample| sample.unwrap().iterations), [0, 4999]);
        for number in 5000..6000 {
            history.progressed(5_000_000, number);
        }
        assert!(history.progress.len() <= SAMPLES);
        assert_eq!(history.progress.last().unwrap().iterations, 5999);
    }
}
