//! The map that photons and cones are found in: records sorted by cell of position, and in each cell by direction.
//!
//! The iteration's bandwidth is one global number for all queries, so the map is built for it: a hashed grid of cells of
//! position, as wide as the radius, and rows of directions. Within a row records are sorted along it, so that a query finds those
//! that point its way by bisection and reads few others. Records are stored in that order, an array for each of their parts. Order depends on the records alone, whatever the number of threads; a record that no query
//! asks for changes nothing for the others.

mod build;
mod direction;
mod occupancy;
mod scan;

pub use direction::{decode_direction, encode_direction};
pub use occupancy::Occupancy;

use crate::math::{PI, Vec3, sin, warp::one_minus_cos};
use crate::spectrum::Spectrum;
use direction::{Windows, decode_coarse, encode_coarse, row_of, sort_key};
use scan::Test;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// A photon or a cone, as light paths produce it.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// Where [scene units].
    pub position: Vec3,
    /// Flux [W] of a photon; flux times BSDF over density [W/sr] of a cone.
    pub weight: Spectrum,
    direction: u32,
    normal: u16,
    edges: u8,
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
        }
    }

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

/// Records sorted by cell and direction.
#[derive(Debug)]
pub struct RecordMap {
    reach: Reach,
    cell_size: f32,
    cells_per_unit: f32,
    /// Rows of directions are sorted in groups of `2^row_shift`.
    row_shift: u32,
    /// `starts[b]..starts[b + 1]` are the records of bucket `b`: those of some rows of directions in some cells, by direction.
    starts: Vec<u32>,
    /// A bit for each hash of a cell and a row that some record has: most of what a query asks for is not there.
    present: Vec<AtomicU64>,
    /// Coordinates of the positions, axis by axis, and directions: each with [`LANES`] more at the end.
    positions: [Vec<f32>; 3],
    directions: Vec<u32>,
    weights: Vec<Spectrum>,
    /// Empty where nobody asks for normals.
    normals: Vec<u16>,
    edges: Vec<u8>,
}

/// Most records a map holds: indices are 32 bits wide.
pub const MAX_RECORDS: usize = u32::MAX as usize;

/// Records that are tested at a time.
const LANES: usize = 4;

/// Side of a cell over the radius: smaller cells make a query read fewer records in more places.
const CELL_OVER_RADIUS: f32 = 1.0;

/// A record within a query's reach.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    map: &'a RecordMap,
    index: usize,
}

impl Neighbour<'_> {
    /// Position [scene units].
    #[must_use]
    pub fn position(&self) -> Vec3 {
        let [x, y, z] = &self.map.positions;
        Vec3::new(x[self.index], y[self.index], z[self.index])
    }

    /// Unit direction, to about 7e-5 radians.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        decode_direction(self.map.directions[self.index])
    }

    /// Geometric normal, to about a degree.
    ///
    /// # Panics
    /// If the map was built without normals.
    #[must_use]
    pub fn normal(&self) -> Vec3 {
        decode_coarse(self.map.normals[self.index])
    }

    /// Flux of the photon, or weight of the cone.
    #[must_use]
    pub fn weight(&self) -> Spectrum {
        self.map.weights[self.index]
    }

    /// Edges of the light path up to the record.
    #[must_use]
    pub fn edges(&self) -> u8 {
        self.map.edges[self.index]
    }
}

impl RecordMap {
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
        size_of_val(&*self.starts)
            + size_of_val(&*self.present)
            + self.positions.iter().map(|axis| size_of_val(&**axis)).sum::<usize>()
            + size_of_val(&*self.directions)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.normals)
            + size_of_val(&*self.edges)
    }

    /// Calls `visit` for each record within `reach` of the position `center` and the unit vector `direction`, in an order that
    /// depends on the records found alone. `reach` must not exceed the map's. Returns how many records were read.
    pub fn query<'a>(
        &'a self,
        center: Vec3,
        direction: Vec3,
        reach: &Reach,
        mut visit: impl FnMut(Neighbour<'a>),
    ) -> u64 {
        let windows = Windows::around(direction, reach.sin_theta);
        let everywhere = self.reach.is_omnidirectional();
        let mut read = 0;
        self.cells_around(center, reach.radius, |cell| {
            let first_bucket = bucket_of(cell);
            let mut scan = |run: Range<usize>, face: u32| {
                read += run.len() as u64;
                let test = Test::new(self, cell, center, direction, reach, face);
                test.scan(self, run, &mut |index| visit(Neighbour { map: self, index }));
            };
            if everywhere {
                if self.may_hold(first_bucket) {
                    scan(self.bucket(first_bucket), 0);
                }
                return;
            }
            for window in windows.as_slice() {
                for [low, high] in window.keys(self.row_shift) {
                    let hash = first_bucket.wrapping_add(row_of(low));
                    if !self.may_hold(hash) {
                        continue;
                    }
                    let bucket = self.bucket(hash);
                    let keys = &self.directions[bucket.clone()];
                    let key = |code: &u32| sort_key(*code, self.row_shift);
                    let from = keys.partition_point(|code| key(code) < low);
                    let end = from + keys[from..].partition_point(|code| key(code) <= high);
                    if from < end {
                        scan(bucket.start + from..bucket.start + end, window.face());
                    }
                }
            }
        });
        read
    }

    /// Calls `visit` for each cell that the sphere about `center` can touch.
    fn cells_around(&self, center: Vec3, radius: f32, mut visit: impl FnMut([i32; 3])) {
        let low = self.cell(center - Vec3::splat(radius));
        let high = self.cell(center + Vec3::splat(radius));
        // Rounding of the cells' corners.
        let slack = 8.0 * f32::EPSILON * (center.abs().max_element() + radius);
        let radius2 = (radius + slack) * (radius + slack);
        let gap2 = |cell: i32, axis: usize| {
            let start = cell as f32 * self.cell_size;
            let gap = (start - center[axis])
                .max(center[axis] - start - self.cell_size)
                .max(0.0);
            gap * gap
        };
        for z in low[2]..=high[2].min(low[2] + 3) {
            let gap_z = gap2(z, 2);
            for y in low[1]..=high[1].min(low[1] + 3) {
                let gap_yz = gap_z + gap2(y, 1);
                for x in low[0]..=high[0].min(low[0] + 3) {
                    if gap_yz + gap2(x, 0) <= radius2 {
                        visit([x, y, z]);
                    }
                }
            }
        }
    }

    /// Whether there may be records of the cell and row with this hash.
    fn may_hold(&self, hash: u32) -> bool {
        let (word, bit) = presence(hash, self.present.len());
        self.present[word].load(Ordering::Relaxed) & bit != 0
    }

    /// Records of a bucket, whose number is taken modulo the number of buckets.
    fn bucket(&self, bucket: u32) -> Range<usize> {
        let bucket = bucket as usize & (self.starts.len() - 2);
        self.starts[bucket] as usize..self.starts[bucket + 1] as usize
    }

    /// Cell coordinates of a position.
    fn cell(&self, position: Vec3) -> [i32; 3] {
        cell(position, self.cells_per_unit)
    }
}

/// Cell coordinates of a position; saturating near the ends of `i32`.
fn cell(position: Vec3, cells_per_unit: f32) -> [i32; 3] {
    (position * cells_per_unit)
        .floor()
        .to_array()
        .map(|c| (c as i32).clamp(i32::MIN + 4, i32::MAX - 4))
}

/// Word and bit of the hash of a cell and a row in a table of `words` words.
fn presence(hash: u32, words: usize) -> (usize, u64) {
    ((hash as usize / 64) & (words - 1), 1 << (hash % 64))
}

/// Bucket of a cell's first row of directions, to be taken modulo the number of buckets. The next rows have the next buckets,
/// so that a query finds neighbouring rows in one place of memory.
fn bucket_of(cell: [i32; 3]) -> u32 {
    let [x, y, z] = cell.map(|c| c as u32);
    let mut hash = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
    hash ^= hash >> 15;
    hash = hash.wrapping_mul(0x2c1b_3c6d);
    hash ^ hash >> 13
}

#[cfg(test)]
mod tests;
