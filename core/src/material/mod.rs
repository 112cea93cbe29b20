//! Materials: how surfaces scatter light.
//!
//! Directions are in the local shading frame, of unit length, and point away from the surface. `wo` is known, `wi`
//! is sampled: on a camera path (radiance) `wi` leads towards the light, on a light path (flux) `wo` does. Nothing here
//! includes a cosine: callers multiply by `|cos|`. Everything returned is finite and not negative, whatever the unit
//! directions.
//!
//! Reflection is symmetric in `wo` and `wi`. Refraction is not: with `eta` the index on the side of `wi` over that on the
//! side of `wo`, `f(wo, wi, Radiance) = f(wi, wo, Flux) = f(wo, wi, Flux) / eta^2`.

mod conductor;
mod conductors;
mod dielectric;
mod diffuse;
mod fresnel;
pub mod ior;
mod microfacet;
#[cfg(test)]
mod tests;

use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;
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
#[derive(Clone, Debug)]
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

impl BsdfSample {
    fn tinted(self, tint: Spectrum) -> Self {
        Self {
            f: self.f * tint,
            ..self
        }
    }
}

/// The direction as seen from the other side of the surface.
fn turned(w: Vec3) -> Vec3 {
    Vec3::new(w.x, w.y, -w.z)
}

fn tints(reflectance: &Texture, transmittance: &Texture, uv: Vec2) -> dielectric::Tints {
    dielectric::Tints {
        reflectance: reflectance.eval(uv),
        transmittance: transmittance.eval(uv),
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
        eta: 1.0,
    })
}

impl Material {
    /// f(wo, wi) [1/sr] without the cosine, delta lobes left out. `uv`: texture coordinates.
    #[must_use]
    pub fn eval(&self, uv: Vec2, wo: Vec3, wi: Vec3, mode: TransportMode) -> Spectrum {
        match self {
            Self::Diffuse { reflectance } => diffuse::eval(wo, wi) * reflectance.eval(uv),
            Self::RoughDielectric {
                eta,
                distribution,
                specular_reflectance,
                specular_transmittance,
            } => {
                let tints = tints(specular_reflectance, specular_transmittance, uv);
                dielectric::eval(*eta, distribution, tints, wo, wi, mode)
            }
            Self::RoughConductor {
                eta,
                k,
                distribution,
                specular_reflectance,
            } => conductor::eval(*eta, *k, distribution, wo, wi) * specular_reflectance.eval(uv),
            Self::TwoSided { front, .. } if wo.z > 0.0 => front.eval(uv, wo, wi, mode),
            Self::TwoSided { back, .. } => back.eval(uv, turned(wo), turned(wi), mode),
            Self::Dielectric { .. } | Self::Conductor { .. } | Self::Null => Spectrum::ZERO,
        }
    }

    /// Solid-angle density [1/sr] with which [`Self::sample`] returns `wi`, delta lobes left out; the same in both modes.
    #[must_use]
    #[expect(
        clippy::only_used_in_recursion,
        reason = "roughness may vary over the surface: callers pass what eval and sample take"
    )]
    pub fn pdf(&self, uv: Vec2, wo: Vec3, wi: Vec3) -> f32 {
        match self {
            Self::Diffuse { .. } => diffuse::pdf(wo, wi),
            Self::RoughDielectric { eta, distribution, .. } => dielectric::pdf(*eta, distribution, wo, wi),
            Self::RoughConductor { distribution, .. } => conductor::pdf(distribution, wo, wi),
            Self::TwoSided { front, .. } if wo.z > 0.0 => front.pdf(uv, wo, wi),
            Self::TwoSided { back, .. } => back.pdf(uv, turned(wo), turned(wi)),
            Self::Dielectric { .. } | Self::Conductor { .. } | Self::Null => 0.0,
        }
    }

    /// Samples `wi` given `wo` from the random numbers `lobe` and `u`. `None` where the sample carries nothing.
    #[must_use]
    pub fn sample(&self, uv: Vec2, wo: Vec3, lobe: f32, u: Vec2, mode: TransportMode) -> Option<BsdfSample> {
        let sample = match self {
            Self::Diffuse { reflectance } => diffuse::sample(wo, u)?.tinted(reflectance.eval(uv)),
            Self::Dielectric {
                eta,
                specular_reflectance,
                specular_transmittance,
            } => {
                let tints = tints(specular_reflectance, specular_transmittance, uv);
                dielectric::sample_smooth(*eta, tints, wo, lobe, mode)?
            }
            Self::RoughDielectric {
                eta,
                distribution,
                specular_reflectance,
                specular_transmittance,
            } => {
                let tints = tints(specular_reflectance, specular_transmittance, uv);
                dielectric::sample(*eta, distribution, tints, wo, (lobe, u), mode)?
            }
            Self::Conductor {
                eta,
                k,
                specular_reflectance,
            } => conductor::sample_smooth(*eta, *k, wo)?.tinted(specular_reflectance.eval(uv)),
            Self::RoughConductor {
                eta,
                k,
                distribution,
                specular_reflectance,
            } => conductor::sample(*eta, *k, distribution, wo, u)?.tinted(specular_reflectance.eval(uv)),
            Self::Null => pass_through(wo)?,
            Self::TwoSided { front, .. } if wo.z > 0.0 => front.sample(uv, wo, lobe, u, mode)?,
            Self::TwoSided { back, .. } => {
                let sample = back.sample(uv, turned(wo), lobe, u, mode)?;
                BsdfSample {
                    wi: turned(sample.wi),
                    ..sample
                }
            }
        };
        (!sample.f.is_black()).then_some(sample)
    }

    /// Whether every lobe that `wo` sees is a delta function: density estimation and next-event estimation do not apply.
    #[must_use]
    pub fn is_delta(&self, wo: Vec3) -> bool {
        self.least_roughness(wo).is_none()
    }

    /// Whether scattering to `wo` is too concentrated for a density estimate: delta, or microfacet roughness below
    /// `roughness` along either axis.
    #[must_use]
    pub fn is_glossier_than(&self, wo: Vec3, roughness: f32) -> bool {
        self.least_roughness(wo).is_none_or(|least| least < roughness)
    }

    /// The smaller microfacet roughness that `wo` sees: infinite for diffuse scattering, `None` for delta functions.
    fn least_roughness(&self, wo: Vec3) -> Option<f32> {
        match self {
            Self::Diffuse { .. } => Some(f32::INFINITY),
            Self::RoughDielectric { distribution, .. } | Self::RoughConductor { distribution, .. } => {
                Some(distribution.alpha.min_element())
            }
            Self::Dielectric { .. } | Self::Conductor { .. } | Self::Null => None,
            Self::TwoSided { front, .. } if wo.z > 0.0 => front.least_roughness(wo),
            Self::TwoSided { back, .. } => back.least_roughness(turned(wo)),
        }
    }
}
