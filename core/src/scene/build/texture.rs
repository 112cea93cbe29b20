//! Colours and textures.

use super::Builder;
use crate::math::Vec2;
use crate::scene::description::{Kind, ObjectId, Property, SpectrumValue, Value};
use crate::scene::error::SceneError;
use crate::scene::image;
use crate::scene::reader::{ANY, Colour, Reader};
use crate::scene::spectrum::{BRIGHTEST, LARGEST_CONSTANT, Use, to_rgb};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, Texture, TextureFilter, UvTransform, WrapMode};
use glam::DMat4;
use std::sync::Arc;

/// A decoded image with how it is read; images that agree in all are kept once.
pub(super) type BitmapKey = (String, bool, u8, u8);

/// What a texture is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Role {
    pub(super) used: Use,
}

impl Role {
    pub(super) const REFLECTANCE: Self = Self { used: Use::Reflectance };
    pub(super) const EMISSION: Self = Self { used: Use::Emission };
    /// A number, a normal or an optical constant: no colour that is seen.
    pub(super) const CONSTANT: Self = Self { used: Use::Constant };
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
        Ok(colour(reader, name, role.used)?.unwrap_or(Spectrum::splat(default)))
    }

    pub(super) fn texture(&mut self, object: ObjectId, role: Role) -> Result<Texture, SceneError> {
        let reader = self.reader(object);
        let texture = match reader.object.plugin.as_str() {
            "bitmap" => {
                let to_uv = uv_transform(&reader)?;
                Texture::Bitmap(self.bitmap(&reader, role)?, to_uv)
            }
            "checkerboard" => Texture::Checkerboard {
                even: self.colour_or(&reader, "color0", role, 0.4)?,
                odd: self.colour_or(&reader, "color1", role, 0.2)?,
                to_uv: uv_transform(&reader)?,
            },
            "mesh_attribute" | "vertexcolors" => self.mesh_attribute(&reader, role)?,
            "gridtexture" | "volume" | "wireframe" | "curvature" => {
                let without = "this type does not exist yet: an even grey of 0.5 stands in for it";
                reader.warn(reader.place(), without);
                reader.accept_rest();
                Texture::Constant(Spectrum::splat(0.5))
            }
            _ => return Err(reader.unknown_type(&["bitmap", "checkerboard"])),
        };
        reader.finish();
        Ok(texture)
    }

    fn bitmap(&mut self, reader: &Reader, role: Role) -> Result<Arc<Bitmap>, SceneError> {
        // Mitsuba 0.x says by the exponent 1 that an image is linear.
        let linear = reader.float("gamma", ANY)? == Some(1.0);
        let raw = reader.boolean("raw", linear)?;
        let wraps = [
            ("repeat", WrapMode::Repeat),
            ("mirror", WrapMode::Mirror),
            ("clamp", WrapMode::Clamp),
        ];
        let wrap = reader.choice("wrap_mode", &wraps, WrapMode::Repeat)?;
        let filters = [
            ("bilinear", TextureFilter::Bilinear),
            ("nearest", TextureFilter::Nearest),
            // Filters of Mitsuba 0.x over a pixel's footprint: the samples of a pixel spread over it.
            ("trilinear", TextureFilter::Bilinear),
            ("ewa", TextureFilter::Bilinear),
        ];
        let filter = reader.choice("filter_type", &filters, TextureFilter::Bilinear)?;
        reader.property("filename");
        reader.ignore(&["accel", "cache", "format", "max_anisotropy"]);
        reader.finish();
        let bitmap = self.bitmap_file(reader, raw, wrap, filter)?;
        if raw && role != Role::CONSTANT && image::is_encoded(&self.file(reader)?.bytes) {
            let message = "it takes the sRGB values of this image as linear, so that its colours come out too light; leave it out";
            reader.warn_of("raw", message);
        }
        let brightest = bitmap
            .texels
            .iter()
            .map(|texel| texel.max_component())
            .fold(0.0, f32::max);
        if role.used == Use::Reflectance && brightest > 1.0 {
            let reason = format!("a texel is {brightest}; reflectances are at most 1");
            return Err(reader.wrong("filename", reason));
        }
        if role == Role::CONSTANT && f64::from(brightest) > LARGEST_CONSTANT {
            let reason = format!("a texel is {brightest}; numbers from textures reach to {LARGEST_CONSTANT:e}");
            return Err(reader.wrong("filename", reason));
        }
        if role.used == Use::Emission && f64::from(brightest) > BRIGHTEST {
            let reason = format!("a texel is {brightest}; lights reach to {BRIGHTEST:e}");
            return Err(reader.wrong("filename", reason));
        }
        Ok(bitmap)
    }

    /// The image that `filename` names.
    pub(super) fn bitmap_file(
        &mut self,
        reader: &Reader,
        raw: bool,
        wrap: WrapMode,
        filter: TextureFilter,
    ) -> Result<Arc<Bitmap>, SceneError> {
        let file = self.file(reader)?;
        let key = (file.name.clone(), raw, wrap as u8, filter as u8);
        if let Some(bitmap) = self.bitmaps.get(&key) {
            return Ok(bitmap.clone());
        }
        let left = self.loader.limits.texels.saturating_sub(self.texels);
        let image = image::read(&file, raw, left);
        let image = image.map_err(|found| self.description.faults.all_but_last(found))?;
        self.texels += image.texels.len() as u64;
        let (width, height, texels) = (image.width, image.height, image.texels);
        let bitmap = Arc::new(Bitmap {
            width,
            height,
            texels,
            wrap,
            filter,
        });
        self.bitmaps.insert(key, bitmap.clone());
        Ok(bitmap)
    }
}

/// The property `name` as a colour.
pub(super) fn colour(reader: &Reader, name: &str, used: Use) -> Result<Option<Spectrum>, SceneError> {
    let Some(colour) = reader.colour(name)? else {
        return Ok(None);
    };
    match to_rgb(&colour, used) {
        Ok(rgb) => Ok(Some(rgb)),
        Err(reason) => reader.fault(reader.wrong(name, reason)).map(|()| None),
    }
}

/// The property `name` as a colour that must not be black, or the same `default` in every channel.
pub(super) fn light_colour(reader: &Reader, name: &str, default: f64) -> Result<Spectrum, SceneError> {
    let colour = reader.colour(name)?.unwrap_or(Colour::Number(default));
    match to_rgb(&colour, Use::Emission) {
        Ok(rgb) => Ok(rgb),
        Err(reason) => reader.fault(reader.wrong(name, reason)).map(|()| Spectrum::ONE),
    }
}

/// The first two rows of `to_uv`, or the scale and offset of the 0.x dialect.
fn uv_transform(reader: &Reader) -> Result<UvTransform, SceneError> {
    let scale = ["uscale", "vscale"].map(|name| reader.float(name, ANY));
    let offset = ["uoffset", "voffset"].map(|name| reader.float(name, ANY));
    let ([u_scale, v_scale], [u_offset, v_offset]) = (scale, offset);
    let (scale, offset) = ([u_scale?, v_scale?], [u_offset?, v_offset?]);
    let old = scale.iter().chain(&offset).any(Option::is_some);
    let matrix = match reader.transform("to_uv")? {
        Some(_) if old => return Err(reader.wrong("to_uv", "it cannot be combined with uscale, voffset and the like")),
        Some(transform) => transform.matrix(),
        None => {
            let scale = glam::DVec3::new(scale[0].unwrap_or(1.0), scale[1].unwrap_or(1.0), 1.0);
            let offset = glam::DVec3::new(offset[0].unwrap_or(0.0), offset[1].unwrap_or(0.0), 0.0);
            DMat4::from_scale(scale) * DMat4::from_translation(offset)
        }
    };
    let row = |i: usize| matrix.row(i).as_vec4();
    let transform = UvTransform {
        linear: [Vec2::new(row(0).x, row(0).y), Vec2::new(row(1).x, row(1).y)],
        offset: Vec2::new(row(0).w, row(1).w),
    };
    let finite = transform
        .linear
        .iter()
        .chain([&transform.offset])
        .all(|v| v.is_finite());
    if finite {
        Ok(transform)
    } else {
        Err(reader.wrong("to_uv", "it is out of the range of single precision"))
    }
}
