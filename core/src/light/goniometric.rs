//! Lamps that are measured from afar.

use super::direction_map::DirectionMap;
use crate::geometry::Ray;
use crate::math::{DVec2, PI, Transform, Vec3};
use crate::spectrum::Spectrum;

/// A point light whose intensity by direction is an image.
#[derive(Clone, Debug)]
pub(super) struct Goniometric {
    position: Vec3,
    /// Radiant intensity [W/sr].
    intensity: DirectionMap,
}

impl Goniometric {
    pub(super) fn new(to_world: &Transform, intensity: DirectionMap) -> Self {
        Self {
            position: to_world.point(Vec3::ZERO),
            intensity,
        }
    }

    /// The light where `to_world` puts it.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        Self::new(to_world, self.intensity.turned(to_world))
    }

    pub(super) fn position(&self) -> Vec3 {
        self.position
    }

    /// Intensity [W/sr] along the unit vector `direction`.
    pub(super) fn intensity(&self, direction: Vec3) -> Spectrum {
        self.intensity.value(direction)
    }

    /// Solid-angle density of the directions of light paths [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        self.intensity.pdf(direction)
    }

    /// A ray, its intensity over the density of its direction, and that density [1/sr].
    pub(super) fn emit(&self, u: DVec2) -> Option<(Ray, Spectrum, f32)> {
        let direction = self.intensity.sample(u)?;
        let pdf = self.intensity.pdf(direction);
        let ray = Ray {
            origin: self.position,
            direction,
            max_distance: f32::INFINITY,
        };
        (pdf > 0.0).then(|| (ray, self.intensity.value(direction) * (1.0 / pdf), pdf))
    }

    /// Luminance of the power.
    pub(super) fn power(&self) -> f32 {
        4.0 * PI * self.intensity.mean_luminance()
    }
}
