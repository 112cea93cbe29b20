//! The map of points: what is found within a distance, whatever its direction.

use super::grid::{CellOnCurve, Grid};
use super::groups::Groups;
use super::sort::{Columns, Key, sort_into};
use super::{LANES, MASK, count_records, for_each_bit};
use crate::math::Vec3;
use rayon::prelude::*;
use std::ops::Range;
use wide::f32x4;

/// A point with what its user keeps there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Point<P> {
    /// Where [scene units].
    pub position: Vec3,
    /// What is kept.
    pub payload: P,
}

/// What can be kept with a point.
pub trait Payload: Copy + Default + Send + Sync {}
impl<P: Copy + Default + Send + Sync> Payload for P {}

/// Points sorted by cell.
///
/// A query first tests positions alone, of which sixteen fill three lines of the cache, and reads the payloads of those within its radius.
#[derive(Debug)]
pub struct PointMap<P> {
    grid: Grid,
    /// Coordinates of the points along each axis, [`LANES`] more at the end.
    positions: [Vec<f32>; 3],
    payloads: Vec<P>,
}

impl<P: Payload> PointMap<P> {
    /// Builds the map for queries of up to about `radius` [scene units]; wider ones read more cells. `chunks` are points in the order of
    /// paths. The result depends on the points alone.
    ///
    /// # Panics
    /// If there are more than [`MAX_RECORDS`](super::MAX_RECORDS) points.
    #[must_use]
    pub fn build(chunks: Vec<Vec<Point<P>>>, radius: f32) -> Self {
        let total = count_records(&chunks);
        let cells_per_unit = 1.0 / radius;
        let mut positions = [(); 3].map(|()| vec![f32::INFINITY; total + LANES]);
        let mut payloads = vec![P::default(); total];
        let columns = PointColumns {
            positions: positions.each_mut().map(|axis| &mut axis[..total]),
            payloads: &mut payloads,
        };
        let key = |point: &Point<P>| Key::new(CellOnCurve::at(point.position, cells_per_unit), 0);
        let blocks = sort_into(columns, chunks, key);
        Self {
            grid: Grid::new(radius, blocks),
            positions,
            payloads,
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.payloads.len()
    }

    /// Whether there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.payloads.is_empty()
    }

    /// Memory that the points and their directory take [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        let positions: usize = self.positions.iter().map(|axis| size_of_val(&**axis)).sum();
        self.grid.bytes() + positions + size_of_val(&*self.payloads)
    }

    /// Calls `visit` with what is kept at each point nearer to `center` than `radius`, in an order that depends on the points found
    /// alone. Returns how many points were tested.
    pub fn query<'a>(&'a self, center: Vec3, radius: f32, mut visit: impl FnMut(&'a P)) -> u64 {
        let mut tested = 0;
        self.grid.cells_near([center; 2], radius, |points| {
            tested += points.len() as u64;
            let positions = self.positions.each_ref().map(|axis| &axis[points.start..]);
            for_each_near(positions, points.len(), center, radius, |index| {
                visit(&self.payloads[points.start + index]);
            });
        });
        tested
    }

    /// Answers many queries on the current rayon pool. Queries of one cell are answered together, cell after cell along a curve
    /// that fills space: what they read lies close in memory.
    ///
    /// `disc` is the position and the radius of a query [scene units]. `answer` is asked for each query, with the points near it. The
    /// answers come back in an order that depends on the queries alone; `None` if `cancelled` says so in between.
    pub fn answer<Q: Sync, A: Send>(
        &self,
        queries: &[Vec<Q>],
        disc: impl Fn(&Q) -> (Vec3, f32) + Sync,
        cancelled: impl Fn() -> bool + Sync,
        answer: impl Fn(&Q, &NearPoints<'_, P>) -> A + Sync,
    ) -> Option<Vec<Vec<A>>> {
        let places = queries.par_iter().enumerate().flat_map_iter(|(number, list)| {
            let cell = |query: &Q| self.grid.cell(disc(query).0);
            list.iter()
                .zip(0_u32..)
                .map(move |(query, index)| (cell(query), (number as u32, index)))
        });
        let groups = Groups::new(places.collect());
        let query = |(list, index): &(u32, u32)| &queries[*list as usize][*index as usize];
        groups
            .tasks()
            .map(|task| {
                if cancelled() {
                    return None;
                }
                let mut near = NearPoints::new(self);
                let mut answers = Vec::new();
                for group in task {
                    near.gather(group.iter().map(|index| disc(query(index))));
                    answers.extend(group.iter().map(|index| answer(query(index), &near)));
                }
                Some(answers)
            })
            .collect()
    }
}

/// The points that some query of a group may find, copied from the map.
#[derive(Debug)]
pub struct NearPoints<'a, P> {
    map: &'a PointMap<P>,
    runs: Vec<Range<usize>>,
    /// Indices in the map.
    indices: Vec<u32>,
    /// Coordinates along each axis, filled up with places out of reach to a multiple of [`LANES`].
    positions: [Vec<f32>; 3],
}

impl<'a, P: Payload> NearPoints<'a, P> {
    fn new(map: &'a PointMap<P>) -> Self {
        Self {
            map,
            runs: Vec::new(),
            indices: Vec::new(),
            positions: Default::default(),
        }
    }

    /// Gathers the points that a query of the group, each with its position and its radius, can find.
    fn gather(&mut self, group: impl Iterator<Item = (Vec3, f32)>) {
        let (mut low, mut high, mut widest) = (Vec3::INFINITY, Vec3::NEG_INFINITY, 0.0_f32);
        for (position, radius) in group {
            low = low.min(position);
            high = high.max(position);
            widest = widest.max(radius);
        }
        self.runs.clear();
        self.map
            .grid
            .cells_near([low, high], widest, |points| match self.runs.last_mut() {
                Some(run) if run.end == points.start => run.end = points.end,
                _ => self.runs.push(points),
            });
        self.indices.clear();
        for run in &self.runs {
            self.indices.extend(run.start as u32..run.end as u32);
        }
        let padded = self.indices.len().next_multiple_of(LANES);
        for (near, all) in self.positions.iter_mut().zip(&self.map.positions) {
            near.clear();
            for run in &self.runs {
                near.extend_from_slice(&all[run.clone()]);
            }
            near.resize(padded, f32::INFINITY);
        }
    }

    /// Calls `visit` with what is kept at each point gathered that is nearer to `center` than `radius`, in an order that depends on the
    /// points found alone. Returns how many points were tested.
    pub fn query(&self, center: Vec3, radius: f32, mut visit: impl FnMut(&'a P)) -> u64 {
        let positions = self.positions.each_ref().map(|axis| &axis[..]);
        for_each_near(positions, self.indices.len(), center, radius, |index| {
            visit(&self.map.payloads[self.indices[index] as usize]);
        });
        self.indices.len() as u64
    }
}

/// Calls `visit` with the index of each of the first `count` positions that is nearer to `center` than `radius`, in their order. There must
/// be positions up to a multiple of [`LANES`].
///
/// Positions are first tested without a branch, since whether one is near is hard to predict, and then visited.
#[inline(always)]
fn for_each_near(positions: [&[f32]; 3], count: usize, center: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
    let radius2 = f32x4::splat(radius * radius);
    let center = center.to_array().map(f32x4::splat);
    for first in (0..count).step_by(MASK) {
        let size = (count - first).min(MASK);
        let some = first..first + size.next_multiple_of(LANES);
        let [x, y, z] = positions.map(|axis| axis[some.clone()].as_chunks::<LANES>().0);
        let mut mask = 0;
        for (group, ((x, y), z)) in x.iter().zip(y).zip(z).enumerate() {
            let [x, y, z] = [
                f32x4::new(*x) - center[0],
                f32x4::new(*y) - center[1],
                f32x4::new(*z) - center[2],
            ];
            let near = (x * x + y * y + z * z).simd_lt(radius2);
            mask |= u64::from(near.to_bitmask()) << (LANES * group);
        }
        let beyond = MASK - size;
        for_each_bit(mask << beyond >> beyond, |bit| visit(first + bit));
    }
}

/// The columns of a map of points, to be filled.
struct PointColumns<'a, P> {
    positions: [&'a mut [f32]; 3],
    payloads: &'a mut [P],
}

impl<P: Payload> Columns<Point<P>> for PointColumns<'_, P> {
    fn len(&self) -> usize {
        self.payloads.len()
    }

    fn split_at(self, size: usize) -> (Self, Self) {
        let [x, y, z] = self.positions.map(|axis| axis.split_at_mut(size));
        let (payloads, payloads_after) = self.payloads.split_at_mut(size);
        let before = Self {
            positions: [x.0, y.0, z.0],
            payloads,
        };
        let after = Self {
            positions: [x.1, y.1, z.1],
            payloads: payloads_after,
        };
        (before, after)
    }

    fn set(&mut self, index: usize, point: &Point<P>) {
        for (axis, coordinate) in self.positions.iter_mut().zip(point.position.to_array()) {
            axis[index] = coordinate;
        }
        self.payloads[index] = point.payload;
    }
}
