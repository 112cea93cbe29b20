//! BSDFs that are made of others.

use super::Builder;
use super::material::{relative_index, warn_of_mean_roughness};
use super::texture::Role;
use crate::material::{Coating, Material, Tilt, TransmittanceTable};
use crate::scene::description::{Kind, ObjectId};
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;
use crate::spectrum::Spectrum;
use crate::texture::Texture;

impl Builder<'_, '_> {
    /// The nested BSDFs, of which there are to be as many as `wanted` says.
    fn nested(&mut self, reader: &Reader, wanted: usize, what: &str) -> Result<Vec<Material>, SceneError> {
        let children = reader.children(Kind::Bsdf);
        if children.len() != wanted {
            return Err(reader.missing(format!("{what} (found {})", children.len())));
        }
        children.iter().map(|child| self.within(reader, child.target)).collect()
    }

    fn only_nested(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let mut nested = self.nested(reader, 1, "one nested BSDF")?;
        Ok(nested.pop().unwrap_or(Material::Null))
    }

    /// A nested BSDF; one that is faulty makes that around it faulty.
    fn within(&mut self, reader: &Reader, object: ObjectId) -> Result<Material, SceneError> {
        let built = self.new_material(object);
        let nested = self.description.attempt(object, built)?;
        Ok(nested.unwrap_or_else(|| {
            reader.object.faulty.set(true);
            Material::Null
        }))
    }

    /// The only texture, whatever its name.
    fn only_texture(&mut self, reader: &Reader, role: Role) -> Result<Option<Texture>, SceneError> {
        let Some(child) = reader.only_child(Kind::Texture)? else {
            return Ok(None);
        };
        let built = self.texture(child.target, role);
        let texture = self.description.attempt(child.target, built)?;
        Ok(Some(texture.unwrap_or_else(|| {
            reader.object.faulty.set(true);
            Texture::Constant(Spectrum::ZERO)
        })))
    }

    pub(super) fn mask(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        Ok(Material::Mask {
            opacity: self.colour_or_texture(reader, "opacity", Role::CONSTANT, 0.5)?,
            nested: Box::new(self.only_nested(reader)?),
        })
    }

    pub(super) fn blend(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let weight = self.colour_or_texture(reader, "weight", Role::CONSTANT, 0.5)?;
        let nested = self.nested(reader, 2, "two nested BSDFs")?;
        match <[Material; 2]>::try_from(nested) {
            Ok(nested) => Ok(Material::Blend {
                weight,
                nested: Box::new(nested),
            }),
            Err(_) => Err(reader.missing("two nested BSDFs")),
        }
    }

    /// Mitsuba 0.x: as many weights as BSDFs. What the weights lack to one is absorbed; above one they are scaled down.
    pub(super) fn mixture(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let Some(text) = reader.string("weights")? else {
            return Err(reader.missing("property `weights`"));
        };
        let words = text.split([' ', ',', ';']).filter(|word| !word.is_empty());
        let weights: Option<Vec<f32>> = words
            .map(|word| {
                let weight = word.parse::<f32>().ok();
                weight.filter(|weight| (0.0..=1e6).contains(weight))
            })
            .collect();
        let Some(mut weights) = weights.filter(|weights| !weights.is_empty()) else {
            return Err(reader.wrong("weights", "expected numbers from 0 to 1, with commas between them"));
        };
        let sum: f32 = weights.iter().sum();
        if sum > 1.0 {
            // Weights such as 0.3, 0.3, 0.4 may exceed one by rounding.
            if sum > 1.0 + 1e-5 {
                reader.warn_of("weights", "their sum is above 1: all are divided by it");
            }
            weights.iter_mut().for_each(|weight| *weight /= sum);
        }
        let what = format!("{} nested BSDFs, one for each weight", weights.len());
        let nested = self.nested(reader, weights.len(), &what)?;
        Ok(Material::Mixture(weights.into_iter().zip(nested).collect()))
    }

    pub(super) fn normal_map(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        // Mitsuba 0.x does not name the texture.
        let normals = match reader.has("normalmap") {
            true => Some(self.colour_or_texture(reader, "normalmap", Role::CONSTANT, 0.5)?),
            false => self.only_texture(reader, Role::CONSTANT)?,
        };
        let Some(normals) = normals else {
            return Err(reader.missing("a texture `normalmap`"));
        };
        Ok(Material::NormalMap {
            normals,
            tilt: tilt(reader)?,
            nested: Box::new(self.only_nested(reader)?),
        })
    }

    pub(super) fn bump_map(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let Some(heights) = self.only_texture(reader, Role::CONSTANT)? else {
            return Err(reader.missing("a texture"));
        };
        Ok(Material::BumpMap {
            heights,
            scale: reader.float_or("scale", -1e9..=1e9, 1.0)? as f32,
            tilt: tilt(reader)?,
            nested: Box::new(self.only_nested(reader)?),
        })
    }

    pub(super) fn coating(&mut self, reader: &Reader) -> Result<Material, SceneError> {
        let eta = relative_index(reader, "bk7")?;
        let rough = match reader.object.plugin.as_str() {
            "roughcoating" => {
                let roughness = self.roughness(reader)?;
                warn_of_mean_roughness(reader, &roughness);
                reader.warn(
                    reader.place(),
                    "an approximation: what is under the coat is seen through it as through a smooth one",
                );
                let table = TransmittanceTable::new(roughness.kind, roughness.mean(), eta);
                Some((roughness, table))
            }
            _ => None,
        };
        let coating = Coating {
            eta,
            rough,
            specular_reflectance: self.colour_or_texture(reader, "specular_reflectance", Role::REFLECTANCE, 1.0)?,
            absorption: self.colour_or_texture(reader, "sigma_a", Role::CONSTANT, 0.0)?,
            thickness: reader.float_or("thickness", 0.0..=1e9, 1.0)? as f32,
            nested: self.only_nested(reader)?,
        };
        if coating.nested.transmits() {
            reader.warn(
                reader.place(),
                "the coat is left out: what is under it lets light through",
            );
            return Ok(coating.nested);
        }
        Ok(Material::Coating(Box::new(coating)))
    }
}

fn tilt(reader: &Reader) -> Result<Tilt, SceneError> {
    Ok(Tilt {
        flip_invalid_normals: reader.boolean("flip_invalid_normals", true)?,
        shadowing: reader.boolean("use_shadowing_function", true)?,
    })
}
