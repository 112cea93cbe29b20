//! Which leaves to lend next, and how many.

use super::SchedulerConfig;
use super::job::Job;
use super::record::Millis;
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::node::NodeKey;

/// A block to lend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) node: NodeKey,
    pub(super) expected_ms: Option<Millis>,
    pub(super) attempt: u32,
}

impl Job {
    /// The next block for `worker`: the lowest free leaves, an aligned power of two of them that takes about the time
    /// of a lease and leaves enough for `workers` of them to end together.
    pub(super) fn next_block(&self, worker: WorkerId, workers: u64, config: &SchedulerConfig) -> Option<Block> {
        let taken = self.taken_ranges(config);
        let (first, free_until) = first_gap(&taken, self.leaves())?;
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
        let free: u64 = self.leaves() - taken.iter().map(|(from, to)| to - from).sum::<u64>();
        let share = (free / (2 * workers.max(1))).max(1);
        let seconds = self.seconds_per_iteration(worker);
        let by_time = seconds
            .map_or(1.0, |s| config.lease_target_ms as f64 / 1e3 / s)
            .max(1.0) as u64;
        let aligned = if first == 0 {
            u64::MAX
        } else {
            1 << first.trailing_zeros()
        };
        let level = largest
            .min(share)
            .min(by_time)
            .min(aligned)
            .ilog2()
            .min(NodeKey::MAX_LEVEL);
        let node = NodeKey {
            level,
            index: u32::try_from(first >> level).ok()?,
        };
        let failed = u32::try_from(first).ok().and_then(|leaf| self.failures.get(&leaf));
        Some(Block {
            node,
            expected_ms: seconds.map(|s| (s * node.leaves() as f64 * 1e3) as Millis),
            attempt: 1 + failed.map_or(0, Vec::len) as u32,
        })
    }

    /// A block that somebody else has had for much longer than it should take, and nobody besides.
    pub(super) fn straggler(&self, worker: WorkerId, now: Millis, config: &SchedulerConfig) -> Option<Block> {
        self.leases.values().map(|lease| &lease.record).find_map(|record| {
            let shared = |other: &NodeKey| other.contains(record.node) || record.node.contains(*other);
            let holders = self.leases.values().filter(|other| shared(&other.record.node)).count();
            let given_up = |node: NodeKey| {
                self.poisoned(config)
                    .any(|(leaf, _)| node.contains(NodeKey::leaf(leaf)))
            };
            if record.worker == worker || holders > 1 || given_up(record.node) {
                return None;
            }
            let mine = self
                .seconds_per_iteration(worker)
                .map(|s| (s * record.node.leaves() as f64 * 1e3) as Millis);
            let expected = record.expected_ms.or(mine)?;
            let patience = expected
                .saturating_mul(config.straggler_factor)
                .max(config.straggler_ms);
            (now.saturating_sub(record.granted_ms) > patience).then_some(Block {
                node: record.node,
                expected_ms: mine.or(Some(expected)),
                attempt: record.attempt + 1,
            })
        })
    }

    /// Seconds that `worker` takes for an iteration, or that the job's workers took on average.
    fn seconds_per_iteration(&self, worker: WorkerId) -> Option<f64> {
        let mean = || {
            let seconds = self.totals().seconds.total();
            (self.done() > 0 && seconds > 0.0).then(|| seconds / self.done() as f64)
        };
        self.pace.seconds_per_iteration(worker).or_else(mean)
    }

    /// Leaves that are in the image, lent or given up: disjoint, from left to right.
    fn taken_ranges(&self, config: &SchedulerConfig) -> Vec<(u64, u64)> {
        let lent = self
            .leases
            .values()
            .map(|lease| (lease.record.node.first(), lease.record.node.end()));
        let poisoned = self
            .poisoned(config)
            .map(|(leaf, _)| (u64::from(leaf), u64::from(leaf) + 1));
        let mut ranges: Vec<(u64, u64)> = self.live_ranges().chain(lent).chain(poisoned).collect();
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
