//! The map of cones: what is found within a distance and an angle.

use super::direction::{decode_direction, encode_coarse, encode_direction, row_shift, sort_key};
use super::grid::{CellOnCurve, Grid};
use super::scan::PackedCone;
use super::sort::{Columns, Key, sort_into};
use super::{LANES, Reach, count_edges, count_records};
use crate::math::Vec3;
use crate::spectrum::Spectrum;

/// Radiance that leaves a surface in a direction, as light paths produce it.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    /// Where [scene units].
    pub position: Vec3,
    /// Flux times BSDF over density [W/sr].
    pub weight: Spectrum,
    direction: u32,
    normal: u16,
    edges: u8,
    states: u8,
}

impl Cone {
    /// A cone on a surface of geometric normal `normal`. `direction` is a unit vector away from the surface. `edges` counts the light
    /// path's edges up to here; above 254 they are not told apart. `states` is a set that a query has to meet; all bits for every query.
    #[must_use]
    pub fn new(position: Vec3, normal: Vec3, direction: Vec3, weight: Spectrum, edges: u32, states: u8) -> Self {
        Self {
            position,
            weight,
            direction: encode_direction(direction),
            normal: encode_coarse(normal),
            edges: count_edges(edges),
            states,
        }
    }

    /// Unit direction, to about 7e-5 radians: what queries see.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        decode_direction(self.direction)
    }

    /// Edges of the light path up to the cone.
    #[must_use]
    pub fn edges(&self) -> u8 {
        self.edges
    }
}

/// Cones sorted by cell and direction: in a cell by rows of directions, and along each row, so that those that point a query's way are
/// found by bisection. [`Candidates`](super::Candidates) reads it.
#[derive(Debug)]
pub struct ConeMap {
    pub(super) grid: Grid,
    /// Rows of directions are sorted in groups of `2^row_shift`.
    pub(super) row_shift: u32,
    /// Positions and directions, [`LANES`] more at the end.
    pub(super) packed: Vec<PackedCone>,
    pub(super) weights: Vec<Spectrum>,
    /// Empty where nobody asks for normals.
    pub(super) normals: Vec<u16>,
    /// Edges of the light path, and its set of states.
    pub(super) paths: Vec<[u8; 2]>,
}

impl ConeMap {
    /// Builds the map for queries that reach as far as `reach`. `chunks` are cones in the order of light paths. `normals`: whether
    /// their normals will be asked for. The result depends on the cones alone.
    ///
    /// # Panics
    /// If there are more than [`MAX_RECORDS`](super::MAX_RECORDS) cones.
    #[must_use]
    pub fn build(chunks: Vec<Vec<Cone>>, reach: &Reach, normals: bool) -> Self {
        let total = count_records(&chunks);
        let row_shift = row_shift(reach.sin_theta);
        let cells_per_unit = 1.0 / reach.radius;
        let mut packed = vec![PackedCone::default(); total + LANES];
        let mut weights = vec![Spectrum::ZERO; total];
        let mut coarse_normals = vec![0; if normals { total } else { 0 }];
        let mut paths = vec![[0; 2]; total];
        let columns = ConeColumns {
            packed: &mut packed[..total],
            weights: &mut weights,
            normals: &mut coarse_normals,
            paths: &mut paths,
        };
        let key = |cone: &Cone| {
            let cell = CellOnCurve::at(cone.position, cells_per_unit);
            Key::new(cell, sort_key(cone.direction, row_shift))
        };
        let blocks = sort_into(columns, chunks, key);
        Self {
            grid: Grid::new(reach.radius, blocks),
            row_shift,
            packed,
            weights,
            normals: coarse_normals,
            paths,
        }
    }

    /// Number of cones.
    #[must_use]
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there are no cones.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Memory that the cones and their directory take [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.grid.bytes()
            + size_of_val(&*self.packed)
            + size_of_val(&*self.weights)
            + size_of_val(&*self.normals)
            + size_of_val(&*self.paths)
    }
}

/// The columns of a map of cones, to be filled.
struct ConeColumns<'a> {
    packed: &'a mut [PackedCone],
    weights: &'a mut [Spectrum],
    normals: &'a mut [u16],
    paths: &'a mut [[u8; 2]],
}

impl Columns<Cone> for ConeColumns<'_> {
    fn len(&self) -> usize {
        self.weights.len()
    }

    fn split_at(self, size: usize) -> (Self, Self) {
        let (packed, packed_after) = self.packed.split_at_mut(size);
        let (weights, weights_after) = self.weights.split_at_mut(size);
        let (normals, normals_after) = self.normals.split_at_mut(size.min(self.normals.len()));
        let (paths, paths_after) = self.paths.split_at_mut(size);
        let before = Self {
            packed,
            weights,
            normals,
            paths,
        };
        let after = Self {
            packed: packed_after,
            weights: weights_after,
            normals: normals_after,
            paths: paths_after,
        };
        (before, after)
    }

    fn set(&mut self, index: usize, cone: &Cone) {
        self.packed[index] = PackedCone::new(cone.position, cone.direction);
        self.weights[index] = cone.weight;
        if let Some(normal) = self.normals.get_mut(index) {
            *normal = cone.normal;
        }
        self.paths[index] = [cone.edges, cone.states];
    }
}
