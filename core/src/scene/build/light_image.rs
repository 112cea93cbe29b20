//! Lights that are images over all directions: `envmap` and `goniometric`.

use super::Builder;
use super::texture::{colour, light_colour};
use crate::light::{Light, Mapping};
use crate::math::Transform;
use crate::scene::error::SceneError;
use crate::scene::ies;
use crate::scene::linear_image::{Encoding, Reading};
use crate::scene::reader::{POSITIVE, Reader};
use crate::scene::spectrum::{BRIGHTEST, Use};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, TextureFilter, WrapMode};
use std::sync::Arc;

/// An image with its mapping and the factor on it.
struct LightImage {
    image: Arc<Bitmap>,
    mapping: Mapping,
    scale: f32,
}

impl Builder<'_, '_> {
    pub(super) fn environment_map(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let scale = colour(reader, "scale", Use::Emission)?.unwrap_or(Spectrum::ONE);
        // Importance sampling is never compensated; the estimate has the same mean either way.
        reader.boolean("mis_compensation", false)?;
        let LightImage { image, mapping, scale } = self.light_image(reader, scale, "scale")?;
        Ok(Light::Environment {
            image,
            mapping,
            scale,
            to_world,
        })
    }

    pub(super) fn goniometric(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let intensity = light_colour(reader, "intensity", 1.0)?;
        let factor = reader.float_or("scale", POSITIVE, 1.0)? as f32;
        let file = self.file(reader)?;
        if !file.name.to_ascii_lowercase().ends_with(".ies") {
            let LightImage { image, mapping, scale } = self.light_image(reader, intensity * factor, "intensity")?;
            return Ok(Light::Goniometric {
                to_world,
                image,
                mapping,
                scale,
            });
        }
        reader.choice("mapping", &MAPPINGS, Mapping::LatitudeLongitude)?;
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

    /// The image that `filename` names, times `factor`, which the property `name` gives.
    fn light_image(&mut self, reader: &Reader, factor: Spectrum, name: &str) -> Result<LightImage, SceneError> {
        let mapping = reader.choice("mapping", &MAPPINGS, Mapping::LatitudeLongitude)?;
        let encoding = match reader.boolean("raw", false)? {
            true => Encoding::Linear,
            false => Encoding::Srgb,
        };
        let reading = Reading {
            encoding,
            ..Reading::COLOURS
        };
        let image = self.bitmap_file(reader, &reading, WrapMode::Repeat, TextureFilter::Bilinear, false)?;
        reader.finish();
        let (width, height) = (image.width, image.height);
        if width < 2 || height < 2 {
            let reason = format!("an image over all directions has 2 x 2 texels or more, found {width} x {height}");
            return Err(reader.wrong("filename", reason));
        }
        if mapping == Mapping::EqualArea && width != height {
            let reason = format!("an image of mapping `equalarea` is a square, found {width} x {height} texels");
            return Err(reader.wrong("filename", reason));
        }
        let (image, scale) = coloured(image, factor);
        check_brightness(reader, &image, scale, name)?;
        Ok(LightImage { image, mapping, scale })
    }
}

const MAPPINGS: [(&str, Mapping); 2] = [
    ("latitudelongitude", Mapping::LatitudeLongitude),
    ("equalarea", Mapping::EqualArea),
];

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
