//! A smooth or rough dielectric coat over a BSDF: Mitsuba's `roughplastic`, and `coating` and `roughcoating` of Mitsuba 0.6.
//!
//! The coat reflects a share of the light, and lets the share `T(w)` of what arrives along `w` through. Over a diffuse base, light is
//! reflected within the coat any number of times, as under [`super::coat`]. Over another BSDF, what the coat would return from within
//! is lost (Weidlich and Wilkie 2007, "Arbitrarily Layered Micro-Facet Surfaces"): with `w'` the direction within that `w` is refracted to,
//! `f(wo, wi) = T(wo) T(wi) g(wo', wi') exp(-a (1 / cos wo' + 1 / cos wi')) / eta^2`, where `g` is the BSDF within and `a` the
//! absorption of the coat, straight through.

use super::rough_coat::TransmittanceTable;
use super::{Bsdf, BsdfSample, GRAZING, Lobe, TransportMode, coat, diffuse, fresnel};
use crate::math::{ONE_MINUS_EPSILON, Vec2, Vec3, exp, safe_sqrt};
use crate::spectrum::Spectrum;

/// A coat over a base, on the outer side.
#[derive(Clone, Debug)]
pub(super) struct Coated {
    /// What the coat reflects.
    top: Lobe,
    passage: Passage,
    base: Base,
    /// Factor on the share that is reflected, and on the share that is let through, when one of them is chosen.
    weights: [f32; 2],
}

/// What the coat lets through.
#[derive(Clone, Debug)]
pub(super) struct Passage {
    /// Index of the coat over that of the exterior.
    pub(super) eta: f32,
    /// `T` of a rough coat.
    pub(super) table: Option<TransmittanceTable>,
}

/// What lies under the coat.
#[derive(Clone, Debug)]
pub(super) enum Base {
    /// A diffuse surface: f over `T(wo) T(wi)` [1/sr].
    Diffuse(Spectrum),
    /// A BSDF, and the absorption `a` of the coat.
    Nested { bsdf: Bsdf, absorption: Spectrum },
}

/// A direction of the exterior and what becomes of it within the coat.
struct Refracted {
    /// Unit direction within.
    within: Vec3,
    transmittance: f32,
}

impl Coated {
    /// `top` is [`Lobe::CoatReflection`] or [`Lobe::RoughCoatReflection`]. `weights` are about the albedos of a mirror in the place of the coat,
    /// and of the base.
    pub(super) fn new(top: Lobe, passage: Passage, base: Base, weights: [f32; 2]) -> Self {
        Self {
            top,
            passage,
            base,
            weights,
        }
    }

    /// Probability of sampling what the coat reflects, seen from `w`.
    fn share_of_top(&self, w: Vec3) -> f32 {
        let transmittance = self.passage.transmittance(w);
        let top = (1.0 - transmittance) * self.weights[0];
        let total = top + transmittance * self.weights[1];
        if total > 0.0 { top / total } else { 1.0 }
    }

    /// As [`Bsdf::f`].
    pub(super) fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        self.top.f(wo, wi, mode) + self.base_f(wo, wi, mode)
    }

    fn base_f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        if wo.z <= GRAZING || wi.z <= GRAZING {
            return Spectrum::ZERO;
        }
        match &self.base {
            Base::Diffuse(base) => *base * (self.passage.transmittance(wo) * self.passage.transmittance(wi)),
            Base::Nested { bsdf, absorption } => {
                let (Some(o), Some(i)) = (self.passage.refract(wo), self.passage.refract(wi)) else {
                    return Spectrum::ZERO;
                };
                let scale = o.transmittance * i.transmittance / (self.passage.eta * self.passage.eta);
                bsdf.f(o.within, i.within, mode) * left(*absorption, o.within, i.within) * scale
            }
        }
    }

    /// As [`Bsdf::pdf`].
    pub(super) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let share = self.share_of_top(wo);
        share * self.top.pdf(wo, wi) + (1.0 - share) * self.base_pdf(wo, wi)
    }

    fn base_pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        if wo.z <= GRAZING || wi.z <= GRAZING {
            return 0.0;
        }
        match &self.base {
            Base::Diffuse(_) => diffuse::pdf(wo, wi),
            Base::Nested { bsdf, .. } => {
                let (Some(o), Some(i)) = (self.passage.refract(wo), self.passage.refract(wi)) else {
                    return 0.0;
                };
                // Solid angles shrink within the coat: d wi' / d wi = cos wi / (eta^2 cos wi').
                bsdf.pdf(o.within, i.within) * wi.z / (self.passage.eta * self.passage.eta * i.within.z)
            }
        }
    }

    /// As [`Bsdf::draw`].
    pub(super) fn draw(&self, wo: Vec3, u: f32, v: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        if wo.z <= GRAZING {
            return None;
        }
        let share = self.share_of_top(wo);
        let (sample, probability) = if u < share {
            (self.top.sample(wo, (u / share).min(ONE_MINUS_EPSILON), v, mode)?, share)
        } else {
            let u = ((u - share) / (1.0 - share)).min(ONE_MINUS_EPSILON);
            (self.draw_base(wo, share, u, v, mode)?, 1.0 - share)
        };
        if sample.delta {
            return Some(BsdfSample {
                pdf: sample.pdf * probability,
                ..sample
            });
        }
        Some(BsdfSample {
            f: self.f(wo, sample.wi, mode),
            pdf: self.pdf(wo, sample.wi),
            ..sample
        })
    }

    /// A sample of the base; its `f` and `pdf` count only where it is a delta function.
    fn draw_base(&self, wo: Vec3, share: f32, u: f32, v: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let Base::Nested { bsdf, absorption } = &self.base else {
            return diffuse::sample(wo, v);
        };
        let o = self.passage.refract(wo)?;
        let sample = bsdf.draw(o.within, u, v, mode)?;
        let wi = self.passage.leave(sample.wi)?;
        let transmittance = o.transmittance * self.passage.transmittance(wi);
        // The cosines are those of the delta function: its weight f |cos wi| within is that outside but for what is lost.
        let f = sample.f * left(*absorption, o.within, sample.wi) * (transmittance * sample.wi.z / wi.z);
        Some(BsdfSample {
            wi,
            f,
            reversal: sample.reversal * (1.0 - self.share_of_top(wi)) / (1.0 - share),
            ..sample
        })
    }

    /// As [`Bsdf::each_lobe`].
    pub(super) fn each_lobe(&self, visit: &mut dyn FnMut(&Lobe)) {
        visit(&self.top);
        match &self.base {
            Base::Diffuse(base) => visit(&Lobe::Diffuse { reflectance: *base }),
            Base::Nested { bsdf, .. } => bsdf.each_lobe(&mut |lobe| visit(lobe)),
        }
    }
}

/// What absorption leaves of light on its way to the base and out again.
fn left(absorption: Spectrum, wo: Vec3, wi: Vec3) -> Spectrum {
    if absorption.is_black() {
        return Spectrum::ONE;
    }
    let length = 1.0 / wo.z + 1.0 / wi.z;
    absorption.map(|a| exp(-a * length))
}

impl Passage {
    /// `T(w)` of a direction on the outer side.
    fn transmittance(&self, w: Vec3) -> f32 {
        match &self.table {
            Some(table) => table.at(w.z),
            None => 1.0 - coat::reflectance(self.eta, w),
        }
    }

    /// The direction within the coat that `w` is refracted to, on the outer side both. `None` under total reflection.
    fn refract(&self, w: Vec3) -> Option<Refracted> {
        let cos = fresnel::dielectric(w.z.clamp(0.0, 1.0), self.eta).cos_transmitted;
        (cos > GRAZING).then(|| Refracted {
            within: Vec3::new(w.x / self.eta, w.y / self.eta, cos),
            transmittance: self.transmittance(w),
        })
    }

    /// The direction of the exterior that `within` is refracted to; the reverse of [`Self::refract`].
    fn leave(&self, within: Vec3) -> Option<Vec3> {
        if within.z <= GRAZING {
            return None;
        }
        let (x, y) = (within.x * self.eta, within.y * self.eta);
        let cos = safe_sqrt(1.0 - x * x - y * y);
        (cos > GRAZING).then(|| Vec3::new(x, y, cos))
    }
}
