//! OpenEXR: 32-bit float channels R, G and B, the standard error of the luminance, and metadata.

use super::PictureError;
use super::metadata::{Entry, PictureMetadata, in_ascii};
use crate::film::Image;
use crate::integrator::layers::Channel;
use crate::spectrum::Spectrum;
use exr::image::write::WritableImage;
use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer};
use exr::math::Vec2;
use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, Chromaticities, IntegerBounds, Text};
use exr::meta::header::LayerAttributes;
use exr::prelude::{ReadChannels, ReadLayers, ReadSpecificChannel};
use std::io::Cursor;

/// Channel with the standard error of each pixel's luminance.
const STANDARD_ERROR: &str = "standard_error";
/// Attribute with the whole metadata as JSON.
const METADATA: &str = "photonfarm";
/// Most bytes that all channels of a pixel may take in a file that is read: 80 channels of 32 bits.
const MAX_BYTES_PER_PIXEL: usize = 320;
/// CIE xy chromaticities of Rec. 709 (ITU-R BT.709-6, item 1.3 and 1.4).
const REC_709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// A picture as read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedExr {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Radiance, row by row from the top left.
    pub pixels: Vec<Spectrum>,
    /// Standard error of each pixel's luminance; empty where the file has none.
    pub standard_error: Vec<f32>,
    /// How the picture was made, where the file is one of ours.
    pub metadata: Option<PictureMetadata>,
}

/// What a file holds beside the picture and how it was made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beside {
    /// Channels of layers.
    pub channels: Vec<Channel>,
    /// Attributes by name, which programs know that read the channels: text in which all but ASCII is written as in JSON.
    pub attributes: Vec<(String, String)>,
    /// Pixels across and down of the whole picture, where the image is the window of it that the metadata name.
    pub whole: Option<[u32; 2]>,
}

/// Writes an image as OpenEXR. The same image, metadata and what is beside them give the same bytes.
///
/// A window of a picture is the data window, and the whole picture the display window.
pub fn encode_exr(image: &Image, beside: Beside, metadata: &PictureMetadata) -> Result<Vec<u8>, PictureError> {
    let Beside {
        channels: layers,
        attributes: further,
        whole,
    } = beside;
    let size = image.width as usize * image.height as usize;
    let errors = image.standard_error.len();
    let complete = layers.iter().all(|channel| channel.samples.len() == size);
    if image.pixels.len() != size || (errors != 0 && errors != size) || size == 0 || !complete {
        return Err(PictureError::Size {
            width: image.width,
            height: image.height,
            pixels: image.pixels.len(),
            standard_errors: errors,
        });
    }
    let colour = |channel: usize| image.pixels.iter().map(|p| p.to_rgb()[channel]).collect();
    let mut channels = vec![
        linear_channel("R", colour(0)),
        linear_channel("G", colour(1)),
        linear_channel("B", colour(2)),
    ];
    if errors != 0 {
        channels.push(linear_channel(STANDARD_ERROR, image.standard_error.clone()));
    }
    let layers = layers.into_iter();
    channels.extend(layers.map(|channel| linear_channel(&channel.name, channel.samples)));
    let (width, height) = (image.width as usize, image.height as usize);
    let mut attributes = attributes(metadata, further)?;
    if let Some(window) = metadata.crop {
        attributes.layer_position = Vec2(window.x as i32, window.y as i32);
    }
    let layer = Layer::new(
        (width, height),
        attributes,
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels.into()),
    );
    let mut picture = exr::image::Image::from_layer(layer);
    picture.attributes.chromaticities = Some(REC_709);
    if let Some(whole) = whole {
        let [width, height] = whole.map(|side| side as usize);
        picture.attributes.display_window = IntegerBounds::from_dimensions((width, height));
    }
    let mut bytes = Vec::new();
    picture.write().non_parallel().to_buffered(Cursor::new(&mut bytes))?;
    sort_header(&mut bytes);
    Ok(bytes)
}

fn linear_channel(name: &str, samples: Vec<f32>) -> AnyChannel<FlatSamples> {
    AnyChannel {
        name: Text::from(name),
        sample_data: FlatSamples::F32(samples),
        quantize_linearly: true,
        sampling: Vec2(1, 1),
    }
}

fn attributes(metadata: &PictureMetadata, further: Vec<(String, String)>) -> Result<LayerAttributes, PictureError> {
    let mut attributes = LayerAttributes {
        software_name: Some(text(&format!("Photonfarm {}", metadata.version))),
        ..LayerAttributes::default()
    };
    for (name, entry) in metadata.entries()? {
        let value = match entry {
            Entry::Text(value) => AttributeValue::Text(text(&value)),
            Entry::Integer(value) => AttributeValue::I32(value),
            Entry::Float(value) => AttributeValue::F32(value),
        };
        attributes.other.insert(text(&name), value);
    }
    for (name, value) in further {
        let value = AttributeValue::Text(text(&in_ascii(&value)));
        attributes.other.insert(text(&name), value);
    }
    let json = serde_json::to_string(metadata)?;
    attributes
        .other
        .insert(text(METADATA), AttributeValue::Text(text(&in_ascii(&json))));
    Ok(attributes)
}

/// Text of the file; what is not ASCII becomes a question mark, since the format names no encoding.
fn text(value: &str) -> Text {
    let ascii = value.bytes().map(|b| if b.is_ascii() { b } else { b'?' }).collect();
    Text::from_bytes_unchecked(ascii)
}

/// Sorts the attributes of the header by name: the `exr` crate keeps those of applications in a hash map, whose order
/// differs from run to run. Each is a name and a type, both ended by a zero, a length and that many bytes; an empty
/// name ends the header. The header's length stays, so offsets into the file stay right.
fn sort_header(bytes: &mut [u8]) {
    const START: usize = 8;
    let end_of_text = |from: usize| from + bytes[from..].iter().position(|&b| b == 0).map_or(0, |n| n + 1);
    let mut attributes: Vec<&[u8]> = Vec::new();
    let mut at = START;
    while bytes[at] != 0 {
        let size_at = end_of_text(end_of_text(at));
        let size = u32::from_le_bytes(std::array::from_fn(|i| bytes[size_at + i])) as usize;
        let next = size_at + 4 + size;
        attributes.push(&bytes[at..next]);
        at = next;
    }
    attributes.sort_unstable();
    let sorted = attributes.concat();
    bytes[START..at].copy_from_slice(&sorted);
}

/// Reads an OpenEXR file of at most `max_pixels` pixels: R, G and B of the first layer that has them, as 16- or 32-bit
/// values.
pub fn decode_exr(bytes: &[u8], max_pixels: usize) -> Result<DecodedExr, PictureError> {
    for header in MetaData::read_from_buffered(Cursor::new(bytes), false)?.headers {
        let Vec2(width, height) = header.layer_size;
        if width.checked_mul(height).is_none_or(|pixels| pixels > max_pixels) {
            return Err(PictureError::TooLarge {
                width,
                height,
                limit: max_pixels,
            });
        }
        if header.channels.bytes_per_pixel > MAX_BYTES_PER_PIXEL {
            let reason = format!(
                "{} bytes per pixel; the limit is {MAX_BYTES_PER_PIXEL}",
                header.channels.bytes_per_pixel
            );
            return Err(exr::error::Error::NotSupported(reason.into()).into());
        }
    }
    let picture = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required("R")
        .required("G")
        .required("B")
        .optional(STANDARD_ERROR, 0.0)
        .collect_pixels(
            |size, (.., error)| Raster {
                width: size.width(),
                pixels: vec![Spectrum::ZERO; size.area()],
                standard_error: vec![0.0; if error.is_some() { size.area() } else { 0 }],
            },
            |raster: &mut Raster, at, (r, g, b, error): (f32, f32, f32, f32)| {
                let index = at.y() * raster.width + at.x();
                raster.pixels[index] = Spectrum::from_rgb([r, g, b]);
                if let Some(slot) = raster.standard_error.get_mut(index) {
                    *slot = error;
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))?;
    let layer = picture.layer_data;
    let metadata = metadata_in(&layer.attributes)?;
    Ok(DecodedExr {
        width: layer.size.width() as u32,
        height: layer.size.height() as u32,
        pixels: layer.channel_data.pixels.pixels,
        standard_error: layer.channel_data.pixels.standard_error,
        metadata,
    })
}

/// Reads how a picture was made, where the file is one of ours.
pub fn read_metadata(bytes: &[u8]) -> Result<Option<PictureMetadata>, PictureError> {
    let headers = MetaData::read_from_buffered(Cursor::new(bytes), false)?.headers;
    let found = headers.iter().map(|header| metadata_in(&header.own_attributes));
    found.reduce(|first, next| Ok(first?.or(next?))).unwrap_or(Ok(None))
}

fn metadata_in(attributes: &LayerAttributes) -> Result<Option<PictureMetadata>, PictureError> {
    match attributes.other.get(&text(METADATA)) {
        Some(AttributeValue::Text(json)) => Ok(Some(serde_json::from_slice(json.as_slice())?)),
        _ => Ok(None),
    }
}

/// Pixels while a file is read.
struct Raster {
    width: usize,
    pixels: Vec<Spectrum>,
    standard_error: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{IntegratorSettings, PcfSettings};

    const MANY: usize = 1 << 20;

    fn image(width: u32, height: u32, iterations: u64) -> Image {
        let count = (width * height) as usize;
        let value = |i: usize| (i as f32 * 0.37).fract() * [1e-3, 1.0, 1e3][i % 3];
        Image {
            width,
            height,
            iterations,
            odd_iterations: iterations.div_ceil(2),
            pixels: (0..count)
                .map(|i| Spectrum::from_rgb([value(i), value(i + 7), value(i + 11)]))
                .collect(),
            standard_error: if iterations < 2 {
                Vec::new()
            } else {
                (0..count).map(|i| value(i + 3)).collect()
            },
        }
    }

    fn metadata() -> PictureMetadata {
        PictureMetadata {
            version: "1.2.3".into(),
            renderer: "1.2.3+0f".into(),
            scene_hash: "ab12".into(),
            sensor: None,
            layers: vec!["albedo".into()],
            crop: None,
            main: "room.xml".into(),
            defines: [("größe".into(), "2 \u{1F4A1} \"quoted\"".into())].into(),
            integrator: IntegratorSettings::Pcf(PcfSettings {
                alpha: 0.3,
                ..PcfSettings::default()
            }),
            warnings: vec!["room.xml:3: left out".into(), "room.xml:4: größer".into()],
            seed: u64::MAX,
            iterations: 64,
            iterations_asked: Some(100),
            sigma: Some([0.1, 0.05]),
            theta: Some([0.3, 0.15]),
            noise: Some(0.0625),
        }
    }

    #[test]
    fn pixels_errors_and_metadata_come_back() {
        let original = image(37, 21, 64);
        let decoded = decode_exr(&encode_exr(&original, Beside::default(), &metadata()).unwrap(), MANY).unwrap();
        assert_eq!((decoded.width, decoded.height), (37, 21));
        assert_eq!(decoded.pixels, original.pixels);
        assert_eq!(decoded.standard_error, original.standard_error);
        assert_eq!(decoded.metadata, Some(metadata()));
        let bytes = encode_exr(&original, Beside::default(), &metadata()).unwrap();
        assert_eq!(read_metadata(&bytes).unwrap(), Some(metadata()));
    }

    #[test]
    fn metadata_of_older_versions_are_read() {
        let mut json = serde_json::to_value(metadata()).unwrap();
        let fields = json.as_object_mut().unwrap();
        for name in ["renderer", "main", "iterations_asked", "noise", "warnings", "layers"] {
            assert!(fields.remove(name).is_some());
        }
        let expected = PictureMetadata {
            renderer: String::new(),
            main: String::new(),
            iterations_asked: None,
            noise: None,
            warnings: vec![],
            layers: vec![],
            ..metadata()
        };
        assert_eq!(serde_json::from_value::<PictureMetadata>(json).unwrap(), expected);
    }

    #[test]
    fn one_iteration_has_no_error_channel() {
        let decoded = decode_exr(
            &encode_exr(&image(5, 4, 1), Beside::default(), &metadata()).unwrap(),
            MANY,
        )
        .unwrap();
        assert!(decoded.standard_error.is_empty());
    }

    #[test]
    fn each_setting_has_its_attribute() {
        let bytes = encode_exr(&image(4, 4, 64), Beside::default(), &metadata()).unwrap();
        let header = MetaData::read_from_buffered(Cursor::new(&bytes), true)
            .unwrap()
            .headers
            .remove(0);
        let attribute = |name: &str| header.own_attributes.other.get(&text(name)).cloned();
        let string = |value: &str| Some(AttributeValue::Text(text(value)));
        assert_eq!(attribute("integrator"), string("pcf"));
        assert_eq!(attribute("alpha"), Some(AttributeValue::F32(0.3)));
        assert_eq!(attribute("photons"), Some(AttributeValue::I32(200_000)));
        assert_eq!(attribute("lookup_vertex"), string("auto"));
        assert_eq!(attribute("samplers"), string("bsdf,camera"));
        assert_eq!(attribute("seed"), string("18446744073709551615"));
        assert_eq!(attribute("iterations"), Some(AttributeValue::I32(64)));
        assert_eq!(attribute("sigma_first"), Some(AttributeValue::F32(0.1)));
        assert_eq!(attribute("sigma_last"), Some(AttributeValue::F32(0.05)));
        assert_eq!(attribute("theta_last"), Some(AttributeValue::F32(0.15)));
        assert_eq!(attribute("iterations_asked"), Some(AttributeValue::I32(100)));
        assert_eq!(attribute("scene_file"), string("room.xml"));
        assert_eq!(attribute("renderer"), string("1.2.3+0f"));
        assert_eq!(attribute("noise"), Some(AttributeValue::F32(0.0625)));
        assert_eq!(attribute("scene_hash"), string("ab12"));
        let warnings = string("room.xml:3: left out\nroom.xml:4: größer");
        assert_eq!(attribute("warnings"), warnings);
        assert_eq!(attribute("sigma1"), None);
        assert_eq!(header.own_attributes.software_name, Some(text("Photonfarm 1.2.3")));
    }

    #[test]
    fn bytes_are_the_same_every_time() {
        let first = encode_exr(&image(16, 16, 2), Beside::default(), &metadata()).unwrap();
        for _ in 0..8 {
            assert_eq!(
                encode_exr(&image(16, 16, 2), Beside::default(), &metadata()).unwrap(),
                first
            );
        }
    }

    #[test]
    fn a_window_lies_in_the_whole_picture() {
        let metadata = PictureMetadata {
            crop: Some("3,4,7x5".parse().unwrap()),
            ..metadata()
        };
        let beside = Beside {
            channels: vec![],
            attributes: vec![(
                "cryptomatte/abcdef0/manifest".into(),
                "{\"\u{e4}\":\"01234567\"}".into(),
            )],
            whole: Some([40, 30]),
        };
        let original = image(7, 5, 2);
        let bytes = encode_exr(&original, beside, &metadata).unwrap();
        let header = MetaData::read_from_buffered(Cursor::new(&bytes), true)
            .unwrap()
            .headers
            .remove(0);
        assert_eq!(header.own_attributes.layer_position, Vec2(3, 4));
        let display = header.shared_attributes.display_window;
        assert_eq!((display.position, display.size), (Vec2(0, 0), Vec2(40, 30)));
        let manifest = header.own_attributes.other.get(&text("cryptomatte/abcdef0/manifest"));
        let escaped = AttributeValue::Text(text("{\"\\u00e4\":\"01234567\"}"));
        assert_eq!(manifest, Some(&escaped));
        let decoded = decode_exr(&bytes, MANY).unwrap();
        assert_eq!((decoded.width, decoded.height), (7, 5));
        assert_eq!((decoded.pixels, decoded.metadata), (original.pixels, Some(metadata)));
    }

    #[test]
    fn wrong_sizes_and_too_many_pixels_are_errors() {
        let mut broken = image(4, 4, 2);
        broken.pixels.pop();
        assert!(matches!(
            encode_exr(&broken, Beside::default(), &metadata()),
            Err(PictureError::Size { pixels: 15, .. })
        ));
        let bytes = encode_exr(&image(8, 8, 2), Beside::default(), &metadata()).unwrap();
        assert!(matches!(
            decode_exr(&bytes, 63),
            Err(PictureError::TooLarge { limit: 63, .. })
        ));
    }

    #[test]
    fn every_truncation_is_an_error() {
        let bytes = encode_exr(&image(9, 5, 2), Beside::default(), &metadata()).unwrap();
        for length in 0..bytes.len() {
            assert!(
                decode_exr(&bytes[..length], MANY).is_err(),
                "{length} of {} bytes",
                bytes.len()
            );
        }
    }

    #[test]
    fn damaged_bytes_never_panic() {
        let bytes = encode_exr(&image(9, 5, 2), Beside::default(), &metadata()).unwrap();
        for at in 0..bytes.len() {
            for damage in [0x01, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= damage;
                let _ = decode_exr(&damaged, MANY);
            }
        }
    }
}
