//! What happened to jobs, for people.
//!
//! Submission, attempts that failed and the end follow from what is kept of a job. The rest (when it began, what people changed,
//! the noise at checkpoints, what was lost) is remembered by this coordinator since its start: the latest of each job, of the
//! newest jobs.

use super::journal::differences;
use super::{Service, ServiceError};
use crate::scheduler::Farm;
use crate::scheduler::record::{Change, JobRecord, LeaseRecord, Loss, Millis};
use photonfarm_proto::api::{JobLog, JobLogEntry};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{FailureKind, JobState};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most jobs that something is remembered of.
const JOBS: usize = 2000;
/// Most that is remembered of a job.
const ENTRIES: usize = 200;

/// What is remembered.
pub(super) struct Log {
    since_ms: Millis,
    jobs: Mutex<BTreeMap<JobId, VecDeque<JobLogEntry>>>,
}

impl Log {
    pub(super) fn new(now: Millis) -> Self {
        Self {
            since_ms: now,
            jobs: Mutex::default(),
        }
    }

    /// Remembers a change that is about to be applied to the farm.
    pub(super) fn note(&self, farm: &Farm, change: &Change, now: Millis) {
        let tell = |job: JobId, text: String| self.add(job, JobLogEntry { at_ms: now, text });
        match change {
            Change::LeaseGranted(LeaseRecord { job, node, worker, .. }) => {
                let begins = farm.job(*job).is_some_and(|job| job.is_queued());
                if begins {
                    let (first, last) = (node.first() + 1, node.end());
                    let worker = farm.worker_named(*worker);
                    tell(
                        *job,
                        format!("it began: {worker} was lent iterations {first} to {last}"),
                    );
                }
            }
            Change::JobChanged { job, control } => {
                let before = farm.job(*job).map(|job| job.control());
                differences(before, control)
                    .into_iter()
                    .for_each(|text| tell(*job, text));
            }
            Change::JobReopened { record, .. } => {
                let text = format!("it goes on to {} iterations", record.control.iterations);
                tell(record.head.id, text);
            }
            Change::NodeLost { job, node, loss } => {
                let iterations = format!("iterations {} to {}", node.first() + 1, node.end());
                match loss {
                    Loss::Damaged => tell(
                        *job,
                        format!("{iterations} are rendered again: their image is missing or damaged"),
                    ),
                    Loss::Untrusted => tell(
                        *job,
                        format!("{iterations} are rendered again: a worker in quarantine had a part in them"),
                    ),
                    Loss::Left | Loss::Replaced => {}
                }
            }
            Change::JobDeleted { job, .. } => _ = self.jobs().remove(job),
            _ => {}
        }
    }

    fn add(&self, job: JobId, entry: JobLogEntry) {
        let mut jobs = self.jobs();
        let entries = jobs.entry(job).or_default();
        entries.push_back(entry);
        if entries.len() > ENTRIES {
            entries.pop_front();
        }
        if jobs.len() > JOBS {
            jobs.pop_first();
        }
    }

    fn of(&self, job: JobId) -> Vec<JobLogEntry> {
        self.jobs().get(&job).into_iter().flatten().cloned().collect()
    }

    fn jobs(&self) -> MutexGuard<'_, BTreeMap<JobId, VecDeque<JobLogEntry>>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Service {
    /// What happened to a job, oldest first.
    pub(crate) async fn job_log(self: &Arc<Self>, id: JobId) -> Result<JobLog, ServiceError> {
        let record = self.stores.state.job(id).await?;
        let record = record.ok_or(crate::scheduler::Refusal::UnknownJob(id))?;
        let cell = self.fresh_farm().await?;
        let mut entries = kept(&record, &cell.farm);
        drop(cell);
        if record.head.created_ms < self.log.since_ms {
            let text = "the coordinator started: of what happened before, only submission, failed attempts and the end are known";
            entries.push(JobLogEntry {
                at_ms: self.log.since_ms,
                text: text.to_owned(),
            });
        }
        entries.extend(self.log.of(id));
        entries.sort_by_key(|entry| entry.at_ms);
        Ok(JobLog { entries })
    }
}

/// What is known of a job for as long as it is kept.
fn kept(record: &JobRecord, farm: &Farm) -> Vec<JobLogEntry> {
    let head = &record.head;
    let owner = match head.owner.as_str() {
        "" => "somebody",
        name => name,
    };
    let submitted = JobLogEntry {
        at_ms: head.created_ms,
        text: format!("{owner} submitted it, with {} iterations", head.spec.iterations),
    };
    let failures = record.failures.iter().map(|(leaf, failed)| {
        let attempt = &failed.attempt;
        let how = match attempt.kind {
            FailureKind::Scene => "the scene is at fault: ",
            FailureKind::Panic => "the renderer panicked: ",
            FailureKind::Lost => "the worker was lost: ",
            FailureKind::Render | FailureKind::OutOfMemory => "",
        };
        let worker = farm.worker_named(attempt.worker);
        JobLogEntry {
            at_ms: attempt.at_ms,
            text: format!("iteration {} failed on {worker}: {how}{}", leaf + 1, attempt.message),
        }
    });
    let end = record.ended_ms.map(|at_ms| {
        let how = match record.state {
            JobState::Done => "it is done",
            JobState::Cancelled => "it was cancelled",
            _ => "it failed",
        };
        let reason = record.failure.as_ref().map(|reason| format!(": {reason}"));
        JobLogEntry {
            at_ms,
            text: format!("{how}{}", reason.unwrap_or_default()),
        }
    });
    std::iter::once(submitted).chain(failures).chain(end).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_remembered_is_bounded() {
        let log = Log::new(0);
        let entry = |at_ms| JobLogEntry {
            at_ms,
            text: String::new(),
        };
        for at in 0..2 * ENTRIES as u64 {
            log.add(JobId(5), entry(at));
        }
        let kept = log.of(JobId(5));
        assert_eq!((kept.len(), kept[0].at_ms), (ENTRIES, ENTRIES as u64));
        for job in 0..2 * JOBS as u64 {
            log.add(JobId(job), entry(0));
        }
        assert_eq!(log.jobs().len(), JOBS);
        assert!(log.of(JobId(5)).is_empty() && !log.of(JobId(2 * JOBS as u64 - 1)).is_empty());
    }
}
