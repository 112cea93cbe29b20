//! Lambertian reflection, on the outer side only.

use super::BsdfSample;
use crate::math::{FRAC_1_PI, Vec2, Vec3, warp};
use crate::spectrum::Spectrum;

/// Whether light can go from one direction to the other.
fn reflects(wo: Vec3, wi: Vec3) -> bool {
    wo.z > 0.0 && wi.z > 0.0
}

/// f = 1 / pi, to be multiplied by the reflectance.
pub(super) fn eval(wo: Vec3, wi: Vec3) -> Spectrum {
    if reflects(wo, wi) {
        Spectrum::splat(FRAC_1_PI)
    } else {
        Spectrum::ZERO
    }
}

/// Density of [`sample`] [1/sr].
pub(super) fn pdf(wo: Vec3, wi: Vec3) -> f32 {
    if reflects(wo, wi) {
        warp::cosine_hemisphere_pdf(wi.z)
    } else {
        0.0
    }
}

/// A direction in proportion to the cosine.
pub(super) fn sample(wo: Vec3, u: Vec2) -> Option<BsdfSample> {
    let wi = warp::square_to_cosine_hemisphere(u);
    reflects(wo, wi).then(|| BsdfSample {
        wi,
        f: eval(wo, wi),
        pdf: pdf(wo, wi),
        delta: false,
        reversal: 1.0,
        eta: 1.0,
    })
}
