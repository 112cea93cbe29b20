//! Portable float maps: a header of text (`PF` for colour, `Pf` for grey, width, height, scale), then rows of 32-bit floats, from the
//! bottom to the top. A negative scale says that they are little-endian; its magnitude is a factor on all values (P. Debevec, "PFM Portable FloatMap
//! Image Format").

use super::error::{Place, SceneError};
use super::linear_image::{Pixels, Samples};
use super::loader::LoadedFile;

/// Whether a file begins as a portable float map.
pub(super) fn is_pfm(bytes: &[u8]) -> bool {
    matches!(bytes, [b'P', b'F' | b'f', end, ..] if end.is_ascii_whitespace())
}

/// Decodes a map; `check_size` is asked before its pixels are read.
pub(super) fn read(
    file: &LoadedFile,
    place: &Place,
    check_size: impl Fn(u64, u64) -> Result<(), SceneError>,
) -> Result<Pixels, SceneError> {
    let broken = |reason: String| SceneError::data(place, format!("broken PFM image: {reason}"));
    let (header, values) = Header::read(&file.bytes).map_err(broken)?;
    check_size(header.width, header.height)?;
    let row = header.width * header.channels as u64 * 4;
    let expected = row.saturating_mul(header.height);
    if values.len() as u64 != expected {
        return Err(broken(format!(
            "{} bytes of pixels, not the {expected} of {} x {}",
            values.len(),
            header.width,
            header.height
        )));
    }
    let float = |bytes: &[u8; 4]| {
        header.factor
            * match header.little_endian {
                true => f32::from_le_bytes(*bytes),
                false => f32::from_be_bytes(*bytes),
            }
    };
    let rows = values.chunks_exact(row as usize).rev();
    Ok(Pixels {
        width: header.width as usize,
        height: header.height as usize,
        channels: header.channels,
        samples: Samples::Floats(rows.flat_map(|row| row.as_chunks::<4>().0.iter().map(float)).collect()),
    })
}

struct Header {
    channels: usize,
    width: u64,
    height: u64,
    little_endian: bool,
    factor: f32,
}

impl Header {
    /// The header, and the bytes after the one that ends it.
    fn read(bytes: &[u8]) -> Result<(Self, &[u8]), String> {
        let mut rest = bytes;
        let mut word = |what: &str| {
            let start = rest.iter().position(|byte| !byte.is_ascii_whitespace());
            let (_, after) = rest.split_at(start.unwrap_or(rest.len()));
            let end = after.iter().take(LONGEST_WORD).position(u8::is_ascii_whitespace);
            let end = end.ok_or_else(|| format!("its header has no {what}"))?;
            rest = &after[end + 1..];
            Ok::<_, String>(String::from_utf8_lossy(&after[..end]).into_owned())
        };
        let channels = if word("type")? == "PF" { 3 } else { 1 };
        let mut size = |what: &str| {
            let text = word(what)?;
            text.parse::<u32>()
                .map(u64::from)
                .map_err(|_| format!("its {what} is `{text}`, not a whole number"))
        };
        let (width, height) = (size("width")?, size("height")?);
        let text = word("scale")?;
        let scale = text.parse::<f32>().ok().filter(|scale| scale.is_normal());
        let scale = scale.ok_or_else(|| format!("its scale is `{text}`, not a finite number other than 0"))?;
        let header = Self {
            channels,
            width,
            height,
            little_endian: scale < 0.0,
            factor: scale.abs(),
        };
        Ok((header, rest))
    }
}

/// Bytes of a word of the header, at most.
const LONGEST_WORD: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::image;
    use crate::scene::linear_image::Reading;
    use crate::texture::Texels;

    fn file(header: &str, values: &[f32], bytes_of: fn(f32) -> [u8; 4]) -> LoadedFile {
        let values = values.iter().flat_map(|value| bytes_of(*value));
        LoadedFile {
            name: "a.pfm".into(),
            bytes: header.bytes().chain(values).collect::<Vec<_>>().into(),
        }
    }

    #[test]
    fn rows_go_up_and_the_sign_of_the_scale_is_the_order_of_bytes() {
        let values: Vec<f32> = (0..12).map(|value| value as f32).collect();
        for (header, bytes_of) in [
            ("PF\n2 2\n-1.0\n", f32::to_le_bytes as fn(f32) -> [u8; 4]),
            ("PF 2 2 1\n", f32::to_be_bytes),
        ] {
            let image = image::read(&file(header, &values, bytes_of), &Reading::COLOURS, 4).unwrap();
            assert_eq!((image.width, image.height), (2, 2));
            let texels: Vec<[f32; 3]> = image.texels.iter().map(|texel| texel.to_rgb()).collect();
            assert_eq!(
                texels,
                [[6.0, 7.0, 8.0], [9.0, 10.0, 11.0], [0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
            );
        }
        let grey = image::read(
            &file("Pf\n1 2\n-0.5\n", &[2.0, 4.0], f32::to_le_bytes),
            &Reading::COLOURS,
            4,
        )
        .unwrap();
        assert!(matches!(grey.texels, Texels::Greys(texels) if texels == [2.0, 1.0]));
    }

    #[test]
    fn broken_files_are_refused_with_a_reason() {
        for (header, reason) in [
            ("PF\n2 2\n", "no scale"),
            ("PF\n2 x\n-1\n", "height is `x`"),
            ("PF\n2 2\n0\n", "scale is `0`"),
            ("PF\n2 -2\n1\n", "height is `-2`"),
            ("PF\n2 2\n1\n", "4 bytes of pixels, not the 48 of 2 x 2"),
            ("PF\n0 2\n1\n", "no pixels"),
            ("PF\n4294967295 4294967295\n1\n", "limit"),
        ] {
            let faults = image::read(&file(header, &[1.0], f32::to_le_bytes), &Reading::COLOURS, 100).unwrap_err();
            let text = faults[0].to_string();
            assert!(text.contains("a.pfm") && text.contains(reason), "{text}");
        }
        let faults = image::read(
            &file("Pf\n1 1\n-1\n", &[-1.0], f32::to_le_bytes),
            &Reading::COLOURS,
            100,
        )
        .unwrap_err();
        assert!(faults[0].to_string().contains("not negative"), "{}", faults[0]);
    }
}
