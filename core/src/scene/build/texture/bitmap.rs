//! Images.

use super::super::Builder;
use super::Role;
use super::pattern::uv_transform;
use crate::scene::error::SceneError;
use crate::scene::image;
use crate::scene::linear_image::{Channel, Encoding, Reading};
use crate::scene::reader::{ANY, Reader};
use crate::scene::spectrum::{Use, greatest};
use crate::texture::{Bitmap, Texels, Texture, TextureFilter, TileFile, WrapMode};
use std::sync::Arc;

/// Bytes of textures in a file that memory keeps, beside [`crate::scene::Limits::texture_bytes`].
const TILE_CACHE_BYTES: usize = 256 << 20;

/// The name of an image, and how it is read in words; images that agree in both are kept once.
pub(in crate::scene::build) type BitmapKey = (String, String);

/// Treatments of coordinates outside the image, with Mitsuba 0.x's `zero` and pbrt's `black`.
const WRAPS: [(&str, WrapMode); 5] = [
    ("repeat", WrapMode::Repeat),
    ("mirror", WrapMode::Mirror),
    ("clamp", WrapMode::Clamp),
    ("black", WrapMode::Black),
    ("zero", WrapMode::Black),
];

/// Filters. The last two are Mitsuba 0.x's over a pixel's footprint: the samples of a pixel spread over it.
const FILTERS: [(&str, TextureFilter); 4] = [
    ("bilinear", TextureFilter::Bilinear),
    ("nearest", TextureFilter::Nearest),
    ("trilinear", TextureFilter::Bilinear),
    ("ewa", TextureFilter::Bilinear),
];

/// Channels; the last two are pbrt's.
const CHANNELS: [(&str, Channel); 8] = [
    ("rgb", Channel::All),
    ("r", Channel::Red),
    ("g", Channel::Green),
    ("b", Channel::Blue),
    ("a", Channel::Alpha),
    ("luminance", Channel::Luminance),
    ("mean", Channel::Mean),
    ("opacity_or_mean", Channel::OpacityOrMean),
];

impl Builder<'_, '_> {
    pub(super) fn bitmap(&mut self, reader: &Reader, role: Role) -> Result<Texture, SceneError> {
        let to_uv = uv_transform(reader)?;
        let encoding = encoding(reader)?;
        let all = if role.number { Channel::Luminance } else { Channel::All };
        let reading = Reading {
            encoding,
            channel: match reader.choice("channel", &CHANNELS, all)? {
                Channel::All => all,
                channel => channel,
            },
            inverted: reader.boolean("invert", false)?,
        };
        let wrap = reader.choice("wrap_mode", &WRAPS, WrapMode::Repeat)?;
        let filter = reader.choice("filter_type", &FILTERS, TextureFilter::Bilinear)?;
        reader.property("filename");
        reader.ignore(&["accel", "cache", "format", "max_anisotropy"]);
        let mapping = self.mapping(reader)?;
        reader.finish();
        let bitmap = self.bitmap_file(reader, &reading, wrap, filter, role.used == Use::Reflectance)?;
        let a_picture = reading.channel == Channel::All && role != Role::CONSTANT;
        if a_picture && encoding == Encoding::Linear && image::is_encoded(&self.file(reader)?.bytes) {
            let written = if reader.has("raw") { "raw" } else { "gamma" };
            let message = "it takes the sRGB values of this image as linear, so that its colours come out too light; leave it out";
            reader.warn_of(written, message);
        }
        let limit = greatest(role.used);
        let what = match role.used {
            Use::Reflectance => "reflectances",
            Use::Emission => "lights",
            Use::Constant | Use::Coefficient => "numbers from textures",
        };
        let brightest = bitmap.texels.brightest();
        if f64::from(brightest) > limit {
            let reason = format!("a texel is {brightest}; {what} reach to {limit:e}");
            return Err(reader.wrong("filename", reason));
        }
        Ok(mapping.of(Texture::Bitmap(bitmap, to_uv)))
    }

    /// The image that `filename` names; in a reflectance, texels count as 1 at most.
    pub(in crate::scene::build) fn bitmap_file(
        &mut self,
        reader: &Reader,
        reading: &Reading,
        wrap: WrapMode,
        filter: TextureFilter,
        reflectance: bool,
    ) -> Result<Arc<Bitmap>, SceneError> {
        let file = self.file(reader)?;
        let key = (
            file.name.clone(),
            format!("{reading:?} {wrap:?} {filter:?} {reflectance}"),
        );
        if let Some(bitmap) = self.bitmaps.get(&key) {
            return Ok(bitmap.clone());
        }
        let image = image::read(&file, reading, self.texels_left());
        let image = image.map_err(|found| self.description.faults.all_but_last(found))?;
        self.texels += image.texels.len() as u64;
        let (width, height, mut texels) = (image.width, image.height, image.texels);
        let brightest = if reflectance { texels.brightest() } else { 0.0 };
        if brightest > 1.0 {
            let message = format!("a texel is {brightest}: what is above 1 counts as 1 here");
            reader.warn_of("filename", &message);
            texels = texels.map(|value| value.min(1.0));
        }
        let bitmap = Arc::new(Bitmap {
            width,
            height,
            texels: self.placed(reader, width, texels)?,
            wrap,
            filter,
        });
        self.bitmaps.insert(key, bitmap.clone());
        Ok(bitmap)
    }

    /// Most texels that another image may have.
    pub(in crate::scene::build) fn texels_left(&self) -> u64 {
        let limits = self.loader.limits;
        limits.texels.saturating_sub(self.texels).min(limits.image_texels)
    }

    /// The texels in memory, or in a file where memory has too many.
    fn placed(&mut self, reader: &Reader, width: usize, texels: Texels) -> Result<Texels, SceneError> {
        let bytes = self.texture_bytes.saturating_add(texels.memory());
        if bytes <= self.loader.limits.texture_bytes {
            self.texture_bytes = bytes;
            return Ok(texels);
        }
        let stored = match &self.tiles {
            Some(file) => Ok(file.clone()),
            None => TileFile::new(TILE_CACHE_BYTES).map(Arc::new),
        };
        let stored = stored.and_then(|file| Ok((file.store(width, &texels)?, file)));
        let (tiles, file) = stored.map_err(|error| {
            let reason = format!(
                "textures fill the memory that they may, and it cannot be written to a temporary file: {error}"
            );
            reader.wrong("filename", reason)
        })?;
        self.tiles = Some(file);
        Ok(Texels::Tiled(tiles))
    }
}

/// What the integers of an image stand for: `raw` of Mitsuba 3, or `gamma` of Mitsuba 0.x and pbrt, where 1 says that they are linear
/// and -1 that they are sRGB values.
fn encoding(reader: &Reader) -> Result<Encoding, SceneError> {
    let by_gamma = match reader.float("gamma", ANY)? {
        None => Encoding::Srgb,
        Some(1.0) => Encoding::Linear,
        Some(gamma) if gamma <= 0.0 => Encoding::Srgb,
        Some(gamma) if (0.1..=10.0).contains(&gamma) => Encoding::Gamma(gamma as f32),
        Some(gamma) => {
            let reason = format!("{gamma} is out of range; allowed: 0.1 to 10, or -1 for sRGB");
            reader.fault(reader.wrong("gamma", reason))?;
            Encoding::Srgb
        }
    };
    Ok(match reader.has("raw") {
        true if reader.boolean("raw", false)? => Encoding::Linear,
        true => Encoding::Srgb,
        false => {
            reader.property("raw");
            by_gamma
        }
    })
}
