//! Queries for cones that are close to each other ask the map together.
//!
//! A group of them reads the map once, for all cones that one of them may find; each then tests the cones gathered. Groups
//! are formed by [`QueryCell`], the order of which also keeps queries that follow each other close in memory.

use super::cones::ConeMap;
use super::direction::{Window, Windows, decode_coarse, direction_cell, encode_direction, row_shift, sort_key};
use super::grid::CellOnCurve;
use super::scan::{PackedCone, ReachTest};
use super::{LANES, MASK, Reach, for_each_bit};
use crate::math::{Vec3, sqr};
use crate::spectrum::Spectrum;
use std::ops::Range;
use wide::f32x4;

/// Side of the cells that queries of a group share, over the radius: a wider group reads less often, but more for each query.
const GROUP_OVER_RADIUS: f32 = 1.0;

/// Up to as many records of a face are read without a closer look at their rows: a few reads in one place cost less than a search.
const SHORT: usize = 96;

/// Cell of position and direction that a query lies in: queries of the same cell make a group. Cells are ordered along a curve that
/// fills space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct QueryCell {
    cell: CellOnCurve,
    direction: u32,
}

impl QueryCell {
    /// The cell of queries of the given reach at the position `center` in the unit direction `direction`.
    #[must_use]
    pub fn new(center: Vec3, direction: Vec3, reach: &Reach) -> Self {
        Self {
            cell: CellOnCurve::at(center, 1.0 / (GROUP_OVER_RADIUS * reach.radius)),
            direction: direction_cell(encode_direction(direction), row_shift(reach.sin_theta)),
        }
    }
}

/// The records that some query of a group may find.
///
/// They are gathered in steps, each a plain loop over a list, so that the processor waits for many places of memory at a time.
#[derive(Debug)]
pub struct Candidates<'a> {
    map: &'a ConeMap,
    cells: Vec<Range<usize>>,
    runs: Vec<Run>,
    indices: Vec<u32>,
    /// Coordinates of positions and directions, filled up with places out of reach to a multiple of [`LANES`].
    positions: [Vec<f32>; 3],
    directions: [Vec<f32>; 3],
    weights: Vec<Spectrum>,
    paths: Vec<[u8; 2]>,
}

/// Records of a cell whose directions lie on one face.
#[derive(Clone, Debug)]
struct Run {
    face: u32,
    records: Range<usize>,
}

/// A record within a query's reach.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    candidates: &'a Candidates<'a>,
    index: usize,
}

impl Candidate<'_> {
    /// Position [scene units].
    #[must_use]
    #[inline]
    pub fn position(&self) -> Vec3 {
        Vec3::from_array(self.candidates.positions.each_ref().map(|axis| axis[self.index]))
    }

    /// Unit direction, to about 7e-5 radians.
    #[must_use]
    #[inline]
    pub fn direction(&self) -> Vec3 {
        Vec3::from_array(self.candidates.directions.each_ref().map(|axis| axis[self.index]))
    }

    /// Geometric normal, to about a degree.
    ///
    /// # Panics
    /// If the map was built without normals.
    #[must_use]
    #[inline]
    pub fn normal(&self) -> Vec3 {
        decode_coarse(self.candidates.map.normals[self.candidates.indices[self.index] as usize])
    }

    /// Flux of the photon, or weight of the cone.
    #[must_use]
    #[inline]
    pub fn weight(&self) -> Spectrum {
        self.candidates.weights[self.index]
    }

    /// Edges of the light path up to the record.
    #[must_use]
    #[inline]
    pub fn edges(&self) -> u8 {
        self.candidates.paths[self.index][0]
    }

    /// The set of states that a query has to meet.
    #[must_use]
    #[inline]
    pub fn states(&self) -> u8 {
        self.candidates.paths[self.index][1]
    }
}

impl<'a> Candidates<'a> {
    /// None yet.
    #[must_use]
    pub fn new(map: &'a ConeMap) -> Self {
        Self {
            map,
            cells: Vec::new(),
            runs: Vec::new(),
            indices: Vec::new(),
            positions: Default::default(),
            directions: Default::default(),
            weights: Vec::new(),
            paths: Vec::new(),
        }
    }

    /// Gathers the records that a query of `group` can find within `reach`: positions and unit directions of one [`QueryCell`]. Returns
    /// how many records were read.
    pub fn gather(&mut self, group: impl Iterator<Item = (Vec3, Vec3)> + Clone, reach: &Reach) -> u64 {
        let (center, axis, reach) = around(group, reach);
        self.cells.clear();
        self.map
            .grid
            .cells_near([center; 2], reach.radius, |records| self.cells.push(records));
        self.find_runs(axis, &reach);
        self.find_records(center, axis, &reach);
        self.unpack();
        self.runs.iter().map(|run| run.records.len() as u64).sum()
    }

    /// Lists the records of the cells whose directions the windows about `axis` cover.
    fn find_runs(&mut self, axis: Vec3, reach: &Reach) {
        self.runs.clear();
        let windows = Windows::around(axis, reach.sin_theta);
        for cell in &self.cells {
            for window in windows.as_slice() {
                let face = window.face();
                let rows = self.within(cell.clone(), window.rows(self.map.row_shift));
                if rows.len() <= SHORT {
                    let records = self.trim(rows, window);
                    self.runs.push(Run { face, records });
                    continue;
                }
                for keys in window.keys(self.map.row_shift) {
                    let records = self.within(rows.clone(), keys);
                    self.runs.push(Run { face, records });
                }
            }
        }
    }

    /// The records without those at both ends whose columns the window does not cover.
    fn trim(&self, mut records: Range<usize>, window: &Window) -> Range<usize> {
        let outside = |index: usize| !window.holds_column(self.map.packed[index].direction_code());
        while !records.is_empty() && outside(records.start) {
            records.start += 1;
        }
        while !records.is_empty() && outside(records.end - 1) {
            records.end -= 1;
        }
        records
    }

    /// Those of the records, which are of one cell, whose sort keys lie in a range, both ends included.
    fn within(&self, records: Range<usize>, [low, high]: [u32; 2]) -> Range<usize> {
        let cones = &self.map.packed[records.clone()];
        let key = |cone: &PackedCone| sort_key(cone.direction_code(), self.map.row_shift);
        let from = cones.partition_point(|cone| key(cone) < low);
        let above = |index: usize| cones.get(index).is_none_or(|cone| key(cone) > high);
        // Most ranges are short: the step is doubled until it leads beyond the range.
        let (mut end, mut step) = (from, 1);
        while !above(end + step - 1) {
            end += step;
            step *= 2;
        }
        end += cones[end..cones.len().min(end + step - 1)].partition_point(|cone| key(cone) <= high);
        records.start + from..records.start + end
    }

    /// Lists the records of the runs that are in reach.
    fn find_records(&mut self, center: Vec3, axis: Vec3, reach: &Reach) {
        self.indices.clear();
        for run in &self.runs {
            let test = ReachTest::new(center, axis, reach, run.face);
            test.scan(&self.map.packed, run.records.clone(), &mut |index| {
                self.indices.push(index as u32)
            });
        }
    }

    /// Copies the records listed.
    fn unpack(&mut self) {
        let map = self.map;
        let indices = self.indices.iter().map(|index| *index as usize);
        let padded = indices.len().next_multiple_of(LANES);
        for axis in self.positions.iter_mut().chain(&mut self.directions) {
            axis.clear();
            axis.resize(padded, f32::INFINITY);
        }
        let [x, y, z] = &mut self.positions;
        let [dx, dy, dz] = &mut self.directions;
        let positions = x.iter_mut().zip(y).zip(z);
        let directions = dx.iter_mut().zip(dy).zip(dz);
        for (index, (((x, y), z), ((dx, dy), dz))) in indices.clone().zip(positions.zip(directions)) {
            [*x, *y, *z] = map.packed[index].position().to_array();
            [*dx, *dy, *dz] = map.packed[index].direction().to_array();
        }
        self.weights.clear();
        self.weights.extend(indices.clone().map(|index| map.weights[index]));
        self.paths.clear();
        self.paths.extend(indices.map(|index| map.paths[index]));
    }

    /// Calls `visit` for each record gathered that lies within `reach` of the position `center` and the unit vector `direction`, in an
    /// order that depends on these records alone. Returns how many records were tested.
    pub fn query(&'a self, center: Vec3, direction: Vec3, reach: &Reach, mut visit: impl FnMut(Candidate<'a>)) -> u64 {
        let radius2 = f32x4::splat(reach.radius * reach.radius);
        let chord2 = f32x4::splat(reach.chord2);
        let [center, direction] = [center, direction].map(|v| v.to_array().map(f32x4::splat));
        let mut visit = |index: usize| {
            visit(Candidate {
                candidates: self,
                index,
            });
        };
        let [px, py, pz] = self.positions.each_ref().map(|axis| axis.as_chunks::<LANES>().0);
        let [dx, dy, dz] = self.directions.each_ref().map(|axis| axis.as_chunks::<LANES>().0);
        for first in (0..px.len()).step_by(MASK / LANES) {
            let some = first..px.len().min(first + MASK / LANES);
            let positions = px[some.clone()].iter().zip(&py[some.clone()]).zip(&pz[some.clone()]);
            let directions = dx[some.clone()].iter().zip(&dy[some.clone()]).zip(&dz[some]);
            let mut mask = 0;
            for (group, (((px, py), pz), ((dx, dy), dz))) in positions.zip(directions).enumerate() {
                let distances2 = lengths2([px, py, pz], &center);
                let chords2 = lengths2([dx, dy, dz], &direction);
                let in_reach = distances2.simd_lt(radius2) & chords2.simd_lt(chord2);
                mask |= u64::from(in_reach.to_bitmask()) << (LANES * group);
            }
            for_each_bit(mask, |bit| visit(LANES * first + bit));
        }
        self.indices.len() as u64
    }
}

/// Squared lengths of the differences of vectors from one vector.
#[inline(always)]
fn lengths2(vectors: [&[f32; LANES]; 3], from: &[f32x4; 3]) -> f32x4 {
    let [x, y, z] = [0, 1, 2].map(|axis| f32x4::new(*vectors[axis]) - from[axis]);
    x * x + y * y + z * z
}

/// A position, a direction and a reach that hold the reach of each query of a group.
fn around(group: impl Iterator<Item = (Vec3, Vec3)> + Clone, reach: &Reach) -> (Vec3, Vec3, Reach) {
    /// Widening against rounding.
    const MARGIN: f32 = 1.0 + 1e-4;
    let mut low = Vec3::INFINITY;
    let mut high = Vec3::NEG_INFINITY;
    let mut sum = Vec3::ZERO;
    for (position, direction) in group.clone() {
        low = low.min(position);
        high = high.max(position);
        sum += direction;
    }
    let center = low + 0.5 * (high - low);
    let axis = sum.normalize_or(Vec3::Z);
    let (mut offset2, mut chord2, mut radius) = (0.0_f32, 0.0_f32, reach.radius);
    for (position, direction) in group {
        offset2 = offset2.max((position - center).length_squared());
        radius = radius.max(reach.at(position).radius);
        chord2 = chord2.max((direction - axis).length_squared());
    }
    let radius = (radius + offset2.sqrt()) * MARGIN;
    let chord2 = sqr((reach.chord2.sqrt() + chord2.sqrt()) * MARGIN);
    let cos = 1.0 - 0.5 * chord2;
    let sin_theta = if cos > 0.0 {
        (1.0 - cos * cos).max(0.0).sqrt()
    } else {
        1.0
    };
    (
        center,
        axis,
        Reach {
            radius,
            chord2,
            sin_theta,
        },
    )
}
