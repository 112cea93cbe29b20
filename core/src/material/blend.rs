//! A weighted sum of BSDFs: Mitsuba's `blendbsdf`, `mixturebsdf` and `mask`.

use super::{Bsdf, BsdfSample, Lobe, TransportMode};
use crate::math::{ONE_MINUS_EPSILON, Vec2, Vec3};
use crate::spectrum::Spectrum;

/// BSDFs with their weights. Each is sampled as often as its share of the sum of the weights.
///
/// A sampled delta function has the `f` and the probability of its own BSDF alone, even where that of another points the same way
/// (two BSDFs may both let light straight through): each is sampled by itself, and the expectation of the sum is the sum of the
/// expectations.
#[derive(Clone, Debug)]
pub(super) struct Blend {
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
struct Part {
    bsdf: Bsdf,
    /// Factor on the BSDF.
    weight: f32,
    /// How often it is sampled: its weight over the sum of all.
    probability: f32,
}

impl Blend {
    /// BSDFs with weights that are not negative and whose sum is finite; what has no weight is left out.
    pub(super) fn new(parts: impl IntoIterator<Item = (f32, Bsdf)>) -> Self {
        let parts: Vec<_> = parts.into_iter().filter(|(weight, _)| *weight > 0.0).collect();
        let sum: f32 = parts.iter().map(|(weight, _)| weight).sum();
        let part = |(weight, bsdf)| Part {
            bsdf,
            weight,
            probability: weight / sum,
        };
        Self {
            parts: parts.into_iter().map(part).collect(),
        }
    }

    /// As [`Bsdf::f`].
    pub(super) fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        self.parts
            .iter()
            .map(|part| part.bsdf.f(wo, wi, mode) * part.weight)
            .sum()
    }

    /// As [`Bsdf::pdf`].
    pub(super) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        self.parts
            .iter()
            .map(|part| part.bsdf.pdf(wo, wi) * part.probability)
            .sum()
    }

    /// As [`Bsdf::draw`].
    pub(super) fn draw(&self, wo: Vec3, u: f32, v: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let (chosen, u) = self.choose(u)?;
        let sample = chosen.bsdf.draw(wo, u, v, mode)?;
        if sample.delta {
            return Some(BsdfSample {
                f: sample.f * chosen.weight,
                pdf: sample.pdf * chosen.probability,
                ..sample
            });
        }
        Some(BsdfSample {
            f: self.f(wo, sample.wi, mode),
            pdf: self.pdf(wo, sample.wi),
            ..sample
        })
    }

    /// The part that `u` chooses, and a random number made of what is left of `u`.
    fn choose(&self, u: f32) -> Option<(&Part, f32)> {
        let mut below = 0.0;
        for part in &self.parts {
            if u < below + part.probability {
                return Some((part, ((u - below) / part.probability).min(ONE_MINUS_EPSILON)));
            }
            below += part.probability;
        }
        // Rounding may leave a little above the last part.
        self.parts.last().map(|part| (part, ONE_MINUS_EPSILON))
    }

    /// As [`Bsdf::immerse`].
    pub(super) fn immerse(&mut self, index: f32) {
        for part in &mut self.parts {
            part.bsdf.immerse(index);
        }
    }

    /// As [`Bsdf::each_lobe`].
    pub(super) fn each_lobe(&self, visit: &mut dyn FnMut(&Lobe)) {
        for part in &self.parts {
            part.bsdf.each_lobe(&mut |lobe| visit(lobe));
        }
    }
}
