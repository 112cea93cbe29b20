//! One job: what is counted, what is lent, what failed.

use super::pace::Pace;
use super::record::{BlobName, Change, FailedAttempt, JobControl, JobHead, JobRecord, LeaseRecord, Millis, NodeRecord};
use super::{Refusal, SchedulerConfig};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{JobSpec, JobState, Totals};
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeMap;

/// A lease, and what is known of it while the process lives.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldLease {
    /// What is kept.
    pub record: LeaseRecord,
    /// When it ends unless renewed.
    pub expires_ms: Millis,
    /// Leaves rendered, as the worker says.
    pub leaves_done: u64,
}

/// A job.
#[derive(Clone, Debug)]
pub struct Job {
    pub(super) head: JobHead,
    pub(super) control: JobControl,
    /// What it has had of the farm [weighted ms].
    pub(super) share_ms: Millis,
    pub(super) state: JobState,
    pub(super) failure: Option<String>,
    pub(super) ended_ms: Option<Millis>,
    pub(super) resolution: Option<[u32; 2]>,
    /// What nodes took that do not know it themselves.
    unassigned: Totals,
    pub(super) nodes: BTreeMap<NodeKey, NodeRecord>,
    /// Nodes that count, by first leaf.
    pub(super) live: BTreeMap<u64, NodeKey>,
    pub(super) leases: BTreeMap<LeaseToken, HeldLease>,
    pub(super) failures: BTreeMap<u32, Vec<FailedAttempt>>,
    pub(super) pace: Pace,
}

impl Job {
    /// A job just submitted.
    #[must_use]
    pub fn new(head: JobHead) -> Self {
        Self {
            control: JobControl::of(&head.spec),
            share_ms: 0,
            head,
            state: JobState::Queued,
            failure: None,
            ended_ms: None,
            resolution: None,
            unassigned: Totals::default(),
            nodes: BTreeMap::new(),
            live: BTreeMap::new(),
            leases: BTreeMap::new(),
            failures: BTreeMap::new(),
            pace: Pace::default(),
        }
    }

    /// A job as it was kept, its leases with it.
    #[must_use]
    pub fn from_record(record: JobRecord) -> Self {
        let mut job = Self::new(record.head);
        job.state = record.state;
        job.failure = record.failure;
        job.ended_ms = record.ended_ms;
        job.resolution = record.resolution;
        job.control = record.control;
        job.share_ms = record.share_ms;
        job.unassigned = record.totals;
        for (key, node) in record.nodes {
            if node.live {
                job.live.insert(key.first(), key);
            }
            job.nodes.insert(key, node);
        }
        for lease in record.leases {
            let until_ms = lease.until_ms;
            job.hold(lease, until_ms);
        }
        for (leaf, attempt) in record.failures {
            job.failures.entry(leaf).or_default().push(attempt);
        }
        job
    }

    pub(super) fn hold(&mut self, record: LeaseRecord, expires_ms: Millis) {
        let lease = HeldLease {
            expires_ms,
            leaves_done: 0,
            record,
        };
        self.leases.insert(lease.record.token, lease);
    }

    /// The job's number.
    #[must_use]
    pub fn id(&self) -> JobId {
        self.head.id
    }

    /// What never changes.
    #[must_use]
    pub fn head(&self) -> &JobHead {
        &self.head
    }

    /// When it ended; nothing while it goes on.
    #[must_use]
    pub fn ended_ms(&self) -> Option<Millis> {
        self.ended_ms
    }

    /// How it goes on.
    #[must_use]
    pub fn control(&self) -> &JobControl {
        &self.control
    }

    /// What is asked for, as it stands.
    #[must_use]
    pub fn spec(&self) -> JobSpec {
        JobSpec {
            iterations: self.control.iterations,
            schedule: self.control.schedule.clone(),
            ..self.head.spec.clone()
        }
    }

    /// Number of leaves of the whole job.
    #[must_use]
    pub fn leaves(&self) -> u64 {
        self.control.iterations.into()
    }

    /// The nodes that make up the image, from left to right.
    pub fn live_nodes(&self) -> impl Iterator<Item = (NodeKey, BlobHash)> + '_ {
        self.live.values().map(|key| (*key, self.nodes[key].digest))
    }

    /// The nodes that make up the image, from left to right, with the names of their images in the store.
    pub fn live_images(&self) -> impl Iterator<Item = (NodeKey, BlobName)> + '_ {
        self.live.values().map(|key| (*key, self.nodes[key].image()))
    }

    /// The name in the store of the image of a node that counts on its own.
    #[must_use]
    pub fn live_image(&self, node: NodeKey) -> Option<BlobName> {
        self.is_live(node).then(|| self.nodes[&node].image())
    }

    /// Whether a node counts on its own.
    #[must_use]
    pub fn is_live(&self, node: NodeKey) -> bool {
        self.live.get(&node.first()) == Some(&node)
    }

    /// Iterations in the image.
    #[must_use]
    pub fn done(&self) -> u64 {
        self.live.values().map(|node| node.leaves()).sum()
    }

    /// Pixels across and down, which the first node fixes for as long as any node counts: it may be given up.
    #[must_use]
    pub fn resolution(&self) -> Option<[u32; 2]> {
        self.resolution.filter(|_| !self.live.is_empty())
    }

    /// What the iterations in the image took.
    #[must_use]
    pub fn totals(&self) -> Totals {
        let mut sum = self.unassigned;
        let totals = self.live.values().filter_map(|node| self.nodes[node].totals.as_ref());
        totals.for_each(|totals| sum.add(totals));
        sum
    }

    /// Leaves of `node` that are in the image.
    pub(super) fn covered_within(&self, node: NodeKey) -> u64 {
        if self.covering(node).is_some() {
            return node.leaves();
        }
        self.live
            .range(node.first()..node.end())
            .map(|(_, inner)| inner.leaves())
            .sum()
    }

    /// The node of the image that contains `node`.
    pub(super) fn covering(&self, node: NodeKey) -> Option<NodeKey> {
        let (_, last) = self.live.range(..=node.first()).next_back()?;
        last.contains(node).then_some(*last)
    }

    pub(super) fn live_ranges(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        self.live.values().map(|node| (node.first(), node.end()))
    }

    /// Leaves given up that are not in the image, with their attempts.
    pub(super) fn poisoned<'a>(
        &'a self,
        config: &'a SchedulerConfig,
    ) -> impl Iterator<Item = (u32, &'a [FailedAttempt])> {
        self.failures
            .iter()
            .filter(|(leaf, _)| u64::from(**leaf) < self.leaves() && self.covering(NodeKey::leaf(**leaf)).is_none())
            .filter(|(_, attempts)| config.is_poisoned(attempts))
            .map(|(leaf, attempts)| (*leaf, attempts.as_slice()))
    }

    /// The leases held.
    #[cfg(test)]
    pub(crate) fn leases_held(&self) -> Vec<HeldLease> {
        self.leases.values().cloned().collect()
    }

    /// The lease, if this worker holds it.
    pub fn lease(&self, token: LeaseToken, worker: WorkerId) -> Result<&HeldLease, Refusal> {
        self.leases
            .get(&token)
            .filter(|lease| lease.record.worker == worker)
            .ok_or(Refusal::StaleLease(token))
    }

    pub(super) fn end_lease(&self, token: LeaseToken) -> Change {
        Change::LeaseEnded { job: self.id(), token }
    }

    /// Applies a change of this job.
    pub(super) fn evolve(&mut self, change: &Change, lease_until: Millis) {
        match change {
            Change::JobChanged { control, .. } => self.control = control.clone(),
            Change::LeasesRenewed(renewals) => {
                for renewal in renewals {
                    if let Some(lease) = self.leases.get_mut(&renewal.token) {
                        lease.record.until_ms = renewal.until_ms;
                        lease.record.restarts = renewal.restarts;
                        lease.expires_ms = lease.expires_ms.max(renewal.until_ms);
                    }
                }
            }
            Change::LeaseGranted(record) => {
                self.state = JobState::Running;
                self.share_ms = record.share[1];
                self.hold(record.clone(), lease_until);
            }
            Change::LeaseEnded { token, .. } => _ = self.leases.remove(token),
            Change::NodeAdded {
                node,
                record,
                resolution,
                ..
            } => {
                if let (Some(worker), Some(totals)) = (record.worker, &record.totals) {
                    self.pace.observe(worker, totals.seconds.total(), node.leaves());
                }
                self.nodes.insert(*node, record.clone());
                self.live.insert(node.first(), *node);
                self.resolution = Some(*resolution);
            }
            Change::NodeJudged { node, record, .. } => _ = self.nodes.insert(*node, record.clone()),
            Change::NodeMerged { node, .. } => {
                if let Some(record) = self.nodes.get_mut(node) {
                    (record.live, record.totals) = (false, None);
                    self.live.remove(&node.first());
                }
            }
            Change::NodeLost { node, .. } => {
                self.nodes.retain(|key, _| !node.contains(*key));
                self.live.remove(&node.first());
            }
            Change::LeafFailed { leaf, attempt, .. } => self.failures.entry(*leaf).or_default().push(attempt.clone()),
            Change::JobEnded {
                state,
                failure,
                ended_ms,
                ..
            } => {
                self.state = *state;
                self.failure.clone_from(failure);
                self.ended_ms = Some(*ended_ms);
                self.leases.clear();
            }
            Change::JobSubmitted(_)
            | Change::JobReopened { .. }
            | Change::WorkerRegistered(_)
            | Change::WorkerJudged { .. }
            | Change::WorkerForgotten(_)
            | Change::JobDeleted { .. } => {}
        }
    }
}
