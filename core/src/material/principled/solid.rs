//! The principled BSDF of a solid body: a dielectric boundary that is metal in part, over a diffuse base, under a clear coat.

use super::clearcoat::Clearcoat;
use super::{Cosines, Principled, Share, boundary_weight, diffuse, facets, normal_reflectance, schlick, sheen, tint};
use crate::material::{
    BsdfSample, GRAZING, LEAST_STEP, Lobe, Microfacets, Tints, TransportMode, conductor, dielectric, fresnel,
};
use crate::math::{ONE_MINUS_EPSILON, Vec2, Vec3, warp};
use crate::spectrum::Spectrum;
use crate::texture::TexturePoint;

/// A [`Principled`] at a point.
#[derive(Clone, Copy, Debug)]
pub struct SolidLobe {
    base: Spectrum,
    eta: f32,
    roughness: f32,
    anisotropic: Share,
    metallic: Share,
    spec_trans: Share,
    spec_tint: Share,
    sheen: Share,
    sheen_tint: Share,
    flatness: Share,
    clearcoat: Share,
    clearcoat_gloss: Share,
}

impl Principled {
    pub(in crate::material) fn resolve(&self, at: &TexturePoint) -> Lobe {
        Lobe::Principled(SolidLobe {
            base: self.base_color.eval(at),
            eta: self.eta,
            roughness: self.roughness.grey(at),
            anisotropic: Share::of(&self.anisotropic, at),
            metallic: Share::of(&self.metallic, at),
            spec_trans: Share::of(&self.spec_trans, at),
            spec_tint: Share::of(&self.spec_tint, at),
            sheen: Share::of(&self.sheen, at),
            sheen_tint: Share::of(&self.sheen_tint, at),
            flatness: Share::of(&self.flatness, at),
            clearcoat: Share::of(&self.clearcoat, at),
            clearcoat_gloss: Share::of(&self.clearcoat_gloss, at),
        })
    }
}

/// How often the parts are sampled from outside, as in Mitsuba: in proportion to these numbers. The boundary has the weight 1.
struct Weights {
    /// Of the boundary's 1, the share of refracted light that is let through.
    transmitted: f32,
    clearcoat: f32,
    diffuse: f32,
}

impl Weights {
    fn total(&self) -> f32 {
        1.0 + self.clearcoat + self.diffuse
    }
}

impl SolidLobe {
    /// As [`crate::material::Bsdf::immerse`]. As where scenes are read, the index is never that of what lies outside.
    pub(in crate::material) fn immerse(&mut self, index: f32) {
        self.eta /= index;
        if (self.eta - 1.0).abs() < LEAST_STEP {
            self.eta = 1.0 + LEAST_STEP;
        }
    }

    fn facets(&self) -> Microfacets {
        facets(self.roughness, self.anisotropic.get())
    }

    fn coat(&self) -> Clearcoat {
        Clearcoat::of_gloss(self.clearcoat_gloss.get())
    }

    /// Share that lets light through.
    fn transmitting(&self) -> f32 {
        (1.0 - self.metallic.get()) * self.spec_trans.get()
    }

    /// Share that scatters diffusely.
    fn scattering(&self) -> f32 {
        (1.0 - self.metallic.get()) * (1.0 - self.spec_trans.get())
    }

    fn weights(&self) -> Weights {
        Weights {
            transmitted: self.transmitting(),
            clearcoat: 0.25 * self.clearcoat.get(),
            diffuse: self.scattering(),
        }
    }

    /// Factors on what the boundary does where one of the directions is inside.
    fn inner_tints(&self) -> Tints {
        let transmitting = self.transmitting();
        Tints {
            reflectance: Spectrum::splat(transmitting),
            transmittance: self.base.map(f32::sqrt) * transmitting,
        }
    }

    /// What a facet of the boundary reflects of light from outside that makes the cosine `cos` with its normal.
    fn fresnel(&self, cos: f32) -> Spectrum {
        let (metallic, spec_tint) = (self.metallic.get(), self.spec_tint.get());
        let clear = (1.0 - metallic) * (1.0 - spec_tint) * fresnel::dielectric(cos, self.eta).reflectance;
        if self.metallic.is_zero() && self.spec_tint.is_zero() {
            return Spectrum::splat(clear);
        }
        let weight = boundary_weight(cos, self.eta);
        let tinted = tint(self.base) * normal_reflectance(self.eta);
        Spectrum::splat(clear)
            + schlick(self.base, weight) * metallic
            + schlick(tinted, weight) * ((1.0 - metallic) * spec_tint)
    }

    /// As [`crate::material::Bsdf::f`].
    pub(in crate::material) fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        let facets = self.facets();
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return match self.transmitting() > 0.0 {
                true => dielectric::eval(self.eta, &facets, self.inner_tints(), wo, wi, mode),
                false => Spectrum::ZERO,
            };
        }
        if wo.z <= GRAZING || wi.z <= GRAZING {
            return Spectrum::ZERO;
        }
        let m = (wo + wi).normalize();
        let cos = Cosines {
            wo: wo.z,
            wi: wi.z,
            half: wo.dot(m).clamp(0.0, 1.0),
        };
        let mirrored = conductor::pdf_of_facet(&facets, wo, m) * facets.masking_over_cos(wi);
        let mut f = self.fresnel(cos.half) * mirrored
            + self.base * (self.scattering() * diffuse(self.roughness, self.flatness.get(), &cos));
        if !self.clearcoat.is_zero() {
            f += Spectrum::splat(self.clearcoat.get() * self.coat().f(self.eta, wo, wi, m));
        }
        if !self.sheen.is_zero() {
            let weight = self.sheen.get() * (1.0 - self.metallic.get());
            f += sheen(self.base, self.sheen_tint.get(), &cos) * weight;
        }
        f
    }

    /// As [`crate::material::Bsdf::pdf`].
    pub(in crate::material) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (facets, weights) = (self.facets(), self.weights());
        if wo.z <= 0.0 {
            return match weights.transmitted > 0.0 {
                true => dielectric::pdf(self.eta, &facets, wo, wi),
                false => 0.0,
            };
        }
        if wi.z <= 0.0 {
            return weights.transmitted / weights.total() * dielectric::pdf(self.eta, &facets, wo, wi);
        }
        if wo.z <= GRAZING || wi.z <= GRAZING {
            return 0.0;
        }
        let m = (wo + wi).normalize();
        let refracted = 1.0 - fresnel::dielectric(wo.dot(m).clamp(0.0, 1.0), self.eta).reflectance;
        let reflected = 1.0 - weights.transmitted * refracted;
        let mut sum =
            reflected * conductor::pdf_of_facet(&facets, wo, m) + weights.diffuse * warp::cosine_hemisphere_pdf(wi.z);
        if weights.clearcoat > 0.0 {
            sum += weights.clearcoat * self.coat().pdf(wo, m);
        }
        sum / weights.total()
    }

    /// As [`crate::material::Bsdf::sample`], but for samples that carry nothing.
    pub(in crate::material) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let (facets, weights) = (self.facets(), self.weights());
        if wo.z <= 0.0 {
            return match weights.transmitted > 0.0 {
                true => dielectric::sample(self.eta, &facets, self.inner_tints(), wo, (lobe, u), mode),
                false => None,
            };
        }
        let (wi, eta) = self.sample_from_outside(&weights, &facets, wo, lobe, u)?;
        let pdf = self.pdf(wo, wi);
        (pdf > 0.0).then(|| BsdfSample {
            wi,
            f: self.f(wo, wi, mode),
            pdf,
            delta: false,
            reversal: 1.0,
            eta,
        })
    }

    /// A direction and the relative index along it.
    fn sample_from_outside(
        &self,
        weights: &Weights,
        facets: &Microfacets,
        wo: Vec3,
        lobe: f32,
        u: Vec2,
    ) -> Option<(Vec3, f32)> {
        if wo.z <= GRAZING {
            return None;
        }
        let mut place = lobe * weights.total();
        if place < weights.diffuse {
            return Some((warp::square_to_cosine_hemisphere(u), 1.0));
        }
        place -= weights.diffuse;
        let mirrored = |m: Vec3| {
            let wi = fresnel::reflect(wo, m, wo.dot(m));
            (wo.dot(m) > 0.0 && wi.z > GRAZING).then_some((wi, 1.0))
        };
        if place < weights.clearcoat {
            return mirrored(self.coat().sample(u));
        }
        let place = (place - weights.clearcoat).clamp(0.0, ONE_MINUS_EPSILON);
        let m = facets.sample_visible(wo, u);
        let cos = wo.dot(m);
        let boundary = fresnel::dielectric(cos.clamp(0.0, 1.0), self.eta);
        if place >= weights.transmitted * (1.0 - boundary.reflectance) {
            return mirrored(m);
        }
        let wi = fresnel::refract(wo, m, cos, boundary.cos_transmitted, self.eta);
        (cos > 0.0 && wi.z < -GRAZING).then_some((wi, self.eta))
    }

    /// The smallest roughness of its parts.
    pub(in crate::material) fn least_roughness(&self) -> f32 {
        let boundary = self.facets().alpha.min_element();
        match self.clearcoat.is_zero() {
            true => boundary,
            false => boundary.min(self.coat().alpha),
        }
    }
}
