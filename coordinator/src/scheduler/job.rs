//! One job: what is counted, what is lent, what failed.

mod evolve;

use super::demand::Demand;
use super::lent::Lent;
use super::nodes::Nodes;
use super::pace::Pace;
use super::ranges::Ranges;
use super::record::{BlobName, Change, FailedAttempt, JobControl, JobHead, JobRecord, LeaseRecord, Millis};
use super::table::{Set, Table};
use super::{Refusal, SchedulerConfig};
use photonfarm_core::integrator::layers::Layers;
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{JobSpec, JobState, Totals};
use photonfarm_proto::node::NodeKey;
use std::sync::Arc;

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
    /// What it was charged of the farm [weighted ms]; kept as its share.
    pub(super) charged_ms: Millis,
    /// What leases took beyond what they should have, or less, since the last was granted [weighted ms].
    share_correction_ms: i64,
    pub(super) state: JobState,
    pub(super) failure: Option<String>,
    pub(super) ended_ms: Option<Millis>,
    pub(super) resolution: Option<[u32; 2]>,
    /// What nodes took that do not know it themselves.
    unassigned: Totals,
    pub(super) nodes: Nodes,
    pub(super) leases: Table<LeaseToken, HeldLease>,
    /// The blocks of leases that add to the image.
    pub(super) lent: Lent,
    /// The nodes of the image that are rendered once more.
    pub(super) repeated: Lent,
    pub(super) failures: Table<u32, Vec<FailedAttempt>>,
    /// Leaves that are tried no more.
    pub(super) given_up: Set<u32>,
    /// Leaves that are neither in the image, nor lent, nor given up.
    pub(super) free: Ranges,
    /// Whether iterations go on from each other.
    chain: bool,
    /// What is rendered beside the picture. The names were checked when the job came.
    layers: Arc<Layers>,
    /// What it asks of its workers.
    pub(super) demand: Arc<Demand>,
    pub(super) owner: Arc<str>,
    pub(super) pace: Pace,
}

impl Job {
    /// A job just submitted.
    #[must_use]
    pub fn new(head: JobHead) -> Self {
        let mut free = Ranges::default();
        free.add(0, head.spec.iterations.into());
        let control = JobControl::of(&head.spec);
        Self {
            demand: Arc::new(Demand::of(&control, &Table::default())),
            control,
            charged_ms: 0,
            share_correction_ms: 0,
            chain: head.spec.integrator.with_defaults().is_sequential(),
            layers: Arc::new(head.spec.layers().unwrap_or_default()),
            owner: head.owner.as_str().into(),
            head,
            state: JobState::Queued,
            failure: None,
            ended_ms: None,
            resolution: None,
            unassigned: Totals::default(),
            nodes: Nodes::default(),
            leases: Table::default(),
            lent: Lent::default(),
            repeated: Lent::default(),
            failures: Table::default(),
            given_up: Set::default(),
            free,
            pace: Pace::default(),
        }
    }

    /// A job as it was kept, its leases with it.
    #[must_use]
    pub fn from_record(record: JobRecord, config: &SchedulerConfig) -> Self {
        let mut job = Self::new(record.head);
        job.state = record.state;
        job.failure = record.failure;
        job.ended_ms = record.ended_ms;
        job.resolution = record.resolution;
        job.charged_ms = record.share_ms;
        job.unassigned = record.totals;
        job.set_control(record.control);
        for (leaf, attempt) in record.failures {
            job.note_failure(leaf, attempt, config);
        }
        for (key, node) in record.nodes {
            let live = node.live;
            job.keep_node(key, node);
            if live {
                job.free.remove(key.first(), key.end());
            }
        }
        for lease in record.leases {
            let until_ms = lease.until_ms;
            job.hold(lease, until_ms);
        }
        job.pace.begin_with(job.totals().seconds.total(), job.done());
        job
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

    /// Whether nothing of it was ever lent.
    #[must_use]
    pub fn is_queued(&self) -> bool {
        self.state == JobState::Queued
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
        self.nodes.live.values().map(|key| (*key, self.nodes.all[key].digest))
    }

    /// The nodes that make up the image, from left to right, with the names of their images in the store.
    pub fn live_images(&self) -> impl Iterator<Item = (NodeKey, BlobName)> + '_ {
        self.nodes.live.values().map(|key| (*key, self.nodes.all[key].image()))
    }

    /// The name in the store of the image of a node that counts on its own.
    #[must_use]
    pub fn live_image(&self, node: NodeKey) -> Option<BlobName> {
        self.is_live(node).then(|| self.nodes.all[&node].image())
    }

    /// Whether a node counts on its own.
    #[must_use]
    pub fn is_live(&self, node: NodeKey) -> bool {
        self.nodes.is_live(node)
    }

    /// Iterations in the image.
    #[must_use]
    pub fn done(&self) -> u64 {
        self.nodes.done
    }

    /// Pixels across and down of the picture; [`Self::resolution`] has the planes of its layers below it.
    #[must_use]
    pub fn picture_size(&self) -> Option<[u32; 2]> {
        self.resolution().map(|size| self.layers.picture_size(size))
    }

    /// What is rendered beside the picture.
    #[must_use]
    pub fn layers(&self) -> &Arc<Layers> {
        &self.layers
    }

    /// Pixels across and down of each node, which the first node fixes for as long as any node counts: it may be given up.
    #[must_use]
    pub fn resolution(&self) -> Option<[u32; 2]> {
        self.resolution.filter(|_| !self.nodes.live.is_empty())
    }

    /// What the iterations in the image took.
    #[must_use]
    pub fn totals(&self) -> Totals {
        let mut sum = self.unassigned;
        let live = self.nodes.live.values();
        let totals = live.filter_map(|node| self.nodes.all[node].totals.as_ref());
        totals.for_each(|totals| sum.add(totals));
        sum
    }

    /// Leaves of `node` that are in the image.
    pub(super) fn covered_within(&self, node: NodeKey) -> u64 {
        if self.covering(node).is_some() {
            return node.leaves();
        }
        self.inner(node).map(NodeKey::leaves).sum()
    }

    /// The node of the image that contains `node`.
    pub(super) fn covering(&self, node: NodeKey) -> Option<NodeKey> {
        let (_, last) = self.nodes.live.range(..=node.first()).next_back()?;
        last.contains(node).then_some(*last)
    }

    /// The nodes of the image that begin within `node`.
    pub(super) fn inner(&self, node: NodeKey) -> impl Iterator<Item = NodeKey> + '_ {
        let live = self.nodes.live.range(node.first()..node.end());
        live.map(|(_, inner)| *inner)
    }

    /// Whether iterations go on from each other.
    #[must_use]
    pub fn is_chain(&self) -> bool {
        self.chain
    }

    /// Leaves given up that are not in the image, with their attempts.
    pub(super) fn given_up(&self) -> impl Iterator<Item = (u32, &[FailedAttempt])> {
        let within = self.given_up.range(..leaf(self.leaves())).map(|(leaf, ())| *leaf);
        within
            .filter(|leaf| self.covering(NodeKey::leaf(*leaf)).is_none())
            .map(|leaf| (leaf, self.failures[&leaf].as_slice()))
    }

    /// The tokens of the leases held.
    pub(crate) fn lease_tokens(&self) -> impl Iterator<Item = LeaseToken> + '_ {
        self.leases.values().map(|lease| lease.record.token)
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

    /// What is kept of a lease that is held.
    #[must_use]
    pub fn lease_record(&self, token: LeaseToken) -> Option<&LeaseRecord> {
        Some(&self.leases.get(&token)?.record)
    }

    pub(super) fn end_lease(&self, token: LeaseToken) -> Change {
        Change::LeaseEnded { job: self.id(), token }
    }

    /// What it has had of the farm [weighted ms]: leases that are over by what they took.
    pub(super) fn share_ms(&self) -> Millis {
        self.charged_ms.saturating_add_signed(self.share_correction_ms)
    }
}

/// A number of leaves as the number of a leaf: there are at most 2^32 - 1 of them.
fn leaf(number: u64) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
