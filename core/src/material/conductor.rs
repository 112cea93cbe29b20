//! Reflection by a smooth or rough metal, on the outer side only.

use super::{BsdfSample, GRAZING, Microfacets, fresnel};
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;

/// The mirror direction of a smooth conductor; `f |cos wi| / pdf` is Fresnel's reflectance.
pub(super) fn sample_smooth(eta: Spectrum, k: Spectrum, wo: Vec3) -> Option<BsdfSample> {
    (wo.z > GRAZING).then(|| BsdfSample {
        wi: Vec3::new(-wo.x, -wo.y, wo.z),
        f: fresnel::conductor(wo.z, eta, k) / wo.z,
        pdf: 1.0,
        delta: true,
        reversal: 1.0,
        eta: 1.0,
    })
}

/// f = F D G / (4 cos wo cos wi) (Walter et al. 2007, equation 20).
pub(super) fn eval(eta: Spectrum, k: Spectrum, facets: &Microfacets, wo: Vec3, wi: Vec3) -> Spectrum {
    if wo.z <= GRAZING || wi.z <= GRAZING {
        return Spectrum::ZERO;
    }
    let m = (wo + wi).normalize();
    value(eta, k, facets, wo, wi, m)
}

/// Density of [`sample`] [1/sr]: D G1(wo) / (4 cos wo).
pub(super) fn pdf(facets: &Microfacets, wo: Vec3, wi: Vec3) -> f32 {
    if wo.z <= GRAZING || wi.z <= GRAZING {
        return 0.0;
    }
    pdf_of_facet(facets, wo, (wo + wi).normalize())
}

/// The mirror direction about a visible microfacet normal.
pub(super) fn sample(eta: Spectrum, k: Spectrum, facets: &Microfacets, wo: Vec3, u: Vec2) -> Option<BsdfSample> {
    if wo.z <= GRAZING {
        return None;
    }
    let m = facets.sample_visible(wo, u);
    let wi = fresnel::reflect(wo, m, wo.dot(m));
    (wi.z > GRAZING).then(|| BsdfSample {
        wi,
        f: value(eta, k, facets, wo, wi, m),
        pdf: pdf_of_facet(facets, wo, m),
        delta: false,
        reversal: 1.0,
        eta: 1.0,
    })
}

fn value(eta: Spectrum, k: Spectrum, facets: &Microfacets, wo: Vec3, wi: Vec3, m: Vec3) -> Spectrum {
    let reflectance = fresnel::conductor(wo.dot(m).clamp(0.0, 1.0), eta, k);
    reflectance * (pdf_of_facet(facets, wo, m) * facets.masking_over_cos(wi))
}

/// Density of the mirror direction about the visible normal `m` [1/sr].
pub(super) fn pdf_of_facet(facets: &Microfacets, wo: Vec3, m: Vec3) -> f32 {
    0.25 * facets.density(m) * facets.masking_over_cos(wo)
}
