//! Colours, numbers and textures.

mod bitmap;
mod pattern;

pub(super) use bitmap::BitmapKey;

use super::Builder;
use crate::scene::description::{Kind, ObjectId, Property, SpectrumValue, Value};
use crate::scene::error::{SceneError, within};
use crate::scene::reader::{Colour, Reader};
use crate::scene::spectrum::{Use, greatest, is_of_bytes, to_rgb};
use crate::spectrum::Spectrum;
use crate::texture::{Pattern, Texture};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// The most textures that one texture is made of, each use counted: all of them are looked up at every hit.
const MOST_PARTS: u64 = 256;

/// What is rendered in the place of textures that do not exist here.
const GREY: &str = "an even grey of 0.5 stands in for it";

/// What a texture is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Role {
    pub(super) used: Use,
    /// Whether it is a number, for which the luminance of colours is taken.
    pub(super) number: bool,
}

impl Role {
    pub(super) const REFLECTANCE: Self = Self {
        used: Use::Reflectance,
        number: false,
    };
    pub(super) const EMISSION: Self = Self {
        used: Use::Emission,
        number: false,
    };
    /// A number in \[0, 1\].
    pub(super) const SHARE: Self = Self {
        used: Use::Reflectance,
        number: true,
    };
    /// A number without an upper bound, such as a roughness.
    pub(super) const NUMBER: Self = Self {
        used: Use::Constant,
        number: true,
    };
    /// A normal, an optical constant, or what nothing uses yet: no colour that is seen.
    pub(super) const CONSTANT: Self = Self {
        used: Use::Constant,
        number: false,
    };

    /// Its largest value.
    pub(super) fn most(self) -> f32 {
        greatest(self.used) as f32
    }
}

/// Textures that were built or are being built.
#[derive(Debug, Default)]
pub(super) struct Textures {
    /// By object and role, with the number of their parts.
    built: BTreeMap<(ObjectId, Role), (Texture, u64)>,
    /// A reference to one of them is a cycle.
    building: Vec<ObjectId>,
    /// Parts so far of the texture that is being built.
    parts: u64,
}

impl Builder<'_, '_> {
    /// The property or nested texture `name` of an object, or the same `default` everywhere.
    pub(super) fn colour_or_texture(
        &mut self,
        reader: &Reader,
        name: &str,
        role: Role,
        default: f32,
    ) -> Result<Texture, SceneError> {
        if let Some(child) = reader.named_child(name, Kind::Texture)? {
            let built = self.texture(child.target, role);
            let texture = self.description.attempt(child.target, built)?;
            return Ok(texture.unwrap_or(Texture::Constant(Spectrum::splat(default))));
        }
        Ok(Texture::Constant(self.colour_or(reader, name, role, default)?))
    }

    /// The number or nested texture `name` of an object, or `default`. Only a number is held to the `range`.
    pub(super) fn number_or_texture(
        &mut self,
        reader: &Reader,
        name: &str,
        range: RangeInclusive<f64>,
        default: f32,
    ) -> Result<Texture, SceneError> {
        self.number_of(reader, name, Role::NUMBER, range, default)
    }

    /// The number in \[0, 1\] or nested texture `name` of an object, or `default`. What is above 1 in a texture counts as 1.
    pub(super) fn share_or_texture(
        &mut self,
        reader: &Reader,
        name: &str,
        default: f32,
    ) -> Result<Texture, SceneError> {
        self.number_of(reader, name, Role::SHARE, 0.0..=1.0, default)
    }

    fn number_of(
        &mut self,
        reader: &Reader,
        name: &str,
        role: Role,
        range: RangeInclusive<f64>,
        default: f32,
    ) -> Result<Texture, SceneError> {
        match reader.property(name).map(|property| &property.value) {
            Some(Value::Float(_) | Value::Integer(_)) if reader.named_child(name, Kind::Texture)?.is_none() => {
                let number = reader.float(name, range)?.map_or(default, |number| number as f32);
                Ok(Texture::Constant(Spectrum::splat(number)))
            }
            _ => self.colour_or_texture(reader, name, role, default),
        }
    }

    /// The property `name` as a colour, or the same `default` in every channel.
    fn colour_or(&mut self, reader: &Reader, name: &str, role: Role, default: f32) -> Result<Spectrum, SceneError> {
        if let Some(Property {
            value: Value::Spectrum(SpectrumValue::Sampled(samples)),
            place,
        }) = reader.property(name)
            && role.used == Use::Reflectance
            && samples.iter().any(|(_, value)| *value > 1.0)
        {
            self.warn(
                place,
                "no surface reflects more than arrives: what is above 1 in this spectrum's colour counts as 1",
            );
        }
        let colour = colour(reader, name, role.used)?.unwrap_or(Spectrum::splat(default));
        let [r, g, b] = colour.to_rgb();
        Ok(match role.number && !(r == g && g == b) {
            true => Spectrum::splat(colour.luminance()),
            false => colour,
        })
    }

    pub(super) fn texture(&mut self, object: ObjectId, role: Role) -> Result<Texture, SceneError> {
        let reader = self.reader(object);
        // What shows attributes of a mesh is another texture on another mesh.
        let shared = self.attributes.is_empty();
        if shared && let Some((texture, parts)) = self.textures.built.get(&(object, role)) {
            self.textures.parts += parts;
            within(
                reader.place(),
                "number of textures that one is made of",
                self.textures.parts,
                MOST_PARTS,
            )?;
            return Ok(texture.clone());
        }
        if self.textures.building.contains(&object) {
            let place = reader.place().clone();
            let (id, reason) = (reader.object.plugin.clone(), "the texture contains itself".to_owned());
            return Err(SceneError::Reference { place, id, reason });
        }
        self.textures.building.push(object);
        let depth = self.textures.building.len() as u64;
        let outer = std::mem::take(&mut self.textures.parts);
        let limit = u64::from(self.loader.limits.depth);
        let built = within(reader.place(), "nesting depth of textures", depth, limit)
            .and_then(|_| self.new_texture(&reader, role));
        let parts = self.textures.parts + 1;
        self.textures.parts = outer + parts;
        self.textures.building.pop();
        let texture = built?;
        within(
            reader.place(),
            "number of textures that one is made of",
            parts,
            MOST_PARTS,
        )?;
        if shared {
            self.textures.built.insert((object, role), (texture.clone(), parts));
        }
        Ok(texture)
    }

    /// Builds a texture of the scene that nothing used, for what is wrong with it to be told.
    pub(super) fn unused_texture(&mut self, object: ObjectId) -> Result<(), SceneError> {
        let used = self.textures.built.keys().any(|(built, _)| *built == object);
        if !used && !self.description.objects[object].faulty.get() {
            let built = self.texture(object, Role::CONSTANT);
            self.description.attempt(object, built)?;
        }
        Ok(())
    }

    fn new_texture(&mut self, reader: &Reader, role: Role) -> Result<Texture, SceneError> {
        let texture = match reader.object.plugin.as_str() {
            "bitmap" => self.bitmap(reader, role)?,
            "mesh_attribute" | "vertexcolors" => self.mesh_attribute(reader, role)?,
            "uniform" | "rawconstant" => self.even(reader, "value", role)?,
            "srgb" => self.even(reader, "color", role)?,
            "volume" | "wireframe" | "curvature" => {
                reader.warn(reader.place(), format_args!("{GREY}: this type does not exist here"));
                reader.accept_rest();
                Texture::Constant(Spectrum::splat(0.5))
            }
            _ => match self.pattern(reader, role)? {
                Some(pattern) => pattern,
                None => {
                    reader.other_type(&pattern::SUPPORTED, GREY)?;
                    Texture::Constant(Spectrum::splat(0.5))
                }
            },
        };
        reader.finish();
        Ok(texture)
    }

    /// The same colour or number everywhere; a vector stands for one as well.
    fn even(&mut self, reader: &Reader, name: &str, role: Role) -> Result<Texture, SceneError> {
        if let Some(Value::Vector(_)) = reader.property(name).map(|property| &property.value)
            && let Some(vector) = reader.vector(name)?
        {
            let channels = vector
                .to_array()
                .map(|channel| channel.clamp(0.0, f64::from(role.most())) as f32);
            return Ok(Texture::Constant(Spectrum::from_rgb(channels)));
        }
        Ok(Texture::Constant(self.colour_or(reader, name, role, 0.5)?))
    }

    /// Two albedos of one surface; where they add up to more than 1, both are scaled, with a warning.
    pub(super) fn shared_light(&self, reader: &Reader, albedos: [Texture; 2]) -> [Texture; 2] {
        let sum = albedos.iter().map(Texture::brightest).sum::<f32>();
        if sum <= 1.0 + 1e-6 {
            return albedos;
        }
        let message = format_args!(
            "its albedos add up to {sum}: both are divided by it, since no more leaves a surface than arrives"
        );
        reader.warn(reader.place(), message);
        albedos.map(|albedo| scaled(albedo, 1.0 / sum))
    }
}

/// A texture times a number.
pub(super) fn scaled(texture: Texture, factor: f32) -> Texture {
    match texture {
        Texture::Constant(value) => Texture::Constant(value * factor),
        texture => Texture::from(Pattern::Scale {
            texture,
            factor: Texture::Constant(Spectrum::splat(factor)),
            most: f32::MAX,
        }),
    }
}

/// The property `name` as a colour.
pub(super) fn colour(reader: &Reader, name: &str, used: Use) -> Result<Option<Spectrum>, SceneError> {
    let Some(mut colour) = reader.colour(name)? else {
        return Ok(None);
    };
    if used == Use::Reflectance && cut_at_one(&mut colour) {
        reader.warn_of(
            name,
            "no surface reflects more than arrives: what is above 1 counts as 1",
        );
    }
    match to_rgb(&colour, used) {
        Ok(rgb) => Ok(Some(rgb)),
        Err(reason) => reader.fault(reader.wrong(name, reason)).map(|()| None),
    }
}

/// Cuts a colour of numbers off at 1; whether there was something above. Colours of bytes are left to the error that says so.
fn cut_at_one(colour: &mut Colour) -> bool {
    let channels = match colour {
        Colour::Number(value) | Colour::Spectrum(SpectrumValue::Uniform(value)) => std::slice::from_mut(value),
        Colour::Rgb(channels) => channels.as_mut_slice(),
        Colour::Spectrum(SpectrumValue::Sampled(_)) => return false,
    };
    if is_of_bytes(channels) || channels.iter().all(|channel| *channel <= 1.0) {
        return false;
    }
    channels.iter_mut().for_each(|channel| *channel = channel.min(1.0));
    true
}

/// The property `name` as a colour that must not be black, or the same `default` in every channel.
pub(super) fn light_colour(reader: &Reader, name: &str, default: f64) -> Result<Spectrum, SceneError> {
    let colour = reader.colour(name)?.unwrap_or(Colour::Number(default));
    match to_rgb(&colour, Use::Emission) {
        Ok(rgb) => Ok(rgb),
        Err(reason) => reader.fault(reader.wrong(name, reason)).map(|()| Spectrum::ONE),
    }
}
