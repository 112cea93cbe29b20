//! Quantities that vary in space.

use super::grid::{Grid, Interpolation};
use crate::math::{DVec3, Transform, Vec3};
use crate::spectrum::Spectrum;
use std::sync::Arc;

/// A quantity at every place.
#[derive(Clone, Debug)]
pub enum Volume {
    /// The same everywhere.
    Constant(Spectrum),
    /// That of a lattice.
    Grid(Box<GridVolume>),
}

/// A lattice in the world.
#[derive(Clone, Debug)]
pub struct GridVolume {
    /// Its values.
    pub grid: Arc<Grid>,
    /// From the world to the unit cube that the lattice fills.
    pub to_local: Transform,
    /// Between the middles of voxels.
    pub interpolation: Interpolation,
    /// Factor on the values.
    pub factor: Spectrum,
    /// How far from the faces of the lattice extinction begins \[voxels\]: lattices whose faces go through the middles of voxels have half a
    /// voxel around that is only there for interpolation.
    pub margin: f64,
}

impl Volume {
    /// The value where it is the same everywhere, and else zero.
    pub(super) fn constant(&self) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Grid(_) => Spectrum::ZERO,
        }
    }

    /// The value at a place in the world.
    pub(super) fn at(&self, place: Vec3) -> Spectrum {
        match self {
            Self::Constant(value) => *value,
            Self::Grid(volume) => volume.at(volume.voxels_at(place)),
        }
    }
}

impl GridVolume {
    /// From the unit cube to voxels.
    pub(super) fn to_voxels(&self, local: DVec3) -> DVec3 {
        local * self.grid.extent().as_dvec3()
    }

    /// A place in the world in terms of voxels.
    pub(super) fn voxels_at(&self, place: Vec3) -> DVec3 {
        self.to_voxels(self.to_local.matrix().transform_point3(place.as_dvec3()))
    }

    /// The lower and the upper corner of the box outside of which there is no extinction, in terms of voxels.
    pub(super) fn corners(&self) -> [DVec3; 2] {
        let margin = DVec3::splat(self.margin);
        [margin, self.grid.extent().as_dvec3() - margin]
    }

    /// The value at a place in terms of voxels.
    pub(super) fn at(&self, place: DVec3) -> Spectrum {
        self.grid.at(place, self.interpolation) * self.factor
    }
}
