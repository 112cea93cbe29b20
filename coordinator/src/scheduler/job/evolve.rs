//! How a job changes.

use super::{HeldLease, Job, leaf};
use crate::scheduler::SchedulerConfig;
use crate::scheduler::demand::Demand;
use crate::scheduler::record::{Change, FailedAttempt, JobControl, LeaseRecord, Millis, NodeRecord, Renewal};
use crate::scheduler::table::Table;
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::job::JobState;
use photonfarm_proto::node::NodeKey;
use std::sync::Arc;

impl Job {
    pub(in crate::scheduler) fn hold(&mut self, record: LeaseRecord, expires_ms: Millis) {
        let (block, token) = (record.node, record.token);
        self.let_go(token);
        match record.verifies {
            true => {
                self.drop_from_indexes(block);
                self.repeated.insert(block, token);
                self.put_into_indexes(block);
            }
            false => {
                self.lent.insert(block, token);
                self.free.remove(block.first(), block.end());
            }
        }
        let lease = HeldLease {
            expires_ms,
            leaves_done: 0,
            record,
        };
        self.leases.insert(token, lease);
    }

    fn let_go(&mut self, token: LeaseToken) {
        let Some(HeldLease { record, .. }) = self.leases.remove(&token) else {
            return;
        };
        match record.verifies {
            true => {
                self.drop_from_indexes(record.node);
                self.repeated.remove(record.node, token);
                self.put_into_indexes(record.node);
            }
            false => {
                self.lent.remove(record.node, token);
                self.free_within(record.node);
            }
        }
    }

    pub(super) fn note_failure(&mut self, leaf: u32, attempt: FailedAttempt, config: &SchedulerConfig) {
        let is_short = attempt.memory_mb.is_some();
        let attempts = self.failures.get_or_default(leaf);
        attempts.push(attempt);
        if config.gives_up(attempts) {
            self.given_up.insert(leaf, ());
            self.free.remove(leaf.into(), u64::from(leaf) + 1);
        }
        if is_short {
            self.update_demand();
        }
    }

    /// Whatever failed is tried again as if for the first time.
    fn forget_failures(&mut self) {
        self.failures = Table::default();
        self.update_demand();
        for (leaf, ()) in std::mem::take(&mut self.given_up).iter() {
            self.free_within(NodeKey::leaf(*leaf));
        }
    }

    pub(super) fn set_control(&mut self, control: JobControl) {
        let before = self.leaves();
        self.control = control;
        self.update_demand();
        let leaves = self.leaves();
        self.free.remove(leaves, before);
        self.free.add(before, leaves);
        let given_up = self.given_up.range(leaf(before)..).map(|(leaf, ())| u64::from(*leaf));
        for leaf in given_up.collect::<Vec<_>>() {
            self.free.remove(leaf, leaf + 1);
        }
        // Whether it waits for a look at the noise may have changed.
        if let Some((_, first)) = self.nodes.live.first() {
            self.update_pair(*first);
        }
    }

    fn update_demand(&mut self) {
        self.demand = Arc::new(Demand::of(&self.control, &self.failures));
    }

    /// Leaves of a block may be free again: those that are neither in the image, nor lent, nor given up.
    pub(in crate::scheduler) fn free_within(&mut self, block: NodeKey) {
        let (first, end) = (block.first(), block.end().min(self.leaves()));
        if first >= end || self.covering(block).is_some() || self.lent.around(block).next().is_some() {
            return;
        }
        self.free.add(first, end);
        let counted = self.nodes.live.range(first..end).map(|(_, node)| *node);
        let given_up = self
            .given_up
            .range(leaf(first)..leaf(end))
            .map(|(leaf, ())| NodeKey::leaf(*leaf));
        let taken: Vec<NodeKey> = counted.chain(given_up).chain(self.lent.inside(block)).collect();
        for node in taken {
            self.free.remove(node.first(), node.end());
        }
    }

    /// What the job was charged for a node when its lease was granted, for how long it should take, is corrected by
    /// how long it took.
    fn correct_share(&mut self, worker: WorkerId, node: NodeKey, seconds: f64, config: &SchedulerConfig) {
        let leases = self.lent.sharing(node).map(|token| &self.leases[&token].record);
        let Some(lease) = leases.into_iter().find(|lease| lease.worker == worker) else {
            return;
        };
        let charged = lease.share[1].saturating_sub(lease.share[0]) as f64;
        let expected_ms = lease.expected_ms.unwrap_or(config.lease_target_ms).max(1) as f64;
        let part = node.leaves() as f64 / lease.node.leaves() as f64;
        let correction = charged * (1e3 * seconds / expected_ms - part);
        self.share_correction_ms = self.share_correction_ms.saturating_add(correction as i64);
    }

    /// Its weight is about to change: what it had beyond `served`, which the job served last had had, counts as if it
    /// had had the new weight then.
    pub(in crate::scheduler) fn reweigh(&mut self, control: &JobControl, served: Millis) {
        let (before, after) = (self.weight(), u64::from(control.schedule.priority.max(1)));
        let ahead = self.share_ms().saturating_sub(served);
        if before != after && ahead > 0 {
            let rescaled = ahead as f64 * before as f64 / after as f64;
            let correction = rescaled - ahead as f64;
            self.share_correction_ms = self.share_correction_ms.saturating_add(correction as i64);
        }
    }

    /// Applies a change of this job.
    pub(in crate::scheduler) fn evolve(&mut self, change: &Change, lease_until: Millis, config: &SchedulerConfig) {
        match change {
            Change::JobChanged { control, .. } => self.set_control(control.clone()),
            Change::LeaseGranted(record) => {
                self.state = JobState::Running;
                (self.charged_ms, self.share_correction_ms) = (record.share[1], 0);
                self.hold(record.clone(), lease_until);
            }
            Change::LeaseEnded { token, .. } => self.let_go(*token),
            Change::NodeAdded {
                node,
                record,
                resolution,
                ..
            } => {
                if let (Some(worker), Some(totals)) = (record.worker, &record.totals) {
                    let seconds = totals.seconds.total();
                    self.pace.observe(worker, seconds, node.leaves());
                    self.correct_share(worker, *node, seconds, config);
                }
                self.keep_node(*node, record.clone());
                self.free.remove(node.first(), node.end());
                self.resolution = Some(*resolution);
            }
            Change::NodeJudged { node, record, .. } => self.keep_node(*node, record.clone()),
            Change::NodeMerged { node, .. } => {
                if let Some(record) = self.nodes.all.get(node) {
                    let merged = NodeRecord {
                        live: false,
                        totals: None,
                        ..record.clone()
                    };
                    self.keep_node(*node, merged);
                }
            }
            Change::NodeLost { node, .. } => self.forget_node(*node),
            Change::LeafFailed { leaf, attempt, .. } => self.note_failure(*leaf, attempt.clone(), config),
            Change::FailuresForgotten { .. } => self.forget_failures(),
            // What concerns leases of several jobs, workers, or a job as a whole, is the farm's.
            Change::LeasesRenewed(_)
            | Change::JobEnded { .. }
            | Change::JobSubmitted(_)
            | Change::JobReopened { .. }
            | Change::WorkerRegistered(_)
            | Change::WorkerJudged { .. }
            | Change::WorkerForgotten(_)
            | Change::JobDeleted { .. }
            | Change::NoticeAdded(_) => {}
        }
    }

    /// The coordinator was started again: there is time for the workers to reconnect.
    pub(in crate::scheduler) fn reconnect(&mut self, config: &SchedulerConfig, now: Millis) {
        let reconnect = |lease: &mut HeldLease| lease.expires_ms = lease.after_restart(config, now);
        self.leases.for_each_mut(reconnect);
    }

    /// Notes how many leaves are rendered by now, now and then.
    pub(in crate::scheduler) fn note_pace(&mut self, now: Millis) {
        if self.pace.is_due(now) {
            let rendered = self.rendered();
            self.pace.sample(now, rendered);
        }
    }

    /// A lease lasts until another time.
    pub(in crate::scheduler) fn renew(&mut self, renewal: &Renewal) {
        if let Some(lease) = self.leases.get_mut(&renewal.token) {
            lease.record.until_ms = renewal.until_ms;
            lease.record.restarts = renewal.restarts;
            lease.expires_ms = lease.expires_ms.max(renewal.until_ms);
        }
    }
}
