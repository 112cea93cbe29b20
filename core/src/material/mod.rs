//! Materials: how surfaces scatter light.
//!
//! A [`Material`] is what a scene says: textures, indices, roughness, perhaps two sides or other materials within.
//! [`Material::resolve_on`] makes a [`Bsdf`] of it at a hit: one or more [`Lobe`]s, every texture looked up. All of evaluating and
//! sampling is the `Bsdf`'s. Being a delta function, or glossy, is a property of a lobe.
//!
//! Directions are in the local shading frame, of unit length, and point away from the surface. `wo` is known, `wi`
//! is sampled: on a camera path (radiance) `wi` leads towards the light, on a light path (flux) `wo` does. Nothing here
//! includes a cosine: callers multiply by `|cos|`. Everything returned is finite and not negative, whatever the unit
//! directions.
//!
//! For every material `f(wo, wi, Radiance) = f(wi, wo, Flux)`. Reflection is symmetric in `wo` and `wi` besides. Refraction is
//! not: with `eta` the index on the side of `wi` over that on the side of `wo`, `f(wo, wi, Radiance) = f(wo, wi, Flux) / eta^2`.
//! Nor is what has a tilted normal.

mod blend;
mod bsdf;
mod coat;
mod coated;
mod conductor;
mod conductors;
mod dielectric;
mod diffuse;
mod fresnel;
mod glossy;
pub mod ior;
mod microfacet;
mod perturbed;
mod phong;
mod principled;
mod resolve;
mod rough_coat;
mod rough_diffuse;
mod roughness;
#[cfg(test)]
mod tests;
mod transmitter;
mod ward;

use bsdf::LEAST_STEP;
pub use bsdf::{Bsdf, BsdfSample, Lobe, Tints};
pub use coat::Coat;
pub use glossy::{Glossy, GlossyLobe, Highlight, WardModel};
pub use perturbed::Tilt;
pub use principled::{Principled, PrincipledThin, SolidLobe, ThinLobe};
pub use resolve::Tangents;
pub use rough_coat::TransmittanceTable;
pub use rough_diffuse::RoughDiffuseLobe;
pub use roughness::Roughness;
pub use transmitter::TransmitterLobe;

use crate::math::{Vec2, Vec3};
use crate::texture::Texture;

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
        distribution: Roughness,
        /// Factor on reflected light.
        specular_reflectance: Texture,
        /// Factor on transmitted light.
        specular_transmittance: Texture,
    },
    /// Thin pane of a dielectric: reflects, and lets the rest straight through.
    ThinDielectric {
        /// Index of the pane over that around it, positive.
        eta: f32,
        /// Factor on reflected light.
        specular_reflectance: Texture,
        /// Factor on transmitted light.
        specular_transmittance: Texture,
    },
    /// Smooth conductor with complex index `eta + i k` (relative to the exterior); outer side only.
    Conductor {
        /// Real part of the index.
        eta: Texture,
        /// Imaginary part of the index.
        k: Texture,
        /// Factor on reflected light.
        specular_reflectance: Texture,
    },
    /// Rough conductor; outer side only.
    RoughConductor {
        /// Real part of the index.
        eta: Texture,
        /// Imaginary part of the index.
        k: Texture,
        /// Roughness.
        distribution: Roughness,
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
    /// A diffuse base under a rough dielectric coat; outer side only.
    RoughPlastic {
        /// The coat.
        coat: Box<RoughCoat>,
        /// Albedo of the base, in [0, 1].
        diffuse_reflectance: Texture,
        /// Factor on what the coat reflects.
        specular_reflectance: Texture,
    },
    /// A material under a dielectric coat; outer side only.
    Coating(Box<Coating>),
    /// A material with holes.
    Mask {
        /// Share of the material; the rest lets light straight through. Taken as a number within [0, 1].
        opacity: Texture,
        /// The material.
        nested: Box<Material>,
    },
    /// Two materials, one growing into the other.
    Blend {
        /// Share of the second, taken as a number within [0, 1].
        weight: Texture,
        /// The first and the second.
        nested: Box<[Material; 2]>,
    },
    /// A weighted sum of materials.
    Mixture(Vec<(f32, Material)>),
    /// A material whose normals a texture gives.
    NormalMap {
        /// Normals in the surface's frame, as colours: 0 to 1 stands for -1 to 1.
        normals: Texture,
        /// How they keep to the surface.
        tilt: Tilt,
        /// The material.
        nested: Box<Material>,
    },
    /// A material whose normals are those of the surface moved along its own normal by a texture.
    BumpMap {
        /// Height [scene units], as a number.
        heights: Texture,
        /// Factor on the height.
        scale: f32,
        /// How the normals keep to the surface.
        tilt: Tilt,
        /// The material.
        nested: Box<Material>,
    },
    /// Not there: light goes straight through.
    Null,
    /// Diffuse reflection by a rough surface (Oren and Nayar 1994); outer side only.
    RoughDiffuse {
        /// Albedo of the surface's walls, in [0, 1].
        reflectance: Texture,
        /// Microfacet roughness; grey, not negative.
        alpha: Texture,
        /// Whether the model's short form is meant, which leaves out the light between walls.
        fast: bool,
    },
    /// A highlight beside diffuse reflection; outer side only.
    Glossy(Box<Glossy>),
    /// A thin sheet that scatters diffusely to both sides. The two albedos add up to 1 at most.
    Transmitter {
        /// Albedo on the side of the light.
        reflectance: Texture,
        /// Albedo on the far side.
        transmittance: Texture,
    },
    /// Burley's model of a solid body.
    Principled(Box<Principled>),
    /// Burley's model of a sheet without thickness.
    PrincipledThin(Box<PrincipledThin>),
    /// A material for each side; neither may transmit.
    TwoSided {
        /// Seen from the outer side.
        front: Box<Material>,
        /// Seen from the inner side, which is its outer side.
        back: Box<Material>,
    },
}

/// A rough dielectric boundary over a diffuse base, as validated data.
#[derive(Clone, Debug)]
pub struct RoughCoat {
    distribution: Roughness,
    transmittance: TransmittanceTable,
    /// What the base does with the light that gets in.
    base: Coat,
}

impl RoughCoat {
    /// A coat with `eta` times the index of the exterior, positive; `nonlinear` as in [`Coat::new`]. Where the roughness
    /// varies, the light that passes is that of its mean.
    #[must_use]
    pub fn new(eta: f32, distribution: Roughness, nonlinear: bool) -> Self {
        let (kind, alpha) = (distribution.kind, distribution.mean());
        Self {
            transmittance: TransmittanceTable::new(kind, alpha, eta),
            base: Coat::with_escaping(eta, rough_coat::escaping(kind, alpha, eta), nonlinear),
            distribution,
        }
    }
}

/// A dielectric layer over a material, which reflects only.
#[derive(Clone, Debug)]
pub struct Coating {
    /// Index of the layer over that of the exterior, positive.
    pub eta: f32,
    /// Its roughness with the light that passes, or `None` for a smooth layer. Where the roughness varies, what passes is that of its mean.
    pub rough: Option<(Roughness, TransmittanceTable)>,
    /// Factor on what the layer reflects.
    pub specular_reflectance: Texture,
    /// Absorption of the layer straight through: its coefficient times the thickness is `absorption * thickness`.
    pub absorption: Texture,
    /// Factor on the absorption, not negative.
    pub thickness: f32,
    /// What is coated.
    pub nested: Material,
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
