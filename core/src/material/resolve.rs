//! From a material to its BSDF at a point.

use super::blend::Blend;
use super::coated::{Base, Coated, Passage};
use super::perturbed::Perturbed;
use super::roughness::share;
use super::{Bsdf, Coating, Lobe, Material, RoughCoat, RoughDiffuseLobe, Tints, TransmitterLobe, turned};
use crate::math::{Vec3, exp};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// Derivatives of the position by the texture coordinates, in the local shading frame [scene units].
#[derive(Clone, Copy, Debug)]
pub struct Tangents {
    /// By u.
    pub du: Vec3,
    /// By v.
    pub dv: Vec3,
}

impl Material {
    /// What the material does at a point, seen from the local direction `wo`: its textures are
    /// looked up here and nowhere else. Of `wo` only the side counts. `tangents` is asked where a material needs them.
    #[must_use]
    pub fn resolve_on(&self, at: &TexturePoint, wo: Vec3, tangents: &dyn Fn() -> Tangents) -> Bsdf {
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
                facets: distribution.at(at),
                tints: Tints::new(specular_reflectance, specular_transmittance, at),
            },
            Self::ThinDielectric {
                eta,
                specular_reflectance,
                specular_transmittance,
            } => Lobe::ThinDielectric {
                eta: *eta,
                tints: Tints::new(specular_reflectance, specular_transmittance, at),
            },
            Self::Conductor {
                eta,
                k,
                specular_reflectance,
            } => Lobe::Conductor {
                eta: eta.eval(at),
                k: k.eval(at),
                reflectance: specular_reflectance.eval(at),
            },
            Self::RoughConductor {
                eta,
                k,
                distribution,
                specular_reflectance,
            } => Lobe::RoughConductor {
                eta: eta.eval(at),
                k: k.eval(at),
                facets: distribution.at(at),
                reflectance: specular_reflectance.eval(at),
            },
            Self::Plastic {
                coat,
                diffuse_reflectance,
                specular_reflectance,
            } => return Bsdf::coated(coat, specular_reflectance.eval(at), diffuse_reflectance.eval(at)),
            Self::RoughPlastic {
                coat,
                diffuse_reflectance,
                specular_reflectance,
            } => return coat.resolve(at, specular_reflectance.eval(at), diffuse_reflectance.eval(at)),
            Self::Null => Lobe::Null,
            Self::RoughDiffuse {
                reflectance,
                alpha,
                fast,
            } => Lobe::RoughDiffuse(RoughDiffuseLobe::new(reflectance.eval(at), alpha.grey(at), *fast)),
            Self::Glossy(surface) => Lobe::Glossy(surface.resolve(at)),
            Self::Transmitter {
                reflectance,
                transmittance,
            } => Lobe::Transmitter(TransmitterLobe {
                reflectance: reflectance.eval(at),
                transmittance: transmittance.eval(at),
            }),
            Self::Principled(body) => body.resolve(at),
            Self::PrincipledThin(sheet) => sheet.resolve(at),
            Self::TwoSided { front, .. } if wo.z > 0.0 => return front.resolve_on(at, wo, tangents),
            Self::TwoSided { back, .. } => return back.resolve_on(at, turned(wo), tangents).turned(),
            Self::Coating(coating) => return coating.resolve(at, wo, tangents),
            Self::Mask { opacity, nested } => {
                let resolved = || nested.resolve_on(at, wo, tangents);
                return mixed(share(opacity, at), resolved, || Bsdf::of(Lobe::Null));
            }
            Self::Blend { weight, nested } => {
                let [first, second] = &**nested;
                let [first, second] = [first, second].map(|material| || material.resolve_on(at, wo, tangents));
                return mixed(share(weight, at), second, first);
            }
            Self::Mixture(parts) => {
                let parts = parts.iter();
                let parts = parts.map(|(weight, material)| (*weight, material.resolve_on(at, wo, tangents)));
                return Blend::new(parts).into();
            }
            Self::NormalMap { normals, tilt, nested } => {
                let [x, y, z] = normals.eval(at).to_rgb().map(|channel| 2.0 * channel - 1.0);
                let nested = nested.resolve_on(at, wo, tangents);
                return Perturbed::new(nested, Vec3::new(x, y, z), *tilt).into();
            }
            Self::BumpMap {
                heights,
                scale,
                tilt,
                nested,
            } => {
                let nested = nested.resolve_on(at, wo, tangents);
                return Perturbed::new(nested, bumped(heights, *scale, at, tangents()), *tilt).into();
            }
        })
    }

    /// Whether light passes through the surface somewhere.
    #[must_use]
    pub fn transmits(&self) -> bool {
        match self {
            Self::Dielectric { .. }
            | Self::RoughDielectric { .. }
            | Self::ThinDielectric { .. }
            | Self::Mask { .. }
            | Self::Transmitter { .. }
            | Self::PrincipledThin(_)
            | Self::Null => true,
            Self::Principled(body) => body.transmits,
            Self::RoughDiffuse { .. }
            | Self::Glossy(_)
            | Self::Diffuse { .. }
            | Self::Conductor { .. }
            | Self::RoughConductor { .. }
            | Self::Plastic { .. }
            | Self::RoughPlastic { .. }
            | Self::Coating(_)
            | Self::TwoSided { .. } => false,
            Self::Blend { nested, .. } => nested.iter().any(Self::transmits),
            Self::Mixture(parts) => parts.iter().any(|(_, nested)| nested.transmits()),
            Self::NormalMap { nested, .. } | Self::BumpMap { nested, .. } => nested.transmits(),
        }
    }

    /// The index of refraction of the inside over that of the outside, where the surface refracts light into it.
    #[must_use]
    pub fn index(&self) -> Option<f32> {
        match self {
            Self::Dielectric { eta, .. } | Self::RoughDielectric { eta, .. } => Some(*eta),
            Self::Principled(body) => body.transmits.then_some(body.eta),
            Self::Mask { nested, .. } | Self::NormalMap { nested, .. } | Self::BumpMap { nested, .. } => nested.index(),
            Self::Blend { nested, .. } => nested.iter().find_map(Self::index),
            Self::Mixture(parts) => parts.iter().find_map(|(_, nested)| nested.index()),
            _ => None,
        }
    }

    /// Whether the material is black seen from the inner side.
    #[must_use]
    pub fn is_one_sided(&self) -> bool {
        !self.transmits() && !self.has_two_sides()
    }

    fn has_two_sides(&self) -> bool {
        match self {
            Self::TwoSided { .. } => true,
            Self::Blend { nested, .. } => nested.iter().any(Self::has_two_sides),
            Self::Mixture(parts) => parts.iter().any(|(_, nested)| nested.has_two_sides()),
            Self::NormalMap { nested, .. } | Self::BumpMap { nested, .. } => nested.has_two_sides(),
            _ => false,
        }
    }

    /// Whether some of the light is mirrored or refracted in one direction only.
    #[must_use]
    pub fn is_specular(&self) -> bool {
        match self {
            Self::Dielectric { .. } | Self::ThinDielectric { .. } | Self::Conductor { .. } | Self::Plastic { .. } => {
                true
            }
            Self::Coating(coating) => coating.rough.is_none() || coating.nested.is_specular(),
            Self::TwoSided { front, back } => front.is_specular() || back.is_specular(),
            Self::Blend { nested, .. } => nested.iter().any(Self::is_specular),
            Self::Mixture(parts) => parts.iter().any(|(_, nested)| nested.is_specular()),
            Self::Mask { nested, .. } | Self::NormalMap { nested, .. } | Self::BumpMap { nested, .. } => {
                nested.is_specular()
            }
            Self::Diffuse { .. }
            | Self::RoughDielectric { .. }
            | Self::RoughConductor { .. }
            | Self::RoughPlastic { .. }
            | Self::RoughDiffuse { .. }
            | Self::Glossy(_)
            | Self::Transmitter { .. }
            | Self::Principled(_)
            | Self::PrincipledThin(_)
            | Self::Null => false,
        }
    }
}

/// The share `weight` of one BSDF and the rest of another. Where one of them is all there is, it stands by itself.
fn mixed(weight: f32, of: impl FnOnce() -> Bsdf, rest: impl FnOnce() -> Bsdf) -> Bsdf {
    if weight >= 1.0 {
        of()
    } else if weight <= 0.0 {
        rest()
    } else {
        Blend::new([(weight, of()), (1.0 - weight, rest())]).into()
    }
}

/// The normal of a surface that is moved along its normal by `scale` times the height; not of unit length. The change of the
/// surface's own normal is left out, as is usual (Blinn 1978, "Simulation of Wrinkled Surfaces").
fn bumped(heights: &Texture, scale: f32, at: &TexturePoint, tangents: Tangents) -> Vec3 {
    let slope = heights.gradient(at) * scale;
    let moved = |tangent: Vec3, slope: f32| Vec3::new(tangent.x, tangent.y, slope);
    let normal = moved(tangents.du, slope.x).cross(moved(tangents.dv, slope.y));
    if normal.z < 0.0 { -normal } else { normal }
}

impl RoughCoat {
    /// A rough coat that reflects the share `reflectance` of what Fresnel's equations say, and a base of the albedo `diffuse` under it.
    fn resolve(&self, at: &TexturePoint, reflectance: Spectrum, diffuse: Spectrum) -> Bsdf {
        let eta = self.base.eta();
        let top = Lobe::RoughCoatReflection {
            eta,
            facets: self.distribution.at(at),
            reflectance,
        };
        let passage = Passage {
            eta,
            table: Some(self.transmittance),
        };
        let base = Base::Diffuse(self.base.base(diffuse));
        Coated::new(top, passage, base, [reflectance.mean(), diffuse.mean()]).into()
    }
}

impl Coating {
    fn resolve(&self, at: &TexturePoint, wo: Vec3, tangents: &dyn Fn() -> Tangents) -> Bsdf {
        let (eta, reflectance) = (self.eta, self.specular_reflectance.eval(at));
        let top = match &self.rough {
            Some((roughness, _)) => Lobe::RoughCoatReflection {
                eta,
                facets: roughness.at(at),
                reflectance,
            },
            None => Lobe::CoatReflection { eta, reflectance },
        };
        let passage = Passage {
            eta,
            table: self.rough.as_ref().map(|(_, table)| *table),
        };
        let absorption = self.absorption.eval(at) * self.thickness;
        let base = Base::Nested {
            bsdf: self.nested.resolve_on(at, wo, tangents),
            absorption,
        };
        let passing = absorption.map(|a| exp(-2.0 * a)).mean();
        Coated::new(top, passage, base, [reflectance.mean(), passing]).into()
    }
}
