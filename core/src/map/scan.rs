//! Testing records against a query, some at a time.

use super::direction::{decode_direction, decode_on_face, on_axis};
use super::{LANES, Reach, RecordMap};
use crate::math::Vec3;
use std::ops::Range;
use wide::f32x4;

/// Records in reach that are remembered before they are visited.
const FOUND: usize = 16;

/// What records of one cell and one face of directions are tested against.
pub(super) struct Test<'r> {
    reach: &'r Reach,
    cells_per_unit: f32x4,
    cell: [f32x4; 3],
    center: [f32x4; 3],
    /// Query direction, and its components along the rows of the face, across them, and along the face's axis.
    direction: Vec3,
    on_face: [f32x4; 3],
    face: u32,
}

impl<'r> Test<'r> {
    pub(super) fn new(
        map: &RecordMap,
        cell: [i32; 3],
        center: Vec3,
        direction: Vec3,
        reach: &'r Reach,
        face: u32,
    ) -> Self {
        Self {
            reach,
            cells_per_unit: f32x4::splat(map.cells_per_unit),
            cell: cell.map(|c| f32x4::splat(c as f32)),
            center: center.to_array().map(f32x4::splat),
            direction,
            on_face: on_axis(direction, face >> 1).map(f32x4::splat),
            face,
        }
    }

    /// Calls `visit` with the index of each record of `run` that is in reach and lies in the cell, in their order.
    ///
    /// Records are first tested without a branch, since whether one counts is hard to predict, and then visited.
    pub(super) fn scan(&self, map: &RecordMap, run: Range<usize>, visit: &mut impl FnMut(usize)) {
        let radius2 = f32x4::splat(self.reach.radius * self.reach.radius);
        let chord2 = f32x4::splat(self.reach.chord2);
        let mut found = [0_u32; FOUND + LANES];
        let mut count = 0;
        for first in run.clone().step_by(LANES) {
            let (distances2, in_cell) = self.positions(map, first);
            let in_reach = distances2.simd_lt(radius2) & self.chords(map, first).simd_lt(chord2) & in_cell;
            let mask = in_reach.to_bitmask() & ((1 << (run.end - first).min(LANES)) - 1);
            for lane in 0..LANES {
                found[count] = (first + lane) as u32;
                count += (mask >> lane & 1) as usize;
            }
            if count >= FOUND {
                found[..count].iter().for_each(|index| visit(*index as usize));
                count = 0;
            }
        }
        found[..count].iter().for_each(|index| visit(*index as usize));
    }

    /// Squared distances from the query, and whether the records lie in the cell: another cell may share its bucket.
    #[inline(always)]
    fn positions(&self, map: &RecordMap, first: usize) -> (f32x4, f32x4) {
        let mut distance2 = f32x4::ZERO;
        let mut in_cell = f32x4::ZERO.simd_eq(f32x4::ZERO);
        for axis in 0..3 {
            let position = f32x4::new(lanes(&map.positions[axis], first));
            let offset = position - self.center[axis];
            distance2 += offset * offset;
            let (place, cell) = (position * self.cells_per_unit, self.cell[axis]);
            in_cell &= place.simd_ge(cell) & (place.simd_lt(cell + f32x4::ONE) | place.simd_eq(cell));
        }
        (distance2, in_cell)
    }

    /// Squared distances on the unit sphere from the query's direction.
    #[inline(always)]
    fn chords(&self, map: &RecordMap, first: usize) -> f32x4 {
        let codes = lanes(&map.directions, first);
        if map.reach.is_omnidirectional() {
            return f32x4::new(codes.map(|code| (decode_direction(code) - self.direction).length_squared()));
        }
        let mut chord2 = f32x4::ZERO;
        for (component, query) in decode_on_face(codes, self.face).into_iter().zip(self.on_face) {
            let difference = component - query;
            chord2 += difference * difference;
        }
        chord2
    }
}

#[inline(always)]
fn lanes<T: Copy>(values: &[T], first: usize) -> [T; LANES] {
    *values[first..]
        .first_chunk()
        .expect("arrays end with a chunk of padding")
}
