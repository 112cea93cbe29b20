//! Spectra as written, turned into linear Rec. 709 as Mitsuba's RGB variants do.

mod cie;

use super::description::SpectrumValue;
use super::reader::Colour;
use crate::spectrum::Spectrum;

/// What a colour is for; it decides how a spectrum becomes RGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Use {
    /// A share of light: seen under D65, and at most one.
    Reflectance,
    /// Emitted light: the spectrum itself is seen.
    Emission,
    /// An optical constant: seen under D65, without an upper bound.
    Constant,
    /// How much a medium does along a length: as a constant, but in any unit of length.
    Coefficient,
}

/// The brightest light: beyond it power and its squares leave single precision.
pub(crate) const BRIGHTEST: f64 = 1e12;
/// The largest optical constant.
pub(crate) const LARGEST_CONSTANT: f64 = 1e4;

/// The RGB value of a colour, or why it has none.
pub(crate) fn to_rgb(colour: &Colour, used: Use) -> Result<Spectrum, String> {
    let rgb = match colour {
        Colour::Number(value) => [*value; 3],
        Colour::Rgb(rgb) => *rgb,
        Colour::Spectrum(SpectrumValue::Uniform(value)) if used == Use::Emission => {
            xyz_to_rgb([1.0; 3]).map(|channel| channel * value)
        }
        Colour::Spectrum(SpectrumValue::Uniform(value)) => [*value; 3],
        Colour::Spectrum(SpectrumValue::Sampled(samples)) => {
            if samples.iter().any(|(_, value)| *value < 0.0) {
                return Err("its values must not be negative".into());
            }
            let clamped = sampled_to_rgb(samples, used != Use::Emission).map(|channel| channel.max(0.0));
            if used == Use::Reflectance {
                clamped.map(|channel| channel.min(1.0))
            } else {
                clamped
            }
        }
    };
    if rgb.iter().any(|channel| *channel < 0.0) {
        return Err(format!("{rgb:?} is negative"));
    }
    if used == Use::Reflectance && rgb.iter().any(|channel| *channel > 1.0) {
        let advice = if is_of_bytes(&rgb) {
            "; colours of 0 to 255 are divided by 255"
        } else {
            ""
        };
        return Err(format!(
            "{rgb:?} is above 1: more light would leave the surface than arrives{advice}"
        ));
    }
    let greatest = greatest(used);
    if rgb.iter().any(|channel| *channel > greatest) {
        return Err(format!("{rgb:?} is above {greatest:e}"));
    }
    let rgb = Spectrum::from_rgb(rgb.map(|channel| channel as f32));
    Ok(rgb)
}

/// The greatest value of a use.
pub(crate) fn greatest(used: Use) -> f64 {
    match used {
        Use::Reflectance => 1.0,
        Use::Constant => LARGEST_CONSTANT,
        Use::Emission | Use::Coefficient => BRIGHTEST,
    }
}

/// Whether the channels of a reflectance look like bytes, 0 to 255.
pub(crate) fn is_of_bytes(channels: &[f64]) -> bool {
    channels.iter().all(|channel| channel.fract() == 0.0) && channels.iter().any(|channel| *channel > 1.5)
}

/// The radiance of a black body at a wavelength \[nm\], in [W/(m^2 sr nm)]: Planck's law.
pub(crate) fn planck(nm: f64, kelvin: f64) -> f64 {
    // Speed of light [m/s], Planck's constant [J s] and Boltzmann's [J/K], exact since 2019.
    const C: f64 = 299_792_458.0;
    const H: f64 = 6.626_070_15e-34;
    const K: f64 = 1.380_649e-23;
    let wavelength = nm * 1e-9;
    let fifth = wavelength * wavelength * wavelength * wavelength * wavelength;
    let per_metre = 2.0 * H * C * C / (fifth * libm::expm1(H * C / (wavelength * K * kelvin)));
    per_metre * 1e-9
}

/// `scale` times the radiance of a black body [W/(m^2 sr nm)], every 5 nm.
pub(crate) fn blackbody(kelvin: f64, scale: f64) -> Vec<(f64, f64)> {
    let sample = |nm: i32| (f64::from(nm), scale * planck(f64::from(nm), kelvin));
    (360..=830).step_by(5).map(sample).collect()
}

/// Linear Rec. 709 of a piecewise linear spectrum of light, scaled to luminance 1; negative channels count as 0. `None` where none of it
/// is seen.
pub(crate) fn unit_luminance(samples: &[(f64, f64)]) -> Option<[f64; 3]> {
    let xyz = sampled_to_xyz(samples, false);
    let luminance = xyz[1];
    (luminance > 0.0).then(|| xyz_to_rgb(xyz.map(|value| value / luminance)).map(|channel| channel.max(0.0)))
}

/// CIE XYZ of a piecewise linear spectrum of light, where the constant spectrum 1 has luminance 1.
pub(crate) fn xyz_of_emission(samples: &[(f64, f64)]) -> [f64; 3] {
    sampled_to_xyz(samples, false)
}

/// Samples of the integral over wavelength.
const SAMPLES: usize = 1000;
/// Integral of the observer's y \[nm\]; divides emission so that the constant spectrum 1 has luminance 1.
const Y_INTEGRAL: f64 = 106.750_259_399_414_06;
/// Integral of D65 times y over that of y; divides D65 so that it has luminance 1.
const D65_LUMINANCE: f64 = 98.997_417_518_762_55;

/// Linear Rec. 709 of a piecewise linear spectrum, zero outside its samples; under D65 or as emitted.
fn sampled_to_rgb(samples: &[(f64, f64)], under_d65: bool) -> [f64; 3] {
    xyz_to_rgb(sampled_to_xyz(samples, under_d65))
}

/// CIE XYZ of a piecewise linear spectrum, zero outside its samples; under D65 or as emitted.
///
/// `[X Y Z] = 1 / 106.75 * integral of s(l) i(l) [x y z](l) dl` with `i` the illuminant, by [`SAMPLES`] equidistant
/// samples each standing for a thousandth of the range, the rule of Mitsuba.
fn sampled_to_xyz(samples: &[(f64, f64)], under_d65: bool) -> [f64; 3] {
    let mut xyz = [0.0; 3];
    for i in 0..SAMPLES {
        let wavelength = cie::FIRST + (cie::LAST - cie::FIRST) * i as f64 / (SAMPLES - 1) as f64;
        let Some(value) = interpolate(samples, wavelength) else {
            continue;
        };
        let [x, y, z, d65] = observer(wavelength);
        let light = if under_d65 { value * d65 / D65_LUMINANCE } else { value };
        for (sum, weight) in xyz.iter_mut().zip([x, y, z]) {
            *sum += weight * light;
        }
    }
    xyz.map(|sum| sum * (cie::LAST - cie::FIRST) / SAMPLES as f64 / Y_INTEGRAL)
}

fn interpolate(samples: &[(f64, f64)], wavelength: f64) -> Option<f64> {
    let after = samples.partition_point(|(w, _)| *w <= wavelength);
    let (w0, v0) = *samples.get(after.checked_sub(1)?)?;
    match samples.get(after) {
        Some((w1, v1)) => Some(v0 + (v1 - v0) * (wavelength - w0) / (w1 - w0)),
        None => (wavelength == w0).then_some(v0),
    }
}

fn observer(wavelength: f64) -> [f64; 4] {
    let position = (wavelength - cie::FIRST) / cie::STEP;
    let row = (position.floor() as usize).min(cie::ROWS.len() - 2);
    let t = position - row as f64;
    std::array::from_fn(|i| cie::ROWS[row][i] * (1.0 - t) + cie::ROWS[row + 1][i] * t)
}

/// CIE XYZ to linear Rec. 709 (IEC 61966-2-1, unrounded).
pub(crate) fn xyz_to_rgb([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        3.240_479 * x - 1.537_150 * y - 0.498_535 * z,
        -0.969_256 * x + 1.875_991 * y + 0.041_556 * z,
        0.055_648 * x - 0.204_043 * y + 1.057_311 * z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(pairs: &[(f64, f64)], used: Use) -> [f32; 3] {
        to_rgb(&Colour::Spectrum(SpectrumValue::Sampled(pairs.to_vec())), used)
            .unwrap()
            .to_rgb()
    }

    fn assert_near(actual: [f32; 3], expected: [f32; 3]) {
        for (a, e) in actual.iter().zip(expected) {
            assert!((a - e).abs() <= 2e-5 * e.max(1.0), "{actual:?} is not {expected:?}");
        }
    }

    /// The expected values were computed by Mitsuba 3.9.1, `spectrum_list_to_srgb`.
    #[test]
    fn spectra_become_the_rgb_that_mitsuba_gives() {
        let lamp = [(400.0, 0.0), (500.0, 8.0), (600.0, 15.6), (700.0, 18.4)];
        assert_near(sampled(&lamp, Use::Emission), [20.710_82, 10.854_642, 2.771_151]);
        assert_near(sampled(&lamp, Use::Constant), [17.714_73, 11.354_427, 3.304_511]);
        let grey = [(400.0, 0.78), (500.0, 0.78), (600.0, 0.78), (700.0, 0.78)];
        assert_near(sampled(&grey, Use::Reflectance), [0.776_368, 0.779_809, 0.776_029]);
        let bumpy = [(400.0, 0.1), (450.0, 0.9), (550.0, 0.2), (700.0, 0.8)];
        assert_near(sampled(&bumpy, Use::Reflectance), [0.435_171, 0.311_151, 0.767_951]);
        assert_near(sampled(&bumpy, Use::Emission), [0.533_608, 0.290_975, 0.689_623]);
        assert_near(
            sampled(&[(600.0, 1.0), (700.0, 1.0)], Use::Emission),
            [0.968_726, 0.0, 0.0],
        );
        assert_near(
            sampled(&[(300.0, 1.0), (900.0, 1.0)], Use::Emission),
            [1.204_883, 0.948_229, 0.909_267],
        );
    }

    #[test]
    fn a_uniform_spectrum_is_grey_except_as_a_lamp() {
        let uniform = Colour::Spectrum(SpectrumValue::Uniform(2.0));
        assert_near(to_rgb(&uniform, Use::Constant).unwrap().to_rgb(), [2.0; 3]);
        assert_near(
            to_rgb(&uniform, Use::Emission).unwrap().to_rgb(),
            [2.409_59, 1.896_58, 1.817_83],
        );
        assert_near(to_rgb(&Colour::Number(2.0), Use::Emission).unwrap().to_rgb(), [2.0; 3]);
    }

    #[test]
    fn negative_and_amplifying_colours_are_refused() {
        assert!(to_rgb(&Colour::Rgb([0.5, 1.1, 0.5]), Use::Reflectance).is_err());
        assert!(to_rgb(&Colour::Rgb([0.5, -0.1, 0.5]), Use::Emission).is_err());
        assert!(to_rgb(&Colour::Number(-1.0), Use::Constant).is_err());
        assert!(to_rgb(&Colour::Rgb([0.5, 1.1, 0.5]), Use::Emission).is_ok());
        let negative = Colour::Spectrum(SpectrumValue::Sampled(vec![(400.0, -1.0), (700.0, 1.0)]));
        assert!(to_rgb(&negative, Use::Emission).is_err());
    }
}
