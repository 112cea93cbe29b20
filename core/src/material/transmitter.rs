//! A thin sheet that scatters diffusely to both sides: Mitsuba 0.6's `difftrans`, pbrt's `diffusetransmission`. It is the same from
//! either side.

use super::{BsdfSample, GRAZING};
use crate::math::{FRAC_1_PI, Vec2, Vec3, warp};
use crate::spectrum::Spectrum;

/// A sheet at a point; its two albedos add up to 1 at most.
#[derive(Clone, Copy, Debug)]
pub struct TransmitterLobe {
    pub(super) reflectance: Spectrum,
    pub(super) transmittance: Spectrum,
}

impl TransmitterLobe {
    /// The albedo of what goes between two directions, and the probability with which it is sampled; `None` where one of them lies
    /// in the surface.
    fn side(&self, wo: Vec3, wi: Vec3) -> Option<(Spectrum, f32)> {
        if wo.z.abs() <= GRAZING || wi.z.abs() <= GRAZING {
            return None;
        }
        let share = self.share();
        Some(match wo.z * wi.z > 0.0 {
            true => (self.reflectance, share),
            false => (self.transmittance, 1.0 - share),
        })
    }

    /// Probability of reflection.
    fn share(&self) -> f32 {
        let (reflected, transmitted) = (self.reflectance.mean(), self.transmittance.mean());
        match reflected + transmitted > 0.0 {
            true => reflected / (reflected + transmitted),
            false => 1.0,
        }
    }

    /// f(wo, wi) [1/sr].
    pub(super) fn f(&self, wo: Vec3, wi: Vec3) -> Spectrum {
        self.side(wo, wi)
            .map_or(Spectrum::ZERO, |(albedo, _)| albedo * FRAC_1_PI)
    }

    /// Density of [`Self::sample`] [1/sr].
    pub(super) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        self.side(wo, wi).map_or(0.0, |(_, probability)| {
            probability * warp::cosine_hemisphere_pdf(wi.z.abs())
        })
    }

    /// A direction in proportion to the cosine, on the side that `lobe` chooses.
    pub(super) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        let w = warp::square_to_cosine_hemisphere(u);
        let same_side = lobe < self.share();
        let wi = Vec3::new(w.x, w.y, if same_side == (wo.z > 0.0) { w.z } else { -w.z });
        let pdf = self.pdf(wo, wi);
        (pdf > 0.0).then(|| BsdfSample::scattered(wi, self.f(wo, wi), pdf))
    }
}
