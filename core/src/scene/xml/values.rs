//! Numbers, lists and colours inside attribute values.

use super::super::description::SpectrumValue;
use super::super::error::{Place, SceneError, shortened};
use super::super::faults::FileFaults;
use super::super::linear_image::srgb_to_linear;
use super::super::loader::LoadedFile;
use super::super::text;
use glam::DVec3;

/// The parts of a list separated by commas or white space.
pub(super) fn tokens(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| c == ',' || c.is_ascii_whitespace())
        .filter(|token| !token.is_empty())
}

pub(super) fn float(text: &str) -> Result<f64, String> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && (value as f32).is_finite() => Ok(value),
        Ok(_) => Err(format!(
            "`{}` is not a finite number within the range of single precision",
            shortened(text)
        )),
        Err(_) => Err(format!("`{}` is not a number", shortened(text))),
    }
}

pub(super) fn integer(text: &str) -> Result<i64, String> {
    text.trim()
        .parse()
        .map_err(|_| format!("`{}` is not an integer", shortened(text)))
}

pub(super) fn boolean(text: &str) -> Result<bool, String> {
    match text.trim().to_ascii_lowercase().as_str() {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => Err(format!("`{}` is neither `true` nor `false`", shortened(text))),
    }
}

pub(super) fn floats(text: &str) -> Result<Vec<f64>, String> {
    tokens(text).map(float).collect()
}

/// Three numbers, or one that stands for all three.
pub(super) fn vector(text: &str) -> Result<DVec3, String> {
    match floats(text)?[..] {
        [v] => Ok(DVec3::splat(v)),
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        ref values => Err(format!("expected one or three numbers, found {}", values.len())),
    }
}

/// One or three numbers, or `#rrggbb` in linear 8-bit steps.
pub(super) fn rgb(text: &str) -> Result<[f64; 3], String> {
    let Some(digits) = text.trim().strip_prefix('#') else {
        return vector(text).map(|v| v.to_array());
    };
    if digits.len() != 6 || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(format!("`{}` is not of the form `#rrggbb`", shortened(text)));
    }
    let mut rgb = [0.0; 3];
    for (i, value) in rgb.iter_mut().enumerate() {
        let byte = u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).map_err(|error| error.to_string())?;
        *value = f64::from(byte) / 255.0;
    }
    Ok(rgb)
}

/// As [`rgb`], of values with the transfer function of sRGB.
pub(super) fn srgb(text: &str) -> Result<[f64; 3], String> {
    Ok(rgb(text)?.map(|channel| f64::from(srgb_to_linear(channel as f32))))
}

/// Whether a text has three parts, and no pairs.
pub(super) fn is_triple(text: &str) -> bool {
    tokens(text).count() == 3 && !text.contains(':')
}

/// A temperature that a black body may have \[K\].
pub(super) fn temperature(kelvin: f64) -> Result<f64, String> {
    if (100.0..=1e6).contains(&kelvin) {
        return Ok(kelvin);
    }
    Err(format!("{kelvin} K is out of range; allowed: 100 to 1000000"))
}

/// One number, or `wavelength:value` pairs.
pub(super) fn spectrum(text: &str) -> Result<SpectrumValue, String> {
    let parts: Vec<&str> = tokens(text).collect();
    if let [single] = parts[..]
        && !single.contains(':')
    {
        return float(single).map(SpectrumValue::Uniform);
    }
    let pair = |part: &&str| {
        let (wavelength, value) = part
            .split_once(':')
            .ok_or_else(|| format!("`{}` is not a pair `wavelength:value`", shortened(part)))?;
        Ok((float(wavelength)?, float(value)?))
    };
    sampled(parts.iter().map(pair).collect::<Result<_, String>>()?)
}

/// A spectrum file: one `wavelength value` pair a line, `#` starts a comment.
pub(super) fn spectrum_file(file: &LoadedFile) -> Result<SpectrumValue, Vec<SceneError>> {
    let mut faults = FileFaults::default();
    let pairs = pairs(file, &mut faults);
    faults.settle(pairs).and_then(|pairs| {
        let broken = |reason| vec![SceneError::data(&Place::whole(&file.name), reason)];
        sampled(pairs).map_err(broken)
    })
}

fn pairs(file: &LoadedFile, faults: &mut FileFaults) -> Result<Vec<(f64, f64)>, SceneError> {
    let pair = |line: &[u8]| {
        let line = std::str::from_utf8(line).map_err(|_| "the line is not text")?;
        match floats(line)?[..] {
            [wavelength, value] => Ok((wavelength, value)),
            ref values => Err(format!("expected a wavelength and a value, found {}", values.len())),
        }
    };
    let mut pairs = Vec::new();
    for (line, text) in text::lines(&file.bytes) {
        if text.starts_with(b"#") || text.trim_ascii().is_empty() {
            continue;
        }
        match pair(text) {
            Ok(pair) => pairs.push(pair),
            Err(reason) => {
                let file = file.name.as_str().into();
                faults.note(SceneError::data(&Place { file, line }, reason))?;
            }
        }
    }
    Ok(pairs)
}

pub(super) fn sampled(pairs: Vec<(f64, f64)>) -> Result<SpectrumValue, String> {
    if pairs.len() < 2 {
        return Err("a spectrum needs one value or at least two `wavelength:value` pairs".into());
    }
    if let Some(w) = pairs.windows(2).find(|w| w[1].0 <= w[0].0) {
        return Err(format!("wavelengths must rise, but {} follows {}", w[1].0, w[0].0));
    }
    Ok(SpectrumValue::Sampled(pairs))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_finite_and_lists_take_commas_and_spaces() {
        assert_eq!(float(" .8 "), Ok(0.8));
        for bad in ["nan", "inf", "-infinity", "1e39", "", "1x", "1,5"] {
            assert!(float(bad).is_err(), "{bad}");
        }
        assert_eq!(vector("  0,   1,    0"), Ok(DVec3::Y));
        assert_eq!(vector("2"), Ok(DVec3::splat(2.0)));
        assert!(vector("1 2").is_err());
        assert_eq!(integer(" -1 "), Ok(-1));
        assert!(integer("1.5").is_err());
        assert_eq!(boolean("TRUE"), Ok(true));
        assert!(boolean("1").is_err());
    }

    #[test]
    fn colours_take_one_three_or_six_digits() {
        assert_eq!(rgb("0.5"), Ok([0.5; 3]));
        assert_eq!(rgb(".8,.8,.4"), Ok([0.8, 0.8, 0.4]));
        assert_eq!(rgb("#ff0033"), Ok([1.0, 0.0, 0.2]));
        assert!(rgb("#ff00").is_err());
        assert!(rgb("#gg0000").is_err());
    }

    #[test]
    fn spectra_are_one_value_or_rising_pairs() {
        assert_eq!(spectrum("0.3"), Ok(SpectrumValue::Uniform(0.3)));
        assert_eq!(
            spectrum("400:0, 700:1"),
            Ok(SpectrumValue::Sampled(vec![(400.0, 0.0), (700.0, 1.0)]))
        );
        for bad in ["", "400:1", "1 2 3", "700:1 400:1", "400:nan 700:1"] {
            assert!(spectrum(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn spectrum_files_have_a_pair_a_line() {
        let read = |bytes: &[u8]| {
            spectrum_file(&LoadedFile {
                name: "a.spd".into(),
                bytes: bytes.to_vec().into(),
            })
        };
        let lines = |bytes| -> Vec<Option<u32>> { read(bytes).unwrap_err().iter().map(SceneError::line).collect() };
        let expected = spectrum("400:1 700:2").unwrap();
        assert_eq!(read(b"# a\n400 1\n\n700 2\n").unwrap(), expected);
        assert_eq!(read(b"\xef\xbb\xbf# \xe9\r400 1\r\n700 2").unwrap(), expected);
        assert_eq!(lines(b"400 1\n500\n600 x\n700 1\r\xff\r"), [Some(2), Some(3), Some(5)]);
        assert_eq!(lines(b"700 1\n400 1\n"), [None]);
    }
}
