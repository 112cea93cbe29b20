//! Random numbers, and what nodes are: a digest is a hash of what the node consists of.

use crate::scheduler::Job;
use crate::scheduler::record::Principal;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::node::NodeKey;

/// SplitMix64.
pub(in crate::scheduler::tests) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    pub(in crate::scheduler::tests) fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    pub(in crate::scheduler::tests) fn chance(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }

    pub(super) fn pick<'a, T>(&mut self, items: &'a [T]) -> Option<&'a T> {
        let n = items.len() as u64;
        (n > 0).then(|| &items[self.below(n) as usize])
    }
}

pub(super) fn mix(state: u64) -> u64 {
    let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

pub(super) fn hash(a: u64, b: u64, c: u64) -> BlobHash {
    let number = mix(mix(mix(a ^ 0x5851_f42d).wrapping_add(b)).wrapping_add(c)) | 1;
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    BlobHash(bytes)
}

pub(super) fn word(hash: BlobHash) -> u64 {
    u64::from_le_bytes(hash.0[..8].try_into().unwrap())
}

fn sum(left: BlobHash, right: BlobHash) -> BlobHash {
    hash(word(left), word(right), 3)
}

/// The digest of a node that others of the job's image make up.
pub(super) fn added_up(job: &Job, node: NodeKey) -> BlobHash {
    if let Some(image) = job.live_image(node) {
        return image.hash;
    }
    let [left, right] = node.children().unwrap().map(|child| added_up(job, child));
    sum(left, right)
}

/// The digest of a node that was rendered as it should be.
pub(super) fn honest(job: JobId, node: NodeKey) -> BlobHash {
    match node.children() {
        None => hash(job.0, node.index.into(), 1),
        Some([left, right]) => sum(honest(job, left), honest(job, right)),
    }
}

/// What a chain goes on from before a leaf, if all was rendered as it should be.
pub(super) fn statistics(job: JobId, leaf: u64) -> u64 {
    word(hash(job.0, leaf, 5))
}

/// A leaf of a chain that goes on from `before`: its digest, and what the next one goes on from.
fn link(job: JobId, leaf: u64, before: u64) -> (BlobHash, u64) {
    if before == statistics(job, leaf) {
        return (honest(job, NodeKey::leaf(leaf as u32)), statistics(job, leaf + 1));
    }
    let digest = hash(job.0 ^ before, leaf, 4);
    (digest, mix(word(digest)))
}

/// A node of a chain that goes on from `before`.
pub(super) fn links(job: JobId, node: NodeKey, before: u64) -> (BlobHash, u64) {
    let Some([left, right]) = node.children() else {
        return link(job, node.first(), before);
    };
    let (left, before) = links(job, left, before);
    let (right, after) = links(job, right, before);
    (sum(left, right), after)
}

/// A principal tells the same lie by all of its workers, and no two principals tell the same.
pub(super) fn lie(principal: Principal, job: JobId, node: NodeKey) -> BlobHash {
    hash(
        principal.0,
        job.0 << 40 | u64::from(node.level) << 32 | u64::from(node.index),
        2,
    )
}

/// The noise of a job's prefix at a level: falls with the root of the iterations.
pub(super) fn noise(level: u32) -> f64 {
    (1.0 / f64::from(1 << level)).sqrt()
}
