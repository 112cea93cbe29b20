//! BSDFs of a single lobe with many numbers: the principled ones, and those of Mitsuba 0.x and pbrt.

use super::Builder;
use super::texture::{Role, scaled};
use crate::material::{Glossy, Highlight, Material, Principled, PrincipledThin, WardModel};
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;
use std::ops::RangeInclusive;

/// Ratios of indices.
const INDEX: RangeInclusive<f64> = 1e-3..=1e3;
/// Roughnesses, as of microfacets.
const ROUGHNESS: RangeInclusive<f64> = 1e-4..=10.0;
/// Beyond it a highlight is narrower than directions in single precision can tell.
const EXPONENT: RangeInclusive<f64> = 0.0..=1e6;

impl Builder<'_, '_> {
    pub(super) fn principled(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        reader.ignore(&[
            "main_specular_sampling_rate",
            "clearcoat_sampling_rate",
            "diffuse_reflectance_sampling_rate",
        ]);
        let spec_trans = self.share_or_texture(reader, "spec_trans", 0.0)?;
        Ok(Material::Principled(Box::new(Principled {
            transmits: spec_trans.brightest() > 0.0,
            spec_trans,
            base_color: self.colour_or_texture(reader, "base_color", Role::REFLECTANCE, 0.5)?,
            roughness: self.share_or_texture(reader, "roughness", 0.5)?,
            anisotropic: self.share_or_texture(reader, "anisotropic", 0.0)?,
            metallic: self.share_or_texture(reader, "metallic", 0.0)?,
            spec_tint: self.share_or_texture(reader, "spec_tint", 0.0)?,
            sheen: self.share_or_texture(reader, "sheen", 0.0)?,
            sheen_tint: self.share_or_texture(reader, "sheen_tint", 0.0)?,
            flatness: self.share_or_texture(reader, "flatness", 0.0)?,
            clearcoat: self.share_or_texture(reader, "clearcoat", 0.0)?,
            clearcoat_gloss: self.share_or_texture(reader, "clearcoat_gloss", 0.0)?,
            eta: principled_index(reader)?,
        })))
    }

    pub(super) fn principled_thin(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        reader.ignore(&[
            "specular_reflectance_sampling_rate",
            "specular_transmittance_sampling_rate",
            "diffuse_reflectance_sampling_rate",
            "diffuse_transmittance_sampling_rate",
        ]);
        Ok(Material::PrincipledThin(Box::new(PrincipledThin {
            base_color: self.colour_or_texture(reader, "base_color", Role::REFLECTANCE, 0.5)?,
            roughness: self.share_or_texture(reader, "roughness", 0.5)?,
            anisotropic: self.share_or_texture(reader, "anisotropic", 0.0)?,
            spec_trans: self.share_or_texture(reader, "spec_trans", 0.0)?,
            // Mitsuba writes 2 where all goes through.
            diff_trans: scaled(self.number_or_texture(reader, "diff_trans", 0.0..=2.0, 0.0)?, 0.5),
            spec_tint: self.share_or_texture(reader, "spec_tint", 0.0)?,
            sheen: self.share_or_texture(reader, "sheen", 0.0)?,
            sheen_tint: self.share_or_texture(reader, "sheen_tint", 0.0)?,
            flatness: self.share_or_texture(reader, "flatness", 0.0)?,
            eta: self.number_or_texture(reader, "eta", INDEX, 1.5)?,
        })))
    }

    pub(super) fn rough_diffuse(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        Ok(Material::RoughDiffuse {
            reflectance: self.diffuse_reflectance(reader)?,
            alpha: self.number_or_texture(reader, "alpha", 0.0..=10.0, 0.2)?,
            fast: reader.boolean("use_fast_approx", false)?,
        })
    }

    /// A highlight beside a diffuse part: `phong`, `ward` and those of pbrt-v3.
    pub(super) fn glossy(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let diffuse = self.colour_or_texture(reader, "diffuse_reflectance", Role::REFLECTANCE, 0.5)?;
        let specular = self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 0.2)?;
        let highlight = match reader.object.plugin.as_str() {
            "phong" => Highlight::Phong {
                exponent: self.number_or_texture(reader, "exponent", EXPONENT, 30.0)?,
            },
            "pbrtplastic" | "pbrtsubstrate" => {
                let distribution = self.roughness(reader)?;
                let facets = match reader.object.plugin.as_str() {
                    "pbrtplastic" => Highlight::Facets {
                        eta: reader.float_or("eta", INDEX, 1.5)? as f32,
                        distribution,
                    },
                    _ => Highlight::Blend { distribution },
                };
                // Fresnel's share leaves the diffuse part what it takes, as a rule; pbrt-v3 does not see to it either.
                return Ok(Material::Glossy(Box::new(Glossy {
                    diffuse_reflectance: diffuse,
                    specular_reflectance: specular,
                    highlight: facets,
                })));
            }
            _ => Highlight::Ward {
                alpha: [
                    self.number_or_texture(reader, "alpha_u", ROUGHNESS, 0.1)?,
                    self.number_or_texture(reader, "alpha_v", ROUGHNESS, 0.1)?,
                ],
                model: reader.choice("variant", &WARD_MODELS, WardModel::Balanced)?,
            },
        };
        let [diffuse_reflectance, specular_reflectance] = self.shared_light(reader, [diffuse, specular]);
        Ok(Material::Glossy(Box::new(Glossy {
            diffuse_reflectance,
            specular_reflectance,
            highlight,
        })))
    }

    /// A diffuse sheet: Mitsuba 0.x's, which only transmits unless told, or pbrt's.
    pub(super) fn transmitter(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let [reflected, transmitted] = match reader.object.plugin.as_str() {
            "difftrans" => [0.0, 0.5],
            _ => [0.25, 0.25],
        };
        let albedos = [
            self.colour_or_texture(reader, "reflectance", Role::REFLECTANCE, reflected)?,
            self.colour_or_texture(reader, "transmittance", Role::REFLECTANCE, transmitted)?,
        ];
        let [reflectance, transmittance] = self.shared_light(reader, albedos);
        Ok(Material::Transmitter {
            reflectance,
            transmittance,
        })
    }
}

const WARD_MODELS: [(&str, WardModel); 3] = [
    ("ward", WardModel::Ward),
    ("ward-duer", WardModel::Duer),
    ("balanced", WardModel::Balanced),
];

/// The ratio of indices, as it is or by what is reflected at normal incidence: `specular` is that over 0.08 (Burley 2012). As in
/// Mitsuba it is never 1, where there is no boundary.
fn principled_index(reader: &Reader) -> Result<f32, SceneError> {
    let (eta, specular) = (reader.float("eta", INDEX)?, reader.float("specular", 0.0..=1.0)?);
    match (eta, specular) {
        (Some(_), Some(_)) => Err(reader.wrong("specular", "give either `eta` or `specular`, not both")),
        (Some(1.0), None) => Ok(1.001),
        (Some(eta), None) => Ok(eta as f32),
        (None, specular) => {
            let specular = specular.unwrap_or(0.5).max(1e-3);
            Ok((2.0 / (1.0 - (0.08 * specular).sqrt()) - 1.0) as f32)
        }
    }
}
