//! Reflection and refraction at a smooth or rough boundary between two transparent media, or at a thin pane.
//!
//! The branch is chosen by Fresnel's reflectance. Radiance that crosses the boundary is scaled by the squared ratio of
//! indices, since it spreads over another solid angle; flux is not (Veach 1997, section 5.2).

use super::{BsdfSample, GRAZING, Microfacets, Tints, TransportMode, fresnel};
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;

/// `wo` turned to the upper side, and the index of the lower side over that of the upper side. The caller turns `wi`
/// by the same `sign`; elliptical roughness is symmetric under it.
struct Oriented {
    wo: Vec3,
    eta: f32,
    sign: f32,
}

fn orient(eta: f32, wo: Vec3) -> Option<Oriented> {
    if wo.z > GRAZING {
        Some(Oriented { wo, eta, sign: 1.0 })
    } else if wo.z < -GRAZING {
        Some(Oriented {
            wo: -wo,
            eta: 1.0 / eta,
            sign: -1.0,
        })
    } else {
        None
    }
}

/// Factor on what crosses into a medium with `eta` times the index, seen from `wo`.
fn compression(eta: f32, mode: TransportMode) -> f32 {
    match mode {
        TransportMode::Radiance => 1.0 / (eta * eta),
        TransportMode::Flux => 1.0,
    }
}

/// The mirror or the refracted direction of a smooth boundary.
pub(super) fn sample_smooth(eta: f32, tints: Tints, wo: Vec3, lobe: f32, mode: TransportMode) -> Option<BsdfSample> {
    let Oriented { wo, eta, sign } = orient(eta, wo)?;
    let boundary = fresnel::dielectric(wo.z, eta);
    if lobe < boundary.reflectance {
        let wi = Vec3::new(-wo.x, -wo.y, wo.z);
        let f = tints.reflectance * (boundary.reflectance / wi.z);
        return Some(BsdfSample {
            wi: wi * sign,
            f,
            pdf: boundary.reflectance,
            delta: true,
            reversal: 1.0,
            eta: 1.0,
        });
    }
    let cos = boundary.cos_transmitted;
    if cos <= GRAZING {
        return None;
    }
    let pdf = 1.0 - boundary.reflectance;
    let wi = Vec3::new(-wo.x / eta, -wo.y / eta, -cos);
    let f = tints.transmittance * (compression(eta, mode) * pdf / cos);
    Some(BsdfSample {
        wi: wi * sign,
        f,
        pdf,
        delta: true,
        reversal: 1.0,
        eta,
    })
}

/// The mirror direction of a thin pane, or straight through. With `R` the reflectance of one side, what the pane reflects is
/// `R + T R T + T R^3 T + ... = 2 R / (1 + R)`: light that enters is reflected within until it leaves by one side or the other, in place
/// (Stokes 1862; Mitsuba's `thindielectric`).
pub(super) fn sample_thin(eta: f32, tints: Tints, wo: Vec3, lobe: f32) -> Option<BsdfSample> {
    let cos = wo.z.abs();
    if cos <= GRAZING {
        return None;
    }
    let once = fresnel::dielectric(cos, eta).reflectance;
    let reflectance = 2.0 * once / (1.0 + once);
    let (wi, pdf, tint) = if lobe < reflectance {
        (Vec3::new(-wo.x, -wo.y, wo.z), reflectance, tints.reflectance)
    } else {
        (-wo, 1.0 - reflectance, tints.transmittance)
    };
    Some(BsdfSample {
        wi,
        f: tint * (pdf / cos),
        pdf,
        delta: true,
        reversal: 1.0,
        eta: 1.0,
    })
}

/// A pair of directions that a microfacet connects, by reflection or refraction.
struct Facet {
    /// Density of sampling `wi` given `wo` [1/sr].
    pdf: f32,
    /// f of the untinted boundary, flux being carried [1/sr].
    f: f32,
    transmitted: bool,
}

/// Reflection at the normal `m`: densities of Walter et al. 2007, equations 14 and 20, with visible normals.
fn reflection(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3, m: Vec3) -> Facet {
    let boundary = fresnel::dielectric(wo.dot(m).clamp(0.0, 1.0), eta);
    let pdf = 0.25 * boundary.reflectance * facets.density(m) * facets.masking_over_cos(wo);
    Facet {
        pdf,
        f: pdf * facets.masking_over_cos(wi),
        transmitted: false,
    }
}

/// Refraction at the normal `m`: Walter et al. 2007, equations 17 and 21, with visible normals. `None` where `m` has
/// both directions on one side.
fn refraction(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3, m: Vec3) -> Option<Facet> {
    let (wo_m, wi_m) = (wo.dot(m), wi.dot(m));
    if wo_m <= 0.0 || wi_m >= 0.0 {
        return None;
    }
    let transmittance = 1.0 - fresnel::reflectance(wo_m, -wi_m, eta);
    let half_length = wo_m + eta * wi_m;
    let jacobian = eta * eta * -wi_m / (half_length * half_length);
    let pdf = transmittance * facets.density(m) * facets.masking_over_cos(wo) * wo_m * jacobian;
    Some(Facet {
        pdf,
        f: pdf * facets.masking_over_cos(wi),
        transmitted: true,
    })
}

/// The facet that connects two directions, `wo` being above.
fn connect(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3) -> Option<Facet> {
    if wi.z > GRAZING {
        let m = (wo + wi).normalize();
        return Some(reflection(eta, facets, wo, wi, m));
    }
    if wi.z >= -GRAZING {
        return None;
    }
    let half = wo + eta * wi;
    let m = half.try_normalize()?;
    let facet = refraction(eta, facets, wo, wi, m * 1.0_f32.copysign(m.z))?;
    (facet.pdf.is_finite() && facet.f.is_finite()).then_some(facet)
}

/// f(wo, wi) [1/sr] of a rough boundary.
pub(super) fn eval(eta: f32, facets: &Microfacets, tints: Tints, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
    let value = |oriented: Oriented| {
        let facet = connect(oriented.eta, facets, oriented.wo, wi * oriented.sign)?;
        Some(facet.tinted(tints, oriented.eta, mode))
    };
    orient(eta, wo).and_then(value).unwrap_or(Spectrum::ZERO)
}

impl Facet {
    fn tinted(&self, tints: Tints, eta: f32, mode: TransportMode) -> Spectrum {
        if self.transmitted {
            tints.transmittance * (self.f * compression(eta, mode))
        } else {
            tints.reflectance * self.f
        }
    }
}

/// Density of [`sample`] [1/sr].
pub(super) fn pdf(eta: f32, facets: &Microfacets, wo: Vec3, wi: Vec3) -> f32 {
    orient(eta, wo)
        .and_then(|oriented| connect(oriented.eta, facets, oriented.wo, wi * oriented.sign))
        .map_or(0.0, |facet| facet.pdf)
}

/// Reflects or refracts at a visible microfacet normal.
pub(super) fn sample(
    eta: f32,
    facets: &Microfacets,
    tints: Tints,
    wo: Vec3,
    (lobe, u): (f32, Vec2),
    mode: TransportMode,
) -> Option<BsdfSample> {
    let Oriented { wo, eta, sign } = orient(eta, wo)?;
    let m = facets.sample_visible(wo, u);
    let cos = wo.dot(m);
    if cos <= 0.0 {
        return None;
    }
    let boundary = fresnel::dielectric(cos.min(1.0), eta);
    let (wi, facet) = if lobe < boundary.reflectance {
        let wi = fresnel::reflect(wo, m, cos);
        (wi, (wi.z > GRAZING).then(|| reflection(eta, facets, wo, wi, m))?)
    } else {
        let wi = fresnel::refract(wo, m, cos, boundary.cos_transmitted, eta);
        (
            wi,
            if wi.z < -GRAZING {
                refraction(eta, facets, wo, wi, m)?
            } else {
                return None;
            },
        )
    };
    Some(BsdfSample {
        wi: wi * sign,
        f: facet.tinted(tints, eta, mode),
        pdf: facet.pdf,
        delta: false,
        reversal: 1.0,
        eta: if facet.transmitted { eta } else { 1.0 },
    })
}
