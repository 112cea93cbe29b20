//! A disc at infinity.

use crate::math::warp::Cone;
use crate::math::{FRAC_1_PI, Vec2, Vec3};
use crate::spectrum::Spectrum;

/// A disc at infinity, evenly bright.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sun {
    /// Unit direction to its middle.
    towards: Vec3,
    cone: Cone,
    radiance: Spectrum,
}

impl Sun {
    /// `half_angle` \[radians\] is half of what the disc is seen under; a surface that faces it has the irradiance `irradiance` but for the
    /// little that the cosine falls off over a small disc.
    pub(super) fn new(towards: Vec3, half_angle: f32, irradiance: Spectrum) -> Self {
        let cone = Cone::of_angle(half_angle);
        Self {
            towards,
            cone,
            radiance: irradiance * cone.pdf(),
        }
    }

    /// Radiance that arrives from the unit vector `direction`.
    pub(super) fn radiance(&self, direction: Vec3) -> Spectrum {
        if self.cone.holds(self.towards, direction) {
            self.radiance
        } else {
            Spectrum::ZERO
        }
    }

    /// A direction with density [`Self::pdf`].
    pub(super) fn sample(&self, u: Vec2) -> Vec3 {
        self.cone.sample_about(self.towards, u)
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        if self.cone.holds(self.towards, direction) {
            self.cone.pdf()
        } else {
            0.0
        }
    }

    /// Luminance averaged over the sphere.
    pub(super) fn mean_luminance(&self) -> f32 {
        0.25 * FRAC_1_PI / self.cone.pdf() * self.radiance.luminance()
    }
}
