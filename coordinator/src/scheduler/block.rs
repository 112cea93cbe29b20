//! Which leaves to lend next, and how many; which to lend a second time.

use super::SchedulerConfig;
use super::job::{HeldLease, Job};
use super::ranges::Ranges;
use super::record::{FailedAttempt, LeaseRecord, Millis, Principal};
use super::roster::Staff;
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::node::NodeKey;

/// A block to lend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) node: NodeKey,
    pub(super) expected_ms: Option<Millis>,
    pub(super) attempt: u32,
    /// Whether it is to be repeated, to be compared.
    pub(super) verifies: bool,
}

/// Whom a block is for, and when.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taker<'a> {
    pub(super) worker: WorkerId,
    /// Who is behind it.
    pub(super) principal: Principal,
    /// The workers that are heard of and may work on the job, this one among them.
    pub(super) staff: &'a Staff<'a>,
    pub(super) now: Millis,
    pub(super) config: &'a SchedulerConfig,
}

impl Taker<'_> {
    /// Whether a leaf that failed before is to be left alone for now: everybody waits a while, longer after each
    /// failure, and who has failed leaves it to others, for longest of all, if there are any.
    fn leaves_alone(&self, attempts: &[FailedAttempt]) -> bool {
        let failed = |principal: &Principal| attempts.iter().any(|attempt| attempt.principal == *principal);
        let others = failed(&self.principal) && !self.staff.principals().all(|other| failed(&other));
        let mut counted = attempts.iter().filter(|attempt| !attempt.repeated);
        let doublings = counted.clone().count().clamp(1, 32) as u32 - 1;
        let pause = self.config.retry_ms.saturating_mul(1 << doublings);
        let longest = self.config.longest_retry_ms;
        let (last, wait) = match others {
            true => (attempts.last(), longest),
            false => (counted.next_back(), pause.min(longest)),
        };
        last.is_some_and(|last| self.now >= last.attempt.at_ms && self.now - last.attempt.at_ms < wait)
    }
}

impl Job {
    /// The next block for `worker`: the lowest free leaves, an aligned power of two of them that takes about the time
    /// of a lease, ends before the deadline, and leaves enough for all workers to end together.
    pub(super) fn next_block(&self, taker: &Taker) -> Option<Block> {
        let (worker, config) = (taker.worker, taker.config);
        let (first, free_until) = self.first_free(taker)?;
        if !self.can_begin_at(first) {
            return None;
        }
        let failed = |leaf: &u64| u32::try_from(*leaf).ok().and_then(|leaf| self.failures.get(&leaf));
        let mut suspects = self.failures.range(first as u32..).map(|(leaf, _)| u64::from(*leaf));
        let largest = match suspects.next() {
            Some(leaf) if leaf == first => 1,
            Some(leaf) => free_until.min(leaf) - first,
            None => free_until - first,
        };
        let free = self.free.leaves();
        // Nobody else could work on a chain meanwhile.
        let share = match self.is_chain() {
            true => free,
            false => (free / (2 * taker.staff.workers().max(1))).max(1),
        };
        let seconds = self.pace.seconds_per_iteration(worker);
        let target_ms = self
            .ms_left(taker.now)
            .unwrap_or(Millis::MAX)
            .min(config.lease_target_ms);
        let by_time = seconds.map_or(1.0, |s| target_ms as f64 / 1e3 / s).max(1.0) as u64;
        let aligned = if first == 0 {
            u64::MAX
        } else {
            1 << first.trailing_zeros()
        };
        let level = largest.min(share).min(by_time).min(aligned).ilog2().min(if first == 0 {
            self.highest_first_level()
        } else {
            NodeKey::MAX_LEVEL
        });
        let node = NodeKey {
            level,
            index: u32::try_from(first >> level).ok()?,
        };
        Some(Block {
            node,
            expected_ms: self.expected_ms(worker, node),
            attempt: 1 + failed(&first).map_or(0, Vec::len) as u32,
            verifies: false,
        })
    }

    /// The first range of leaves that are free and need not rest.
    fn first_free(&self, taker: &Taker) -> Option<(u64, u64)> {
        self.free.iter().find_map(|(mut from, to)| {
            for (leaf, attempts) in self.failures.range(from as u32..) {
                if u64::from(*leaf) != from || from == to || !taker.leaves_alone(attempts) {
                    break;
                }
                from += 1;
            }
            (from < to).then_some((from, to))
        })
    }

    /// A node in doubt that a worker may repeat and nobody does.
    pub(super) fn next_doubt(&self, taker: &Taker) -> Option<Block> {
        let mut doubts = self.nodes.to_repeat(taker.principal);
        let node = doubts.find(|node| self.can_be_repeated(*node))?;
        Some(Block {
            node,
            expected_ms: self.expected_ms(taker.worker, node),
            attempt: 1,
            verifies: true,
        })
    }

    /// What to lend of a lease a second time: a part that its worker has not come to, or all of what cannot be divided.
    /// Whoever has it already must have been given enough time for it.
    pub(super) fn steal(&self, lease: &HeldLease, taker: &Taker) -> Option<Block> {
        let record = &lease.record;
        let patience = |holder: &LeaseRecord| {
            let expected = holder.expected_ms.or(self.expected_ms(taker.worker, holder.node))?;
            Some(taker.config.patience_ms(expected))
        };
        let patient = |holder: &LeaseRecord, times: u64| {
            let elapsed = taker.now.saturating_sub(holder.granted_ms);
            patience(holder).is_none_or(|ms| elapsed <= ms.saturating_mul(times))
        };
        if record.worker == taker.worker || patient(record, 1) {
            return None;
        }
        let node = match record.verifies {
            true => record.node,
            false if self.is_chain() => self
                .next_link(record.node)
                .filter(|_| self.can_begin_at(self.complete()))?,
            false => self.part_left(lease)?,
        };
        let leaves = node.first() as u32..=(node.end() - 1) as u32;
        if !record.verifies
            && self
                .failures
                .range(leaves)
                .any(|(_, attempts)| taker.leaves_alone(attempts))
        {
            return None;
        }
        let mine = self.expected_ms(taker.worker, node);
        let sharing: Vec<LeaseToken> = match record.verifies {
            true => self.repeated.on(node).collect(),
            false => self.lent.sharing(node).collect(),
        };
        let holders: Vec<&LeaseRecord> = sharing.iter().map(|token| &self.leases[token].record).collect();
        let times = holders.len() as u64;
        let mine_already = holders.iter().any(|holder| holder.worker == taker.worker);
        let known = record.verifies && self.has_opinion(node, taker.principal);
        if known || mine_already || holders.iter().any(|holder| patient(holder, times)) {
            return None;
        }
        Some(Block {
            node,
            expected_ms: mine.or(record.expected_ms),
            attempt: holders.iter().map(|holder| holder.attempt).max().unwrap_or(0) + 1,
            verifies: record.verifies,
        })
    }

    /// The largest aligned part at the end of a lease that is neither in the image, nor lent to others besides, nor the
    /// leaf that its worker is at, unless that is all there is.
    fn part_left(&self, lease: &HeldLease) -> Option<NodeKey> {
        let block = lease.record.node;
        let given_up = self.given_up.range(block.first() as u32..=(block.end() - 1) as u32);
        let given_up = given_up.map(|(leaf, ())| NodeKey::leaf(*leaf));
        let taken = self.inner(block).chain(self.lent.inside(block)).chain(given_up);
        let mut free = Ranges::default();
        free.add(block.first(), block.end());
        taken.for_each(|node| free.remove(node.first(), node.end()));
        let (from, end) = free.iter().last()?;
        let at = block.first() + lease.leaves_done;
        let parts = (0..block.level).rev().map(|level| NodeKey {
            level,
            index: ((end - 1) >> level) as u32,
        });
        let whole = |node: &NodeKey| node.end() == end && node.first() >= from && node.first() > at;
        parts.into_iter().find(whole).or(Some(NodeKey::leaf((end - 1) as u32)))
    }

    fn expected_ms(&self, worker: WorkerId, node: NodeKey) -> Option<Millis> {
        let seconds = self.pace.seconds_per_iteration(worker);
        seconds.map(|s| (s * node.leaves() as f64 * 1e3) as Millis)
    }
}
