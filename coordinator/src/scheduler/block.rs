//! Which leaves to lend next, and how many; which to lend a second time.

use super::SchedulerConfig;
use super::job::{HeldLease, Job};
use super::record::{FailedAttempt, LeaseRecord, Millis, Principal};
use photonfarm_proto::id::WorkerId;
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
    /// Who is behind the workers heard of lately that may work on the job, this one among them: once for each worker.
    pub(super) all: &'a [Principal],
    pub(super) now: Millis,
    pub(super) config: &'a SchedulerConfig,
}

impl Taker<'_> {
    /// Whether a leaf that failed before is to be left alone for now: everybody waits a while, longer after each
    /// failure, and who has failed leaves it to others, for longest of all, if there are any.
    fn leaves_alone(&self, attempts: &[FailedAttempt]) -> bool {
        let failed = |principal: &Principal| attempts.iter().any(|attempt| attempt.principal == *principal);
        let others = failed(&self.principal) && !self.all.iter().all(failed);
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
        let (worker, workers, config) = (taker.worker, taker.all.len() as u64, taker.config);
        let taken = self.taken_ranges(taker);
        let (first, free_until) = first_gap(&taken, self.leaves())?;
        if !self.can_begin_at(first) {
            return None;
        }
        let suspect = self
            .failures
            .keys()
            .map(|leaf| u64::from(*leaf))
            .find(|leaf| *leaf >= first);
        let largest = match suspect {
            Some(leaf) if leaf == first => 1,
            Some(leaf) => free_until.min(leaf) - first,
            None => free_until - first,
        };
        let free: u64 = self
            .leaves()
            .saturating_sub(taken.iter().map(|(from, to)| to - from).sum::<u64>());
        // Nobody else could work on a chain meanwhile.
        let share = match self.is_chain() {
            true => free,
            false => (free / (2 * workers.max(1))).max(1),
        };
        let seconds = self.seconds_per_iteration(worker);
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
        let failed = u32::try_from(first).ok().and_then(|leaf| self.failures.get(&leaf));
        Some(Block {
            node,
            expected_ms: self.expected_ms(worker, node),
            attempt: 1 + failed.map_or(0, Vec::len) as u32,
            verifies: false,
        })
    }

    /// The first node in doubt that a worker may repeat and nobody does.
    pub(super) fn next_doubt(&self, taker: &Taker) -> Option<Block> {
        let (worker, principal) = (taker.worker, taker.principal);
        let mut doubts = self.nodes_in_doubt().filter(|node| self.can_be_repeated(*node));
        let node = doubts.find(|node| !self.has_opinion(*node, principal) && self.verifiers(*node).next().is_none())?;
        Some(Block {
            node,
            expected_ms: self.expected_ms(worker, node),
            attempt: 1,
            verifies: true,
        })
    }

    /// Work that somebody else has had for much longer than it should take.
    pub(super) fn straggler(&self, taker: &Taker) -> Option<Block> {
        self.leases.values().find_map(|lease| self.steal(lease, taker))
    }

    /// What to lend of a lease a second time: a part that its worker has not come to, or all of what cannot be divided.
    /// Whoever has it already must have been given enough time for it.
    fn steal(&self, lease: &HeldLease, taker: &Taker) -> Option<Block> {
        let record = &lease.record;
        let patience = |holder: &LeaseRecord| {
            let expected = holder.expected_ms.or(self.expected_ms(taker.worker, holder.node))?;
            Some(
                expected
                    .saturating_mul(taker.config.straggler_factor)
                    .max(taker.config.straggler_ms),
            )
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
            false => self.part_left(lease, taker.config)?,
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
        let shares = |other: &&LeaseRecord| {
            other.verifies == record.verifies && (other.node.contains(node) || node.contains(other.node))
        };
        let holders: Vec<&LeaseRecord> = self.leases.values().map(|other| &other.record).filter(shares).collect();
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
    fn part_left(&self, lease: &HeldLease, config: &SchedulerConfig) -> Option<NodeKey> {
        let block = lease.record.node;
        let others = self.leases.values().map(|other| &other.record);
        let others = others.filter(|other| !other.verifies && !other.node.contains(block));
        let poisoned = self.poisoned(config).map(|(leaf, _)| NodeKey::leaf(leaf));
        let taken = others
            .map(|other| other.node)
            .chain(poisoned)
            .map(|node| (node.first(), node.end()));
        let (from, end) = last_gap(&disjoint(self.live_ranges().chain(taken).collect()), block)?;
        let at = block.first() + lease.leaves_done;
        let parts = (0..block.level).rev().map(|level| NodeKey {
            level,
            index: ((end - 1) >> level) as u32,
        });
        let whole = |node: &NodeKey| node.end() == end && node.first() >= from && node.first() > at;
        parts.into_iter().find(whole).or(Some(NodeKey::leaf((end - 1) as u32)))
    }

    fn expected_ms(&self, worker: WorkerId, node: NodeKey) -> Option<Millis> {
        let seconds = self.seconds_per_iteration(worker);
        seconds.map(|s| (s * node.leaves() as f64 * 1e3) as Millis)
    }

    /// Seconds that `worker` takes for an iteration, or that the job's workers took on average.
    fn seconds_per_iteration(&self, worker: WorkerId) -> Option<f64> {
        let mean = || {
            let seconds = self.totals().seconds.total();
            (self.done() > 0 && seconds > 0.0).then(|| seconds / self.done() as f64)
        };
        self.pace.seconds_per_iteration(worker).or_else(mean)
    }

    /// Leaves that are in the image, lent, given up, or to be left alone for now: disjoint, from left to right.
    fn taken_ranges(&self, taker: &Taker) -> Vec<(u64, u64)> {
        let lent = self.leases.values().map(|lease| &lease.record);
        let lent = lent
            .filter(|lease| !lease.verifies)
            .map(|lease| (lease.node.first(), lease.node.end()));
        let alone = |attempts: &[FailedAttempt]| taker.config.is_poisoned(attempts) || taker.leaves_alone(attempts);
        let within = |leaf: &u32| u64::from(*leaf) < self.leaves();
        let failed = self
            .failures
            .iter()
            .filter(|(leaf, attempts)| within(leaf) && alone(attempts));
        let failed = failed.map(|(leaf, _)| (u64::from(*leaf), u64::from(*leaf) + 1));
        disjoint(self.live_ranges().chain(lent).chain(failed).collect())
    }
}

/// The union of ranges, from left to right.
fn disjoint(mut ranges: Vec<(u64, u64)>) -> Vec<(u64, u64)> {
    ranges.sort_unstable();
    let mut disjoint: Vec<(u64, u64)> = Vec::with_capacity(ranges.len());
    for (from, to) in ranges {
        match disjoint.last_mut() {
            Some((_, end)) if from <= *end => *end = (*end).max(to),
            _ => disjoint.push((from, to)),
        }
    }
    disjoint
}

/// The last stretch of a block outside the ranges.
fn last_gap(taken: &[(u64, u64)], block: NodeKey) -> Option<(u64, u64)> {
    let mut end = block.end();
    for (from, to) in taken.iter().rev() {
        if *to < end {
            return Some((block.first().max(*to), end)).filter(|(from, to)| from < to);
        }
        end = end.min(*from);
    }
    (block.first() < end).then_some((block.first(), end))
}

/// The first stretch of `[0, end)` outside the ranges.
fn first_gap(taken: &[(u64, u64)], end: u64) -> Option<(u64, u64)> {
    let mut first = 0;
    for (from, to) in taken {
        if first < *from {
            return Some((first, (*from).min(end)));
        }
        first = first.max(*to);
    }
    (first < end).then_some((first, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_found_from_the_left() {
        assert_eq!(first_gap(&[], 4), Some((0, 4)));
        assert_eq!(first_gap(&[(0, 2)], 4), Some((2, 4)));
        assert_eq!(first_gap(&[(1, 2)], 4), Some((0, 1)));
        assert_eq!(first_gap(&[(0, 2), (3, 4)], 8), Some((2, 3)));
        assert_eq!(first_gap(&[(0, 4)], 4), None);
    }
}
