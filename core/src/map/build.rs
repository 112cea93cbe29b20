//! Building the map: a stable sort by block, cell, direction and path on the current rayon pool.

use super::blocks::{Block, Blocks, block_of, cell_in_block, hash_block};
use super::direction::{row_shift, sort_key};
use super::scan::Spot;
use super::{CELL_OVER_RADIUS, LANES, MAX_RECORDS, Payload, Reach, Record, RecordMap, cell};
use crate::spectrum::Spectrum;
use rayon::prelude::*;

/// Parts that the blocks are split into by the high bits of their hash, so that each can be sorted on its own.
const PART_BITS: u32 = 8;
const PARTS: usize = 1 << PART_BITS;

/// The records of one chunk of light paths, by part.
struct Split<P> {
    /// In order within a part.
    records: Vec<Record<P>>,
    /// `starts[p]..starts[p + 1]` are the records of part `p`.
    starts: Vec<u32>,
}

impl<P> Split<P> {
    fn part(&self, part: usize) -> &[Record<P>] {
        &self.records[self.starts[part] as usize..self.starts[part + 1] as usize]
    }
}

/// How records are put in order.
#[derive(Clone, Copy)]
struct Layout {
    cells_per_unit: f32,
    /// `None`: by path alone.
    row_shift: Option<u32>,
}

impl<P: Payload> RecordMap<P> {
    /// Builds the map for queries that reach as far as `reach`. `chunks` are records in the order of light paths. `normals`: whether
    /// their normals will be asked for.
    ///
    /// Every chunk is split by the hashes of the records' blocks, then every part is sorted. The result depends on the records and on
    /// nothing else.
    ///
    /// # Panics
    /// If there are more than [`MAX_RECORDS`] records.
    #[must_use]
    pub fn build(chunks: Vec<Vec<Record<P>>>, reach: &Reach, normals: bool) -> Self {
        let total: usize = chunks.iter().map(Vec::len).sum();
        assert!(
            total <= MAX_RECORDS,
            "{total} records in one map: at most {MAX_RECORDS}"
        );
        let cell_size = CELL_OVER_RADIUS * reach.radius;
        let shift = row_shift(reach.sin_theta);
        let layout = Layout {
            cells_per_unit: 1.0 / cell_size,
            row_shift: (!reach.is_omnidirectional()).then_some(shift),
        };
        // Every chunk goes as soon as it is split.
        let splits: Vec<Split<P>> = chunks.into_par_iter().map(|chunk| layout.split(&chunk)).collect();
        let mut spots = vec![Spot::default(); total + LANES];
        let mut weights = vec![Spectrum::ZERO; total];
        let mut coarse_normals = vec![0; if normals { total } else { 0 }];
        let mut edges = vec![0; total];
        let mut payloads = vec![P::default(); total];
        let arrays = Arrays {
            spots: &mut spots,
            weights: &mut weights,
            normals: &mut coarse_normals,
            edges: &mut edges,
            payloads: &mut payloads,
        };
        let directories: Vec<Directory> = tasks(arrays, &splits)
            .into_par_iter()
            .map(|task| task.fill(&layout, &splits))
            .collect();
        Self {
            reach: *reach,
            cell_size,
            cells_per_unit: layout.cells_per_unit,
            row_shift: shift,
            blocks: join(&directories, total),
            spots,
            weights,
            normals: coarse_normals,
            edges,
            payloads,
        }
    }
}

/// Cuts the arrays into parts.
fn tasks<'a, P>(arrays: Arrays<'a, P>, splits: &[Split<P>]) -> Vec<PartTask<'a, P>> {
    let (mut rest, mut first) = (arrays, 0);
    let mut tasks = Vec::with_capacity(PARTS);
    for part in 0..PARTS {
        let size = splits.iter().map(|split| split.part(part).len()).sum();
        let (arrays, after) = rest.split_at(size);
        rest = after;
        tasks.push(PartTask { part, first, arrays });
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

impl Layout {
    /// Orders a chunk by part.
    fn split<P: Payload>(&self, chunk: &[Record<P>]) -> Split<P> {
        let block = |record: &Record<P>| block_of(cell(record.position, self.cells_per_unit));
        let part = |record: &Record<P>| hash_block(block(record)) >> (u64::BITS - PART_BITS);
        let parts: Vec<u8> = chunk.iter().map(|record| part(record) as u8).collect();
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
        Split { records, starts }
    }

    fn key<P>(&self, record: &Record<P>) -> Key {
        let cell = cell(record.position, self.cells_per_unit);
        let direction = self.row_shift.map_or(0, |shift| sort_key(record.direction, shift));
        Key::new(block_of(cell), cell_in_block(cell), direction)
    }
}

/// Block, cell within it, and direction, by which records are sorted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Key(u128);

impl Key {
    fn new(block: u64, cell: u32, direction: u32) -> Self {
        Self(u128::from(block) << u64::BITS | u128::from(cell) << u32::BITS | u128::from(direction))
    }

    fn block(self) -> u64 {
        (self.0 >> u64::BITS) as u64
    }

    fn cell(self) -> u32 {
        (self.0 >> u32::BITS) as u32
    }
}

/// The parts of records, each in an array.
struct Arrays<'a, P> {
    spots: &'a mut [Spot],
    weights: &'a mut [Spectrum],
    normals: &'a mut [u16],
    edges: &'a mut [u8],
    payloads: &'a mut [P],
}

impl<'a, P> Arrays<'a, P> {
    fn split_at(self, size: usize) -> (Self, Self) {
        let (spots, spots_after) = self.spots.split_at_mut(size);
        let (weights, weights_after) = self.weights.split_at_mut(size);
        let (normals, normals_after) = self.normals.split_at_mut(size.min(self.normals.len()));
        let (edges, edges_after) = self.edges.split_at_mut(size);
        let (payloads, payloads_after) = self.payloads.split_at_mut(size);
        let before = Self {
            spots,
            weights,
            normals,
            edges,
            payloads,
        };
        let after = Self {
            spots: spots_after,
            weights: weights_after,
            normals: normals_after,
            edges: edges_after,
            payloads: payloads_after,
        };
        (before, after)
    }

    fn set(&mut self, index: usize, record: &Record<P>)
    where
        P: Payload,
    {
        self.spots[index] = Spot::new(record.position, record.direction);
        self.weights[index] = record.weight;
        if let Some(normal) = self.normals.get_mut(index) {
            *normal = record.normal;
        }
        self.edges[index] = record.edges;
        self.payloads[index] = record.payload;
    }
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
struct PartTask<'a, P> {
    part: usize,
    /// Records in the parts before.
    first: u32,
    arrays: Arrays<'a, P>,
}

impl<P: Payload> PartTask<'_, P> {
    fn fill(mut self, layout: &Layout, splits: &[Split<P>]) -> Directory {
        let mut sorted: Vec<(Key, &Record<P>)> = Vec::with_capacity(self.arrays.weights.len());
        let records = splits.iter().flat_map(|split| split.part(self.part));
        sorted.extend(records.map(|record| (layout.key(record), record)));
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
            self.arrays.set(slot, record);
        }
        directory
    }
}
