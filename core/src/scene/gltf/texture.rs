//! Textures: an image with a sampler and a transform of coordinates becomes a `bitmap`.

use super::accessor::Accessors;
use super::container::resource;
use super::document::{Document, TextureInfo, TextureTransform};
use super::warnings::Told;
use crate::math::Transform;
use crate::scene::description::{Draft, Kind, ObjectId, Value};
use crate::scene::error::{SceneError, shortened};
use crate::scene::loader::{LoadedFile, Loader};
use glam::{DMat4, DVec3, DVec4};
use image::{ImageFormat, ImageReader};
use std::collections::BTreeMap;
use std::io::Cursor;

/// What of an image is taken.
#[derive(Clone, Copy)]
pub(super) struct Sampling {
    /// Whether its values are numbers, and not colours in sRGB.
    raw: bool,
    /// The one channel that counts, or all.
    channel: Option<&'static str>,
    /// By which its values are multiplied.
    factor: [f64; 3],
}

impl Sampling {
    /// Colours, times `factor`.
    pub(super) fn colour(factor: [f64; 3]) -> Self {
        Self {
            raw: false,
            channel: None,
            factor,
        }
    }

    /// Linear numbers in all channels.
    pub(super) fn numbers() -> Self {
        Self {
            raw: true,
            ..Self::colour([1.0; 3])
        }
    }

    /// One channel of linear numbers, times `factor`.
    pub(super) fn channel(channel: &'static str, factor: f64) -> Self {
        Self {
            raw: true,
            channel: Some(channel),
            ..Self::colour([factor; 3])
        }
    }
}

/// The document's textures; each image is read once.
pub(super) struct Textures<'a> {
    pub(super) document: &'a Document,
    pub(super) accessors: &'a Accessors<'a>,
    pub(super) told: &'a Told,
    pub(super) scene: &'a LoadedFile,
    pub(super) images: BTreeMap<usize, LoadedFile>,
}

impl Textures<'_> {
    /// Adds a texture. `written` is what messages call it.
    pub(super) fn add(
        &mut self,
        draft: &mut Draft,
        loader: &mut Loader,
        info: &TextureInfo,
        written: &str,
        sampling: Sampling,
    ) -> Result<ObjectId, SceneError> {
        let file = self.file(info, loader, written)?;
        let object = self.bitmap(draft, info, file, written)?;
        if sampling.raw {
            draft.set(object, "raw", Value::Boolean(true));
        }
        if let Some(channel) = sampling.channel {
            draft.set(object, "channel", Value::String(channel.into()));
        }
        if sampling.factor == [1.0; 3] {
            return Ok(object);
        }
        let scaled = draft.add(Kind::Texture, "scale", Some(written), self.told.place());
        draft.set(scaled, "scale", Value::Rgb(sampling.factor));
        draft.link(scaled, None, object);
        Ok(scaled)
    }

    /// Adds a texture of numbers that are made of the image's pixels.
    pub(super) fn add_changed(
        &mut self,
        draft: &mut Draft,
        loader: &mut Loader,
        info: &TextureInfo,
        written: &str,
        change: Change,
    ) -> Result<ObjectId, SceneError> {
        let file = self.file(info, loader, written)?;
        let changed = change
            .of(&file, loader.limits.image_texels)
            .map_err(|reason| SceneError::value(self.told.place(), written, reason))?;
        let object = self.bitmap(draft, info, changed, written)?;
        draft.set(object, "raw", Value::Boolean(true));
        Ok(object)
    }

    /// The file of a texture's image.
    fn file(&mut self, info: &TextureInfo, loader: &mut Loader, written: &str) -> Result<LoadedFile, SceneError> {
        let wrong = |reason: String| SceneError::value(self.told.place(), written, reason);
        let textures = &self.document.textures;
        let texture = textures.get(info.index).ok_or_else(|| {
            wrong(format!(
                "there is no texture {}; the file has {}",
                info.index,
                textures.len()
            ))
        })?;
        let other = texture.extensions.webp.as_ref().map(|webp| webp.source);
        let Some(source) = other.or(texture.source) else {
            if texture.extensions.basisu.is_some() {
                let instead = "export PNG or JPEG images (in Blender, Material > Images)";
                return Err(self
                    .accessors
                    .unsupported(written.into(), "KHR_texture_basisu", instead));
            }
            return Err(wrong(format!("texture {} has no image", info.index)));
        };
        self.image(source, loader, written)
    }

    /// Adds a bitmap of an image with the sampler and the transform of a texture that exists.
    fn bitmap(
        &self,
        draft: &mut Draft,
        info: &TextureInfo,
        file: LoadedFile,
        written: &str,
    ) -> Result<ObjectId, SceneError> {
        let object = draft.add(Kind::Texture, "bitmap", Some(written), self.told.place());
        draft.set(object, "filename", Value::File(file));
        let sampler = self
            .document
            .textures
            .get(info.index)
            .and_then(|texture| texture.sampler);
        self.sampler(draft, object, sampler, written)?;
        if let Some(transform) = &info.extensions.transform {
            match to_uv(transform) {
                Some(to_uv) => draft.set(object, "to_uv", Value::Transform(Box::new(to_uv))),
                None => self.told.warn(format!(
                    "{written}: KHR_texture_transform has no inverse and is left out"
                )),
            }
        }
        Ok(object)
    }

    /// Sets how coordinates outside the image and between texels are taken.
    fn sampler(
        &self,
        draft: &mut Draft,
        object: ObjectId,
        sampler: Option<usize>,
        written: &str,
    ) -> Result<(), SceneError> {
        let Some(index) = sampler else { return Ok(()) };
        let samplers = &self.document.samplers;
        let sampler = samplers.get(index).ok_or_else(|| {
            let reason = format!("there is no sampler {index}; the file has {}", samplers.len());
            SceneError::value(self.told.place(), written, reason)
        })?;
        const NEAREST: u32 = 9728;
        if sampler.mag_filter == Some(NEAREST) {
            draft.set(object, "filter_type", Value::String("nearest".into()));
        }
        let wrap = |mode: Option<u32>| match mode {
            Some(33071) => "clamp",
            Some(33648) => "mirror",
            _ => "repeat",
        };
        let (u, v) = (wrap(sampler.wrap_s), wrap(sampler.wrap_t));
        if u != v {
            self.told
                .warn(format!("{written}: `wrapT` is {v}; it is rendered as {u}, as `wrapS`"));
        }
        draft.set(object, "wrap_mode", Value::String(u.into()));
        Ok(())
    }

    /// The file of an image.
    fn image(&mut self, index: usize, loader: &mut Loader, written: &str) -> Result<LoadedFile, SceneError> {
        if let Some(file) = self.images.get(&index) {
            return Ok(file.clone());
        }
        let images = &self.document.images;
        let place = self.told.place();
        let image = images.get(index).ok_or_else(|| {
            let reason = format!("there is no image {index}; the file has {}", images.len());
            SceneError::value(place, written, reason)
        })?;
        let field = format!("images[{index}]");
        let file = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => resource(loader, self.scene, place, &format!("{field}.uri"), uri)?,
            (None, Some(view)) => LoadedFile {
                name: format!("{}#{field} \"{}\"", self.scene.name, shortened(&image.name)),
                bytes: self.accessors.view(view, &field)?,
            },
            (None, None) => {
                let reason = "it has neither `uri` nor `bufferView`";
                return Err(SceneError::value(place, field, reason));
            }
        };
        self.images.insert(index, file.clone());
        Ok(file)
    }
}

/// What is made of an image before it is rendered.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// 1 where its alpha, times `factor`, reaches `cutoff`, and 0 elsewhere.
    Cut { factor: f64, cutoff: f64 },
    /// Normals whose first two coordinates are multiplied by `scale` (section 3.9.3 of the specification).
    Steeper { scale: f64 },
}

impl Change {
    /// The changed image. Errors say what is wrong with the image.
    fn of(self, file: &LoadedFile, most_texels: u64) -> Result<LoadedFile, String> {
        let broken = |error: image::ImageError| format!("broken image: {error}");
        let reader = || {
            let reader = ImageReader::new(Cursor::new(&file.bytes[..])).with_guessed_format();
            reader.map_err(|error| format!("broken image: {error}"))
        };
        let (width, height) = reader()?.into_dimensions().map_err(broken)?;
        let texels = u64::from(width) * u64::from(height);
        if texels > most_texels {
            return Err(format!("number of texels: {texels} is over the limit of {most_texels}"));
        }
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(most_texels.saturating_mul(16).max(1 << 20));
        let mut reader = reader()?;
        reader.limits(limits);
        let mut pixels = reader.decode().map_err(broken)?.into_rgba16();
        pixels.pixels_mut().for_each(|pixel| pixel.0 = self.pixel(pixel.0));
        let mut bytes = Cursor::new(Vec::new());
        pixels.write_to(&mut bytes, ImageFormat::Png).map_err(broken)?;
        Ok(LoadedFile {
            name: format!("{} as {self:?}", file.name),
            bytes: bytes.into_inner().into(),
        })
    }

    /// What becomes of a pixel.
    pub(super) fn pixel(self, [r, g, b, a]: [u16; 4]) -> [u16; 4] {
        const MOST: f64 = u16::MAX as f64;
        match self {
            Self::Cut { factor, cutoff } => {
                let shows = f64::from(a) / MOST * factor >= cutoff;
                let level = if shows { u16::MAX } else { 0 };
                [level, level, level, u16::MAX]
            }
            Self::Steeper { scale } => {
                let [x, y, z] = [r, g, b].map(|c| f64::from(c) / MOST * 2.0 - 1.0);
                let normal = DVec3::new(x * scale, y * scale, z).normalize_or(DVec3::Z);
                let [x, y, z] = normal.to_array().map(|c| ((0.5 * c + 0.5) * MOST).round() as u16);
                [x, y, z, u16::MAX]
            }
        }
    }
}

/// The map of KHR_texture_transform: scale, then rotation, then offset. `None` where it has no inverse.
pub(super) fn to_uv(transform: &TextureTransform) -> Option<Transform> {
    let (sine, cosine) = (libm::sin(transform.rotation), libm::cos(transform.rotation));
    let [x, y] = transform.scale;
    Transform::from_matrix(DMat4::from_cols(
        DVec4::new(cosine * x, -sine * x, 0.0, 0.0),
        DVec4::new(sine * y, cosine * y, 0.0, 0.0),
        DVec4::Z,
        DVec4::new(transform.offset[0], transform.offset[1], 0.0, 1.0),
    ))
}
