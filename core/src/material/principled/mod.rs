//! Burley's principled BSDF: Mitsuba 3's `principled` ([`solid`]) and `principledthin` ([`thin`]).
//!
//! Sources: Burley 2012, "Physically Based Shading at Disney"; Burley 2015, "Extending the Disney BRDF to a BSDF with Integrated
//! Subsurface Scattering". Where they leave a choice, the values are those of Mitsuba 3.9.1. The model is an artist's one: its parts
//! are added without regard to each other, and at grazing angles they may return more light than arrives.

mod clearcoat;
mod solid;
mod thin;

pub use solid::SolidLobe;
pub use thin::ThinLobe;

use super::{MicrofacetKind, Microfacets};
use crate::math::{FRAC_1_PI, Vec2, safe_sqrt, sqr};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// The principled BSDF of a solid body, as validated data. Textures but `base_color` are grey and in [0, 1].
#[derive(Clone, Debug)]
pub struct Principled {
    /// Colour of all that is not a reflection by a dielectric, in [0, 1].
    pub base_color: Texture,
    /// Square root of the microfacet roughness.
    pub roughness: Texture,
    /// How much longer than broad highlights are: the axes are as 1 to 1 - 0.9 `anisotropic`.
    pub anisotropic: Texture,
    /// Share that is metal.
    pub metallic: Texture,
    /// Of what is no metal, the share that transmits instead of scattering diffusely.
    pub spec_trans: Texture,
    /// Share of the base colour in what a dielectric reflects.
    pub spec_tint: Texture,
    /// Weight of what a cloth reflects at grazing angles.
    pub sheen: Texture,
    /// Share of the base colour in that.
    pub sheen_tint: Texture,
    /// Share of the diffuse part that looks as if light came back from below the surface.
    pub flatness: Texture,
    /// Weight of a second, colourless coat.
    pub clearcoat: Texture,
    /// How smooth that is.
    pub clearcoat_gloss: Texture,
    /// Interior over exterior index, positive and not 1.
    pub eta: f32,
    /// Whether `spec_trans` is above 0 somewhere.
    pub transmits: bool,
}

/// The principled BSDF of a sheet without thickness, as validated data. Textures but `base_color` are grey and in [0, 1].
#[derive(Clone, Debug)]
pub struct PrincipledThin {
    /// Colour of all that is not a reflection, in [0, 1].
    pub base_color: Texture,
    /// Square root of the microfacet roughness.
    pub roughness: Texture,
    /// How much longer than broad highlights are: the axes are as 1 to 1 - 0.9 `anisotropic`.
    pub anisotropic: Texture,
    /// Share that reflects and transmits as glass instead of scattering diffusely.
    pub spec_trans: Texture,
    /// Share of the diffuse part that goes through.
    pub diff_trans: Texture,
    /// Share of the base colour in what the glass reflects.
    pub spec_tint: Texture,
    /// Weight of what a cloth reflects at grazing angles.
    pub sheen: Texture,
    /// Share of the base colour in that.
    pub sheen_tint: Texture,
    /// Share of the diffuse part that looks as if light came back from below the surface.
    pub flatness: Texture,
    /// Index of the sheet over that of its surroundings, positive; grey.
    pub eta: Texture,
}

/// A number in [0, 1] in steps of 1 / 65535. Lobes are copied at every hit, and have many of them.
#[derive(Clone, Copy, Debug)]
struct Share(u16);

impl Share {
    /// The share that a grey texture has at a point.
    fn of(texture: &Texture, at: &TexturePoint) -> Self {
        Self((texture.grey(at).clamp(0.0, 1.0) * f32::from(u16::MAX) + 0.5) as u16)
    }

    fn get(self) -> f32 {
        f32::from(self.0) / f32::from(u16::MAX)
    }

    fn is_zero(self) -> bool {
        self.0 == 0
    }
}

/// Mitsuba's least roughness.
const LEAST_ALPHA: f32 = 1e-3;

/// The microfacets of a roughness.
fn facets(roughness: f32, anisotropic: f32) -> Microfacets {
    let alpha = sqr(roughness);
    let aspect = (1.0 - 0.9 * anisotropic).sqrt();
    Microfacets {
        kind: MicrofacetKind::Ggx,
        alpha: Vec2::new(alpha / aspect, alpha * aspect).max(Vec2::splat(LEAST_ALPHA)),
    }
}

/// The weight of white in Schlick's approximation: `(1 - cos)^5`.
fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    sqr(sqr(m)) * m
}

/// The weight for a boundary whose far side has `eta` times the index: where that is the smaller one, the cosine is that of the
/// refracted direction.
fn boundary_weight(cos: f32, eta: f32) -> f32 {
    match eta > 1.0 {
        true => schlick_weight(cos),
        false => schlick_weight(safe_sqrt(1.0 - (1.0 - cos * cos) / (eta * eta))),
    }
}

/// Schlick's approximation of what is reflected, of which the share `normal` is at normal incidence.
fn schlick(normal: Spectrum, weight: f32) -> Spectrum {
    normal.map(|r| r + (1.0 - r) * weight)
}

/// What a boundary reflects at normal incidence.
fn normal_reflectance(eta: f32) -> f32 {
    sqr((eta - 1.0) / (eta + 1.0))
}

/// The colour without its brightness: of luminance 1, and white for black.
fn tint(colour: Spectrum) -> Spectrum {
    let luminance = colour.luminance();
    match luminance > 0.0 {
        true => colour / luminance,
        false => Spectrum::ONE,
    }
}

/// What both diffuse parts need: cosines of both directions with the normal, and of either with the half vector.
struct Cosines {
    wo: f32,
    wi: f32,
    half: f32,
}

/// f of the diffuse part over the base colour; the flat one is after Hanrahan and Krueger.
fn diffuse(roughness: f32, flatness: f32, cos: &Cosines) -> f32 {
    let (fo, fi) = (schlick_weight(cos.wo), schlick_weight(cos.wi));
    let retro = 2.0 * roughness * sqr(cos.half);
    let round = (1.0 - 0.5 * fi) * (1.0 - 0.5 * fo) + retro * (fo + fi + fo * fi * (retro - 1.0));
    let towards = |weight: f32| 1.0 + (0.5 * retro - 1.0) * weight;
    let flat = 1.25 * (towards(fo) * towards(fi) * (1.0 / (cos.wo + cos.wi) - 0.5) + 0.5);
    FRAC_1_PI * (round + flatness * (flat - round))
}

/// f of the sheen of weight one.
fn sheen(base: Spectrum, sheen_tint: f32, cos: &Cosines) -> Spectrum {
    let colour = tint(base).map(|c| 1.0 + sheen_tint * (c - 1.0));
    colour * schlick_weight(cos.half)
}
