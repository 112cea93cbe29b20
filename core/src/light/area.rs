//! Shapes that emit.

use crate::geometry::{Geometry, ShapeSampler, SurfacePoint};
use crate::math::{DVec2, Vec3};
use crate::texture::Texture;

/// A shape that emits.
#[derive(Clone, Debug)]
pub(super) struct Area {
    pub(super) sampler: ShapeSampler,
    pub(super) radiance: Texture,
    pub(super) two_sided: bool,
}

impl Area {
    /// Area of the sides that emit [scene units squared].
    pub(super) fn emitting(&self) -> f32 {
        match self.two_sided {
            true => 2.0 * self.sampler.area(),
            false => self.sampler.area(),
        }
    }

    /// The same on the shape as it is in `geometry`.
    pub(super) fn moved(&self, geometry: &Geometry) -> Self {
        Self {
            sampler: ShapeSampler::new(geometry, self.sampler.shape()),
            ..self.clone()
        }
    }

    /// Whether the surface emits along `wo`.
    pub(super) fn emits_along(&self, point: &SurfacePoint, wo: Vec3) -> bool {
        self.two_sided || point.geometric_normal.dot(wo) > 0.0
    }

    /// A point uniform over the sides that emit; its normal is that of its side.
    pub(super) fn sample(&self, geometry: &Geometry, mut u: DVec2) -> Option<SurfacePoint> {
        let inner = self.two_sided && u.x >= 0.5;
        if self.two_sided {
            u.x = 2.0 * u.x - f64::from(u8::from(inner));
        }
        let mut point = self.sampler.sample(geometry, u)?;
        if inner {
            point.geometric_normal = -point.geometric_normal;
        }
        Some(point)
    }
}
