//! One job: what is counted, what is lent, what failed.

use super::pace::Pace;
use super::record::{Change, JobControl, JobHead, JobRecord, LeaseRecord, Loss, Millis, NodeRecord};
use super::{Refusal, SchedulerConfig};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobSpec, JobState, JobStatus, Poisoned, Totals};
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeMap;

/// A node that a worker delivers; its bytes are safe in the store, or the worker says so.
#[derive(Clone, Debug, PartialEq)]
pub struct Delivery {
    /// The lease under which it was rendered.
    pub token: LeaseToken,
    /// Who rendered it.
    pub worker: WorkerId,
    /// The job.
    pub job: JobId,
    /// The node.
    pub node: NodeKey,
    /// Image size.
    pub resolution: [u32; 2],
    /// Hash of its image.
    pub digest: BlobHash,
    /// Whether its worker stored the image and no coordinator has read it yet.
    pub unread: bool,
    /// What it took.
    pub totals: Totals,
}

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
    failure: Option<String>,
    ended_ms: Option<Millis>,
    resolution: Option<[u32; 2]>,
    /// What nodes took that do not know it themselves.
    unassigned: Totals,
    nodes: BTreeMap<NodeKey, NodeRecord>,
    /// Nodes that count, by first leaf.
    live: BTreeMap<u64, NodeKey>,
    pub(super) leases: BTreeMap<LeaseToken, HeldLease>,
    pub(super) failures: BTreeMap<u32, Vec<Attempt>>,
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

    /// A job as it was kept. Its leases last until `leases_until`.
    #[must_use]
    pub fn from_record(record: JobRecord, leases_until: Millis) -> Self {
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
            job.hold(lease, leases_until);
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

    /// Pixels across and down, once the first node has fixed them.
    #[must_use]
    pub fn resolution(&self) -> Option<[u32; 2]> {
        self.resolution
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
    fn covering(&self, node: NodeKey) -> Option<NodeKey> {
        let (_, last) = self.live.range(..=node.first()).next_back()?;
        last.contains(node).then_some(*last)
    }

    pub(super) fn live_ranges(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        self.live.values().map(|node| (node.first(), node.end()))
    }

    /// Leaves given up that are not in the image, with their attempts.
    pub(super) fn poisoned<'a>(&'a self, config: &'a SchedulerConfig) -> impl Iterator<Item = (u32, &'a [Attempt])> {
        self.failures
            .iter()
            .filter(|(leaf, attempts)| config.is_poisoned(attempts) && self.covering(NodeKey::leaf(**leaf)).is_none())
            .map(|(leaf, attempts)| (*leaf, attempts.as_slice()))
    }

    /// Decides over a delivery: whether it counts, is known, or is refused.
    pub fn deliver(&self, delivery: &Delivery) -> Result<(Delivered, Vec<Change>), Refusal> {
        let Delivery {
            token, node, digest, ..
        } = *delivery;
        let leaves = self.control.iterations;
        if !node.fits(leaves) {
            return Err(Refusal::Invalid(format!(
                "node {node} lies beyond the job's {leaves} iterations"
            )));
        }
        if let Some(known) = self.nodes.get(&node).filter(|known| known.digest != digest) {
            return Err(Refusal::Conflict {
                job: self.id(),
                node,
                counted: known.digest,
                offered: digest,
            });
        }
        if self.covering(node).is_some() {
            return Ok((Delivered::Duplicate, self.leases_covered_by(None)));
        }
        if self.state.ended() {
            return Err(Refusal::JobEnded(self.id()));
        }
        let lease = self.lease(token, delivery.worker)?;
        if !lease.record.node.contains(node) {
            return Err(Refusal::Invalid(format!(
                "node {node} lies outside the lease of {}",
                lease.record.node
            )));
        }
        if let Some([width, height]) = self.resolution.filter(|fixed| *fixed != delivery.resolution) {
            let [w, h] = delivery.resolution;
            return Err(Refusal::Invalid(format!(
                "an image of {w} x {h} for a job of {width} x {height}"
            )));
        }
        Ok((Delivered::Counted, self.count(delivery)))
    }

    fn count(&self, delivery: &Delivery) -> Vec<Change> {
        let (job, node) = (self.id(), delivery.node);
        let inner: Vec<NodeKey> = self.live.range(node.first()..node.end()).map(|(_, key)| *key).collect();
        let mut changes: Vec<Change> = inner.into_iter().map(|node| Change::NodeMerged { job, node }).collect();
        changes.push(Change::NodeAdded {
            job,
            node,
            record: NodeRecord {
                worker: Some(delivery.worker),
                unread: delivery.unread,
                totals: Some(delivery.totals),
                ..NodeRecord::new(delivery.digest)
            },
            resolution: delivery.resolution,
        });
        changes.extend(self.leases_covered_by(Some(node)));
        changes
    }

    /// Ends the leases of which every leaf is in the image once `added` is.
    fn leases_covered_by(&self, added: Option<NodeKey>) -> Vec<Change> {
        let covered = |block: NodeKey| match added {
            Some(node) if node.contains(block) => true,
            Some(node) if block.contains(node) => {
                self.covered_within(block) - self.covered_within(node) + node.leaves() == block.leaves()
            }
            _ => self.covered_within(block) == block.leaves(),
        };
        self.leases
            .values()
            .filter(|lease| covered(lease.record.node))
            .map(|lease| self.end_lease(lease.record.token))
            .collect()
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
            FailureKind::Scene => Ok(vec![]),
            FailureKind::Render | FailureKind::Panic => {
                Ok(vec![Change::LeafFailed { job, leaf, attempt }, self.end_lease(token)])
            }
        }
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

    /// The leftmost two siblings that both count: their parent is to be made.
    #[must_use]
    pub fn next_merge(&self) -> Option<NodeKey> {
        self.live
            .values()
            .find(|left| left.index.is_multiple_of(2) && self.is_live(left.sibling()))
            .map(|left| left.parent())
    }

    /// Replaces two siblings by their parent; `None` if they are not both there any more.
    #[must_use]
    pub fn merge(&self, parent: NodeKey, digest: BlobHash) -> Option<Vec<Change>> {
        let children = parent.children()?;
        if self.state.ended() || !children.iter().all(|child| self.is_live(*child)) {
            return None;
        }
        let job = self.id();
        let mut changes: Vec<Change> = children.map(|node| Change::NodeMerged { job, node }).into();
        let mut totals: Option<Totals> = None;
        for took in children.iter().filter_map(|child| self.nodes[child].totals.as_ref()) {
            totals.get_or_insert_default().add(took);
        }
        changes.push(Change::NodeAdded {
            job,
            node: parent,
            record: NodeRecord {
                totals,
                ..NodeRecord::new(digest)
            },
            resolution: self.resolution?,
        });
        Some(changes)
    }

    /// The leftmost node of the image that no coordinator has read yet.
    #[must_use]
    pub fn next_unread(&self) -> Option<(NodeKey, BlobHash)> {
        let mut live = self.live.values().map(|key| (*key, &self.nodes[key]));
        live.find(|(_, record)| record.unread)
            .map(|(key, record)| (key, record.digest))
    }

    /// The image of a node was read, and is what it should be.
    #[must_use]
    pub fn check(&self, node: NodeKey) -> Option<Change> {
        let record = self.nodes.get(&node).filter(|record| record.live && record.unread)?;
        Some(Change::NodeJudged {
            job: self.id(),
            node,
            record: NodeRecord {
                unread: false,
                ..record.clone()
            },
        })
    }

    /// Gives up a node whose image is missing or damaged. If it never was as its worker said, that is the worker's
    /// failure.
    #[must_use]
    pub fn lose(&self, node: NodeKey, reason: &str, now: Millis) -> Vec<Change> {
        let (job, loss) = (self.id(), Loss::Damaged);
        if !self.is_live(node) || self.state.ended() {
            return Vec::new();
        }
        let mut changes = vec![Change::NodeLost { job, node, loss }];
        let record = &self.nodes[&node];
        if let (Some(worker), true, Ok(leaf)) = (record.worker, record.unread, u32::try_from(node.first())) {
            let attempt = Attempt {
                worker,
                kind: FailureKind::Render,
                message: format!("worker {worker} delivered node {node}, but {reason}"),
                at_ms: now,
            };
            changes.push(Change::LeafFailed { job, leaf, attempt });
        }
        changes
    }

    /// Ends the job once every leaf is in the tree's shape in the image, read by a coordinator, or given up.
    #[must_use]
    pub fn settle(&self, config: &SchedulerConfig, now: Millis) -> Option<Change> {
        if self.state.ended() || self.next_merge().is_some() || self.next_unread().is_some() {
            return None;
        }
        let poisoned: Vec<_> = self.poisoned(config).collect();
        let leased = |leaf: u32| {
            self.leases
                .values()
                .any(|lease| lease.record.node.contains(NodeKey::leaf(leaf)))
        };
        if self.done() + poisoned.len() as u64 != self.leaves() || poisoned.iter().any(|(leaf, _)| leased(*leaf)) {
            return None;
        }
        let failure = poisoned.first().map(|(leaf, attempts)| {
            let reason = attempts.last().map_or("", |attempt| attempt.message.as_str());
            let (count, of) = (poisoned.len(), self.leaves());
            format!(
                "{count} of {of} iterations could not be rendered; iteration {}: {reason}",
                leaf + 1
            )
        });
        let state = if failure.is_some() {
            JobState::Failed
        } else {
            JobState::Done
        };
        Some(Change::JobEnded {
            job: self.id(),
            state,
            failure,
            ended_ms: now,
        })
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
            | Change::WorkerForgotten(_) => {}
        }
    }

    /// Leaves rendered, delivered or not.
    #[must_use]
    pub fn rendered(&self) -> u64 {
        let mut undelivered: BTreeMap<NodeKey, u64> = BTreeMap::new();
        for lease in self.leases.values() {
            let left = lease.record.node.leaves() - self.covered_within(lease.record.node);
            let entry = undelivered.entry(lease.record.node).or_default();
            *entry = (*entry).max(lease.leaves_done.min(left));
        }
        self.done() + undelivered.values().sum::<u64>()
    }

    /// How far the job has come.
    #[must_use]
    pub fn status(&self, config: &SchedulerConfig) -> JobStatus {
        let poisoned = self.poisoned(config).map(|(leaf, attempts)| Poisoned {
            iteration: leaf + 1,
            attempts: attempts.to_vec(),
        });
        let mut workers: Vec<WorkerId> = self.leases.values().map(|lease| lease.record.worker).collect();
        workers.sort_unstable();
        workers.dedup();
        JobStatus {
            id: self.id(),
            state: self.state,
            spec: self.spec(),
            owner: self.head.owner.clone(),
            created_ms: self.head.created_ms,
            ended_ms: self.ended_ms,
            iterations_done: self.done(),
            iterations_rendered: self.rendered(),
            poisoned: poisoned.collect(),
            failure: self.failure.clone(),
            resolution: self.resolution,
            totals: self.totals(),
            iterations_per_second: self.pace.iterations_per_second(),
            workers: workers.len() as u32,
            iterations_in_doubt: 0,
            renderer: self.control.renderer.clone(),
            checkpoint: self.control.checkpoint,
            stop: self.control.stop,
            waiting: None,
        }
    }
}

/// What became of a delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivered {
    /// It counts from now on.
    Counted,
    /// It, or a node that contains it, counted already.
    Duplicate,
}
