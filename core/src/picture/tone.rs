//! The tone curve of PNG pictures.

use super::PictureError;
use crate::film::Image;
use crate::math;
use crate::spectrum::Spectrum;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// Luminance that the average of the picture is mapped to before compression: a middle grey (Reinhard et al. 2002, section 3).
const KEY: f64 = 0.18;
/// Share of the pixels that may burn out.
const BURN: f64 = 0.001;

/// The global operator of Reinhard, Stark, Shirley and Ferwerda, "Photographic Tone Reproduction for Digital Images" (2002).
///
/// Luminance `L_w` is scaled to `L = a / mean(L_w) * L_w`, where the mean is geometric and over pixels that are not
/// black (eq. 1 and 2), then compressed to `L (1 + L / L_white^2) / (1 + L)` (eq. 4). `L_white` is the luminance that
/// all but a thousandth of the pixels stay below, so that highlights such as caustics keep their shape; it is at
/// least one, where the curve is a straight line. Chromaticity stays; channels beyond one are cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneCurve {
    /// Factor applied to radiance.
    pub exposure: f32,
    /// Scaled luminance that is mapped to one.
    pub white: f32,
}

impl ToneCurve {
    /// The curve that fits a picture.
    #[must_use]
    pub fn fit(pixels: &[Spectrum]) -> Self {
        let mut luminances: Vec<f32> = pixels
            .iter()
            .map(|p| p.luminance())
            .filter(|l| *l > 0.0 && l.is_finite())
            .collect();
        if luminances.is_empty() {
            return Self {
                exposure: 1.0,
                white: 1.0,
            };
        }
        let sum_of_logs: f64 = luminances.iter().map(|&l| libm::log(f64::from(l))).sum();
        let mean = libm::exp(sum_of_logs / luminances.len() as f64);
        let exposure = (KEY / mean).min(f64::from(f32::MAX)) as f32;
        let burnt = (pixels.len() as f64 * BURN) as usize;
        let brightest = luminances.len() - 1 - burnt.min(luminances.len() - 1);
        let (_, white, _) = luminances.select_nth_unstable_by(brightest, f32::total_cmp);
        Self {
            exposure,
            white: (*white * exposure).clamp(1.0, 1e9),
        }
    }

    /// Linear display values of a radiance, in [0, 1].
    #[must_use]
    pub fn apply(&self, radiance: Spectrum) -> [f32; 3] {
        let scaled = radiance.luminance() * self.exposure;
        let factor = self.exposure * (1.0 + scaled / (self.white * self.white)) / (1.0 + scaled);
        radiance
            .to_rgb()
            .map(|c| c * factor)
            .map(|c| if c > 0.0 { c.min(1.0) } else { 0.0 })
    }
}

/// Writes an image as 8-bit PNG in sRGB, by the [`ToneCurve`] that fits it. The same image gives the same bytes.
pub fn encode_png(image: &Image) -> Result<Vec<u8>, PictureError> {
    let curve = ToneCurve::fit(&image.pixels);
    let samples: Vec<u8> = image
        .pixels
        .iter()
        .flat_map(|&p| curve.apply(p).map(|c| (srgb(c) * 255.0 + 0.5) as u8))
        .collect();
    if samples.len() != image.width as usize * image.height as usize * 3 {
        return Err(PictureError::Size {
            width: image.width,
            height: image.height,
            pixels: image.pixels.len(),
            standard_errors: image.standard_error.len(),
        });
    }
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive).write_image(
        &samples,
        image.width,
        image.height,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

/// The sRGB transfer function (IEC 61966-2-1).
fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * math::pow(linear, 1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, luminances: &[f32]) -> Image {
        Image {
            width,
            height: luminances.len() as u32 / width,
            iterations: 1,
            odd_iterations: 1,
            pixels: luminances.iter().map(|&l| Spectrum::splat(l)).collect(),
            standard_error: Vec::new(),
        }
    }

    fn decode(bytes: &[u8]) -> image::RgbImage {
        image::load_from_memory_with_format(bytes, image::ImageFormat::Png)
            .unwrap()
            .to_rgb8()
    }

    #[test]
    fn a_uniform_picture_is_middle_grey() {
        let decoded = decode(&encode_png(&picture(4, &[7.0; 16])).unwrap());
        // sRGB of 0.18: 1.055 * 0.18^(1 / 2.4) - 0.055 = 0.4613, of 255: 117.6.
        assert!(
            decoded.pixels().all(|p| p.0 == [118, 118, 118]),
            "{:?}",
            decoded.get_pixel(0, 0)
        );
    }

    #[test]
    fn exposure_does_not_depend_on_units_or_black_pixels() {
        let mut luminances = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8];
        let reference = encode_png(&picture(4, &luminances)).unwrap();
        luminances.iter_mut().for_each(|l| *l *= 1024.0);
        assert_eq!(encode_png(&picture(4, &luminances)).unwrap(), reference);
        let fit = |l: &[f32]| ToneCurve::fit(&picture(1, l).pixels);
        assert_eq!(fit(&[0.5, 2.0, 0.0, 0.0]).exposure, fit(&[0.5, 2.0]).exposure);
    }

    #[test]
    fn highlights_stay_apart_and_order_is_kept() {
        let luminances: Vec<f32> = (0..64).map(|i| 0.01 * math::exp(0.12 * i as f32)).collect();
        let decoded = decode(&encode_png(&picture(8, &luminances)).unwrap());
        let levels: Vec<u8> = decoded.pixels().map(|p| p.0[0]).collect();
        assert!(levels.windows(2).all(|w| w[0] < w[1]), "{levels:?}");
        assert_eq!(levels[63], 255);
    }

    #[test]
    fn black_and_unusual_values_are_written() {
        assert!(
            decode(&encode_png(&picture(2, &[0.0; 4])).unwrap())
                .pixels()
                .all(|p| p.0 == [0; 3])
        );
        let odd = [f32::NAN, f32::INFINITY, -1.0, f32::MIN_POSITIVE, f32::MAX, 1.0];
        assert_eq!(decode(&encode_png(&picture(3, &odd)).unwrap()).dimensions(), (3, 2));
        assert!(matches!(
            encode_png(&picture(4, &[1.0; 6])),
            Err(PictureError::Size { .. })
        ));
    }

    #[test]
    fn saturated_colours_keep_their_hue_below_one() {
        let curve = ToneCurve {
            exposure: 1.0,
            white: 4.0,
        };
        let [r, g, b] = curve.apply(Spectrum::from_rgb([0.8, 0.4, 0.2]));
        assert!((r / g - 2.0).abs() < 1e-6 && (g / b - 2.0).abs() < 1e-6);
    }
}
