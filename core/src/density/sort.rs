//! Sorting records into the columns of a map: a stable sort by block, cell, direction and path on the current rayon pool.

use super::blocks::{Block, Blocks, hash_block};
use super::grid::CellOnCurve;
use rayon::prelude::*;

/// Parts that the blocks are split into by the high bits of their hash, so that each can be sorted on its own.
const PART_BITS: u32 = 8;
const PARTS: usize = 1 << PART_BITS;

/// What a map keeps of its records of type `R`, each kind of value in a slice of its own.
pub(super) trait Columns<R>: Sized + Send {
    /// Number of records.
    fn len(&self) -> usize;
    /// The first `size` records, and the others.
    fn split_at(self, size: usize) -> (Self, Self);
    /// Puts a record at an index.
    fn set(&mut self, index: usize, record: &R);
}

/// Block, cell within it, and direction, by which records are sorted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key(u128);

impl Key {
    pub(super) fn new(cell: CellOnCurve, direction: u32) -> Self {
        Self(u128::from(cell.block) << u64::BITS | u128::from(cell.in_block) << u32::BITS | u128::from(direction))
    }

    fn block(self) -> u64 {
        (self.0 >> u64::BITS) as u64
    }

    fn cell(self) -> u32 {
        (self.0 >> u32::BITS) as u32
    }
}

/// Fills `columns` with the records of all chunks by the order of their keys, and in the order of chunks where keys are the same. Returns where
/// the records of each cell are.
///
/// Every chunk is split by the hashes of the records' blocks, then every part is sorted. The result depends on the records and on
/// nothing else.
pub(super) fn sort_into<R, C>(columns: C, chunks: Vec<Vec<R>>, key: impl Fn(&R) -> Key + Sync) -> Blocks
where
    R: Copy + Send + Sync,
    C: Columns<R>,
{
    let total = columns.len();
    // Every chunk goes as soon as it is split.
    let splits: Vec<Split<R>> = chunks.into_par_iter().map(|chunk| Split::new(&chunk, &key)).collect();
    let directories: Vec<Directory> = tasks(columns, &splits)
        .into_par_iter()
        .map(|task| task.fill(&splits, &key))
        .collect();
    join(&directories, total)
}

/// The records of one chunk of light paths, by part.
struct Split<R> {
    /// In order within a part.
    records: Vec<R>,
    /// `starts[p]..starts[p + 1]` are the records of part `p`.
    starts: Vec<u32>,
}

impl<R: Copy> Split<R> {
    fn new(chunk: &[R], key: &impl Fn(&R) -> Key) -> Self {
        let part = |record: &R| (hash_block(key(record).block()) >> (u64::BITS - PART_BITS)) as u8;
        let parts: Vec<u8> = chunk.iter().map(part).collect();
        let mut starts = vec![0_u32; PARTS + 1];
        for &part in &parts {
            starts[usize::from(part) + 1] += 1;
        }
        for part in 0..PARTS {
            starts[part + 1] += starts[part];
        }
        let mut order = vec![0; chunk.len()];
        let mut next = starts.clone();
        for (index, &part) in parts.iter().enumerate() {
            let slot = &mut next[usize::from(part)];
            order[*slot as usize] = index;
            *slot += 1;
        }
        let records = order.into_iter().map(|index| chunk[index]).collect();
        Self { records, starts }
    }

    fn part(&self, part: usize) -> &[R] {
        &self.records[self.starts[part] as usize..self.starts[part + 1] as usize]
    }
}

/// Cuts the columns into parts.
fn tasks<R: Copy, C: Columns<R>>(columns: C, splits: &[Split<R>]) -> Vec<PartTask<C>> {
    let (mut rest, mut first) = (columns, 0);
    let mut tasks = Vec::with_capacity(PARTS);
    for part in 0..PARTS {
        let size = splits.iter().map(|split| split.part(part).len()).sum();
        let (columns, after) = rest.split_at(size);
        rest = after;
        tasks.push(PartTask { part, first, columns });
        first += size as u32;
    }
    tasks
}

/// Joins the directories of all parts, in their order; there are `total` records.
fn join(directories: &[Directory], total: usize) -> Blocks {
    let blocks = directories.iter().flat_map(|directory| &directory.blocks);
    let mut starts: Vec<u32> = directories
        .iter()
        .flat_map(|directory| &directory.starts)
        .copied()
        .collect();
    starts.push(total as u32);
    let mut first = 0;
    let place = |block: &Block| {
        let placed = Block { first, ..*block };
        first += block.cells.count_ones();
        placed
    };
    Blocks::new(blocks.map(place).collect(), starts)
}

/// The blocks and cells of a part.
#[derive(Default)]
struct Directory {
    /// Without their first cells.
    blocks: Vec<Block>,
    /// First record of each cell.
    starts: Vec<u32>,
}

/// One part of the map, to be filled.
struct PartTask<C> {
    part: usize,
    /// Records in the parts before.
    first: u32,
    columns: C,
}

impl<C> PartTask<C> {
    fn fill<R: Copy>(mut self, splits: &[Split<R>], key: &impl Fn(&R) -> Key) -> Directory
    where
        C: Columns<R>,
    {
        let mut sorted: Vec<(Key, &R)> = Vec::with_capacity(self.columns.len());
        let records = splits.iter().flat_map(|split| split.part(self.part));
        sorted.extend(records.map(|record| (key(record), record)));
        sorted.sort_by_key(|(key, _)| *key);
        let mut directory = Directory::default();
        let mut last = None;
        for (slot, &(key, record)) in sorted.iter().enumerate() {
            let (block, cell) = (key.block(), 1 << key.cell());
            if last.replace((block, cell)) != Some((block, cell)) {
                directory.starts.push(self.first + slot as u32);
                match directory.blocks.last_mut().filter(|last| last.number == block) {
                    Some(last) => last.cells |= cell,
                    None => directory.blocks.push(Block {
                        number: block,
                        cells: cell,
                        first: 0,
                    }),
                }
            }
            self.columns.set(slot, record);
        }
        directory
    }
}
