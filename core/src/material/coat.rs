//! A dielectric coat over a diffuse base: Mitsuba's `plastic`, and what the rough coat of `roughplastic` reflects.
//!
//! The coat reflects the share `F(w)` of what arrives along `w` as a mirror does, and lets the rest through. What the base
//! reflects is even within the coat; the coat returns a share of it to the base, again and again, and lets the rest out, also by
//! Fresnel's equations and reciprocally. So the base is a lobe `f(wo, wi) = (1 - F(wo)) (1 - F(wi)) d / (pi eta^2 (1 - d Fi))`, with `d`
//! its albedo and `Fi` the share of even light from within that the coat returns (Jakob 2010, Mitsuba's `plastic`; the sum over all
//! orders is that of Wolff 1994, "Diffuse-Reflectance Model for Smooth Dielectric Surfaces").

use super::{BsdfSample, GRAZING, Microfacets, conductor, diffuse, fresnel};
use crate::math::{FRAC_1_PI, Vec2, Vec3};
use crate::spectrum::Spectrum;

/// A dielectric boundary over a diffuse base, as validated data.
#[derive(Clone, Copy, Debug)]
pub struct Coat {
    /// Index of the coat over that of the exterior.
    eta: f32,
    /// Share of even light from within that the coat lets out, `1 - Fi`.
    escaping: f32,
    /// Whether the base takes its colour from light as often as light meets it.
    nonlinear: bool,
}

impl Coat {
    /// A coat with `eta` times the index of the exterior, positive. The light that it returns to the base takes the base's colour
    /// each time if `nonlinear`; otherwise the colour is taken once, however often the light meets the base.
    #[must_use]
    pub fn new(eta: f32, nonlinear: bool) -> Self {
        Self::with_escaping(eta, (1.0 - fresnel::mean_reflectance(1.0 / eta)) as f32, nonlinear)
    }

    /// A coat that lets out the share `escaping` of even light from within.
    pub(super) fn with_escaping(eta: f32, escaping: f32, nonlinear: bool) -> Self {
        Self {
            eta,
            escaping,
            nonlinear,
        }
    }

    /// Index of the coat over that of the exterior.
    pub(super) fn eta(&self) -> f32 {
        self.eta
    }

    /// `f` of a base of this albedo over both factors `1 - F`.
    pub(super) fn base(&self, albedo: Spectrum) -> Spectrum {
        let scale = FRAC_1_PI / (self.eta * self.eta);
        albedo.map(|d| {
            let escaping = match self.nonlinear {
                true => (1.0 - d) + d * self.escaping,
                false => self.escaping,
            };
            scale * d / escaping
        })
    }
}

/// Share of the power arriving along `w`, on the outer side, that the coat reflects.
pub(super) fn reflectance(eta: f32, w: Vec3) -> f32 {
    fresnel::dielectric(w.z.clamp(0.0, 1.0), eta).reflectance
}

/// The mirror direction at the coat, on the outer side.
pub(super) fn sample_reflection(eta: f32, wo: Vec3) -> Option<BsdfSample> {
    (wo.z > GRAZING).then(|| BsdfSample {
        wi: Vec3::new(-wo.x, -wo.y, wo.z),
        f: Spectrum::splat(reflectance(eta, wo) / wo.z),
        pdf: 1.0,
        delta: true,
        reversal: 1.0,
        eta: 1.0,
    })
}

/// f = (1 - F(wo)) (1 - F(wi)), to be multiplied by [`Coat::base`].
pub(super) fn eval_base(eta: f32, wo: Vec3, wi: Vec3) -> f32 {
    if wo.z <= GRAZING || wi.z <= GRAZING {
        return 0.0;
    }
    (1.0 - reflectance(eta, wo)) * (1.0 - reflectance(eta, wi))
}

/// A direction in proportion to the cosine, as [`diffuse::sample`], whose density it has.
pub(super) fn sample_base(eta: f32, wo: Vec3, u: Vec2) -> Option<BsdfSample> {
    let sample = diffuse::sample(wo, u)?;
    Some(BsdfSample {
        f: Spectrum::splat(eval_base(eta, wo, sample.wi)),
        ..sample
    })
}

/// f = F D G / (4 cos wo cos wi) (Walter et al. 2007, equation 20) of a rough coat, on the outer side.
pub(super) fn eval_rough(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3) -> f32 {
    if wo.z <= GRAZING || wi.z <= GRAZING {
        return 0.0;
    }
    value_of_facet(eta, facets, wo, wi, (wo + wi).normalize())
}

/// The mirror direction about a visible microfacet normal, with the density [`conductor::pdf`].
pub(super) fn sample_rough(eta: f32, facets: &Microfacets, wo: Vec3, u: Vec2) -> Option<BsdfSample> {
    if wo.z <= GRAZING {
        return None;
    }
    let m = facets.sample_visible(wo, u);
    let wi = fresnel::reflect(wo, m, wo.dot(m));
    (wi.z > GRAZING).then(|| BsdfSample {
        wi,
        f: Spectrum::splat(value_of_facet(eta, facets, wo, wi, m)),
        pdf: conductor::pdf_of_facet(facets, wo, m),
        delta: false,
        reversal: 1.0,
        eta: 1.0,
    })
}

fn value_of_facet(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3, m: Vec3) -> f32 {
    let reflectance = fresnel::dielectric(wo.dot(m).clamp(0.0, 1.0), eta).reflectance;
    reflectance * conductor::pdf_of_facet(facets, wo, m) * facets.masking_over_cos(wi)
}
