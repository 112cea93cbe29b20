//! The picture as plain numbers, for programs that show or measure it without a reader of OpenEXR.
//!
//! All numbers are little-endian. A header of 32 bytes: the letters `photonf1`, pixels across and down (`u32` each), the number of
//! iterations (`u64`), the noise of the picture (`f64`, NaN where it is unknown). Then for each pixel, row by row from the top left,
//! four `f32`: radiance in red, green and blue, and the standard error of the luminance, NaN where it is unknown. The values are those
//! of the OpenEXR file, bit for bit. Layers follow likewise: their three channels, or their only one three times, and the standard error
//! of their luminance, which only those of light have. Mattes are shown by a colour for each id.

use photonfarm_core::film::Image;
use photonfarm_core::integrator::layers::{Channel, LayerError, Layers};

/// What such a picture begins with.
const MAGIC: &[u8; 8] = b"photonf1";
/// Length of the header.
const HEADER: usize = 32;
/// Bytes of a pixel.
const PIXEL: usize = 16;

/// An image beside the picture.
pub(super) struct Plane {
    colours: [Vec<f32>; 3],
    /// Empty where it is unknown.
    standard_error: Vec<f32>,
}

/// Layers of a picture with the layers `names` below it, by their places in that list.
///
/// # Errors
/// An image that is no such stack.
pub(super) fn planes(stack: &Image, names: &[String], chosen: &[usize]) -> Result<Vec<Plane>, LayerError> {
    let picture = Layers::parse(names)?.picture_size([stack.width, stack.height]);
    let size = picture.map(|side| side as usize).iter().product::<usize>();
    let mut planes = Vec::new();
    for place in chosen {
        let before = Layers::parse(&names[..*place])?.stack() as usize;
        let layer = Layers::parse(&names[*place..=*place])?;
        // A stack of its own, on whatever lies above it.
        let range = (before - 1) * size..(before + layer.stack() as usize - 1) * size;
        let pixels = stack.pixels.get(range).ok_or(LayerError::Stack {
            height: stack.height,
            planes: layer.stack(),
        })?;
        let alone = Image {
            height: picture[1] * layer.stack(),
            pixels: pixels.to_vec(),
            standard_error: vec![],
            ..*stack
        };
        let is_light = names[*place].starts_with("lamp:") || names[*place].contains('=');
        let errors = stack.standard_error.get(before * size..(before + 1) * size);
        let channels = layer.channels(&alone)?;
        let images: Vec<[Vec<f32>; 3]> = match names[*place].starts_with("cryptomatte:") {
            true => vec![mattes(&channels)],
            false => channels.chunks(3).map(three).collect(),
        };
        for colours in images {
            planes.push(Plane {
                colours,
                standard_error: errors.filter(|_| is_light).unwrap_or_default().to_vec(),
            });
        }
    }
    Ok(planes)
}

/// Three channels, or the only one three times.
fn three(channels: &[Channel]) -> [Vec<f32>; 3] {
    std::array::from_fn(|index| channels[index.min(channels.len() - 1)].samples.clone())
}

/// Mattes as a picture: each id has the colour that its lower bytes give, as much of it as the id covers.
fn mattes(channels: &[Channel]) -> [Vec<f32>; 3] {
    let size = channels.first().map_or(0, |channel| channel.samples.len());
    let mut colours = [0, 1, 2].map(|_| vec![0.0; size]);
    for pair in channels.chunks_exact(2) {
        let pixels = pair[0].samples.iter().zip(&pair[1].samples);
        for (pixel, (id, coverage)) in pixels.enumerate() {
            for (colour, byte) in colours.iter_mut().zip(id.to_bits().to_le_bytes()) {
                colour[pixel] += coverage * f32::from(byte) / 255.0;
            }
        }
    }
    colours
}

/// Writes an image, of this noise, as plain numbers, and others of its size behind it.
pub(super) fn encode_raw(image: &Image, noise: Option<f64>, planes: &[Plane]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + PIXEL * image.pixels.len() * (1 + planes.len()));
    bytes.extend(MAGIC);
    bytes.extend(image.width.to_le_bytes());
    bytes.extend(image.height.to_le_bytes());
    bytes.extend(image.iterations.to_le_bytes());
    bytes.extend(noise.unwrap_or(f64::NAN).to_le_bytes());
    let error = |errors: &[f32], index: usize| errors.get(index).copied().unwrap_or(f32::NAN);
    let mut put = |colours: [f32; 3], error: f32| {
        for value in colours.into_iter().chain([error]) {
            bytes.extend(value.to_le_bytes());
        }
    };
    for (index, pixel) in image.pixels.iter().enumerate() {
        put(pixel.to_rgb(), error(&image.standard_error, index));
    }
    for Plane {
        colours,
        standard_error,
    } in planes
    {
        let [red, green, blue] = colours;
        for (index, ((r, g), b)) in red.iter().zip(green).zip(blue).enumerate() {
            put([*r, *g, *b], error(standard_error, index));
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
            let raw = encode_raw(&image, image.noise(), &[]);
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

    #[test]
    fn layers_follow_the_picture_in_the_order_asked_for() {
        let names = ["normal", "lamp:a", "depth", "halves"].map(str::to_owned);
        let layers = Layers::parse(&names).unwrap();
        let (width, height) = (2, 3);
        let size = width * height;
        let pixels = size * layers.stack() as usize;
        let stack = Image {
            width: width as u32,
            height: height as u32 * layers.stack(),
            iterations: 3,
            odd_iterations: 2,
            pixels: (0..pixels)
                .map(|i| Spectrum::from_rgb([i as f32, 0.5 * i as f32, 7.0]))
                .collect(),
            standard_error: (0..pixels).map(|i| 0.25 * i as f32).collect(),
        };
        let all = layers.channels(&stack).unwrap();
        let samples = |name: &str| &all.iter().find(|channel| channel.name == name).unwrap().samples;
        let planes = planes(&stack, &names, &[2, 1, 3, 0]).unwrap();
        let expected = [
            ["depth.Z", "depth.Z", "depth.Z"],
            ["lamp_a.R", "lamp_a.G", "lamp_a.B"],
            ["half_a.R", "half_a.G", "half_a.B"],
            ["half_b.R", "half_b.G", "half_b.B"],
            ["normal.X", "normal.Y", "normal.Z"],
        ];
        assert_eq!(planes.len(), expected.len());
        for (plane, names) in planes.iter().zip(expected) {
            let found = plane.colours.iter().zip(names);
            found.for_each(|(colour, name)| assert_eq!(colour, samples(name), "{name}"));
        }
        let with_errors: Vec<bool> = planes.iter().map(|plane| !plane.standard_error.is_empty()).collect();
        assert_eq!(with_errors, [false, true, false, false, false]);
        assert_eq!(planes[1].standard_error, stack.standard_error[3 * size..4 * size]);

        let raw = encode_raw(&layers.picture(stack).unwrap(), None, &planes);
        assert_eq!(raw.len(), HEADER + PIXEL * size * 6);
        let value = |at: usize| f32::from_le_bytes(raw[at..at + 4].try_into().unwrap());
        let second = HEADER + PIXEL * size * 2;
        let last = second + PIXEL * (size - 1);
        let expected = ["lamp_a.R", "lamp_a.G", "lamp_a.B"].map(|name| samples(name)[size - 1]);
        assert_eq!([0, 4, 8].map(|offset| value(last + offset)), expected);
        assert_eq!(value(last + 12), 0.25 * (4 * size - 1) as f32);
    }
}
