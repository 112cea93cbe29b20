//! Queries in groups of those that look at the same place.

use rayon::prelude::*;

/// Groups that one task works through.
const PER_TASK: usize = 256;

/// Queries, each known by an index of type `I`, group by group. Groups that follow each other look at places close to each other, so
/// that what they read is still in the processor's caches.
#[derive(Debug)]
pub struct Groups<I> {
    order: Vec<I>,
    /// Where each group begins in `order`.
    starts: Vec<u32>,
}

impl<I> Default for Groups<I> {
    fn default() -> Self {
        Self {
            order: Vec::new(),
            starts: Vec::new(),
        }
    }
}

impl<I: Copy + Ord + Send + Sync> Groups<I> {
    /// Puts queries of the same place into a group: groups in the order of places, and in each the queries in that of their indices.
    #[must_use]
    pub fn new<P: Copy + Ord + Send>(mut queries: Vec<(P, I)>) -> Self {
        queries.par_sort_unstable();
        let begins = |index: &usize| *index == 0 || queries[*index - 1].0 != queries[*index].0;
        Self {
            starts: (0..queries.len()).filter(begins).map(|index| index as u32).collect(),
            order: queries.into_iter().map(|(_, index)| index).collect(),
        }
    }

    /// All queries, group by group.
    #[must_use]
    pub fn order(&self) -> &[I] {
        &self.order
    }

    /// The groups, in tasks for the current rayon pool.
    pub fn tasks(&self) -> impl IndexedParallelIterator<Item = impl Iterator<Item = &[I]>> {
        self.starts.par_chunks(PER_TASK).enumerate().map(|(task, starts)| {
            let end = self
                .starts
                .get((task + 1) * PER_TASK)
                .map_or(self.order.len(), |end| *end as usize);
            let ends = starts[1..].iter().map(|start| *start as usize).chain([end]);
            starts
                .iter()
                .zip(ends)
                .map(|(start, end)| &self.order[*start as usize..end])
        })
    }
}
