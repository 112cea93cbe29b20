//! The clear coat of the principled BSDF: a coat of index 1.5 with a distribution of normals whose tail is
//! longer than GGX's, GTR with the exponent 1.

use super::super::{MicrofacetKind, Microfacets};
use super::{boundary_weight, schlick};
use crate::math::{PI, TAU, Vec2, Vec3, ln, pow, safe_sqrt, sin_cos, sqr};
use crate::spectrum::Spectrum;

/// Reflectance at normal incidence.
const NORMAL_REFLECTANCE: f32 = 0.04;
/// The roughness that shadows facets.
const SHADOWING: Microfacets = Microfacets {
    kind: MicrofacetKind::Ggx,
    alpha: Vec2::splat(0.25),
};

/// A coat of some roughness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clearcoat {
    pub(super) alpha: f32,
}

impl Clearcoat {
    /// The roughness goes from 0.1 without gloss to 0.001.
    pub(super) fn of_gloss(gloss: f32) -> Self {
        Self {
            alpha: 0.1 + (0.001 - 0.1) * gloss,
        }
    }

    /// D(m) [1/sr] (Burley 2012, appendix B). The sine is written out: near the normal its square is all that counts.
    fn density(self, m: Vec3) -> f32 {
        let alpha_squared = sqr(self.alpha);
        let sine_squared = sqr(m.x) + sqr(m.y);
        (alpha_squared - 1.0) / (PI * ln(alpha_squared) * (sine_squared + alpha_squared * sqr(m.z)))
    }

    /// f(wo, wi) [1/sr], both outside and `m` half-way between. As in Mitsuba the shadowed density of facets is not divided by the
    /// cosines.
    pub(super) fn f(self, eta: f32, wo: Vec3, wi: Vec3, m: Vec3) -> f32 {
        let shadowing = SHADOWING.masking_over_cos(wo) * wo.z * SHADOWING.masking_over_cos(wi) * wi.z;
        let weight = boundary_weight(wo.dot(m).clamp(0.0, 1.0), eta);
        let fresnel = schlick(Spectrum::splat(NORMAL_REFLECTANCE), weight)[0];
        0.25 * fresnel * self.density(m) * shadowing
    }

    /// Density with which [`Self::sample`] mirrors `wo` at `m` [1/sr].
    pub(super) fn pdf(self, wo: Vec3, m: Vec3) -> f32 {
        self.density(m) * m.z / (4.0 * wo.dot(m))
    }

    /// A normal with density `D(m) cos m` (Burley 2012, appendix B).
    pub(super) fn sample(self, u: Vec2) -> Vec3 {
        let alpha_squared = sqr(self.alpha);
        let cos_squared = (1.0 - pow(alpha_squared, 1.0 - u.y)) / (1.0 - alpha_squared);
        let (sin_phi, cos_phi) = sin_cos(TAU * u.x);
        let sin = safe_sqrt(1.0 - cos_squared);
        Vec3::new(sin * cos_phi, sin * sin_phi, safe_sqrt(cos_squared))
    }
}
