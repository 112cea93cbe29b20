//! The map that photons and cones are found in: records sorted by position cell, built for one bandwidth.
//!
//! The iteration's bandwidth is one global number, so the map is a hashed grid of cells two bandwidths wide: a query
//! reads at most eight cells. Records themselves are stored in cell order, in two arrays: what every candidate is
//! tested by (16 bytes), and what only a counted one needs (16 bytes). Order within a cell is the order of light
//! paths, whatever the number of threads.

mod build;
mod direction;

pub use direction::{decode_direction, encode_direction};

use crate::math::Vec3;
use crate::spectrum::Spectrum;

/// A photon or a cone, as light paths produce it.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// Where [scene units].
    pub position: Vec3,
    /// Unit direction, away from the surface: where the photon came from, or where the cone's radiance goes.
    pub direction: Vec3,
    /// Flux [W] of a photon; flux times BSDF over density [W/sr] of a cone.
    pub weight: Spectrum,
    /// Edges of the light path up to here.
    pub edges: u32,
}

/// What a query tests.
#[derive(Clone, Copy, Debug, Default)]
pub struct Place {
    position: [f32; 3],
    direction: u32,
}

/// What a query adds up.
#[derive(Clone, Copy, Debug, Default)]
pub struct Payload {
    weight: Spectrum,
    edges: u32,
}

/// Records sorted by cell.
#[derive(Debug)]
pub struct RecordMap {
    radius: f32,
    cells_per_unit: f32,
    /// `starts[b]..starts[b + 1]` are the records of bucket `b`.
    starts: Vec<u32>,
    places: Vec<Place>,
    payloads: Vec<Payload>,
}

/// Most records a map holds: indices are 32 bits wide.
pub const MAX_RECORDS: usize = u32::MAX as usize;

/// A record within a query's radius.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    place: &'a Place,
    payload: &'a Payload,
}

impl Neighbour<'_> {
    /// Unit direction, to about 7e-5 radians.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        decode_direction(self.place.direction)
    }

    /// Flux of the photon, or weight of the cone.
    #[must_use]
    pub fn weight(&self) -> Spectrum {
        self.payload.weight
    }

    /// Edges of the light path up to the record.
    #[must_use]
    pub fn edges(&self) -> u32 {
        self.payload.edges
    }
}

impl RecordMap {
    /// Number of records.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there are no records.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Calls `visit` for each record closer to `center` than the map's radius, in an order that depends on the records
    /// alone. Returns how many records were read.
    pub fn query<'a>(&'a self, center: Vec3, mut visit: impl FnMut(Neighbour<'a>)) -> u64 {
        let radius2 = self.radius * self.radius;
        let (buckets, count) = self.buckets_around(center);
        let mut read = 0;
        for &bucket in &buckets[..count] {
            let range = self.starts[bucket as usize] as usize..self.starts[bucket as usize + 1] as usize;
            read += range.len() as u64;
            let places = &self.places[range.clone()];
            let payloads = &self.payloads[range];
            for (place, payload) in places.iter().zip(payloads) {
                let [dx, dy, dz] = [
                    place.position[0] - center.x,
                    place.position[1] - center.y,
                    place.position[2] - center.z,
                ];
                if dx * dx + dy * dy + dz * dz < radius2 {
                    visit(Neighbour { place, payload });
                }
            }
        }
        read
    }

    /// The distinct buckets of the eight cells that the query's sphere can touch. Cells may share a bucket; visiting it
    /// once is what keeps a record from being counted twice.
    fn buckets_around(&self, center: Vec3) -> ([u32; 8], usize) {
        let low = cell(center - Vec3::splat(self.radius), self.cells_per_unit);
        let high = cell(center + Vec3::splat(self.radius), self.cells_per_unit);
        let mut buckets = [0; 8];
        let mut count = 0;
        for z in low[2]..=high[2].min(low[2] + 1) {
            for y in low[1]..=high[1].min(low[1] + 1) {
                for x in low[0]..=high[0].min(low[0] + 1) {
                    let bucket = self.bucket([x, y, z]);
                    if !buckets[..count].contains(&bucket) {
                        buckets[count] = bucket;
                        count += 1;
                    }
                }
            }
        }
        (buckets, count)
    }

    fn bucket(&self, cell: [i32; 3]) -> u32 {
        bucket_of(cell, self.starts.len() as u32 - 2)
    }
}

/// Cell coordinates of a position; saturating at the ends of `i32`.
fn cell(position: Vec3, cells_per_unit: f32) -> [i32; 3] {
    (position * cells_per_unit)
        .floor()
        .to_array()
        .map(|c| (c as i32).clamp(i32::MIN + 1, i32::MAX - 1))
}

/// Bucket of a cell; `mask` is the number of buckets, a power of two, less one. Cells that are neighbours along x have
/// neighbouring buckets, so that a query finds both in one place of memory.
fn bucket_of(cell: [i32; 3], mask: u32) -> u32 {
    let [x, y, z] = cell.map(|c| c as u32);
    let mut row = y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
    row ^= row >> 15;
    row = row.wrapping_mul(0x2c1b_3c6d);
    row ^= row >> 13;
    row.wrapping_add(x) & mask
}

#[cfg(test)]
mod tests;
