//! Jobs of sequential integrators: one chain of iterations, each of which goes on from the statistics of the one before.
//!
//! The image of a node carries the statistics after its last iteration, so that every node of the image is a checkpoint: the
//! next block begins where the complete prefix ends, and goes on from the node that ends there. Images are added up as
//! those of any job, and the sum takes the statistics of its right child. Work on a wrong checkpoint is wrong: what follows a node
//! that is found out goes with it, and while a node is in doubt nothing is built on it.

use super::job::Job;
use super::record::{BlobName, Change, FailedAttempt, Loss};
use super::{Decision, Farm, Refusal};
use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
use photonfarm_proto::node::{NodeHeader, NodeKey};

impl Job {
    /// Leaves that are in the image from the first one on, without a gap.
    pub(super) fn complete(&self) -> u64 {
        let mut complete = 0;
        for node in self.nodes.live.values() {
            if node.first() != complete {
                break;
            }
            complete = node.end();
        }
        complete
    }

    /// Whether a block that begins with leaf `first` can be rendered now, and nothing that it is built on is in doubt.
    pub(super) fn can_begin_at(&self, first: u64) -> bool {
        !self.is_chain() || first == self.complete() && self.nodes_in_doubt().all(|node| node.first() >= first)
    }

    /// Whether a node that counts can be rendered once more: what it goes on from is there.
    pub(super) fn can_be_repeated(&self, node: NodeKey) -> bool {
        !self.is_chain() || node.first() <= self.complete()
    }

    /// The largest aligned part of a block of a chain that can be rendered now.
    pub(super) fn next_link(&self, block: NodeKey) -> Option<NodeKey> {
        let first = self.complete();
        let within = |level: &u32| first.is_multiple_of(1 << level) && first + (1 << level) <= block.end();
        let level = (0..=block.level).rev().find(within)?;
        (first >= block.first()).then_some(NodeKey {
            level,
            index: u32::try_from(first >> level).ok()?,
        })
    }

    /// Of a chain: gives up what was built on a checkpoint before leaf `from`, and revokes the leases on what is being built.
    pub(super) fn revoke_after(&self, from: u64) -> Vec<Change> {
        if !self.is_chain() {
            return vec![];
        }
        let (job, loss) = (self.id(), Loss::Untrusted);
        let leases = self.leases.values().map(|lease| &lease.record);
        let built = leases.filter(|lease| lease.node.end() > from);
        let mut changes: Vec<Change> = built.map(|lease| self.end_lease(lease.token)).collect();
        let nodes = self.live_nodes().filter(|(node, _)| node.first() >= from);
        changes.extend(nodes.map(|(node, _)| Change::NodeLost { job, node, loss }));
        changes
    }

    /// The leaf of a chain that was given up and that all others wait for, with its attempts.
    pub(super) fn broken_link(&self) -> Option<(u32, &[FailedAttempt])> {
        let next = self.complete();
        let mut given_up = self.given_up();
        given_up.find(|(leaf, _)| self.is_chain() && u64::from(*leaf) == next)
    }

    /// What precedes the planes of a node's image.
    #[must_use]
    pub fn header(&self, key: NodeKey) -> NodeHeader {
        let [width, height] = self.resolution().unwrap_or_default();
        NodeHeader {
            job: self.id(),
            key,
            width,
            height,
            statistics: self.statistics_per_pixel(),
        }
    }

    /// Statistics of each pixel in the image of a node.
    #[must_use]
    pub fn statistics_per_pixel(&self) -> u16 {
        self.head.spec.integrator.with_defaults().statistics_per_pixel() as u16
    }
}

impl Farm {
    /// The node of which the statistics are those that a lease goes on from; `None` if a node before it was given up.
    pub fn checkpoint_of(
        &self,
        job: JobId,
        token: LeaseToken,
        worker: WorkerId,
    ) -> Result<Decision<Option<(NodeHeader, BlobName)>>, Refusal> {
        let job = self.live_job(job)?;
        let first = job.lease(token, worker)?.record.node.first();
        if !job.is_chain() || first == 0 {
            return Err(Refusal::Invalid("the lease goes on from nothing".into()));
        }
        let before = job.live_images().find(|(node, _)| node.end() == first);
        let checkpoint = before.map(|(node, image)| (job.header(node), image));
        Ok(Decision::new(checkpoint, vec![]))
    }
}
