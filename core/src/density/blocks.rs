//! The directory of cells: blocks of 4 x 4 x 4 cells in a hash table.

use std::ops::Range;

/// Bits of a cell's coordinate within its block.
const CELL_BITS: u32 = 2;
const CELLS: u32 = 1 << CELL_BITS;

/// Least number of slots of the hash table for each block.
const SLOTS_PER_BLOCK: usize = 2;

/// A slot without a block.
const EMPTY: u32 = u32::MAX;

/// The number of a cell's block along a curve that fills space, so that blocks of similar numbers are close.
pub(super) fn block_of(cell: [i32; 3]) -> u64 {
    let [x, y, z] = cell.map(|c| spread_bits((c >> CELL_BITS) as u32));
    x | y << 1 | z << 2
}

/// The number of a cell within its block: x first, then y, then z.
pub(super) fn cell_in_block(cell: [i32; 3]) -> u32 {
    let [x, y, z] = cell.map(|c| c as u32 % CELLS);
    x | y << CELL_BITS | z << (2 * CELL_BITS)
}

/// The low 21 bits of a number, two zeros between each of them and the next.
fn spread_bits(number: u32) -> u64 {
    let mut bits = u64::from(number & 0x1f_ffff);
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// Mixes a block's number: the high bits are fit for a hash table.
pub(super) fn hash_block(block: u64) -> u64 {
    let hash = (block ^ block >> 29).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (hash ^ hash >> 32).wrapping_mul(0xbf58_476d_1ce4_e5b9)
}

/// A block that holds records.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    pub(super) number: u64,
    /// A bit for each cell that holds records; none: no block.
    pub(super) cells: u64,
    /// The first of them in [`Blocks::starts`].
    pub(super) first: u32,
}

/// Where the records of each cell are.
#[derive(Debug)]
pub(super) struct Blocks {
    /// Indices of blocks: open addressing from the high bits of the hash.
    slots: Vec<u32>,
    blocks: Vec<Block>,
    /// First record of each cell that holds some, in the order of records; at last their number.
    starts: Vec<u32>,
}

impl Blocks {
    pub(super) fn new(blocks: Vec<Block>, starts: Vec<u32>) -> Self {
        let slots = (SLOTS_PER_BLOCK * blocks.len()).next_power_of_two().max(2);
        let mut directory = Self {
            slots: vec![EMPTY; slots],
            blocks,
            starts,
        };
        for index in 0..directory.blocks.len() {
            let slot = directory.slot(directory.blocks[index].number);
            directory.slots[slot] = index as u32;
        }
        directory
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.slots) + size_of_val(&*self.blocks) + size_of_val(&*self.starts)
    }

    /// The slot of a block, or the empty one where it would be.
    fn slot(&self, number: u64) -> usize {
        let mut slot = (hash_block(number) >> (u64::BITS - self.slots.len().trailing_zeros())) as usize;
        while self.slots[slot] != EMPTY && self.blocks[self.slots[slot] as usize].number != number {
            slot = (slot + 1) % self.slots.len();
        }
        slot
    }

    /// Calls `visit` with the coordinates and the records of each cell from `low` to `high`, both included, that holds some: block by
    /// block and in each x by x, y by y, z by z.
    pub(super) fn cells_between(&self, low: [i32; 3], high: [i32; 3], mut visit: impl FnMut([i32; 3], Range<usize>)) {
        let blocks = |axis: usize| low[axis] >> CELL_BITS..=high[axis] >> CELL_BITS;
        for bz in blocks(2) {
            for by in blocks(1) {
                for bx in blocks(0) {
                    let corner = [bx, by, bz].map(|c| c << CELL_BITS);
                    let Some(block) = self.blocks.get(self.slots[self.slot(block_of(corner))] as usize) else {
                        continue;
                    };
                    let mut wanted = block.cells & cells_mask(corner, low, high);
                    while wanted != 0 {
                        let bit = wanted.trailing_zeros();
                        wanted &= wanted - 1;
                        let before = (block.cells & ((1 << bit) - 1)).count_ones();
                        let start = (block.first + before) as usize;
                        let cell = [0, 1, 2]
                            .map(|axis| corner[axis] + (bit >> (axis as u32 * CELL_BITS) & (CELLS - 1)) as i32);
                        visit(cell, self.starts[start] as usize..self.starts[start + 1] as usize);
                    }
                }
            }
        }
    }
}

/// The bits of the cells from `low` to `high` in the block at `corner`.
fn cells_mask(corner: [i32; 3], low: [i32; 3], high: [i32; 3]) -> u64 {
    let [x, y, z] = [0, 1, 2].map(|axis| {
        let first = (low[axis] - corner[axis]).max(0);
        let last = (high[axis] - corner[axis]).min(CELLS as i32 - 1);
        (2_u64 << last) - (1 << first)
    });
    // Each bit of y and z stands for a row and a plane of cells.
    let rows = (y & 1) | (y & 2) << 3 | (y & 4) << 6 | (y & 8) << 9;
    let planes = (z & 1) | (z & 2) << 15 | (z & 4) << 30 | (z & 8) << 45;
    x * rows * planes
}
