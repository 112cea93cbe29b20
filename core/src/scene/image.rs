//! Images: PNG, JPEG, WebP, BMP, TGA and Radiance HDR by the `image` crate, OpenEXR by `exr`, PFM by [`pfm`], all into linear colour.

use super::error::{Place, SceneError, within};
use super::faults::FileFaults;
use super::linear_image::{LinearImage, Pixels, Reading, Samples};
use super::loader::LoadedFile;
use super::pfm;
use crate::texture::Texels;
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};
use std::borrow::Cow;
use std::io::Cursor;

/// The most channels that an OpenEXR layer may have.
const CHANNELS: usize = 64;
/// How OpenEXR files begin.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Whether an image holds integers, which are sRGB values as a rule, and not linear floats.
pub(crate) fn is_encoded(bytes: &[u8]) -> bool {
    !bytes.starts_with(&EXR) && !bytes.starts_with(b"#?") && !pfm::is_pfm(bytes)
}

/// Decodes an image of at most `texel_limit` texels.
pub(crate) fn read(file: &LoadedFile, reading: &Reading, texel_limit: u64) -> Result<LinearImage, Vec<SceneError>> {
    let mut faults = FileFaults::default();
    let image = decode(file, texel_limit).and_then(|pixels| {
        let mut image = pixels.decode(reading);
        check_texels(&image, &Place::whole(&file.name), &mut faults)?;
        if reading.inverted {
            image.texels = image.texels.map(|value| (1.0 - value).max(0.0));
        }
        Ok(image)
    });
    faults.settle(image)
}

fn check_texels(image: &LinearImage, place: &Place, faults: &mut FileFaults) -> Result<(), SceneError> {
    if matches!(image.texels, Texels::ColourBytes(..) | Texels::GreyBytes(..)) {
        return Ok(());
    }
    let broken = image.texels.iter().enumerate().filter(|(_, texel)| !texel.is_valid());
    for (index, texel) in broken {
        let (x, y) = (index % image.width, index / image.width);
        let reason = format!(
            "texel ({x}, {y}) is {:?}: colours are finite and not negative",
            texel.to_rgb()
        );
        faults.note(SceneError::data(place, reason))?;
    }
    Ok(())
}

fn decode(file: &LoadedFile, texel_limit: u64) -> Result<Pixels, SceneError> {
    let place = Place::whole(&file.name);
    let check_size = |width: u64, height: u64| {
        if width == 0 || height == 0 {
            return Err(SceneError::data(&place, "the image has no pixels"));
        }
        within(&place, "number of texels", width.saturating_mul(height), texel_limit).map(|_| ())
    };
    if file.bytes.starts_with(&EXR) {
        read_exr(file, &place, check_size)
    } else if pfm::is_pfm(&file.bytes) {
        pfm::read(file, &place, check_size)
    } else {
        read_other(file, &place, texel_limit, check_size)
    }
}

/// How Radiance HDR images of other programs than Radiance begin, Mitsuba among them; the decoder wants the name of that program.
const RGBE: &[u8] = b"#?RGBE";

fn read_other(
    file: &LoadedFile,
    place: &Place,
    texel_limit: u64,
    check_size: impl Fn(u64, u64) -> Result<(), SceneError>,
) -> Result<Pixels, SceneError> {
    let formats = "allowed: OpenEXR, PFM, PNG, JPEG, WebP, BMP, TGA, Radiance HDR";
    let is_tga = || file.name.to_ascii_lowercase().ends_with(".tga");
    let format = match image::guess_format(&file.bytes) {
        Ok(format) => Some(format),
        Err(_) if file.bytes.starts_with(RGBE) => Some(ImageFormat::Hdr),
        Err(_) => is_tga().then_some(ImageFormat::Tga),
    };
    let format = format
        .filter(|format| format.reading_enabled())
        .ok_or_else(|| SceneError::data(place, format!("not an image of a known format; {formats}")))?;
    let memory = texel_limit.saturating_mul(16).max(1 << 20);
    let broken = |error: image::ImageError| match error {
        image::ImageError::Limits(_) => SceneError::Limit {
            place: place.clone(),
            what: "bytes of the decoded image".into(),
            value: memory.saturating_add(1),
            limit: memory,
        },
        _ => SceneError::data(place, format!("broken {format:?} image: {error}")),
    };
    if let (ImageFormat::Png, Some(size)) = (format, file.bytes.get(16..24)) {
        // The decoder takes memory for a row before it tells the size.
        let [width, height] = [&size[..4], &size[4..]].map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]));
        check_size(u64::from(width), u64::from(height))?;
    }
    let bytes = match file.bytes.strip_prefix(RGBE) {
        Some(rest) => Cow::Owned([b"#?RADIANCE", rest].concat()),
        None => Cow::Borrowed(&file.bytes[..]),
    };
    let mut reader = ImageReader::with_format(Cursor::new(&bytes[..]), format);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(memory);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(broken)?;
    let (width, height) = decoder.dimensions();
    check_size(u64::from(width), u64::from(height))?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(broken)?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let (channels, samples) = match decoded {
        DynamicImage::ImageLuma8(image) => (1, Samples::Bytes(image.into_raw())),
        DynamicImage::ImageLumaA8(image) => (2, Samples::Bytes(image.into_raw())),
        DynamicImage::ImageRgb8(image) => (3, Samples::Bytes(image.into_raw())),
        DynamicImage::ImageRgba8(image) => (4, Samples::Bytes(image.into_raw())),
        DynamicImage::ImageLuma16(image) => (1, Samples::Words(image.into_raw())),
        DynamicImage::ImageLumaA16(image) => (2, Samples::Words(image.into_raw())),
        DynamicImage::ImageRgb16(image) => (3, Samples::Words(image.into_raw())),
        DynamicImage::ImageRgba16(image) => (4, Samples::Words(image.into_raw())),
        floats => (4, Samples::Floats(floats.into_rgba32f().into_raw())),
    };
    Ok(Pixels {
        width,
        height,
        channels,
        samples,
    })
}

fn read_exr(
    file: &LoadedFile,
    place: &Place,
    check_size: impl Fn(u64, u64) -> Result<(), SceneError>,
) -> Result<Pixels, SceneError> {
    let broken = |error: exr::error::Error| SceneError::data(place, format!("broken OpenEXR image: {error}"));
    let headers = exr::meta::MetaData::read_from_buffered(Cursor::new(&file.bytes[..]), false)
        .map_err(broken)?
        .headers;
    for header in &headers {
        check_size(header.layer_size.width() as u64, header.layer_size.height() as u64)?;
        within(
            place,
            "number of channels",
            header.channels.list.len() as u64,
            CHANNELS as u64,
        )?;
        if header
            .channels
            .list
            .iter()
            .any(|channel| channel.sampling != exr::math::Vec2(1, 1))
        {
            return Err(SceneError::data(place, "subsampled OpenEXR channels are not supported"));
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(&file.bytes[..]))
        .map_err(broken)?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    check_size(width as u64, height as u64)?;
    let count = width * height;
    // Of a channel within a layer the name follows that of the layer.
    let channel = |name: &str| {
        let of_name = |found: &str| found == name || found.rsplit('.').next() == Some(name);
        let channels = &layer.channel_data.list;
        let exact = channels.iter().find(|channel| channel.name.eq(name));
        let found = exact.or_else(|| channels.iter().find(|channel| of_name(&channel.name.to_string())));
        found
            .map(|channel| values(&channel.sample_data))
            .filter(|values| values.len() == count)
    };
    let mut channels = match (channel("R"), channel("G"), channel("B"), channel("Y")) {
        (Some(r), Some(g), Some(b), _) => vec![r, g, b],
        (_, _, _, Some(y)) => vec![y],
        _ => {
            return Err(SceneError::data(
                place,
                "the OpenEXR image has neither channels R, G and B nor Y",
            ));
        }
    };
    channels.extend(channel("A"));
    let samples = (0..count).flat_map(|i| channels.iter().map(move |channel| channel[i]));
    Ok(Pixels {
        width,
        height,
        channels: channels.len(),
        samples: Samples::Floats(samples.collect()),
    })
}

fn values(samples: &FlatSamples) -> Vec<f32> {
    match samples {
        FlatSamples::F16(values) => values.iter().map(|value| value.to_f32()).collect(),
        FlatSamples::F32(values) => values.clone(),
        FlatSamples::U32(values) => values.iter().map(|value| *value as f32).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::linear_image::Encoding;

    const RAW: Reading = Reading {
        encoding: Encoding::Linear,
        ..Reading::COLOURS
    };

    fn file(name: &str, bytes: &[u8]) -> LoadedFile {
        LoadedFile {
            name: name.into(),
            bytes: bytes.to_vec().into(),
        }
    }

    fn encoded(format: ImageFormat, image: &DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn eight_bit_images_are_decoded_from_srgb_unless_raw() {
        let mut image = image::RgbImage::new(2, 1);
        image.put_pixel(1, 0, image::Rgb([255, 188, 51]));
        let image = DynamicImage::ImageRgb8(image);
        for (format, name) in [
            (ImageFormat::Png, "a.png"),
            (ImageFormat::Bmp, "a.bmp"),
            (ImageFormat::Tga, "a.tga"),
        ] {
            let file = file(name, &encoded(format, &image));
            let [r, g, b] = read(&file, &Reading::COLOURS, 100).unwrap().texels.get(1).to_rgb();
            assert!(
                (r - 1.0).abs() < 1e-6 && (g - 0.502_886).abs() < 1e-5 && (b - 0.033_105).abs() < 1e-5,
                "{r} {g} {b}"
            );
            assert_eq!(
                read(&file, &RAW, 100).unwrap().texels.get(1).to_rgb(),
                [1.0, 188.0 / 255.0, 0.2]
            );
        }
    }

    #[test]
    fn exr_and_hdr_are_linear() {
        let mut bytes = Cursor::new(Vec::new());
        let pixels = |position: exr::math::Vec2<usize>| (position.x() as f32, position.y() as f32, 0.5_f32);
        use exr::prelude::WritableImage;
        exr::prelude::Image::from_channels((3, 2), exr::prelude::SpecificChannels::rgb(pixels))
            .write()
            .to_buffered(&mut bytes)
            .unwrap();
        let image = read(&file("a.exr", &bytes.into_inner()), &Reading::COLOURS, 100).unwrap();
        assert_eq!((image.width, image.height), (3, 2));
        assert_eq!(image.texels.get(5).to_rgb(), [2.0, 1.0, 0.5]);
        let hdr = DynamicImage::ImageRgb32F(image::Rgb32FImage::from_pixel(9, 1, image::Rgb([4.0, 2.0, 0.5])));
        let image = read(&file("a.hdr", &encoded(ImageFormat::Hdr, &hdr)), &Reading::COLOURS, 100).unwrap();
        let rgbe = encoded(ImageFormat::Hdr, &hdr);
        let rgbe = [b"#?RGBE", rgbe.strip_prefix(b"#?RADIANCE").unwrap()].concat();
        let other = read(&file("a.hdr", &rgbe), &Reading::COLOURS, 100).unwrap();
        assert_eq!(other.texels.get(0), image.texels.get(0));
        assert_eq!(image.texels.get(8).to_rgb(), [4.0, 2.0, 0.5]);
    }

    #[test]
    fn size_is_checked_before_decoding() {
        let png = encoded(ImageFormat::Png, &DynamicImage::new_rgb8(20, 20));
        let faults = read(&file("a.png", &png), &Reading::COLOURS, 399).unwrap_err();
        assert!(
            matches!(
                faults[..],
                [SceneError::Limit {
                    value: 400,
                    limit: 399,
                    ..
                }]
            ),
            "{faults:?}"
        );
        let faults = read(&file("a.png", b"garbage"), &Reading::COLOURS, 399).unwrap_err();
        assert!(matches!(faults[..], [SceneError::Data { .. }]), "{faults:?}");
    }
}
