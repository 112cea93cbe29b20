//! The principled BSDF of a sheet without thickness, the same from both sides: glass that bends nothing, or a diffuse sheet that lets
//! a part of the light through.

use super::{
    Cosines, PrincipledThin, Share, boundary_weight, diffuse, facets, normal_reflectance, schlick, sheen, tint,
};
use crate::material::{BsdfSample, GRAZING, Lobe, Microfacets, conductor, fresnel};
use crate::math::{FRAC_1_PI, Vec2, Vec3, warp};
use crate::spectrum::Spectrum;
use crate::texture::TexturePoint;

/// A [`PrincipledThin`] at a point.
#[derive(Clone, Copy, Debug)]
pub struct ThinLobe {
    base: Spectrum,
    eta: f32,
    roughness: f32,
    anisotropic: Share,
    spec_trans: Share,
    diff_trans: Share,
    spec_tint: Share,
    sheen: Share,
    sheen_tint: Share,
    flatness: Share,
}

impl PrincipledThin {
    pub(in crate::material) fn resolve(&self, at: &TexturePoint) -> Lobe {
        Lobe::PrincipledThin(ThinLobe {
            base: self.base_color.eval(at),
            eta: self.eta.grey(at).clamp(1e-3, 1e3),
            roughness: self.roughness.grey(at),
            anisotropic: Share::of(&self.anisotropic, at),
            spec_trans: Share::of(&self.spec_trans, at),
            diff_trans: Share::of(&self.diff_trans, at),
            spec_tint: Share::of(&self.spec_tint, at),
            sheen: Share::of(&self.sheen, at),
            sheen_tint: Share::of(&self.sheen_tint, at),
            flatness: Share::of(&self.flatness, at),
        })
    }
}

/// Both directions as if light came from above and were reflected, and whether it is.
struct Folded {
    wo: Vec3,
    wi: Vec3,
    reflected: bool,
}

/// `None` where one of the directions lies in the surface.
fn fold(wo: Vec3, wi: Vec3) -> Option<Folded> {
    let raised = |w: Vec3| Vec3::new(w.x, w.y, w.z.abs());
    (wo.z.abs() > GRAZING && wi.z.abs() > GRAZING).then(|| Folded {
        wo: raised(wo),
        wi: raised(wi),
        reflected: wo.z * wi.z > 0.0,
    })
}

impl ThinLobe {
    /// The facets that reflect.
    fn facets(&self) -> Microfacets {
        facets(self.roughness, self.anisotropic.get())
    }

    /// The facets that transmit: light passes two boundaries (Burley 2015, figure 15).
    fn transmitting_facets(&self) -> Microfacets {
        facets((0.65 * self.eta - 0.35) * self.roughness, self.anisotropic.get())
    }

    /// f of the part that is glass.
    fn glass(&self, folded: &Folded, m: Vec3, cos: f32) -> Spectrum {
        let clear = fresnel::dielectric(cos, self.eta).reflectance;
        let (facets, factor) = if folded.reflected {
            let spec_tint = self.spec_tint.get();
            let tinted = tint(self.base) * normal_reflectance(self.eta);
            let tinted = schlick(tinted, boundary_weight(cos, self.eta));
            (
                self.facets(),
                Spectrum::splat((1.0 - spec_tint) * clear) + tinted * spec_tint,
            )
        } else {
            (self.transmitting_facets(), self.base * (1.0 - clear))
        };
        let mirrored = conductor::pdf_of_facet(&facets, folded.wo, m) * facets.masking_over_cos(folded.wi);
        factor * (mirrored * self.spec_trans.get())
    }

    /// f of the diffuse part.
    fn sheet(&self, folded: &Folded, cos: f32) -> Spectrum {
        let (share, through) = (1.0 - self.spec_trans.get(), self.diff_trans.get());
        if !folded.reflected {
            return self.base * (share * through * FRAC_1_PI);
        }
        let cos = Cosines {
            wo: folded.wo.z,
            wi: folded.wi.z,
            half: cos,
        };
        let mut f = self.base * diffuse(self.roughness, self.flatness.get(), &cos);
        if !self.sheen.is_zero() {
            f += sheen(self.base, self.sheen_tint.get(), &cos) * self.sheen.get();
        }
        f * (share * (1.0 - through))
    }

    /// As [`crate::material::Bsdf::f`]; the same in both modes.
    ///
    /// Mitsuba leaves out what goes through where the facet that would mirror it faces away from the direction on the far side. Of
    /// two directions this depends on which is which, so that light and camera would see two different sheets; it is not done here.
    pub(in crate::material) fn f(&self, wo: Vec3, wi: Vec3) -> Spectrum {
        let Some(folded) = fold(wo, wi) else {
            return Spectrum::ZERO;
        };
        let m = (folded.wo + folded.wi).normalize();
        let cos = folded.wo.dot(m).clamp(0.0, 1.0);
        let sheet = self.sheet(&folded, cos);
        match self.spec_trans.is_zero() {
            true => sheet,
            false => sheet + self.glass(&folded, m, cos),
        }
    }

    /// As [`crate::material::Bsdf::pdf`].
    pub(in crate::material) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let Some(folded) = fold(wo, wi) else {
            return 0.0;
        };
        let glass = self.spec_trans.get();
        let (facets, through) = match folded.reflected {
            true => (self.facets(), 1.0 - self.diff_trans.get()),
            false => (self.transmitting_facets(), self.diff_trans.get()),
        };
        let mut sum = (1.0 - glass) * through * warp::cosine_hemisphere_pdf(folded.wi.z);
        if glass > 0.0 {
            let m = (folded.wo + folded.wi).normalize();
            sum += 0.5 * glass * conductor::pdf_of_facet(&facets, folded.wo, m);
        }
        sum
    }

    /// As [`crate::material::Bsdf::sample`], but for samples that carry nothing.
    pub(in crate::material) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<BsdfSample> {
        if wo.z.abs() <= GRAZING {
            return None;
        }
        let above = Vec3::new(wo.x, wo.y, wo.z.abs());
        let glass = self.spec_trans.get();
        let (wi, reflected) = if lobe < glass {
            let reflected = lobe < 0.5 * glass;
            let facets = match reflected {
                true => self.facets(),
                false => self.transmitting_facets(),
            };
            let m = facets.sample_visible(above, u);
            (fresnel::reflect(above, m, above.dot(m)), reflected)
        } else {
            let reflected = lobe - glass < (1.0 - glass) * (1.0 - self.diff_trans.get());
            (warp::square_to_cosine_hemisphere(u), reflected)
        };
        if wi.z <= GRAZING {
            return None;
        }
        let side = if reflected { wo.z } else { -wo.z };
        let wi = Vec3::new(wi.x, wi.y, wi.z.copysign(side));
        let pdf = self.pdf(wo, wi);
        (pdf > 0.0).then(|| BsdfSample::scattered(wi, self.f(wo, wi), pdf))
    }

    /// The smallest roughness of its parts.
    pub(in crate::material) fn least_roughness(&self) -> f32 {
        match self.spec_trans.is_zero() {
            true => f32::INFINITY,
            false => {
                let [reflecting, transmitting] = [self.facets(), self.transmitting_facets()];
                reflecting.alpha.min(transmitting.alpha).min_element()
            }
        }
    }
}
