//! Materials: how surfaces scatter light.
//!
//! A [`Material`] is what a scene says: textures, indices, roughness, perhaps two sides. [`Material::resolve`] makes a
//! [`Bsdf`] of it at a hit: a small value of one or a few [`Lobe`]s, every texture looked up. All of evaluating and sampling is
//! the `Bsdf`'s. Being a delta function, or glossy, is a property of a lobe.
//!
//! Directions are in the local shading frame, of unit length, and point away from the surface. `wo` is known, `wi`
//! is sampled: on a camera path (radiance) `wi` leads towards the light, on a light path (flux) `wo` does. Nothing here
//! includes a cosine: callers multiply by `|cos|`. Everything returned is finite and not negative, whatever the unit
//! directions.
//!
//! Reflection is symmetric in `wo` and `wi`. Refraction is not: with `eta` the index on the side of `wi` over that on the
//! side of `wo`, `f(wo, wi, Radiance) = f(wi, wo, Flux) = f(wo, wi, Flux) / eta^2`.

mod bsdf;
mod coat;
mod conductor;
mod conductors;
mod dielectric;
mod diffuse;
mod fresnel;
pub mod ior;
mod microfacet;
#[cfg(test)]
mod tests;

pub use bsdf::{Bsdf, BsdfSample, Lobe, Tints};
pub use coat::Coat;

use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// What is estimated along the path: radiance on paths from the camera, flux on paths from a light.
/// It matters for refraction (radiance is scaled by the squared ratio of indices; flux is not) and for shading normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransportMode {
    /// The path starts at the camera; `wo` points back along it.
    Radiance,
    /// The path starts at a light; `wo` points back along it.
    Flux,
}

/// A material, as validated data. Indices of refraction are interior over exterior where one number is kept.
#[derive(Clone, Debug)]
pub enum Material {
    /// Lambertian reflection on the outer side; black on the inner side (as Mitsuba's `diffuse`).
    Diffuse {
        /// Albedo, in [0, 1].
        reflectance: Texture,
    },
    /// Smooth dielectric boundary; `eta` = interior / exterior index.
    Dielectric {
        /// Interior over exterior index, positive.
        eta: f32,
        /// Factor on reflected light.
        specular_reflectance: Texture,
        /// Factor on transmitted light.
        specular_transmittance: Texture,
    },
    /// Rough dielectric boundary (Walter et al. 2007).
    RoughDielectric {
        /// Interior over exterior index, positive and not 1.
        eta: f32,
        /// Roughness.
        distribution: Microfacets,
        /// Factor on reflected light.
        specular_reflectance: Texture,
        /// Factor on transmitted light.
        specular_transmittance: Texture,
    },
    /// Smooth conductor with complex index `eta + i k` (relative to the exterior); outer side only.
    Conductor {
        /// Real part of the index.
        eta: Spectrum,
        /// Imaginary part of the index.
        k: Spectrum,
        /// Factor on reflected light.
        specular_reflectance: Texture,
    },
    /// Rough conductor; outer side only.
    RoughConductor {
        /// Real part of the index.
        eta: Spectrum,
        /// Imaginary part of the index.
        k: Spectrum,
        /// Roughness.
        distribution: Microfacets,
        /// Factor on reflected light.
        specular_reflectance: Texture,
    },
    /// A diffuse base under a smooth dielectric coat; outer side only.
    Plastic {
        /// The coat.
        coat: Coat,
        /// Albedo of the base, in [0, 1].
        diffuse_reflectance: Texture,
        /// Factor on what the coat reflects.
        specular_reflectance: Texture,
    },
    /// Not there: light goes straight through.
    Null,
    /// A material for each side; neither may transmit.
    TwoSided {
        /// Seen from the outer side.
        front: Box<Material>,
        /// Seen from the inner side, which is its outer side.
        back: Box<Material>,
    },
}

/// Distribution of microfacet normals.
#[derive(Clone, Copy, Debug)]
pub struct Microfacets {
    /// Which distribution.
    pub kind: MicrofacetKind,
    /// Roughness along the tangent (s) and bitangent (t), positive and finite; values below 1e-4 count as 1e-4.
    pub alpha: Vec2,
}

/// The distributions of Mitsuba's rough materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MicrofacetKind {
    /// Normals of a surface with Gaussian slopes; `alpha` is sqrt(2) times the standard deviation of the slope.
    Beckmann,
    /// Walter et al. 2007 (Trowbridge and Reitz 1975): longer tails.
    Ggx,
}

/// Directions whose cosine with the normal is smaller lie in the surface: nothing is scattered to or from them. It is
/// the rounding error of a unit vector, and keeps every quotient by a cosine finite.
const GRAZING: f32 = 1e-7;

/// The direction as seen from the other side of the surface.
fn turned(w: Vec3) -> Vec3 {
    Vec3::new(w.x, w.y, -w.z)
}

impl Material {
    /// What the material does at a point, seen from the local direction `wo`: its textures are
    /// looked up here and nowhere else. Of `wo` only the side counts.
    #[must_use]
    pub fn resolve(&self, at: &TexturePoint, wo: Vec3) -> Bsdf {
        Bsdf::of(match self {
            Self::Diffuse { reflectance } => Lobe::Diffuse {
                reflectance: reflectance.eval(at),
            },
            Self::Dielectric {
                eta,
                specular_reflectance,
                specular_transmittance,
            } => Lobe::Dielectric {
                eta: *eta,
                tints: Tints::new(specular_reflectance, specular_transmittance, at),
            },
            Self::RoughDielectric {
                eta,
                distribution,
                specular_reflectance,
                specular_transmittance,
            } => Lobe::RoughDielectric {
                eta: *eta,
                facets: *distribution,
                tints: Tints::new(specular_reflectance, specular_transmittance, at),
            },
            Self::Conductor {
                eta,
                k,
                specular_reflectance,
            } => Lobe::Conductor {
                eta: *eta,
                k: *k,
                reflectance: specular_reflectance.eval(at),
            },
            Self::RoughConductor {
                eta,
                k,
                distribution,
                specular_reflectance,
            } => Lobe::RoughConductor {
                eta: *eta,
                k: *k,
                facets: *distribution,
                reflectance: specular_reflectance.eval(at),
            },
            Self::Plastic {
                coat,
                diffuse_reflectance,
                specular_reflectance,
            } => return Bsdf::coated(coat, specular_reflectance.eval(at), diffuse_reflectance.eval(at)),
            Self::Null => Lobe::Null,
            Self::TwoSided { front, .. } if wo.z > 0.0 => return front.resolve(at, wo),
            Self::TwoSided { back, .. } => return back.resolve(at, turned(wo)).turned(),
        })
    }
}
