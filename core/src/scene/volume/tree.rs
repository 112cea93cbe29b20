//! Trees of voxels as OpenVDB has them (Museth 2013, "VDB: High-Resolution Sparse Volumes with Dynamic Topology"), and the lattices that they
//! become: a root of nodes of 32 x 32 x 32, these of 16 x 16 x 16, and these of leaves of 8 x 8 x 8 voxels. In place of a node or a leaf, one value may stand
//! for all its voxels: a tile.

use crate::medium::Grid;
use crate::scene::error::{Place, SceneError, within};
use crate::scene::limits::Limits;
use glam::{DMat4, DVec3};

/// Voxels of a leaf.
pub(super) const VOXELS: usize = 512;
/// Voxels along an edge of a leaf, of a node of leaves, and of a node of those.
const LEAF: u32 = 8;

/// The two kinds of nodes.
#[derive(Clone, Copy)]
pub(super) struct Level {
    /// Children along an edge, as a power of two.
    log2: u32,
    /// Voxels along an edge of a child.
    pub(super) child: u32,
}

impl Level {
    /// A node of nodes.
    pub(super) const UPPER: Self = Self { log2: 5, child: 128 };
    /// A node of leaves.
    pub(super) const LOWER: Self = Self { log2: 4, child: LEAF };

    /// Children of a node.
    pub(super) const fn count(self) -> usize {
        1 << (3 * self.log2)
    }

    /// Voxels along an edge of a node.
    pub(super) const fn edge(self) -> u32 {
        self.child << self.log2
    }

    /// The first voxel of the child at a place in the node whose first voxel is `origin`. `None` beyond the range of coordinates.
    pub(super) fn origin(self, origin: [i32; 3], index: usize) -> Option<[i32; 3]> {
        let mask = (1 << self.log2) - 1;
        let index = index as u32;
        // z is fastest.
        let within = [index >> (2 * self.log2), (index >> self.log2) & mask, index & mask];
        let mut child = origin;
        for (child, within) in child.iter_mut().zip(within) {
            *child = child.checked_add((within * self.child) as i32)?;
        }
        Some(child)
    }
}

/// Whether a bit is set, of words of any size in the order of their bytes.
pub(super) fn is_set(mask: &[u8], index: usize) -> bool {
    mask[index / 8] >> (index % 8) & 1 == 1
}

/// A value for all voxels of a cube.
struct Tile {
    origin: [i32; 3],
    edge: u32,
    value: f32,
}

/// What a tree holds: the first voxel of each leaf, with `L`, which says where its values are, and tiles.
pub(super) struct Tree<'a, L> {
    place: &'a Place,
    limits: &'a Limits,
    leaves: Vec<([i32; 3], L)>,
    tiles: Vec<Tile>,
    /// Children of all nodes that were looked at.
    visited: u64,
}

/// A lattice with its place.
pub(crate) struct Lattice {
    pub(crate) grid: Grid,
    /// The coordinates of its first voxel in the file.
    pub(crate) first: [i32; 3],
    /// From the unit cube that the lattice fills to the world.
    pub(crate) to_world: DMat4,
}

impl<'a, L> Tree<'a, L> {
    pub(super) fn new(place: &'a Place, limits: &'a Limits) -> Self {
        Self {
            place,
            limits,
            leaves: Vec::new(),
            tiles: Vec::new(),
            visited: 0,
        }
    }

    /// Counts a node that is looked at, so that no file makes more work than one that is as large as allowed.
    pub(super) fn visit(&mut self, level: Level) -> Result<(), SceneError> {
        self.visited = self.visited.saturating_add(level.count() as u64);
        self.bounded(self.visited)
    }

    /// Holds the bytes of so many values of 32 bits to the limit.
    fn bounded(&self, values: u64) -> Result<(), SceneError> {
        let bytes = values.saturating_mul(size_of::<f32>() as u64);
        within(self.place, "bytes of volumes", bytes, self.limits.texture_bytes).map(|_| ())
    }

    pub(super) fn add_leaf(&mut self, origin: [i32; 3], leaf: L) -> Result<(), SceneError> {
        self.bounded((self.leaves.len() as u64 + 1) * VOXELS as u64)?;
        self.leaves.push((origin, leaf));
        Ok(())
    }

    /// Adds a tile, unless it is as empty as all around. A value that is no number is told by the lattice.
    pub(super) fn add_tile(&mut self, origin: [i32; 3], edge: u32, value: f32) -> Result<(), SceneError> {
        if value <= 0.0 {
            return Ok(());
        }
        self.bounded((self.tiles.len() as u64 + 1) * VOXELS as u64)?;
        self.tiles.push(Tile { origin, edge, value });
        Ok(())
    }

    /// The first voxel, and the number of voxels along each axis, of the box of whole leaves that holds all.
    fn extent(&self) -> Option<([i32; 3], [i64; 3])> {
        let leaves = self.leaves.iter().map(|(origin, _)| (*origin, LEAF));
        let cubes = leaves.chain(self.tiles.iter().map(|tile| (tile.origin, tile.edge)));
        let (mut lower, mut upper) = ([i32::MAX; 3], [i64::MIN; 3]);
        let mut any = false;
        for (origin, edge) in cubes {
            any = true;
            for axis in 0..3 {
                lower[axis] = lower[axis].min(origin[axis]);
                upper[axis] = upper[axis].max(i64::from(origin[axis]) + i64::from(edge));
            }
        }
        any.then(|| (lower, std::array::from_fn(|axis| upper[axis] - i64::from(lower[axis]))))
    }

    /// The lattice of the tree. `to_world` maps the coordinates of voxels' middles to the world; `read` writes the values of the next leaf, of which z is fastest.
    pub(super) fn lattice(
        self,
        to_world: DMat4,
        greatest: f64,
        mut read: impl FnMut(L, &mut [f32; VOXELS]) -> Result<(), SceneError>,
    ) -> Result<Lattice, SceneError> {
        let place = self.place;
        let (first, size) = self.extent().unwrap_or(([0; 3], [i64::from(LEAF); 3]));
        // A brick of the lattice has a word for its place and one for its bound.
        let bricks = size.iter().map(|size| (size / i64::from(LEAF)) as u64);
        let bricks = bricks.fold(1, u64::saturating_mul);
        let table = bricks.saturating_mul(2);
        let tiled = self.tiles.iter().map(|tile| u64::from(tile.edge / LEAF).pow(3));
        if tiled.fold(0, u64::saturating_add) > bricks {
            return Err(SceneError::data(
                place,
                "broken volume: its tiles lie within each other",
            ));
        }
        let kept = (self.leaves.len() + self.tiles.len()) * VOXELS;
        self.bounded(table.saturating_add(kept as u64))?;
        let memory = |_| SceneError::data(place, "memory does not hold the volume");
        let size = size.map(|size| size as u32);
        let mut grid = Grid::new(size, false).map_err(memory)?;
        grid.reserve(self.leaves.len() + self.tiles.len()).map_err(memory)?;
        let inside = |origin: [i32; 3]| -> [u32; 3] {
            std::array::from_fn(|axis| (i64::from(origin[axis]) - i64::from(first[axis])) as u32)
        };
        let checked = |value: f32, origin: [i32; 3]| match value.is_finite() {
            true => Ok(value.clamp(0.0, greatest as f32)),
            false => Err(SceneError::data(
                place,
                format!("a value of the leaf at {origin:?} is not finite"),
            )),
        };
        let (mut values, mut brick) = ([0.0; VOXELS], [0.0; VOXELS]);
        for (origin, leaf) in self.leaves {
            read(leaf, &mut values)?;
            for (index, value) in values.iter().enumerate() {
                let [x, y, z] = [index >> 6, index >> 3 & 7, index & 7];
                brick[(z * 8 + y) * 8 + x] = checked(*value, origin)?;
            }
            grid.set_brick(inside(origin), &brick).map_err(memory)?;
        }
        for tile in self.tiles {
            let value = checked(tile.value, tile.origin)?;
            grid.fill(inside(tile.origin), tile.edge, value).map_err(memory)?;
        }
        let lower = DVec3::from_array(first.map(f64::from)) - DVec3::splat(0.5);
        let size = DVec3::from_array(size.map(f64::from));
        Ok(Lattice {
            grid,
            first,
            to_world: to_world * DMat4::from_translation(lower) * DMat4::from_scale(size),
        })
    }
}
