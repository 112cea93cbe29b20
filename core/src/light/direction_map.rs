//! Images over all directions, of radiance from infinity or of intensity about a point.

use super::Mapping;
use super::environment::Environment;
use super::equal_area::EqualArea;
use crate::math::{DVec2, Transform, Vec3};
use crate::spectrum::Spectrum;
use crate::texture::Bitmap;
use std::sync::Arc;

/// An image over all directions.
#[derive(Clone, Debug)]
pub(super) enum DirectionMap {
    LatitudeLongitude(Environment),
    EqualArea(EqualArea),
}

impl DirectionMap {
    /// `to_world` maps the frame of the image to the world.
    pub(super) fn new(image: Arc<Bitmap>, mapping: Mapping, scale: f32, to_world: &Transform) -> Self {
        match mapping {
            Mapping::LatitudeLongitude => Self::LatitudeLongitude(Environment::new(image, scale, to_world)),
            Mapping::EqualArea => Self::EqualArea(EqualArea::new(image, scale, to_world)),
        }
    }

    /// The same image with another `to_world`.
    pub(super) fn turned(&self, to_world: &Transform) -> Self {
        match self {
            Self::LatitudeLongitude(map) => Self::LatitudeLongitude(map.turned(to_world)),
            Self::EqualArea(map) => Self::EqualArea(map.turned(to_world)),
        }
    }

    /// The value in the unit direction `direction`.
    pub(super) fn value(&self, direction: Vec3) -> Spectrum {
        match self {
            Self::LatitudeLongitude(map) => map.radiance(direction),
            Self::EqualArea(map) => map.value(direction),
        }
    }

    /// A direction with density [`Self::pdf`]; `None` for a black image.
    pub(super) fn sample(&self, u: DVec2) -> Option<Vec3> {
        match self {
            Self::LatitudeLongitude(map) => map.sample(u),
            Self::EqualArea(map) => map.sample(u),
        }
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        match self {
            Self::LatitudeLongitude(map) => map.pdf(direction),
            Self::EqualArea(map) => map.pdf(direction),
        }
    }

    /// Luminance averaged over the sphere.
    pub(super) fn mean_luminance(&self) -> f32 {
        match self {
            Self::LatitudeLongitude(map) => map.mean_luminance(),
            Self::EqualArea(map) => map.mean_luminance(),
        }
    }
}
