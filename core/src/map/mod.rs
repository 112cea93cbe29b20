//! The map that photons and cones are found in: records sorted by cell of position, and in each cell by direction.
//!
//! The iteration's bandwidth is one global number for all queries, so the map is built for it. Cells are as wide as the radius. Blocks of
//! 4 x 4 x 4 of them are found in a hash table and lie in memory along a curve that fills space. In a cell records are sorted by rows of
//! directions, and along each row, so that those that point a query's way are found by bisection. Queries of one place ask together
//! ([`Candidates`]). The order of records depends on them alone, whatever the number of threads; a record that no query asks for
//! changes nothing for the others.

mod blocks;
mod build;
mod direction;
mod group;
mod occupancy;
mod scan;

pub use direction::{decode_direction, encode_direction};
pub use group::{Candidate, Candidates, Place};
pub use occupancy::Occupancy;

use crate::math::{PI, Vec3, sin, warp::one_minus_cos};
use crate::spectrum::Spectrum;
use blocks::Blocks;
use direction::encode_coarse;
use scan::{Spot, Test};
use std::ops::Range;

/// What a user of the map keeps with each record, besides what all of them need; nothing by default.
pub trait Payload: Copy + Default + Send + Sync {}
impl<P: Copy + Default + Send + Sync> Payload for P {}

/// A photon or a cone, as light paths produce it.
#[derive(Clone, Copy, Debug)]
pub struct Record<P = ()> {
    /// Where [scene units].
    pub position: Vec3,
    /// Flux [W] of a photon; flux times BSDF over density [W/sr] of a cone.
    pub weight: Spectrum,
    direction: u32,
    normal: u16,
    edges: u8,
    payload: P,
}

impl Record {
    /// A record on a surface of geometric normal `normal`. `direction` is a unit vector away from the surface: where a photon
    /// came from, or where a cone's radiance goes. `edges` counts the light path's edges up to here; above 254 they are not
    /// told apart.
    #[must_use]
    pub fn new(position: Vec3, normal: Vec3, direction: Vec3, weight: Spectrum, edges: u32) -> Self {
        Self {
            position,
            weight,
            direction: encode_direction(direction),
            normal: encode_coarse(normal),
            edges: count_edges(edges),
            payload: (),
        }
    }

    /// The same record with a payload.
    #[must_use]
    pub fn with<P: Payload>(self, payload: P) -> Record<P> {
        Record {
            position: self.position,
            weight: self.weight,
            direction: self.direction,
            normal: self.normal,
            edges: self.edges,
            payload,
        }
    }
}

impl<P> Record<P> {
    /// Unit direction, to about 7e-5 radians: what queries see.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        decode_direction(self.direction)
    }

    /// Edges of the light path up to the record.
    #[must_use]
    pub fn edges(&self) -> u8 {
        self.edges
    }
}

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
    /// Within `radius` [scene units] and the angle `theta` [radians]; pi: in every direction.
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

    /// The reach of a query at `position`: wider far from the origin, where single precision does not tell apart the positions within
    /// the radius.
    #[must_use]
    pub fn at(&self, position: Vec3) -> Self {
        Self {
            radius: self.radius.max(LEAST_RADIUS * position.abs().max_element()),
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

    fn is_omnidirectional(&self) -> bool {
        self.chord2 == f32::INFINITY
    }
}

/// Half angle below which cones of directions are not counted in [radians]: directions of records lie on a lattice of 6e-5 by 1.2e-4,
/// of which a narrower cone holds so few points that their number misses its solid angle by percents.
pub const LEAST_ANGLE: f32 = 1e-3;

/// Radius over the distance from the origin, along an axis, below which records are not counted in: positions there lie on a lattice
/// of up to a sixteenth of that radius, and a smaller disc would hold too few points of it or none.
const LEAST_RADIUS: f32 = 1.0 / (1 << 19) as f32;

/// Records sorted by cell and direction.
#[derive(Debug)]
pub struct RecordMap<P = ()> {
    reach: Reach,
    cell_size: f32,
    cells_per_unit: f32,
    /// Rows of directions are sorted in groups of `2^row_shift`.
    row_shift: u32,
    blocks: Blocks,
    /// Positions and directions, [`LANES`] more at the end.
    spots: Vec<Spot>,
    weights: Vec<Spectrum>,
    /// Empty where nobody asks for normals.
    normals: Vec<u16>,
    edges: Vec<u8>,
    payloads: Vec<P>,
}

/// Most records a map holds: indices are 32 bits wide.
pub const MAX_RECORDS: usize = u32::MAX as usize;

/// Records that are tested at a time.
const LANES: usize = 4;

/// Side of a cell over the radius: smaller cells make a query read fewer records in more places.
const CELL_OVER_RADIUS: f32 = 1.0;

/// A record within a query's reach.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a, P = ()> {
    map: &'a RecordMap<P>,
    index: usize,
}

impl<P: Payload> Neighbour<'_, P> {
    /// Unit direction, to about 7e-5 radians.
    #[must_use]
    #[inline]
    pub fn direction(&self) -> Vec3 {
        self.map.spots[self.index].direction()
    }

    /// Flux of the photon, or weight of the cone.
    #[must_use]
    #[inline]
    pub fn weight(&self) -> Spectrum {
        self.map.weights[self.index]
    }

    /// Edges of the light path up to the record.
    #[must_use]
    #[inline]
    pub fn edges(&self) -> u8 {
        self.map.edges[self.index]
    }

    /// What its user keeps with the record.
    #[must_use]
    #[inline]
    pub fn payload(&self) -> P {
        self.map.payloads[self.index]
    }
}

impl<P: Payload> RecordMap<P> {
    /// Number of records.
    #[must_use]
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there are no records.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Memory that the records and their directory take [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.blocks.bytes()
            + size_of_val(&*self.spots)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.normals)
            + size_of_val(&*self.edges)
            + size_of_val(&*self.payloads)
    }

    /// Calls `visit` for each record within the radius of `reach` of `center`, whatever its direction, in an order that depends on the
    /// records found alone. The map must have been built for every direction and for that radius at least. Returns how many records
    /// were read.
    pub fn query<'a>(&'a self, center: Vec3, reach: &Reach, mut visit: impl FnMut(Neighbour<'a, P>)) -> u64 {
        let mut read = 0;
        let test = Test::new(center, Vec3::Z, reach, 0);
        self.cells_around(center, reach.radius, |records| {
            read += records.len() as u64;
            test.scan(self, records, &mut |index| visit(Neighbour { map: self, index }));
        });
        read
    }

    /// Calls `visit` with the records of each cell that holds some and that the sphere about `center` can touch: block by block, in an
    /// order that is the same for every sphere.
    fn cells_around(&self, center: Vec3, radius: f32, mut visit: impl FnMut(Range<usize>)) {
        // Rounding of the cells' corners.
        let slack = 8.0 * f32::EPSILON * (center.abs().max_element() + radius);
        let radius2 = (radius + slack) * (radius + slack);
        let gap2 = |cell: i32, axis: usize| {
            if cell.abs() >= FARTHEST_CELL {
                // All that is further away is kept here too.
                return 0.0;
            }
            let start = cell as f32 * self.cell_size;
            let gap = (start - center[axis])
                .max(center[axis] - start - self.cell_size)
                .max(0.0);
            gap * gap
        };
        let low = cell(center - Vec3::splat(radius), self.cells_per_unit);
        let high = cell(center + Vec3::splat(radius), self.cells_per_unit);
        self.blocks.cells_between(low, high, |[x, y, z], records| {
            if gap2(x, 0) + gap2(y, 1) + gap2(z, 2) <= radius2 {
                visit(records);
            }
        });
    }
}

/// Cell coordinates of a position, within [`FARTHEST_CELL`] of the origin.
fn cell(position: Vec3, cells_per_unit: f32) -> [i32; 3] {
    (position * cells_per_unit)
        .to_array()
        .map(|c| floor(c).clamp(-FARTHEST_CELL, FARTHEST_CELL))
}

/// The greatest integer not above `x`; a call of the library's function takes longer than the rest of [`cell`].
fn floor(x: f32) -> i32 {
    let towards_zero = x as i32;
    towards_zero.saturating_sub(i32::from(towards_zero as f32 > x))
}

/// Bound of a cell's coordinates: 22 bits and a sign. That far from the origin single precision tells positions apart to half a
/// cell, and queries reach further ([`Reach::at`]).
const FARTHEST_CELL: i32 = (1 << 22) - 1;

#[cfg(test)]
mod tests;
