//! Leaves that could not be rendered, and leases that expired.

use super::job::{HeldLease, Job};
use super::record::{Change, FailedAttempt, Millis, Principal};
use super::{Decision, Farm, Refusal, SchedulerConfig};
use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobState};
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeSet;

impl HeldLease {
    /// When the lease ends after a start of the coordinator: there is time to reconnect, but less after every start
    /// without a heartbeat, so that frequent starts do not keep the lease of a dead worker alive.
    pub(super) fn after_restart(&self, config: &SchedulerConfig, now: Millis) -> Millis {
        let restarts = self.record.restarts.min(63);
        let reconnect = now + (config.reconnect_ms >> restarts);
        let kept = self.record.until_ms.min(now + config.reconnect_ms);
        if restarts == 0 { reconnect } else { reconnect.max(kept) }
    }
}

impl Job {
    /// Decides over a failure that a worker reports.
    pub(super) fn fail(&self, token: LeaseToken, leaf: u32, attempt: FailedAttempt) -> Result<Vec<Change>, Refusal> {
        let lease = self.lease(token, attempt.attempt.worker)?;
        if !lease.record.node.contains(NodeKey::leaf(leaf)) {
            let reason = format!("leaf {leaf} lies outside the lease of {}", lease.record.node);
            return Err(Refusal::Invalid(reason));
        }
        let job = self.id();
        match attempt.attempt.kind {
            FailureKind::Lost => Err(Refusal::Invalid("a worker cannot report itself lost".into())),
            FailureKind::Scene | FailureKind::Render | FailureKind::Panic | FailureKind::OutOfMemory => {
                Ok(vec![Change::LeafFailed { job, leaf, attempt }, self.end_lease(token)])
            }
        }
    }

    /// The attempts that found a fault of the scene.
    fn scene_faults(&self) -> impl Iterator<Item = &FailedAttempt> {
        let attempts = self.failures.values().flatten();
        attempts.filter(|failed| failed.attempt.kind == FailureKind::Scene)
    }

    /// The workers whose reported failures lie within a node, each once.
    pub(super) fn failed_within(&self, node: NodeKey) -> impl Iterator<Item = WorkerId> + '_ {
        let leaves = node.first() as u32..=(node.end() - 1) as u32;
        let attempts = self.failures.range(leaves).flat_map(|(_, attempts)| attempts);
        let reported = attempts.filter(|failed| !is_of_machine(failed.attempt.kind));
        let workers: BTreeSet<WorkerId> = reported.map(|failed| failed.attempt.worker).collect();
        workers.into_iter()
    }

    /// The leaf that a lease is at, unless it is in the image.
    fn suspect(&self, lease: &HeldLease) -> Option<u32> {
        let node = lease.record.node;
        let leaf = NodeKey::leaf(u32::try_from(node.first() + lease.leaves_done).ok()?);
        (node.contains(leaf) && self.covering(leaf).is_none()).then_some(leaf.index)
    }
}

/// Whether a failure says nothing of how well its worker renders.
fn is_of_machine(kind: FailureKind) -> bool {
    matches!(kind, FailureKind::Lost | FailureKind::OutOfMemory)
}

impl Farm {
    /// A worker could not render a leaf. A fault of the scene ends the job once two principals have found one, or the only one
    /// that is there.
    pub fn fail(
        &self,
        job: JobId,
        token: LeaseToken,
        leaf: u32,
        attempt: Attempt,
        now: Millis,
    ) -> Result<Decision<()>, Refusal> {
        let live = self.live_job(job)?;
        if let Ok(lease) = live.lease(token, attempt.worker)
            && lease.record.verifies
        {
            return Ok(Decision::new((), self.hear_failure(live, &lease.record)));
        }
        let Attempt {
            worker, kind, message, ..
        } = attempt.clone();
        let mut changes = live.fail(token, leaf, self.failed_attempt(live, leaf, attempt))?;
        let principal = self.principal_of(worker);
        let agrees = |other: &&FailedAttempt| {
            let known = self.workers.get(other.attempt.worker);
            other.principal != principal && known.is_some_and(|known| !known.is_held())
        };
        let alone = || {
            self.workers
                .staff_for(live)
                .principals()
                .all(|other| other == principal)
        };
        if kind == FailureKind::Scene && (live.scene_faults().any(|other| agrees(&other)) || alone()) {
            changes.push(Change::JobEnded {
                job,
                state: JobState::Failed,
                failure: Some(message),
                ended_ms: now,
            });
        }
        Ok(Decision::new((), changes))
    }

    /// What is kept of an attempt that failed. Whoever fails at a leaf again counts only where nobody else is there to try it:
    /// one principal alone cannot have an iteration given up that others could render.
    pub(super) fn failed_attempt(&self, job: &Job, leaf: u32, attempt: Attempt) -> FailedAttempt {
        let before = job.failures.get(&leaf).map_or(&[][..], Vec::as_slice);
        let has_failed = |principal: Principal| before.iter().any(|failed| failed.principal == principal);
        let principal = self.principal_of(attempt.worker);
        let mut others = self.workers.staff_for(job).principals();
        let repeated = has_failed(principal) && others.any(|other| !has_failed(other));
        FailedAttempt {
            attempt,
            principal,
            repeated,
            memory_mb: None,
        }
    }

    /// Ends the leases of a job that were not renewed in time; the leaf that each was at is held against it.
    pub(super) fn expire_leases(&self, job: &Job, now: Millis) -> Vec<Change> {
        let expired = job.leases.values().filter(|lease| lease.expires_ms <= now);
        let mut changes = Vec::new();
        for lease in expired {
            if let Some(leaf) = job.suspect(lease) {
                let worker = lease.record.worker;
                let attempt = Attempt {
                    worker,
                    kind: FailureKind::Lost,
                    message: format!("worker {worker} was lost while rendering it"),
                    at_ms: now,
                };
                changes.push(Change::LeafFailed {
                    job: job.id(),
                    leaf,
                    attempt: self.failed_attempt(job, leaf, attempt),
                });
            }
            changes.push(job.end_lease(lease.record.token));
        }
        changes
    }
}
