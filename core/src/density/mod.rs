//! Density estimates: what photons, cones and importons are found by, and how wide kernels are.
//!
//! [`kernel`] has the kernels and [`schedule`] their widths. The bandwidth of an iteration is one number for all queries, or at least has an upper bound, so that
//! maps are built for it: records are sorted into cells as wide as the radius ([`grid`]). Blocks of 4 x 4 x 4 cells are found in a hash table and lie in
//! memory along a curve that fills space ([`blocks`], [`sort`]). There are two maps:
//!
//! * [`PointMap`]: points, found by position alone, with whatever their user keeps there.
//! * [`ConeMap`]: cones, found by position and direction; in a cell they are sorted by [`direction`] too.
//!
//! What is found along rays, and has an extent of its own, lies in a hierarchy of boxes: [`RayMap`].
//!
//! Queries of one place ask together ([`Groups`], [`NearPoints`], [`Candidates`]). The order of what they find depends on the records alone, whatever the
//! number of threads; a record that no query asks for changes nothing for the others ([`Occupancy`] tells which these are).

mod blocks;
mod candidates;
mod cones;
mod direction;
mod grid;
mod groups;
mod kernel;
mod occupancy;
mod points;
mod rays;
mod scan;
pub mod schedule;
mod sort;

pub use candidates::{Candidate, Candidates, QueryCell};
pub use cones::{Cone, ConeMap};
pub use direction::{decode_direction, encode_direction};
pub use groups::Groups;
pub use kernel::{Extent, KernelShape, ball_height, cone_height, disc_height};
pub use occupancy::Occupancy;
pub use points::{NearPoints, Payload, Point, PointMap};
pub(crate) use rays::{Passable, RayMap};

use crate::math::{PI, Vec3, sin, warp::one_minus_cos};

/// A number of edges as records keep it: 255 stands for more.
#[must_use]
pub fn count_edges(edges: u32) -> u8 {
    u8::try_from(edges).unwrap_or(u8::MAX)
}

/// How far a query reaches in position and direction.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    radius: f32,
    /// Squared distance on the unit sphere of two directions `theta` apart: `2 (1 - cos theta)`.
    chord2: f32,
    /// Sine of the angle; 1 from a right angle on.
    sin_theta: f32,
}

impl Reach {
    /// Within `radius` [scene units] and the angle `theta` \[radians\]; pi: in every direction.
    #[must_use]
    pub fn new(radius: f32, theta: f32) -> Self {
        Self {
            radius,
            chord2: if theta < PI {
                2.0 * one_minus_cos(theta)
            } else {
                f32::INFINITY
            },
            sin_theta: if theta < 0.5 * PI { sin(theta) } else { 1.0 },
        }
    }

    /// The reach of a query at `position` ([`radius_at`]).
    #[must_use]
    pub fn at(&self, position: Vec3) -> Self {
        Self {
            radius: radius_at(self.radius, position),
            ..*self
        }
    }

    /// Radius [scene units].
    #[must_use]
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// `2 (1 - cos theta)`, infinite for every direction.
    #[must_use]
    pub fn chord2(&self) -> f32 {
        self.chord2
    }
}

/// The radius of a query at `position`: `radius`, or more far from the origin, where single precision does not tell apart the positions
/// within it [scene units].
#[must_use]
pub fn radius_at(radius: f32, position: Vec3) -> f32 {
    radius.max(LEAST_RADIUS * position.abs().max_element())
}

/// Half angle below which cones of directions are not counted in \[radians\]: directions of records lie on a lattice of 6e-5 by 1.2e-4,
/// of which a narrower cone holds so few points that their number misses its solid angle by percents.
pub const LEAST_ANGLE: f32 = 1e-3;

/// Radius over the distance from the origin, along an axis, below which records are not counted in: positions there lie on a lattice
/// of up to a sixteenth of that radius, and a smaller disc would hold too few points of it or none.
const LEAST_RADIUS: f32 = 1.0 / (1 << 19) as f32;

/// Most records a map holds: indices are 32 bits wide.
pub const MAX_RECORDS: usize = u32::MAX as usize;

/// The number of records of all chunks.
///
/// # Panics
/// If there are more than [`MAX_RECORDS`].
fn count_records<R>(chunks: &[Vec<R>]) -> usize {
    let total: usize = chunks.iter().map(Vec::len).sum();
    assert!(
        total <= MAX_RECORDS,
        "{total} records in one map: at most {MAX_RECORDS}"
    );
    total
}

/// Records that are tested at a time.
const LANES: usize = 4;

/// Records that are tested before those in reach are visited: the bits of a mask.
const MASK: usize = u64::BITS as usize;

/// Calls `visit` with the number of each bit that is set, lowest first.
#[inline(always)]
fn for_each_bit(mut mask: u64, mut visit: impl FnMut(usize)) {
    while mask != 0 {
        visit(mask.trailing_zeros() as usize);
        mask &= mask - 1;
    }
}

#[cfg(test)]
mod tests;
