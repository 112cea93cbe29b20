//! Where the queries of an iteration look: what lies elsewhere need not be stored.

use super::Reach;
use super::direction::{CellWindows, ROW_BITS, Windows, direction_cell, encode_direction, row_shift};
use super::grid::cell_at;
use crate::math::Vec3;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bits for each query: it marks some thirty cells, most of which its neighbours mark as well.
const BITS_PER_QUERY: usize = 64;
/// Bounds of the number of bits.
const BITS: [usize; 2] = [1 << 16, 1 << 27];

/// Stands for all cells of direction together.
const ANY_DIRECTION: u32 = u32::MAX;

/// A set of cells of position and direction, hashed into bits: it may hold cells that nobody marked, never the reverse.
#[derive(Debug)]
pub struct Occupancy {
    reach: Reach,
    cells_per_unit: f32,
    row_shift: u32,
    bits: Vec<AtomicU64>,
}

/// The cells that one query marked: its neighbour often marks the same.
#[derive(Debug, Default)]
pub struct LastMarked(Option<([i32; 3], [i32; 3], CellWindows)>);

impl Occupancy {
    /// An empty set for about `queries` queries of the given reach. Cells are two radii and about one to two angles wide.
    #[must_use]
    pub fn new(reach: &Reach, queries: usize) -> Self {
        let bits = queries
            .saturating_mul(BITS_PER_QUERY)
            .clamp(BITS[0], BITS[1])
            .next_power_of_two();
        Self {
            reach: *reach,
            cells_per_unit: 0.5 / reach.radius,
            row_shift: (row_shift(reach.sin_theta) + 1).min(ROW_BITS),
            bits: std::iter::repeat_with(AtomicU64::default).take(bits / 64).collect(),
        }
    }

    /// Marks what a query at `center` and the unit vector `direction` can count. `last` is the memory of a run of queries.
    pub fn mark(&self, center: Vec3, direction: Vec3, last: &mut LastMarked) {
        let radius = Vec3::splat(self.reach.at(center).radius);
        let low = cell_at(center - radius, self.cells_per_unit);
        let high = cell_at(center + radius, self.cells_per_unit);
        let windows = Windows::around(direction, self.reach.sin_theta).cells(self.row_shift);
        let marks = Some((low, high, windows));
        if last.0 == marks {
            return;
        }
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let position = hash_position([x, y, z]);
                    self.set(position, ANY_DIRECTION);
                    windows.for_each(|cell| self.set(position, cell));
                }
            }
        }
        last.0 = marks;
    }

    /// Whether some query may count a record at `position`.
    #[must_use]
    pub fn may_count_at(&self, position: Vec3) -> bool {
        self.holds(position, ANY_DIRECTION)
    }

    /// Whether some query may count a record at `position` with the unit vector `direction`.
    #[must_use]
    pub fn may_count(&self, position: Vec3, direction: Vec3) -> bool {
        self.holds(position, direction_cell(encode_direction(direction), self.row_shift))
    }

    fn holds(&self, position: Vec3, direction: u32) -> bool {
        let (word, bit) = self.place(hash_position(cell_at(position, self.cells_per_unit)), direction);
        self.bits[word].load(Ordering::Relaxed) & bit != 0
    }

    fn set(&self, position: u64, direction: u32) {
        let (word, bit) = self.place(position, direction);
        let word = &self.bits[word];
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
    }

    fn place(&self, position: u64, direction: u32) -> (usize, u64) {
        let hash =
            (position ^ u64::from(direction).wrapping_mul(0xff51_afd7_ed55_8ccd)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let index = hash >> 20;
        ((index as usize / 64) & (self.bits.len() - 1), 1 << (index % 64))
    }
}

fn hash_position(cell: [i32; 3]) -> u64 {
    let [x, y, z] = cell.map(|c| u64::from(c as u32));
    let mut hash = x.wrapping_mul(0x8cb9_2ba7_2f3d_8dd7)
        ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ z.wrapping_mul(0x1656_67b1_9e37_79f9);
    hash ^= hash >> 29;
    hash
}
