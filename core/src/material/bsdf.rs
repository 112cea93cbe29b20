//! A material at a hit: its lobes by value, their textures looked up.

use super::blend::Blend;
use super::coated::Coated;
use super::perturbed::Perturbed;
use super::{
    Coat, GRAZING, GlossyLobe, Microfacets, RoughDiffuseLobe, SolidLobe, ThinLobe, TransmitterLobe, TransportMode,
    coat, conductor, dielectric, diffuse,
};
use crate::math::{ONE_MINUS_EPSILON, Vec2, Vec3};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// How a surface scatters at one point, seen from one of its sides. Made by [`super::Material::resolve_on`].
///
/// Most surfaces are one lobe, or a lobe over another. They are kept in place, and nothing is allocated for them. BSDFs that are made of
/// others form a tree, each node of which lies on the heap: the size of vertices, which the integrators keep by the million, is that
/// of the common surfaces, and the rest pay for an allocation at each hit.
#[derive(Clone, Debug)]
pub struct Bsdf {
    parts: Parts,
    /// 1, or -1 where the lobes are to see directions turned to the other side.
    side: f32,
}

/// Indices that differ by less are the same.
pub(super) const LEAST_STEP: f32 = 1e-3;

#[derive(Clone, Debug)]
enum Parts {
    One(Lobe),
    Two(Lobe, Second),
    Blend(Box<Blend>),
    Perturbed(Box<Perturbed>),
    Coated(Box<Coated>),
}

/// A lobe beside the first one.
#[derive(Clone, Copy, Debug)]
struct Second {
    lobe: Lobe,
    choice: Choice,
}

/// How often the first of two lobes is sampled, when it is what a smooth dielectric boundary reflects and the second what the
/// boundary lets through: `F(w) reflected` against `(1 - F(w)) transmitted`.
#[derive(Clone, Copy, Debug)]
struct Choice {
    eta: f32,
    /// Albedo of the first lobe where all is reflected.
    reflected: f32,
    /// Albedo of the second where nothing is.
    transmitted: f32,
}

impl Choice {
    /// Probability of the first lobe seen from `w`.
    fn first(&self, w: Vec3) -> f32 {
        let reflectance = coat::reflectance(self.eta, w);
        let first = reflectance * self.reflected;
        let total = first + (1.0 - reflectance) * self.transmitted;
        if total > 0.0 { first / total } else { 1.0 }
    }
}

/// A part of a BSDF: one way to scatter, with constants in place of textures.
#[derive(Clone, Copy, Debug)]
pub enum Lobe {
    /// Lambertian reflection on the outer side.
    Diffuse {
        /// Albedo, in \[0, 1\].
        reflectance: Spectrum,
    },
    /// Reflection and refraction at a smooth boundary: a delta function.
    Dielectric {
        /// Interior over exterior index.
        eta: f32,
        /// Factors on the two branches.
        tints: Tints,
    },
    /// Reflection by a thin pane, and what it lets straight through: delta functions.
    ThinDielectric {
        /// Index of the pane over that around it.
        eta: f32,
        /// Factors on the two branches.
        tints: Tints,
    },
    /// Reflection and refraction at a rough boundary.
    RoughDielectric {
        /// Interior over exterior index.
        eta: f32,
        /// Roughness.
        facets: Microfacets,
        /// Factors on the two branches.
        tints: Tints,
    },
    /// The mirror image in a metal, on the outer side: a delta function.
    Conductor {
        /// Real part of the index.
        eta: Spectrum,
        /// Imaginary part of the index.
        k: Spectrum,
        /// Factor on reflected light.
        reflectance: Spectrum,
    },
    /// Reflection by a rough metal, on the outer side.
    RoughConductor {
        /// Real part of the index.
        eta: Spectrum,
        /// Imaginary part of the index.
        k: Spectrum,
        /// Roughness.
        facets: Microfacets,
        /// Factor on reflected light.
        reflectance: Spectrum,
    },
    /// The mirror image in a smooth coat, on the outer side: a delta function.
    CoatReflection {
        /// Index of the coat over that of the exterior.
        eta: f32,
        /// Factor on reflected light.
        reflectance: Spectrum,
    },
    /// Reflection by a rough coat, on the outer side.
    RoughCoatReflection {
        /// Index of the coat over that of the exterior.
        eta: f32,
        /// Roughness.
        facets: Microfacets,
        /// Factor on reflected light.
        reflectance: Spectrum,
    },
    /// Reflection by the diffuse base under a smooth coat, on the outer side.
    CoatedDiffuse {
        /// Index of the coat over that of the exterior.
        eta: f32,
        /// f over what the coat lets in and out, `(1 - F(wo)) (1 - F(wi))` \[1/sr\].
        base: Spectrum,
    },
    /// Straight through: a delta function.
    Null,
    /// Diffuse reflection by a rough surface, on the outer side.
    RoughDiffuse(RoughDiffuseLobe),
    /// A highlight beside diffuse reflection, on the outer side.
    Glossy(GlossyLobe),
    /// Diffuse reflection and transmission by a thin sheet.
    Transmitter(TransmitterLobe),
    /// Burley's model of a solid body.
    Principled(SolidLobe),
    /// Burley's model of a sheet.
    PrincipledThin(ThinLobe),
}

/// Factors that a material puts on the two branches of a dielectric boundary.
#[derive(Clone, Copy, Debug)]
pub struct Tints {
    /// On reflected light.
    pub reflectance: Spectrum,
    /// On transmitted light.
    pub transmittance: Spectrum,
}

impl Tints {
    pub(super) fn new(reflectance: &Texture, transmittance: &Texture, at: &TexturePoint) -> Self {
        Self {
            reflectance: reflectance.eval(at),
            transmittance: transmittance.eval(at),
        }
    }
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Local direction.
    pub wi: Vec3,
    /// f(wo, wi) \[1/sr\], of all lobes together that are no delta functions; for a delta lobe the factor such that
    /// `f * |cos wi| / pdf` is the path weight.
    pub f: Spectrum,
    /// Solid-angle density \[1/sr\], of all lobes together; for a delta lobe the probability of choosing it.
    pub pdf: f32,
    /// Whether the lobe is a delta function of direction.
    pub delta: bool,
    /// Relative index of refraction along `wi` (1 unless the sample crossed a dielectric boundary); for Russian roulette.
    pub eta: f32,
    /// Factor of [`Bsdf::pdf_rev`] for delta lobes: 1 for a lobe by itself. Others come from a boundary that is tilted against the
    /// surface, and from choices between lobes that are made otherwise on the way back.
    pub reversal: f32,
}

impl BsdfSample {
    /// Of a lobe that is no delta function, by which the light stays on its side of any boundary or passes a sheet, and of a medium.
    pub(crate) fn scattered(wi: Vec3, f: Spectrum, pdf: f32) -> Self {
        Self {
            wi,
            f,
            pdf,
            delta: false,
            reversal: 1.0,
            eta: 1.0,
        }
    }

    fn tinted(self, tint: Spectrum) -> Self {
        Self {
            f: self.f * tint,
            ..self
        }
    }
}

impl Bsdf {
    pub(super) fn of(lobe: Lobe) -> Self {
        Self::made_of(Parts::One(lobe))
    }

    fn made_of(parts: Parts) -> Self {
        Self { parts, side: 1.0 }
    }

    /// A coat that reflects the share `reflectance` of what Fresnel's equations say, and a base of the albedo `diffuse` under it.
    pub(super) fn coated(coat: &Coat, reflectance: Spectrum, diffuse: Spectrum) -> Self {
        let eta = coat.eta();
        let second = Second {
            lobe: Lobe::CoatedDiffuse {
                eta,
                base: coat.base(diffuse),
            },
            choice: Choice {
                eta,
                reflected: reflectance.mean(),
                transmitted: diffuse.mean(),
            },
        };
        Self::made_of(Parts::Two(Lobe::CoatReflection { eta, reflectance }, second))
    }

    /// The same on the other side of the surface.
    pub(super) fn turned(self) -> Self {
        Self {
            side: -self.side,
            ..self
        }
    }

    /// The BSDF of a surface that lets light in and stands in what has `index` times the index of refraction of empty space, where the one before stood.
    pub(crate) fn immerse(&mut self, index: f32) {
        match &mut self.parts {
            Parts::One(lobe) => lobe.immerse(index),
            Parts::Blend(blend) => blend.immerse(index),
            Parts::Perturbed(perturbed) => perturbed.immerse(index),
            // Coats lie on what lets no light in.
            Parts::Two(..) | Parts::Coated(_) => {}
        }
    }

    /// The direction as the lobes see it, and back.
    fn turn(&self, w: Vec3) -> Vec3 {
        Vec3::new(w.x, w.y, self.side * w.z)
    }

    /// f(wo, wi) \[1/sr\] without the cosine, delta lobes left out.
    #[must_use]
    pub fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        let (wo, wi) = (self.turn(wo), self.turn(wi));
        match &self.parts {
            Parts::One(lobe) => lobe.f(wo, wi, mode),
            Parts::Two(first, second) => first.f(wo, wi, mode) + second.lobe.f(wo, wi, mode),
            Parts::Blend(blend) => blend.f(wo, wi, mode),
            Parts::Perturbed(perturbed) => perturbed.f(wo, wi, mode),
            Parts::Coated(coated) => coated.f(wo, wi, mode),
        }
    }

    /// Solid-angle density \[1/sr\] with which [`Self::sample`] returns `wi`, delta lobes left out; the same in both modes.
    #[must_use]
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        let (wo, wi) = (self.turn(wo), self.turn(wi));
        match &self.parts {
            Parts::One(lobe) => lobe.pdf(wo, wi),
            Parts::Two(first, second) => {
                let share = second.choice.first(wo);
                share * first.pdf(wo, wi) + (1.0 - share) * second.lobe.pdf(wo, wi)
            }
            Parts::Blend(blend) => blend.pdf(wo, wi),
            Parts::Perturbed(perturbed) => perturbed.pdf(wo, wi),
            Parts::Coated(coated) => coated.pdf(wo, wi),
        }
    }

    /// Samples `wi` given `wo` from the random numbers `lobe` and `u`. `None` where the sample carries nothing.
    #[must_use]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        self.draw(wo, lobe, u, mode).filter(|sample| !sample.f.is_black())
    }

    /// As [`Self::sample`], but for samples that carry nothing: what has another BSDF beside this one may carry something
    /// there, and the density of both together counts them.
    pub(super) fn draw(&self, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let wo = self.turn(wo);
        let sample = match &self.parts {
            Parts::One(single) => single.sample(wo, lobe, u, mode)?,
            Parts::Two(first, second) => sample_of_two(first, second, wo, lobe, u, mode)?,
            Parts::Blend(blend) => blend.draw(wo, lobe, u, mode)?,
            Parts::Perturbed(perturbed) => perturbed.draw(wo, lobe, u, mode)?,
            Parts::Coated(coated) => coated.draw(wo, lobe, u, mode)?,
        };
        Some(BsdfSample {
            wi: self.turn(sample.wi),
            ..sample
        })
    }

    /// The density with which the path of `sample`, walked the other way, would have been sampled: of `wo` given `sample.wi`
    /// \[1/sr\]; for a delta lobe its probability in units of `sample.pdf`.
    ///
    /// The delta function of the sample is one of `wi`, that of the reverse one of `wo`: the quotient of the solid angles that a
    /// narrow pencil fills on both sides, `|d wi / d wo| = |cos wo| / (eta^2 |cos wi|)` (Veach 1997, section 5.2), stands between
    /// them. So quotients of both are those of a rough lobe in the limit.
    #[must_use]
    pub fn pdf_rev(&self, wo: Vec3, sample: &BsdfSample) -> f32 {
        if !sample.delta {
            return self.pdf(sample.wi, wo);
        }
        // A boundary reflects the same share from both sides, and a coat from both directions that it mirrors into each other: the
        // probability is the same, but for what `reversal` says.
        sample.pdf * sample.reversal * (wo.z / sample.wi.z).abs() / (sample.eta * sample.eta)
    }

    /// Visits the lobes, of which any number may be delta functions.
    pub(super) fn each_lobe(&self, visit: &mut impl FnMut(&Lobe)) {
        match &self.parts {
            Parts::One(lobe) => visit(lobe),
            Parts::Two(first, second) => {
                visit(first);
                visit(&second.lobe);
            }
            Parts::Blend(blend) => blend.each_lobe(visit),
            Parts::Perturbed(perturbed) => perturbed.each_lobe(visit),
            Parts::Coated(coated) => coated.each_lobe(visit),
        }
    }

    /// Whether some lobe is a delta function: a path can go on along it that no other technique finds.
    #[must_use]
    pub fn has_delta(&self) -> bool {
        let mut found = false;
        self.each_lobe(&mut |lobe| found |= lobe.is_delta());
        found
    }

    /// Whether some lobe is no delta function: next-event estimation and density estimation apply to it.
    #[must_use]
    pub fn has_smooth(&self) -> bool {
        let mut found = false;
        self.each_lobe(&mut |lobe| found |= !lobe.is_delta());
        found
    }

    /// Whether scattering is too concentrated for a density estimate: of the lobes that are no delta functions one has a microfacet
    /// roughness below `roughness` along either axis, or there are none.
    #[must_use]
    pub fn is_glossier_than(&self, roughness: f32) -> bool {
        self.least_roughness().is_none_or(|least| least < roughness)
    }

    /// The smallest microfacet roughness of the lobes that are no delta functions: infinite for diffuse scattering, `None` where
    /// there are none.
    #[must_use]
    pub fn least_roughness(&self) -> Option<f32> {
        let mut least: Option<f32> = None;
        self.each_lobe(&mut |lobe| {
            if let Some(roughness) = lobe.least_roughness() {
                least = Some(least.map_or(roughness, |least| least.min(roughness)));
            }
        });
        least
    }
}

impl From<Blend> for Bsdf {
    fn from(blend: Blend) -> Self {
        Self::made_of(Parts::Blend(Box::new(blend)))
    }
}

impl From<Perturbed> for Bsdf {
    fn from(perturbed: Perturbed) -> Self {
        Self::made_of(Parts::Perturbed(Box::new(perturbed)))
    }
}

impl From<Coated> for Bsdf {
    fn from(coated: Coated) -> Self {
        Self::made_of(Parts::Coated(Box::new(coated)))
    }
}

fn sample_of_two(first: &Lobe, second: &Second, wo: Vec3, u: f32, v: Vec2, mode: TransportMode) -> Option<BsdfSample> {
    let share = second.choice.first(wo);
    let (chosen, other, probability, u) = if u < share {
        (first, &second.lobe, share, u / share)
    } else {
        (&second.lobe, first, 1.0 - share, (u - share) / (1.0 - share))
    };
    let mut sample = chosen.sample(wo, u.min(ONE_MINUS_EPSILON), v, mode)?;
    sample.pdf *= probability;
    if !sample.delta {
        sample.f += other.f(wo, sample.wi, mode);
        sample.pdf += (1.0 - probability) * other.pdf(wo, sample.wi);
    }
    Some(sample)
}

impl Lobe {
    /// As [`Bsdf::immerse`].
    fn immerse(&mut self, index: f32) {
        match self {
            Self::Dielectric { eta, .. } => *eta /= index,
            Self::RoughDielectric { eta, tints, .. } => {
                *eta /= index;
                // Without a step of the index a rough boundary bends nothing.
                if (*eta - 1.0).abs() < LEAST_STEP {
                    *self = Self::Dielectric {
                        eta: 1.0,
                        tints: *tints,
                    };
                }
            }
            Self::Principled(body) => body.immerse(index),
            _ => {}
        }
    }

    /// As [`Bsdf::f`].
    pub(super) fn f(&self, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        match self {
            Self::Diffuse { reflectance } => diffuse::eval(wo, wi) * *reflectance,
            Self::RoughDielectric { eta, facets, tints } => dielectric::eval(*eta, facets, *tints, wo, wi, mode),
            Self::RoughConductor {
                eta,
                k,
                facets,
                reflectance,
            } => conductor::eval(*eta, *k, facets, wo, wi) * *reflectance,
            Self::RoughCoatReflection {
                eta,
                facets,
                reflectance,
            } => *reflectance * coat::eval_rough(*eta, facets, wo, wi),
            Self::CoatedDiffuse { eta, base } => *base * coat::eval_base(*eta, wo, wi),
            Self::RoughDiffuse(lobe) => lobe.f(wo, wi),
            Self::Glossy(lobe) => lobe.f(wo, wi),
            Self::Transmitter(lobe) => lobe.f(wo, wi),
            Self::Principled(lobe) => lobe.f(wo, wi, mode),
            Self::PrincipledThin(lobe) => lobe.f(wo, wi),
            Self::Dielectric { .. }
            | Self::ThinDielectric { .. }
            | Self::Conductor { .. }
            | Self::CoatReflection { .. }
            | Self::Null => Spectrum::ZERO,
        }
    }

    /// As [`Bsdf::pdf`].
    pub(super) fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        match self {
            Self::Diffuse { .. } | Self::CoatedDiffuse { .. } | Self::RoughDiffuse(_) => diffuse::pdf(wo, wi),
            Self::RoughDielectric { eta, facets, .. } => dielectric::pdf(*eta, facets, wo, wi),
            Self::RoughConductor { facets, .. } | Self::RoughCoatReflection { facets, .. } => {
                conductor::pdf(facets, wo, wi)
            }
            Self::Glossy(lobe) => lobe.pdf(wo, wi),
            Self::Transmitter(lobe) => lobe.pdf(wo, wi),
            Self::Principled(lobe) => lobe.pdf(wo, wi),
            Self::PrincipledThin(lobe) => lobe.pdf(wo, wi),
            Self::Dielectric { .. }
            | Self::ThinDielectric { .. }
            | Self::Conductor { .. }
            | Self::CoatReflection { .. }
            | Self::Null => 0.0,
        }
    }

    /// As [`Bsdf::sample`], but for samples that carry nothing.
    pub(super) fn sample(&self, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        match self {
            Self::Diffuse { reflectance } => Some(diffuse::sample(wo, u)?.tinted(*reflectance)),
            Self::Dielectric { eta, tints } => dielectric::sample_smooth(*eta, *tints, wo, lobe, mode),
            Self::ThinDielectric { eta, tints } => dielectric::sample_thin(*eta, *tints, wo, lobe),
            Self::RoughDielectric { eta, facets, tints } => {
                dielectric::sample(*eta, facets, *tints, wo, (lobe, u), mode)
            }
            Self::Conductor { eta, k, reflectance } => {
                Some(conductor::sample_smooth(*eta, *k, wo)?.tinted(*reflectance))
            }
            Self::RoughConductor {
                eta,
                k,
                facets,
                reflectance,
            } => Some(conductor::sample(*eta, *k, facets, wo, u)?.tinted(*reflectance)),
            Self::CoatReflection { eta, reflectance } => Some(coat::sample_reflection(*eta, wo)?.tinted(*reflectance)),
            Self::RoughCoatReflection {
                eta,
                facets,
                reflectance,
            } => Some(coat::sample_rough(*eta, facets, wo, u)?.tinted(*reflectance)),
            Self::CoatedDiffuse { eta, base } => Some(coat::sample_base(*eta, wo, u)?.tinted(*base)),
            Self::Null => pass_through(wo),
            Self::RoughDiffuse(surface) => surface.sample(wo, u),
            Self::Glossy(surface) => surface.sample(wo, lobe, u),
            Self::Transmitter(sheet) => sheet.sample(wo, lobe, u),
            Self::Principled(body) => body.sample(wo, lobe, u, mode),
            Self::PrincipledThin(sheet) => sheet.sample(wo, lobe, u),
        }
    }

    /// Whether the lobe is a delta function of direction.
    #[must_use]
    pub fn is_delta(&self) -> bool {
        self.least_roughness().is_none()
    }

    /// The smaller microfacet roughness: infinite for diffuse scattering, `None` for delta functions.
    fn least_roughness(&self) -> Option<f32> {
        match self {
            Self::Diffuse { .. } | Self::CoatedDiffuse { .. } | Self::RoughDiffuse(_) | Self::Transmitter(_) => {
                Some(f32::INFINITY)
            }
            Self::RoughDielectric { facets, .. }
            | Self::RoughConductor { facets, .. }
            | Self::RoughCoatReflection { facets, .. } => Some(facets.alpha.min_element()),
            Self::Glossy(lobe) => Some(lobe.least_roughness()),
            Self::Principled(lobe) => Some(lobe.least_roughness()),
            Self::PrincipledThin(lobe) => Some(lobe.least_roughness()),
            Self::Dielectric { .. }
            | Self::ThinDielectric { .. }
            | Self::Conductor { .. }
            | Self::CoatReflection { .. }
            | Self::Null => None,
        }
    }
}

/// Straight through, with weight one.
fn pass_through(wo: Vec3) -> Option<BsdfSample> {
    let cos = wo.z.abs();
    (cos > GRAZING).then(|| BsdfSample {
        wi: -wo,
        f: Spectrum::splat(1.0 / cos),
        pdf: 1.0,
        delta: true,
        reversal: 1.0,
        eta: 1.0,
    })
}
