//! How much light a rough dielectric boundary reflects and lets through in all: tables made before rendering.
//!
//! The rules are those of Mitsuba 3's `roughplastic`, so that pictures agree: cosines at 64 equal steps, linear between them, and the mean of the
//! reflectance from within as the plain mean over these cosines (about 1.5 % below the integral). Scattering from facet to facet is left
//! out: what is reflected and what is let through add up to less than one.

use super::{MicrofacetKind, Microfacets, fresnel};
use crate::math::{Vec2, Vec3};
use rayon::prelude::*;

/// Cosines in a table.
const COSINES: usize = 64;
/// Facets that stand for all, along each random number of [`Microfacets::sample_visible`].
const FACETS: usize = 32;

/// The share of light that a rough boundary lets in, by the cosine of its direction.
#[derive(Clone, Copy, Debug)]
pub struct TransmittanceTable([f32; COSINES]);

impl TransmittanceTable {
    /// Of a boundary with `eta` times the index of the exterior, and a roughness of at least 1e-4.
    #[must_use]
    pub fn new(kind: MicrofacetKind, alpha: f32, eta: f32) -> Self {
        let of_facet = |wo: Vec3, m: Vec3, cos: f32, facets: &Microfacets| {
            let boundary = fresnel::dielectric(cos, eta);
            let wi = fresnel::refract(wo, m, cos, boundary.cos_transmitted, eta);
            match wi.z < 0.0 {
                true => (1.0 - boundary.reflectance) * facets.masking_over_cos(wi) * -wi.z,
                false => 0.0,
            }
        };
        Self(over_facets(kind, alpha, of_facet).map(|value| value as f32))
    }

    /// The value for a direction of this cosine.
    pub(super) fn at(&self, cos: f32) -> f32 {
        let place = cos.clamp(0.0, 1.0) * (COSINES - 1) as f32;
        let index = (place as usize).min(COSINES - 2);
        let beyond = place - index as f32;
        self.0[index] * (1.0 - beyond) + self.0[index + 1] * beyond
    }
}

/// The share of even light from within that a rough coat lets out.
pub(super) fn escaping(kind: MicrofacetKind, alpha: f32, eta: f32) -> f32 {
    let of_facet = |wo: Vec3, m: Vec3, cos: f32, facets: &Microfacets| {
        let wi = fresnel::reflect(wo, m, cos);
        match wi.z > 0.0 {
            true => fresnel::dielectric(cos, 1.0 / eta).reflectance * facets.masking_over_cos(wi) * wi.z,
            false => 0.0,
        }
    };
    let weighted = over_facets(kind, alpha, of_facet)
        .into_iter()
        .enumerate()
        .map(|(index, reflectance)| reflectance * f64::from(cosine(index)));
    (1.0 - 2.0 * weighted.sum::<f64>() / COSINES as f64) as f32
}

fn cosine(index: usize) -> f32 {
    (index as f32 / (COSINES - 1) as f32).max(1e-6)
}

/// The mean over the facets that are visible from a direction `wo`, for each cosine of `wo`, of a function of `wo`, the normal of the facet, their
/// cosine, and all facets; by the rule of midpoints.
fn over_facets(
    kind: MicrofacetKind,
    alpha: f32,
    of_facet: impl Fn(Vec3, Vec3, f32, &Microfacets) -> f32 + Sync,
) -> [f64; COSINES] {
    let facets = Microfacets {
        kind,
        alpha: Vec2::splat(alpha),
    };
    let middle = |i: usize| (i as f32 + 0.5) / FACETS as f32;
    let of_cosine = |index: usize| {
        let cos = cosine(index);
        let wo = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
        let value = |i: usize, j: usize| {
            let m = facets.sample_visible(wo, Vec2::new(middle(i), middle(j)));
            let cos = wo.dot(m).min(1.0);
            if cos > 0.0 {
                f64::from(of_facet(wo, m, cos, &facets))
            } else {
                0.0
            }
        };
        let pairs = (0..FACETS).flat_map(|i| (0..FACETS).map(move |j| (i, j)));
        pairs.map(|(i, j)| value(i, j)).sum::<f64>() / (FACETS * FACETS) as f64
    };
    let values: Vec<f64> = (0..COSINES).into_par_iter().map(of_cosine).collect();
    std::array::from_fn(|index| values[index])
}
