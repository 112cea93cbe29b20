//! The picture as plain numbers, for programs that show or measure it without a reader of OpenEXR.
//!
//! All numbers are little-endian. A header of 32 bytes: the letters `photonf1`, pixels across and down (`u32` each), the number of
//! iterations (`u64`), the noise of the picture (`f64`, NaN where it is unknown). Then for each pixel, row by row from the top left,
//! four `f32`: radiance in red, green and blue, and the standard error of the luminance, NaN where it is unknown. The values are those
//! of the OpenEXR file, bit for bit.

use photonfarm_core::film::Image;

/// What such a picture begins with.
const MAGIC: &[u8; 8] = b"photonf1";
/// Length of the header.
const HEADER: usize = 32;
/// Bytes of a pixel.
const PIXEL: usize = 16;

/// Writes an image, of this noise, as plain numbers.
pub(super) fn encode_raw(image: &Image, noise: Option<f64>) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + PIXEL * image.pixels.len());
    bytes.extend(MAGIC);
    bytes.extend(image.width.to_le_bytes());
    bytes.extend(image.height.to_le_bytes());
    bytes.extend(image.iterations.to_le_bytes());
    bytes.extend(noise.unwrap_or(f64::NAN).to_le_bytes());
    for (index, pixel) in image.pixels.iter().enumerate() {
        let error = image.standard_error.get(index).copied().unwrap_or(f32::NAN);
        let [r, g, b] = pixel.to_rgb();
        for value in [r, g, b, error] {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::picture::{Beside, PictureMetadata, decode_exr, encode_exr};
    use photonfarm_core::spectrum::Spectrum;

    fn metadata() -> PictureMetadata {
        let integrator = photonfarm_core::settings::IntegratorSettings::Path(Default::default());
        PictureMetadata {
            version: String::new(),
            renderer: String::new(),
            scene_hash: String::new(),
            main: String::new(),
            defines: Default::default(),
            sensor: None,
            layers: vec![],
            crop: None,
            integrator,
            warnings: vec![],
            seed: 0,
            iterations: 2,
            iterations_asked: None,
            sigma: None,
            theta: None,
            noise: None,
        }
    }

    #[test]
    fn the_numbers_are_those_of_the_exr_bit_for_bit() {
        let value = |index: usize| Spectrum::from_rgb([0.1 * index as f32, 1e-20, 3.0e30 / (1.0 + index as f32)]);
        for with_errors in [true, false] {
            let image = Image {
                width: 3,
                height: 2,
                iterations: 7,
                odd_iterations: 4,
                pixels: (0..6).map(value).collect(),
                standard_error: if with_errors {
                    (0..6).map(|index| 0.3 * index as f32).collect()
                } else {
                    vec![]
                },
            };
            let raw = encode_raw(&image, image.noise());
            let exr = decode_exr(&encode_exr(&image, Beside::default(), &metadata()).unwrap(), 100).unwrap();
            assert_eq!((&raw[..8], raw.len()), (&MAGIC[..], 32 + 6 * 16));
            let number = |at: usize| u32::from_le_bytes(raw[at..at + 4].try_into().unwrap());
            assert_eq!([8, 12, 16, 20].map(number), [3, 2, 7, 0]);
            let noise = f64::from_le_bytes(raw[24..32].try_into().unwrap());
            assert_eq!(Some(noise).filter(|noise| !noise.is_nan()), image.noise());
            for index in 0..6 {
                let [r, g, b] = exr.pixels[index].to_rgb().map(f32::to_bits);
                let error = exr.standard_error.get(index).map_or(f32::NAN, |error| *error);
                let found = [0, 4, 8, 12].map(|at| number(32 + 16 * index + at));
                assert_eq!(found, [r, g, b, error.to_bits()]);
            }
        }
    }
}
