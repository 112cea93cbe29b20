//! Testing cones of the map against a query, some at a time.

use super::direction::{decode_direction, decode_on_face, on_axis};
use super::{LANES, MASK, Reach, for_each_bit};
use crate::math::Vec3;
use std::ops::Range;
use wide::f32x4;

/// Where a cone is, and in which direction: four fill a line of the cache.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PackedCone([f32; 4]);

impl PackedCone {
    pub(super) fn new(position: Vec3, direction: u32) -> Self {
        Self([position.x, position.y, position.z, f32::from_bits(direction)])
    }

    #[inline]
    pub(super) fn position(&self) -> Vec3 {
        let [x, y, z, _] = self.0;
        Vec3::new(x, y, z)
    }

    #[inline]
    pub(super) fn direction(&self) -> Vec3 {
        decode_direction(self.direction_code())
    }

    #[inline]
    pub(super) fn direction_code(&self) -> u32 {
        self.0[3].to_bits()
    }
}

/// A query's reach, which cones of one face of directions are tested against.
pub(super) struct ReachTest<'r> {
    reach: &'r Reach,
    center: [f32x4; 3],
    /// Components of the query's direction along the rows of the face, across them, and along the face's axis.
    on_face: [f32x4; 3],
    face: u32,
}

impl<'r> ReachTest<'r> {
    pub(super) fn new(center: Vec3, direction: Vec3, reach: &'r Reach, face: u32) -> Self {
        Self {
            reach,
            center: center.to_array().map(f32x4::splat),
            on_face: on_axis(direction, face >> 1).map(f32x4::splat),
            face,
        }
    }

    /// Calls `visit` with the index of each of the `cones` of `run` that is in reach, in their order.
    ///
    /// Cones are first tested without a branch, since whether one counts is hard to predict, and then visited.
    pub(super) fn scan(&self, cones: &[PackedCone], run: Range<usize>, visit: &mut impl FnMut(usize)) {
        let radius2 = f32x4::splat(self.reach.radius * self.reach.radius);
        let chord2 = f32x4::splat(self.reach.chord2);
        for first in run.clone().step_by(MASK) {
            let mut mask = 0;
            for (group, first) in (first..run.end.min(first + MASK)).step_by(LANES).enumerate() {
                let lanes: &[PackedCone; LANES] =
                    cones[first..].first_chunk().expect("the cones end with a chunk more");
                let [x, y, z, codes] = f32x4::transpose(lanes.map(|cone| f32x4::new(cone.0)));
                let in_reach = self.distances(&[x, y, z]).simd_lt(radius2) & self.chords(codes).simd_lt(chord2);
                mask |= u64::from(in_reach.to_bitmask()) << (LANES * group);
            }
            let beyond = MASK - (run.end - first).min(MASK);
            for_each_bit(mask << beyond >> beyond, |bit| visit(first + bit));
        }
    }

    /// Squared distances from the query.
    #[inline(always)]
    fn distances(&self, positions: &[f32x4; 3]) -> f32x4 {
        let mut distance2 = f32x4::ZERO;
        for (position, center) in positions.iter().zip(self.center) {
            let offset = *position - center;
            distance2 += offset * offset;
        }
        distance2
    }

    /// Squared distances on the unit sphere from the query's direction.
    #[inline(always)]
    fn chords(&self, codes: f32x4) -> f32x4 {
        let mut chord2 = f32x4::ZERO;
        let components = decode_on_face(codes.to_array().map(f32::to_bits), self.face);
        for (component, query) in components.into_iter().zip(self.on_face) {
            let difference = component - query;
            chord2 += difference * difference;
        }
        chord2
    }
}
