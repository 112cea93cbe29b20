//! Diffuse reflection by a rough surface: grooves with diffuse walls that shadow and light each other (Oren and Nayar 1994,
//! "Generalization of Lambert's Reflectance Model"), on the outer side only.

use super::{BsdfSample, GRAZING, diffuse};
use crate::math::{FRAC_1_PI, Vec2, Vec3, acos, safe_sqrt, sqr};
use crate::spectrum::Spectrum;

/// A rough diffuse surface at a point.
#[derive(Clone, Copy, Debug)]
pub struct RoughDiffuseLobe {
    /// Albedo of the grooves' walls, in [0, 1].
    pub(super) reflectance: Spectrum,
    /// Variance of the slope of the walls.
    variance: f32,
    /// Whether the paper's short form is meant, which leaves out the light between walls.
    fast: bool,
}

/// Both angles with the normal, the larger being `alpha`.
struct Angles {
    sin_alpha: f32,
    sin_beta: f32,
    tan_beta: f32,
    /// Cosine of the difference of azimuths.
    cos_phi: f32,
}

impl Angles {
    fn of(wo: Vec3, wi: Vec3) -> Self {
        let sine = |w: Vec3| Vec2::new(w.x, w.y).length();
        let (high, low) = if wo.z > wi.z { (wo, wi) } else { (wi, wo) };
        let (sin_alpha, sin_beta) = (sine(low).min(1.0), sine(high).min(1.0));
        let product = sin_alpha * sin_beta;
        Self {
            sin_alpha,
            sin_beta,
            tan_beta: sin_beta / high.z,
            cos_phi: match product > 0.0 {
                true => ((wo.x * wi.x + wo.y * wi.y) / product).clamp(-1.0, 1.0),
                false => 0.0,
            },
        }
    }
}

impl RoughDiffuseLobe {
    /// `alpha` is a microfacet roughness: sqrt(2) times the standard deviation of slopes, as in Mitsuba.
    pub(super) fn new(reflectance: Spectrum, alpha: f32, fast: bool) -> Self {
        Self {
            reflectance,
            variance: 0.5 * sqr(alpha),
            fast,
        }
    }

    /// f(wo, wi) [1/sr]: the functional model of the paper with its light between walls, or the qualitative one.
    pub(super) fn f(&self, wo: Vec3, wi: Vec3) -> Spectrum {
        if wo.z <= GRAZING || wi.z <= GRAZING {
            return Spectrum::ZERO;
        }
        let angles = Angles::of(wo, wi);
        let Angles {
            sin_alpha,
            tan_beta,
            cos_phi,
            ..
        } = angles;
        let c1 = 1.0 - 0.5 * self.variance / (self.variance + 0.33);
        let slope = self.variance / (self.variance + 0.09);
        if self.fast {
            let shape = c1 + 0.45 * slope * cos_phi.max(0.0) * sin_alpha * tan_beta;
            return self.reflectance * (FRAC_1_PI * shape);
        }
        let (alpha, beta) = (acos(wo.z.min(wi.z)), acos(wo.z.max(wi.z).min(1.0)));
        let beta_share = 2.0 * FRAC_1_PI * beta;
        let back = if cos_phi > 0.0 {
            0.0
        } else {
            beta_share * sqr(beta_share)
        };
        let c2 = 0.45 * slope * (sin_alpha - back);
        let c3 = 0.125 * slope * sqr(4.0 * sqr(FRAC_1_PI) * alpha * beta);
        let c4 = 0.17 * self.variance / (self.variance + 0.13);
        let single = c1 + cos_phi * c2 * tan_beta + (1.0 - cos_phi.abs()) * c3 * angles.tan_of_mean();
        let double = c4 * (1.0 - cos_phi * sqr(beta_share));
        self.reflectance
            .map(|rho| FRAC_1_PI * rho * (single + rho * double).max(0.0))
    }

    /// A direction in proportion to the cosine, as [`diffuse::sample`], whose density it has.
    pub(super) fn sample(&self, wo: Vec3, u: Vec2) -> Option<BsdfSample> {
        let sample = diffuse::sample(wo, u)?;
        Some(BsdfSample {
            f: self.f(wo, sample.wi),
            ..sample
        })
    }
}

impl Angles {
    /// `tan((alpha + beta) / 2)`.
    fn tan_of_mean(&self) -> f32 {
        let cosine = |sine: f32| safe_sqrt(1.0 - sqr(sine));
        (self.sin_alpha + self.sin_beta) / (cosine(self.sin_alpha) + cosine(self.sin_beta)).max(GRAZING)
    }
}
