//! Materials: how surfaces scatter light.
//!
//! Directions are in the local shading frame, of unit length, and point away from the surface. `wo` is known, `wi`
//! is sampled. Nothing here includes a cosine: callers multiply by `|cos|`.
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;
use crate::texture::Texture;

/// What is carried along the path: radiance from the camera's side or importance's flux from the light's side.
/// It matters for refraction (radiance is scaled by the squared ratio of indices; flux is not) and for shading normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransportMode {
    /// The path starts at the camera; `wo` points back along it.
    Radiance,
    /// The path starts at a light; `wo` points back along it.
    Flux,
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Local direction.
    pub wi: Vec3,
    /// f(wo, wi) [1/sr]; for a delta lobe the factor such that `f * |cos wi| / pdf` is the path weight.
    pub f: Spectrum,
    /// Solid-angle density [1/sr], of all lobes together; for a delta lobe the probability of choosing it.
    pub pdf: f32,
    /// Whether the lobe is a delta function of direction.
    pub delta: bool,
    /// Relative index of refraction along `wi` (1 unless the sample crossed a dielectric boundary); for Russian roulette.
    pub eta: f32,
}

/// A material, as validated data. Indices of refraction are interior over exterior where one number is kept.
#[derive(Clone, Debug)]
pub enum Material {
    /// Lambertian reflection on the outer side; black on the inner side (as Mitsuba's `diffuse`).
    Diffuse { reflectance: Texture },
    /// Smooth dielectric boundary; `eta` = interior / exterior index.
    Dielectric {
        eta: f32,
        specular_reflectance: Texture,
        specular_transmittance: Texture,
    },
    /// Rough dielectric boundary (Walter et al. 2007).
    RoughDielectric {
        eta: f32,
        distribution: Microfacets,
        specular_reflectance: Texture,
        specular_transmittance: Texture,
    },
    /// Smooth conductor with complex index `eta + i k` (relative to the exterior); outer side only.
    Conductor {
        eta: Spectrum,
        k: Spectrum,
        specular_reflectance: Texture,
    },
    /// Rough conductor; outer side only.
    RoughConductor {
        eta: Spectrum,
        k: Spectrum,
        distribution: Microfacets,
        specular_reflectance: Texture,
    },
    /// Not there: light goes straight through.
    Null,
    /// `front` seen from the outer side, `back` from the inner side; neither may transmit.
    TwoSided { front: Box<Material>, back: Box<Material> },
}

/// Distribution of microfacet normals.
#[derive(Clone, Debug)]
pub struct Microfacets {
    /// Which distribution.
    pub kind: MicrofacetKind,
    /// Roughness along the tangent (s) and bitangent (t); textured roughness is not supported.
    pub alpha: Vec2,
}

/// The distributions of Mitsuba's rough materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MicrofacetKind {
    Beckmann,
    Ggx,
}

impl Material {
    /// f(wo, wi) [1/sr] without the cosine, delta lobes left out. `uv`: texture coordinates.
    #[must_use]
    pub fn eval(&self, _uv: Vec2, _wo: Vec3, _wi: Vec3, _mode: TransportMode) -> Spectrum {
        unimplemented!()
    }
    /// Solid-angle density [1/sr] with which [`Self::sample`] returns `wi`, delta lobes left out.
    #[must_use]
    pub fn pdf(&self, _uv: Vec2, _wo: Vec3, _wi: Vec3) -> f32 {
        unimplemented!()
    }
    /// Samples `wi` given `wo`. `None` where the sample carries nothing.
    #[must_use]
    pub fn sample(&self, _uv: Vec2, _wo: Vec3, _lobe: f32, _u: Vec2, _mode: TransportMode) -> Option<BsdfSample> {
        unimplemented!()
    }
    /// Whether every lobe is a delta function: density estimation and next-event estimation do not apply.
    #[must_use]
    pub fn is_delta(&self) -> bool {
        unimplemented!()
    }
    /// Whether scattering is too concentrated for a density estimate: delta, or microfacet roughness below `roughness`.
    #[must_use]
    pub fn is_glossier_than(&self, _roughness: f32) -> bool {
        unimplemented!()
    }
}
