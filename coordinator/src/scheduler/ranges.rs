//! A set of leaves as ranges: what is free takes little memory, and its first part is found at once.

use super::table::Table;

/// Leaves, as disjoint ranges that do not touch.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Ranges {
    /// The end of each range by its beginning.
    ends: Table<u64, u64>,
    leaves: u64,
}

impl Ranges {
    /// Number of leaves.
    pub(super) fn leaves(&self) -> u64 {
        self.leaves
    }

    /// The ranges, from left to right.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        self.ends.iter().map(|(from, to)| (*from, *to))
    }

    /// Adds the leaves of `[from, to)`, of which some may be there.
    pub(super) fn add(&mut self, from: u64, to: u64) {
        let (mut from, mut to) = (from, to);
        if from >= to {
            return;
        }
        while let Some((first, end)) = self.last_before(to + 1).filter(|(_, end)| *end >= from) {
            self.take_range(first, end);
            (from, to) = (from.min(first), to.max(end));
        }
        self.put_range(from, to);
    }

    /// Takes the leaves of `[from, to)` away, of which some may not be there.
    pub(super) fn remove(&mut self, from: u64, to: u64) {
        if from >= to {
            return;
        }
        while let Some((first, end)) = self.last_before(to).filter(|(_, end)| *end > from) {
            self.take_range(first, end);
            self.put_range(to, end);
            self.put_range(first, from);
        }
    }

    /// The last range that begins before `leaf`.
    fn last_before(&self, leaf: u64) -> Option<(u64, u64)> {
        let (first, end) = self.ends.range(..leaf).next_back()?;
        Some((*first, *end))
    }

    fn put_range(&mut self, from: u64, to: u64) {
        if from < to {
            self.ends.insert(from, to);
            self.leaves += to - from;
        }
    }

    fn take_range(&mut self, from: u64, to: u64) {
        self.ends.remove(&from);
        self.leaves -= to - from;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_those_of_a_set_of_leaves() {
        let mut state = 1_u64;
        let mut random = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) % below
        };
        let (mut ranges, mut leaves) = (Ranges::default(), [false; 48]);
        for _ in 0..4_000 {
            let (from, to) = (random(49), random(49));
            let inside = random(2) == 0;
            match inside {
                true => ranges.add(from, to),
                false => ranges.remove(from, to),
            }
            (from..to).for_each(|leaf| leaves[leaf as usize] = inside);
            let expected = leaves
                .iter()
                .enumerate()
                .fold(Vec::<(u64, u64)>::new(), |mut found, (leaf, free)| {
                    let leaf = leaf as u64;
                    match found.last_mut().filter(|(_, end)| *end == leaf) {
                        Some((_, end)) if *free => *end += 1,
                        _ if *free => found.push((leaf, leaf + 1)),
                        _ => {}
                    }
                    found
                });
            assert_eq!(ranges.iter().collect::<Vec<_>>(), expected);
            assert_eq!(ranges.leaves(), leaves.iter().filter(|free| **free).count() as u64);
        }
    }
}
