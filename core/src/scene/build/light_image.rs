//! Lights that are images over all directions: `envmap` and `goniometric`.

use super::Builder;
use super::texture::{colour, light_colour};
use crate::light::{Light, Mapping};
use crate::math::{PI, Transform};
use crate::scene::error::SceneError;
use crate::scene::ies;
use crate::scene::linear_image::{Channel, Encoding, Reading};
use crate::scene::reader::{POSITIVE, Reader};
use crate::scene::spectrum::{BRIGHTEST, Use};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, TextureFilter, WrapMode};
use glam::{DMat4, DVec4};
use std::f64::consts::TAU;
use std::sync::Arc;

/// An image with its mapping and the factor on it.
struct LightImage {
    image: Arc<Bitmap>,
    mapping: Mapping,
    scale: f32,
    /// Whether its pole is +z.
    lies: bool,
}

impl Builder<'_, '_> {
    pub(super) fn environment_map(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let scale = colour(reader, "scale", Use::Emission)?.unwrap_or(Spectrum::ONE);
        // Importance sampling is never compensated; the estimate has the same mean either way.
        reader.boolean("mis_compensation", false)?;
        let illuminance = reader.float("illuminance", POSITIVE)?;
        let found = self.light_image(reader, scale, ("scale", Channel::All))?;
        let factor = illuminance.map_or(1.0, |illuminance| illuminance as f32 / upper_illuminance(&found.image));
        Ok(Light::Environment {
            to_world: found.turned(&to_world),
            image: found.image,
            mapping: found.mapping,
            scale: found.scale * if factor.is_finite() { factor } else { 1.0 },
        })
    }

    pub(super) fn goniometric(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let intensity = light_colour(reader, "intensity", 1.0)?;
        let factor = reader.float_or("scale", POSITIVE, 1.0)? as f32;
        let file = self.file(reader)?;
        if !file.name.to_ascii_lowercase().ends_with(".ies") {
            let power = reader.float("power", POSITIVE)?;
            let channel = match reader.string("mapping")? {
                // A lamp of pbrt has one colour.
                Some("pbrt") => Channel::Mean,
                _ => Channel::All,
            };
            let found = self.light_image(reader, intensity * factor, ("intensity", channel))?;
            let mean = Spectrum::average(found.image.texels.iter()).luminance();
            let factor = power.map_or(1.0, |power| power as f32 / (4.0 * PI * mean));
            return Ok(Light::Goniometric {
                to_world: found.turned(&to_world),
                image: found.image,
                mapping: found.mapping,
                scale: found.scale * if factor.is_finite() { factor } else { 1.0 },
            });
        }
        reader.choice("mapping", &MAPPINGS, Written::Mapping(Mapping::LatitudeLongitude))?;
        reader.finish();
        let profile = ies::read(&file)?;
        let image = Arc::new(profile.image());
        let (image, scale) = coloured(image, intensity * factor);
        check_brightness(reader, &image, scale, "intensity")?;
        Ok(Light::Goniometric {
            // Angles of a profile are counted from the axis, as those of a spot.
            to_world: to_world.after(&super::light::upright_image()),
            image,
            mapping: Mapping::LatitudeLongitude,
            scale,
        })
    }

    /// A channel of the image that `filename` names, times `factor`, which the property `name` gives.
    fn light_image(
        &mut self,
        reader: &Reader,
        factor: Spectrum,
        (name, channel): (&str, Channel),
    ) -> Result<LightImage, SceneError> {
        let written = reader.choice("mapping", &MAPPINGS, Written::Mapping(Mapping::LatitudeLongitude))?;
        let encoding = match reader.boolean("raw", false)? {
            true => Encoding::Linear,
            false => Encoding::Srgb,
        };
        let reading = Reading {
            encoding,
            channel,
            ..Reading::COLOURS
        };
        let image = self.bitmap_file(reader, &reading, WrapMode::Repeat, TextureFilter::Bilinear, false)?;
        reader.finish();
        let (width, height) = (image.width, image.height);
        if width < 2 || height < 2 {
            let reason = format!("an image over all directions has 2 x 2 texels or more, found {width} x {height}");
            return Err(reader.wrong("filename", reason));
        }
        let mapping = match written {
            Written::Mapping(mapping) => mapping,
            Written::Pbrt if width == height => Mapping::EqualArea,
            Written::Pbrt => Mapping::LatitudeLongitude,
        };
        if mapping == Mapping::EqualArea && width != height {
            let reason = format!("an image of mapping `equalarea` is a square, found {width} x {height} texels");
            return Err(reader.wrong("filename", reason));
        }
        let (image, scale) = coloured(image, factor);
        check_brightness(reader, &image, scale, name)?;
        Ok(LightImage {
            image,
            mapping,
            scale,
            lies: written == Written::Pbrt && mapping == Mapping::LatitudeLongitude,
        })
    }
}

/// What `mapping` says.
#[derive(Clone, Copy, PartialEq)]
enum Written {
    Mapping(Mapping),
    /// pbrt-v4's for a square image, and pbrt-v3's for others.
    Pbrt,
}

const MAPPINGS: [(&str, Written); 3] = [
    ("latitudelongitude", Written::Mapping(Mapping::LatitudeLongitude)),
    ("equalarea", Written::Mapping(Mapping::EqualArea)),
    ("pbrt", Written::Pbrt),
];

impl LightImage {
    /// The frame of the image in the world. Images of pbrt-v3 have the pole +z, and the left edge +x, from where they go to +y; ours
    /// have the pole +y and the middle +z.
    fn turned(&self, to_world: &Transform) -> Transform {
        if !self.lies {
            return *to_world;
        }
        let turn = DMat4::from_cols(DVec4::Y, DVec4::Z, DVec4::NEG_X, DVec4::W);
        to_world.after(&Transform::from_matrix(turn).unwrap_or_default())
    }
}

/// The illuminance of a horizontal surface under a square image of equal areas, as pbrt-v4 computes it (`Light::Create`): it counts each
/// texel of the upper half with half of its solid angle.
fn upper_illuminance(image: &Bitmap) -> f32 {
    let texel = |index: usize, side: usize| ((index as f64 + 0.5) / side as f64 * 2.0 - 1.0).abs();
    let cosines = image.texels.iter().enumerate().map(|(index, value)| {
        // The distance from the middle by which the mapping tells the height.
        let r = texel(index % image.width, image.width) + texel(index / image.width, image.height);
        f64::from(value.luminance()) * (1.0 - r * r).max(0.0)
    });
    (cosines.sum::<f64>() * TAU / (image.width * image.height) as f64) as f32
}

/// An image and a factor on it that together are `image` times `factor`.
fn coloured(image: Arc<Bitmap>, factor: Spectrum) -> (Arc<Bitmap>, f32) {
    let [r, g, b] = factor.to_rgb();
    if r == g && g == b {
        return (image, r);
    }
    let texels: Vec<Spectrum> = image.texels.iter().map(|texel| texel * factor).collect();
    let coloured = Bitmap {
        texels: texels.into(),
        ..Bitmap::clone(&image)
    };
    (Arc::new(coloured), 1.0)
}

fn check_brightness(reader: &Reader, image: &Bitmap, scale: f32, name: &str) -> Result<(), SceneError> {
    let brightest = image.texels.brightest();
    if f64::from(brightest) * f64::from(scale) <= BRIGHTEST {
        return Ok(());
    }
    let reason = format!("the brightest texel, {brightest}, times {scale} is above {BRIGHTEST:e}");
    Err(reader.wrong(name, reason))
}
