//! Small pictures for lists, as JPEG.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use photonfarm_core::film::Image;
use photonfarm_core::math;
use photonfarm_core::picture::{PictureError, ToneCurve};

/// Longest side \[pixels\].
const SIDE: u32 = 256;
/// Quality by the scale of the Independent JPEG Group.
const QUALITY: u8 = 82;

/// Writes an image as a small JPEG: as the PNG shows it, each pixel the mean of those that it stands for, in linear light.
pub(super) fn encode_preview(image: &Image) -> Result<Vec<u8>, PictureError> {
    let curve = ToneCurve::fit(&image.pixels);
    let [width, height] = small(image.width, image.height);
    // Rows or columns from `begin` to `end` of `from` become the `index`th of `to`.
    let part = |index: u32, from: u32, to: u32| {
        let at = |index: u32| (u64::from(index) * u64::from(from) / u64::from(to)) as usize;
        at(index)..at(index + 1)
    };
    let mut samples = Vec::with_capacity(width as usize * height as usize * 3);
    for y in 0..height {
        for x in 0..width {
            let (rows, columns) = (part(y, image.height, height), part(x, image.width, width));
            let count = (rows.len() * columns.len()) as f32;
            let mut sum = [0.0; 3];
            for row in rows {
                let from = row * image.width as usize;
                for pixel in &image.pixels[from + columns.start..from + columns.end] {
                    let shown = curve.apply(*pixel);
                    (0..3).for_each(|channel| sum[channel] += shown[channel]);
                }
            }
            samples.extend(sum.map(|sum| (srgb(sum / count) * 255.0 + 0.5) as u8));
        }
    }
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, QUALITY);
    encoder.write_image(&samples, width, height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// The size of a preview: that of the picture, or smaller in the same proportion.
fn small(width: u32, height: u32) -> [u32; 2] {
    let longest = width.max(height).max(SIDE);
    let side = |side: u32| (u64::from(side) * u64::from(SIDE) / u64::from(longest)).max(1) as u32;
    [width, height].map(side)
}

/// The sRGB transfer function (IEC 61966-2-1).
fn srgb(linear: f32) -> f32 {
    match linear <= 0.003_130_8 {
        true => 12.92 * linear,
        false => 1.055 * math::pow(linear, 1.0 / 2.4) - 0.055,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::spectrum::Spectrum;

    fn preview(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> image::RgbImage {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let image = Image {
            width,
            height,
            iterations: 1,
            odd_iterations: 1,
            pixels: pixels.map(|(x, y)| Spectrum::splat(value(x, y))).collect(),
            standard_error: vec![],
        };
        let bytes = encode_preview(&image).unwrap();
        image::load_from_memory_with_format(&bytes, image::ImageFormat::Jpeg)
            .unwrap()
            .to_rgb8()
    }

    #[test]
    fn a_preview_is_small_and_shows_what_the_png_shows() {
        // Middle grey, as in the PNG, is 118.
        let grey = preview(1000, 500, |_, _| 7.0);
        assert_eq!(grey.dimensions(), (256, 128));
        assert!(
            grey.pixels()
                .all(|pixel| pixel.0.iter().all(|&value| value.abs_diff(118) <= 1))
        );
        assert_eq!(preview(3, 2, |_, _| 0.0).dimensions(), (3, 2));
        assert_eq!(preview(4000, 1, |_, _| 1.0).dimensions(), (256, 1));
    }

    #[test]
    fn pixels_are_averaged_as_light_is() {
        // Half of the pixels are black, the others middle grey: half of 0.18 is 84 in sRGB, and half of 118 would be 59.
        let striped = preview(1024, 1024, |x, _| (x % 2) as f32);
        assert!(
            striped.pixels().all(|pixel| pixel.0[0].abs_diff(84) <= 2),
            "{:?}",
            striped.get_pixel(9, 9)
        );
    }
}
