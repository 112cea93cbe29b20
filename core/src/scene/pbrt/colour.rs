//! Colours and spectra, turned into linear Rec. 709.
//!
//! pbrt-v4 renders with spectra, and its film turns what arrives into the RGB of its colour space, by default that of sRGB. Two
//! rules decide how bright a light is there (`lights.cpp`, `SpectrumToPhotometric`):
//!
//! * `rgb` values of a light multiply the illuminant of their colour space. They come out of the film as they are written, where that
//!   is sRGB, since each light is divided by the luminance of its illuminant.
//! * Every other spectrum of a light is divided by its own luminance: `blackbody`, a named one, or one given by samples has
//!   luminance 1 whatever the size of its numbers, and `scale` and `power` say how bright it is.
//!
//! pbrt-v3 takes such spectra as they are.

use super::Reading;
use super::parameter::Parameters;
use super::token::Tokens;
use super::values::{Parameter, Type, Values};
use crate::material::ior;
use crate::scene::description::SpectrumValue;
use crate::scene::error::{SceneError, list, shortened};
use crate::scene::reader::Colour;
use crate::scene::spectrum::{Use, blackbody, planck, to_rgb, unit_luminance, xyz_to_rgb};
use glam::{DMat3, DVec3};

/// The colour space of the RGB values in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum ColourSpace {
    #[default]
    Srgb,
    DciP3,
    Rec2020,
    Aces,
}

impl ColourSpace {
    pub(super) const NAMES: [(&'static str, Self); 4] = [
        ("srgb", Self::Srgb),
        ("dci-p3", Self::DciP3),
        ("rec2020", Self::Rec2020),
        ("aces2065-1", Self::Aces),
    ];

    /// Chromaticities of red, green, blue and white: ITU-R BT.709, SMPTE EG 432-1 with the white of D65 as pbrt has it, ITU-R BT.2020,
    /// and SMPTE ST 2065-1.
    fn chromaticities(self) -> [[f64; 2]; 4] {
        match self {
            Self::Srgb => [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], D65],
            Self::DciP3 => [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06], D65],
            Self::Rec2020 => [[0.708, 0.292], [0.17, 0.797], [0.131, 0.046], D65],
            Self::Aces => [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077], ACES_WHITE],
        }
    }

    /// The matrix from its RGB to CIE XYZ.
    fn to_xyz(self) -> DMat3 {
        let [r, g, b, white] = self.chromaticities().map(|xy| DVec3::from_array(xyz_of(xy)));
        let primaries = DMat3::from_cols(r, g, b);
        let scale = primaries.inverse() * white;
        DMat3::from_cols(r * scale.x, g * scale.y, b * scale.z)
    }

    /// Linear Rec. 709 of light of this RGB; what lies outside counts as 0.
    pub(super) fn light(self, rgb: [f64; 3]) -> [f64; 3] {
        if self == Self::Srgb {
            return rgb;
        }
        let converted = Self::Srgb.to_xyz().inverse() * self.to_xyz() * DVec3::from_array(rgb);
        converted.max(DVec3::ZERO).to_array()
    }

    /// Linear Rec. 709 of a reflectance of this RGB: white stays white, whatever the illuminant.
    pub(super) fn reflectance(self, rgb: [f64; 3]) -> [f64; 3] {
        if self == Self::Srgb {
            return rgb;
        }
        let largest = if rgb.iter().all(|channel| *channel <= 1.0) {
            1.0
        } else {
            f64::MAX
        };
        let (rgb, white) = (self.light(rgb), self.light([1.0; 3]));
        std::array::from_fn(|i| (rgb[i] / white[i]).min(largest))
    }
}

/// CIE D65 (publication 15).
const D65: [f64; 2] = [0.312_71, 0.329_02];
/// The white of ACES.
const ACES_WHITE: [f64; 2] = [0.321_68, 0.337_67];

/// CIE XYZ of luminance 1 with a chromaticity.
fn xyz_of([x, y]: [f64; 2]) -> [f64; 3] {
    [x / y, 1.0, (1.0 - x - y) / y]
}

/// Illuminants that pbrt knows by name, by their chromaticity (CIE publication 15, 2 degree observer).
const ILLUMINANTS: [(&str, [f64; 2]); 16] = [
    ("stdillum-A", [0.447_57, 0.407_45]),
    ("stdillum-D50", [0.345_67, 0.358_50]),
    ("stdillum-D65", D65),
    ("stdillum-F1", [0.313_10, 0.337_27]),
    ("stdillum-F2", [0.372_08, 0.375_29]),
    ("stdillum-F3", [0.409_10, 0.394_30]),
    ("stdillum-F4", [0.440_18, 0.403_29]),
    ("stdillum-F5", [0.313_79, 0.345_31]),
    ("stdillum-F6", [0.377_90, 0.388_35]),
    ("stdillum-F7", [0.312_92, 0.329_33]),
    ("stdillum-F8", [0.345_88, 0.358_75]),
    ("stdillum-F9", [0.374_17, 0.372_81]),
    ("stdillum-F10", [0.346_09, 0.359_86]),
    ("stdillum-F11", [0.380_52, 0.377_13]),
    ("stdillum-F12", [0.436_95, 0.404_41]),
    ("illum-acesD60", ACES_WHITE),
];

/// Glasses that pbrt knows by name, with their index at 587.6 nm (Schott, Optical Glass Data Sheets); pbrt's F5, F10 and F11 are Schott's
/// SF5, SF10 and SF11.
const GLASSES: [(&str, f64); 7] = [
    ("glass-BK7", 1.5168),
    ("glass-BAF10", 1.670_03),
    ("glass-FK51A", 1.486_56),
    ("glass-LASF9", 1.850_25),
    ("glass-F5", 1.6727),
    ("glass-F10", 1.728_25),
    ("glass-F11", 1.784_72),
];

/// Metals that pbrt knows by name and ours do not have: brass, its index and extinction at 650, 550 and 450 nm (pbrt-v4's spectra).
const BRASS: [[f64; 3]; 2] = [[0.444, 0.527, 1.094], [3.695, 2.765, 1.829]];

/// The spectrum of a name that pbrt has, as RGB: a light's has luminance 1.
pub(super) fn named(name: &str) -> Option<[f64; 3]> {
    if let Some((_, xy)) = ILLUMINANTS.iter().find(|(known, _)| *known == name) {
        if *xy == D65 {
            return Some([1.0; 3]);
        }
        return Some(xyz_to_rgb(xyz_of(*xy)).map(|channel| channel.max(0.0)));
    }
    if let Some((_, index)) = GLASSES.iter().find(|(known, _)| *known == name) {
        return Some([*index; 3]);
    }
    let (metal, part) = name.strip_prefix("metal-")?.rsplit_once('-')?;
    let part = match part {
        "eta" => 0,
        "k" => 1,
        _ => return None,
    };
    if metal == "CuZn" {
        return Some(BRASS[part]);
    }
    let (eta, k) = ior::conductor(metal)?;
    Some([eta, k][part].to_rgb().map(f64::from))
}

impl Reading<'_, '_> {
    /// The colour `name`: a number for all channels, or any spectrum, as linear Rec. 709.
    pub(super) fn colour(
        &mut self,
        parameters: &Parameters,
        name: &str,
        used: Use,
    ) -> Result<Option<[f64; 3]>, SceneError> {
        let Some(parameter) = parameters.find(name) else {
            return Ok(None);
        };
        match self.value(parameter, used) {
            Ok(rgb) => Ok(Some(rgb)),
            Err(Fault::Reason(reason)) => parameters.fault(name, reason),
            Err(Fault::Error(error)) => self.faults.note(error).map(|()| None),
        }
    }

    fn value(&mut self, parameter: &Parameter, used: Use) -> Result<[f64; 3], Fault> {
        let emitted = used == Use::Emission;
        let rgb = match (parameter.kind, &parameter.values) {
            (Type::Rgb | Type::Xyz, Values::Numbers(values)) => {
                let rgb = <[f64; 3]>::try_from(&values[..])
                    .map_err(|_| Fault::reason(format!("expected 3 numbers, found {}", values.len())))?;
                match (parameter.kind, emitted) {
                    (Type::Xyz, _) => xyz_to_rgb(rgb).map(|channel| channel.max(0.0)),
                    (_, true) => parameter.space.light(rgb),
                    (_, false) => parameter.space.reflectance(rgb),
                }
            }
            (Type::Float | Type::Integer, Values::Numbers(values)) if values.len() == 1 => [values[0]; 3],
            (Type::Blackbody, Values::Numbers(values)) => return self.blackbody(values),
            (Type::Spectrum, Values::Numbers(values)) => {
                if !values.len().is_multiple_of(2) {
                    return Err(Fault::reason("expected pairs of a wavelength and a value"));
                }
                let pairs: Vec<_> = values.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect();
                return self.sampled(pairs, used);
            }
            (Type::Spectrum, Values::Texts(names)) if names.len() == 1 => match named(&names[0]) {
                Some(rgb) => rgb,
                None => {
                    let pairs = self.spectrum_file(parameter, &names[0])?;
                    return self.sampled(pairs, used);
                }
            },
            _ => return Err(Fault::reason("expected a value of type rgb, spectrum or blackbody")),
        };
        if used == Use::Reflectance && rgb.iter().any(|channel| *channel > 1.0) {
            let name = shortened(&parameter.name);
            let message = format!("`{name}`: {rgb:?} is above 1: what is above 1 counts as 1 in a reflectance");
            self.warnings.note(&parameter.place, message);
            return Ok(rgb.map(|channel| channel.clamp(0.0, 1.0)));
        }
        checked(Colour::Rgb(rgb), used).map(|_| rgb)
    }

    /// The colour of a black body. pbrt-v3 writes a scale besides, for a spectrum whose largest value is 1.
    fn blackbody(&mut self, values: &[f64]) -> Result<[f64; 3], Fault> {
        let kelvin = values[0];
        if !(100.0..=1e6).contains(&kelvin) {
            return Err(Fault::reason(format!(
                "{kelvin} K is out of range; allowed: 100 to 1000000"
            )));
        }
        match values {
            [_] => unit_luminance(&blackbody(kelvin, 1.0)).ok_or_else(|| Fault::reason("none of its light is seen")),
            [_, scale] => {
                self.old = true;
                // Wien's displacement law: where the spectrum is largest [nm].
                let peak = 2.897_771_955e6 / kelvin;
                let samples = blackbody(kelvin, scale / planck(peak, kelvin));
                checked(Colour::Spectrum(SpectrumValue::Sampled(samples)), Use::Emission)
            }
            _ => Err(Fault::reason(format!("expected one number, found {}", values.len()))),
        }
    }

    fn sampled(&self, pairs: Vec<(f64, f64)>, used: Use) -> Result<[f64; 3], Fault> {
        if pairs.len() < 2 || pairs.windows(2).any(|pair| pair[0].0 >= pair[1].0) {
            return Err(Fault::reason(
                "a spectrum has two or more samples, at wavelengths that rise",
            ));
        }
        if pairs.iter().any(|(_, value)| *value < 0.0) {
            return Err(Fault::reason("its values must not be negative"));
        }
        if used == Use::Emission && !self.old {
            return unit_luminance(&pairs).ok_or_else(|| Fault::reason("none of its light is seen"));
        }
        checked(Colour::Spectrum(SpectrumValue::Sampled(pairs)), used)
    }

    /// The samples in a spectrum file: a wavelength and a value in turn.
    fn spectrum_file(&mut self, parameter: &Parameter, name: &str) -> Result<Vec<(f64, f64)>, Fault> {
        let file = match self.loader.open(&parameter.place, &self.search, name) {
            Ok(file) => file,
            Err(SceneError::NotFound { .. }) => {
                let names = ILLUMINANTS
                    .iter()
                    .map(|entry| entry.0)
                    .chain(GLASSES.iter().map(|entry| entry.0));
                let metals = "metal-NAME-eta and metal-NAME-k";
                let reason = format!(
                    "there is no file `{}`, and no spectrum of the name; there are: {}, {metals}",
                    shortened(name),
                    list(names)
                );
                return Err(Fault::Reason(reason));
            }
            Err(error) => return Err(Fault::Error(error)),
        };
        let mut tokens = Tokens::new(&file.name, file.bytes);
        let mut numbers = Vec::new();
        while tokens.peek().is_some() {
            numbers.push(tokens.required_number().map_err(Fault::Error)?);
        }
        if !numbers.len().is_multiple_of(2) {
            return Err(Fault::Error(tokens.broken("the last wavelength has no value")));
        }
        Ok(numbers.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect())
    }
}

/// Why a colour cannot be read.
enum Fault {
    /// Something with the parameter.
    Reason(String),
    /// Something with a file, which has its own place.
    Error(SceneError),
}

impl Fault {
    fn reason(reason: impl Into<String>) -> Self {
        Self::Reason(reason.into())
    }
}

fn checked(colour: Colour, used: Use) -> Result<[f64; 3], Fault> {
    to_rgb(&colour, used)
        .map(|rgb| rgb.to_rgb().map(f64::from))
        .map_err(Fault::Reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(actual: [f64; 3], expected: [f64; 3], tolerance: f64) {
        for (a, e) in actual.iter().zip(expected) {
            assert!((a - e).abs() <= tolerance, "{actual:?} is not {expected:?}");
        }
    }

    /// Of the matrices in ITU-R BT.2087 and IEC 61966-2-1.
    #[test]
    fn colour_spaces_share_their_white() {
        for (_, space) in ColourSpace::NAMES {
            near(space.reflectance([1.0; 3]), [1.0; 3], 1e-12);
        }
        near(ColourSpace::Rec2020.light([1.0; 3]), [1.0; 3], 1e-12);
        near(
            ColourSpace::Rec2020.light([0.5, 0.5, 0.2]),
            [0.5 * 1.6605 - 0.5 * 0.5876 - 0.2 * 0.0728, 0.5043, 0.1641],
            2e-3,
        );
        near(ColourSpace::Srgb.light([2.0, 0.5, 0.0]), [2.0, 0.5, 0.0], 0.0);
        let aces = ColourSpace::Aces.light([1.0; 3]);
        assert!(aces[0] > 1.02 && aces[2] < 0.96, "D60 is warmer than D65: {aces:?}");
    }

    #[test]
    fn named_spectra() {
        assert_eq!(named("stdillum-D65"), Some([1.0; 3]));
        let [r, g, b] = named("stdillum-A").unwrap();
        let luminance = 0.212_6 * r + 0.715_2 * g + 0.072_2 * b;
        assert!(r > g && g > b && (luminance - 1.0).abs() < 1e-2, "{luminance}");
        assert_eq!(named("glass-BK7"), Some([1.5168; 3]));
        let (eta, k) = ior::conductor("Cu").unwrap();
        assert_eq!(named("metal-Cu-eta"), Some(eta.to_rgb().map(f64::from)));
        assert_eq!(named("metal-Cu-k"), Some(k.to_rgb().map(f64::from)));
        for metal in ["Ag", "Al", "Au", "Cu", "CuZn", "MgO", "TiO2"] {
            assert!(named(&format!("metal-{metal}-eta")).is_some() && named(&format!("metal-{metal}-k")).is_some());
        }
        assert_eq!(named("metal-Cu"), None);
        assert_eq!(named("metal-Xx-eta"), None);
    }
}
