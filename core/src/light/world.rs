//! What lights at infinity shine through.

use crate::geometry::{Geometry, Ray};
use crate::math::warp::square_to_disk;
use crate::math::{Frame, PI, Vec2, Vec3};

/// A sphere around the scene: what distant lights shine through.
#[derive(Clone, Copy, Debug)]
pub(super) struct World {
    center: Vec3,
    radius: f32,
}

impl World {
    pub(super) fn new(geometry: &Geometry) -> Self {
        let (lower, upper) = geometry.bounds();
        let radius = 0.5 * (upper - lower).length() * (1.0 + 1e-4);
        Self {
            center: 0.5 * (lower + upper),
            radius: if radius > 0.0 { radius } else { 1.0 },
        }
    }

    /// Area of the disc that faces any direction.
    pub(super) fn cross_section(&self) -> f32 {
        PI * self.radius * self.radius
    }

    /// A ray along `direction` from before the sphere, its origin uniform on that disc.
    pub(super) fn ray(&self, direction: Vec3, u: Vec2) -> Ray {
        let offset = (square_to_disk(u) * self.radius).extend(-self.radius);
        let origin = self.center + Frame::from_normal(direction).to_world(offset);
        Ray {
            origin,
            direction,
            max_distance: f32::INFINITY,
        }
    }
}
