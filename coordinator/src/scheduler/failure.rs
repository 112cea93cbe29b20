//! Leaves that could not be rendered, and leases that ran out.

use super::job::{HeldLease, Job};
use super::record::{Change, LeaseRecord, Millis};
use super::{Refusal, SchedulerConfig};
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind};
use photonfarm_proto::node::NodeKey;

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
    pub(super) fn fail(&self, token: LeaseToken, leaf: u32, attempt: Attempt) -> Result<Vec<Change>, Refusal> {
        let lease = self.lease(token, attempt.worker)?;
        if !lease.record.node.contains(NodeKey::leaf(leaf)) {
            let reason = format!("leaf {leaf} lies outside the lease of {}", lease.record.node);
            return Err(Refusal::Invalid(reason));
        }
        let job = self.id();
        match attempt.kind {
            FailureKind::Lost => Err(Refusal::Invalid("a worker cannot report itself lost".into())),
            FailureKind::Scene | FailureKind::Render | FailureKind::Panic => {
                Ok(vec![Change::LeafFailed { job, leaf, attempt }, self.end_lease(token)])
            }
        }
    }

    /// Whether a worker has found a fault of the scene.
    pub(super) fn was_found_broken_by(&self, worker: WorkerId) -> bool {
        let mut attempts = self.failures.values().flatten();
        attempts.any(|attempt| attempt.kind == FailureKind::Scene && attempt.worker == worker)
    }

    /// The workers whose reported failures lie within a node, each once.
    pub(super) fn failed_within(&self, node: NodeKey) -> impl Iterator<Item = WorkerId> + '_ {
        let leaves = node.first() as u32..=(node.end() - 1) as u32;
        let attempts = self.failures.range(leaves).flat_map(|(_, attempts)| attempts);
        let reported = attempts.filter(|attempt| attempt.kind != FailureKind::Lost);
        let workers: std::collections::BTreeSet<WorkerId> = reported.map(|attempt| attempt.worker).collect();
        workers.into_iter()
    }

    /// Ends the leases that were not renewed in time; the leaf that each was at is held against them.
    pub(super) fn expire(&self, now: Millis) -> Vec<Change> {
        let mut changes = Vec::new();
        for lease in self.leases.values().filter(|lease| lease.expires_ms <= now) {
            let LeaseRecord {
                token, node, worker, ..
            } = lease.record;
            let leaf = node.first() + lease.leaves_done;
            let suspect = u32::try_from(leaf)
                .ok()
                .map(NodeKey::leaf)
                .filter(|leaf| node.contains(*leaf));
            if let Some(leaf) = suspect.filter(|leaf| self.covering(*leaf).is_none()) {
                let message = format!("worker {worker} was lost while rendering it");
                let attempt = Attempt {
                    worker,
                    kind: FailureKind::Lost,
                    message,
                    at_ms: now,
                };
                changes.push(Change::LeafFailed {
                    job: self.id(),
                    leaf: leaf.index,
                    attempt,
                });
            }
            changes.push(self.end_lease(token));
        }
        changes
    }
}
