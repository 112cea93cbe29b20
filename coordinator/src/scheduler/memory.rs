//! Memory: how much a job needs, and what becomes of workers that ran out of it.
//!
//! A job needs what it was measured to take, a step more at most, and what it asks for by itself before anything was
//! measured. Where workers ran out of memory at it three times, it needs more than they have. Running out of memory gives
//! no iteration up: the job waits for a larger worker, which may come.

use super::job::Job;
use super::record::{Change, FailedAttempt, JobControl};
use super::table::Table;
use super::{Decision, Farm, Refusal};
use photonfarm_proto::id::{JobId, LeaseToken};
use photonfarm_proto::job::{Attempt, FailureKind};
use photonfarm_proto::memory::{MOST_MEMORY_MB, Shortage, step_down, step_up};
use photonfarm_proto::node::NodeKey;

/// Workers that ran out of memory at a job before it is given to larger ones only: another program may have taken the
/// memory of one of them.
const TRIES: usize = 3;

/// The memory that proved to be too little: [`TRIES`] attempts failed with that much or more.
fn too_little(failures: &Table<u32, Vec<FailedAttempt>>) -> Option<u32> {
    let counted = failures.values().flatten().filter(|failed| !failed.repeated);
    let mut short: Vec<u32> = counted.filter_map(|failed| failed.memory_mb).collect();
    short.sort_unstable();
    short.iter().rev().nth(TRIES - 1).copied()
}

/// Memory that a worker must have for a job that goes on like this and failed so far like that \[MiB\].
pub(super) fn needed(control: &JobControl, failures: &Table<u32, Vec<FailedAttempt>>) -> u32 {
    let measured = control.memory_mb.map(step_up);
    let needed = measured.or(control.schedule.memory_mb).unwrap_or(0);
    needed.max(too_little(failures).map_or(0, |memory| memory + 1))
}

impl Job {
    /// A worker says how much memory it held while it worked on the job.
    pub(super) fn measured(&self, memory_mb: Option<u32>) -> Option<Change> {
        let memory_mb = memory_mb?.min(MOST_MEMORY_MB);
        let control = JobControl {
            memory_mb: Some(memory_mb),
            ..self.control.clone()
        };
        (self.control.memory_mb < Some(memory_mb)).then(|| Change::JobChanged {
            job: self.id(),
            control,
        })
    }

    /// Whether workers ran out of memory at it.
    pub(super) fn is_short(&self) -> bool {
        let mut attempts = self.failures.values().flatten();
        attempts.any(|failed| failed.memory_mb.is_some())
    }

    /// Why it needs the memory that it needs.
    fn why_so_much(&self) -> String {
        match (too_little(&self.failures), self.control.memory_mb) {
            (Some(memory), _) if self.demand.memory_mb == memory + 1 => {
                format!("workers with {memory} MiB of memory ran out of it")
            }
            (_, Some(measured)) => format!("it was measured to take {measured} MiB of memory"),
            _ => format!("it asks for {} MiB of memory", self.demand.memory_mb),
        }
    }
}

impl Farm {
    /// What is the matter where no worker has the memory that a job needs.
    pub(super) fn what_is_too_small(&self, job: &Job) -> String {
        let others = self.workers.crews().map(|(skill, _)| skill);
        let others = others.filter(|skill| skill.meets_but_for_memory(&job.demand));
        let largest = others.filter_map(|skill| skill.memory_mb).max().unwrap_or(0);
        format!(
            "{}, and the largest worker that could do it has {largest} MiB: start one with at least {} MiB",
            job.why_so_much(),
            job.demand.memory_mb
        )
    }

    /// The process of a worker was killed, since memory had run out, and its next one says so. If the lease has ended by
    /// then, its worker counts as lost: the attempt has its name all the same.
    pub fn out_of_memory(
        &self,
        job: JobId,
        token: LeaseToken,
        leaf: u32,
        attempt: Attempt,
        shortage: Shortage,
    ) -> Result<Decision<()>, Refusal> {
        let live = self.live_job(job)?;
        let worker = attempt.worker;
        let ended = match live.lease(token, worker) {
            Ok(lease) => {
                if !lease.record.node.contains(NodeKey::leaf(leaf)) {
                    let reason = format!("leaf {leaf} lies outside the lease of {}", lease.record.node);
                    return Err(Refusal::Invalid(reason));
                }
                Some(live.end_lease(token))
            }
            Err(stale) => {
                let of_worker = |kind: FailureKind| {
                    let attempts = live.failures.values().flatten();
                    let mut attempts = attempts.map(|failed| &failed.attempt);
                    attempts.any(move |other| other.worker == worker && other.kind == kind)
                };
                if !of_worker(FailureKind::Lost) || of_worker(FailureKind::OutOfMemory) {
                    return Err(stale);
                }
                None
            }
        };
        let attempt = FailedAttempt {
            memory_mb: shortage.has_mb.map(|memory| memory.min(MOST_MEMORY_MB)),
            ..self.failed_attempt(live, leaf, attempt)
        };
        // What it held alone does not keep the next try from a worker like it: pages of files count, which need not be held.
        let most = shortage.has_mb.map_or(MOST_MEMORY_MB, step_down);
        let held = shortage.held_mb.map(|held| held.min(most));
        let mut changes: Vec<Change> = live.measured(held).into_iter().collect();
        changes.push(Change::LeafFailed { job, leaf, attempt });
        changes.extend(ended);
        Ok(Decision::new((), changes))
    }
}
