//! Nodes that workers deliver: whether they count.

use super::job::Job;
use super::record::{BlobName, Change, Loss, Millis, NodeRecord, Opinion, Principal};
use super::{Farm, Refusal};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::Totals;
use photonfarm_proto::node::NodeKey;

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
    /// Which copy of its image the store keeps.
    pub copy: u64,
    /// Whether its worker stored the image and no coordinator has read it yet.
    pub unread: bool,
    /// What it took.
    pub totals: Totals,
    /// Memory that its worker held meanwhile, if that is known \[MiB\].
    pub memory_mb: Option<u32>,
}

/// What became of a delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivered {
    /// It counts from now on.
    Counted,
    /// It, or a node that contains it, counted already.
    Duplicate,
    /// It repeats a node that counts, to be compared with it.
    Repeated,
    /// It differs from a node that counts: another worker decides.
    Disputed,
}

impl Delivery {
    /// The name of its image in the store.
    #[must_use]
    pub fn image(&self) -> BlobName {
        BlobName {
            hash: self.digest,
            copy: self.copy,
        }
    }
}

impl Job {
    /// Decides over a delivery: whether it counts, is known, or is refused.
    ///
    /// A node in `doubt` is to be repeated by a worker of another principal than this one before it is accepted.
    pub fn deliver(
        &self,
        delivery: &Delivery,
        principal: Principal,
        doubt: bool,
    ) -> Result<(Delivered, Vec<Change>), Refusal> {
        let Delivery {
            token, node, digest, ..
        } = *delivery;
        let leaves = self.control.iterations;
        if !node.fits(leaves) {
            return Err(Refusal::Invalid(format!(
                "node {node} lies beyond the job's {leaves} iterations"
            )));
        }
        if let Some(known) = self.nodes.all.get(&node).filter(|known| known.digest != digest) {
            return Err(Refusal::Conflict {
                job: self.id(),
                node,
                counted: known.digest,
                offered: digest,
            });
        }
        if self.covering(node).is_some() {
            return Ok((Delivered::Duplicate, self.leases_covered_by(node, false)));
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
        if let Some([width, height]) = self.resolution().filter(|fixed| *fixed != delivery.resolution) {
            let [w, h] = delivery.resolution;
            return Err(Refusal::Invalid(format!(
                "an image of {w} x {h} for a job of {width} x {height}"
            )));
        }
        Ok((Delivered::Counted, self.count(delivery, principal, doubt)))
    }

    fn count(&self, delivery: &Delivery, principal: Principal, doubt: bool) -> Vec<Change> {
        let (job, node) = (self.id(), delivery.node);
        let inner: Vec<NodeKey> = self.inner(node).collect();
        let loss = Loss::Replaced;
        let over = inner.iter().flat_map(|node| self.verifiers(*node));
        let mut changes: Vec<Change> = over.map(|lease| self.end_lease(lease.token)).collect();
        changes.extend(inner.iter().map(|node| Change::NodeLost { job, node: *node, loss }));
        let opinion = Opinion {
            worker: delivery.worker,
            principal,
            digest: delivery.digest,
        };
        changes.push(Change::NodeAdded {
            job,
            node,
            record: NodeRecord {
                worker: Some(delivery.worker),
                principal,
                unread: delivery.unread,
                totals: Some(delivery.totals),
                opinions: if doubt { vec![opinion] } else { vec![] },
                ..NodeRecord::new(delivery.image())
            },
            resolution: delivery.resolution,
        });
        changes.extend(self.leases_covered_by(node, true));
        changes
    }

    /// Ends the leases that share leaves with `node` and of which every leaf is in the image, once `node` is added to
    /// it or as it is.
    fn leases_covered_by(&self, node: NodeKey, added: bool) -> Vec<Change> {
        let covered = |block: NodeKey| match added {
            true if node.contains(block) => true,
            true => self.covered_within(block) - self.covered_within(node) + node.leaves() == block.leaves(),
            false => self.covered_within(block) == block.leaves(),
        };
        let blocks = self.lent.around(node).chain(self.lent.inside(node));
        let covered = blocks.filter(|block| covered(*block));
        covered
            .flat_map(|block| self.lent.on(block))
            .map(|token| self.end_lease(token))
            .collect()
    }
}

impl Farm {
    /// A delivery of which the work took no longer than its lease has lasted, whatever the worker says: leases are cut, divided
    /// and charged by what was said before.
    pub(super) fn bounded(&self, job: &Job, delivery: &Delivery, now: Millis) -> Delivery {
        let mut bounded = delivery.clone();
        if let Ok(lease) = job.lease(delivery.token, delivery.worker) {
            // The clock may have been set back since.
            let lasted = now.checked_sub(lease.record.granted_ms);
            let most_ms = lasted.unwrap_or(self.config.lease_target_ms);
            bounded.totals.seconds.bound(most_ms as f64 / 1e3);
        }
        bounded
    }
}
