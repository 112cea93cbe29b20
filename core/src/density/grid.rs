//! The grid of cubic cells that records are sorted by, and that queries look into.

use super::blocks::{Blocks, block_of, cell_in_block};
use crate::math::Vec3;
use std::ops::Range;

/// Bound of a cell's coordinates: 22 bits and a sign. That far from the origin single precision tells positions apart to half a
/// cell, and queries reach further ([`radius_at`](super::radius_at)).
const FARTHEST_CELL: i32 = (1 << 22) - 1;

/// Coordinates of the cell of a position, within [`FARTHEST_CELL`] of the origin.
pub(super) fn cell_at(position: Vec3, cells_per_unit: f32) -> [i32; 3] {
    (position * cells_per_unit)
        .to_array()
        .map(|c| floor(c).clamp(-FARTHEST_CELL, FARTHEST_CELL))
}

/// The greatest integer not above `x`; a call of the library's function takes longer than the rest of [`cell_at`].
fn floor(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero.saturating_sub(i32::from(towards_zero as f32 > x))
}

/// A cell by its place on a curve that fills space: cells that follow each other are close.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct CellOnCurve {
    pub(super) block: u64,
    pub(super) in_block: u32,
}

impl CellOnCurve {
    pub(super) fn at(position: Vec3, cells_per_unit: f32) -> Self {
        let cell = cell_at(position, cells_per_unit);
        Self {
            block: block_of(cell),
            in_block: cell_in_block(cell),
        }
    }
}

/// Where the records of each cell are.
#[derive(Debug)]
pub(super) struct Grid {
    cell_size: f32,
    cells_per_unit: f32,
    blocks: Blocks,
}

impl Grid {
    /// A grid of cells of the side `cell_size` [scene units].
    pub(super) fn new(cell_size: f32, blocks: Blocks) -> Self {
        Self {
            cell_size,
            cells_per_unit: 1.0 / cell_size,
            blocks,
        }
    }

    pub(super) fn cell(&self, position: Vec3) -> CellOnCurve {
        CellOnCurve::at(position, self.cells_per_unit)
    }

    pub(super) fn bytes(&self) -> usize {
        self.blocks.bytes()
    }

    /// Calls `visit` with the records of each cell that holds some and that lies within `radius` of the box from `low` to `high`: block
    /// by block, in an order that is the same for every box.
    pub(super) fn cells_near(&self, [low, high]: [Vec3; 2], radius: f32, mut visit: impl FnMut(Range<usize>)) {
        // Rounding of the cells' corners.
        let slack = 8.0 * f32::EPSILON * (low.abs().max(high.abs()).max_element() + radius);
        let radius2 = (radius + slack) * (radius + slack);
        let gap2 = |cell: i32, axis: usize| {
            if cell.abs() >= FARTHEST_CELL {
                // All that is further away is kept here too.
                return 0.0;
            }
            let start = cell as f32 * self.cell_size;
            let gap = (start - high[axis]).max(low[axis] - start - self.cell_size).max(0.0);
            gap * gap
        };
        let first = cell_at(low - Vec3::splat(radius), self.cells_per_unit);
        let last = cell_at(high + Vec3::splat(radius), self.cells_per_unit);
        self.blocks.cells_between(first, last, |[x, y, z], records| {
            if gap2(x, 0) + gap2(y, 1) + gap2(z, 2) <= radius2 {
                visit(records);
            }
        });
    }
}
