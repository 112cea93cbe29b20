//! The glow of media by their temperature.

use crate::scene::spectrum::{BRIGHTEST, blackbody, planck, xyz_of_emission, xyz_to_rgb};

/// The colours of black bodies whose radiance is 1 at the wavelength where it is largest (pbrt-v4, `BlackbodySpectrum`), as its film shows
/// them.
pub(super) struct Heat {
    /// At temperatures of which each is [`RATIO`] times the one before.
    colours: Vec<[f64; 3]>,
}

/// What is colder does not glow in pbrt-v4 (`GridMedium::SamplePoint`), and what is warmer glows as this \[K\].
const COLDEST: f64 = 100.0;
const WARMEST: f64 = 1e5;
const STEPS: usize = 1024;
/// The film of pbrt-v4 weighs radiance by the observer alone, and lights are divided by the luminance that they have by this; media
/// are not (`PixelSensor::ToSensorRGB`, `SpectrumToPhotometric`) \[nm\].
pub(super) const LUMINANCE_OF_ONE: f64 = 106.856_895;

impl Heat {
    pub(super) fn new() -> Self {
        let colour = |step: usize| {
            let kelvin = COLDEST * libm::pow(WARMEST / COLDEST, step as f64 / STEPS as f64);
            // Wien's displacement law: where the spectrum is largest [nm].
            let peak = 2.897_771_955e6 / kelvin;
            let xyz = xyz_of_emission(&blackbody(kelvin, LUMINANCE_OF_ONE / planck(peak, kelvin)));
            xyz_to_rgb(xyz).map(|channel| channel.max(0.0))
        };
        Self {
            colours: (0..=STEPS).map(colour).collect(),
        }
    }

    /// The colour at a temperature \[K\].
    pub(super) fn at(&self, kelvin: f64) -> [f64; 3] {
        if kelvin.is_nan() || kelvin <= COLDEST {
            return [0.0; 3];
        }
        let place = libm::log(kelvin.min(WARMEST) / COLDEST) / libm::log(WARMEST / COLDEST) * STEPS as f64;
        let lower = (place as usize).min(STEPS - 1);
        let share = place - lower as f64;
        std::array::from_fn(|channel| {
            self.colours[lower][channel] * (1.0 - share) + self.colours[lower + 1][channel] * share
        })
    }
}

/// A number of a lattice, not negative and not too large.
pub(super) fn bounded(value: f64) -> f32 {
    value.clamp(0.0, BRIGHTEST) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::description::SpectrumValue;
    use crate::scene::reader::Colour;
    use crate::scene::spectrum::{Use, to_rgb};

    /// Between the steps it is what the spectrum gives, which is divided by its largest value and not by its luminance.
    #[test]
    fn colours_are_those_of_black_bodies() {
        let heat = Heat::new();
        for kelvin in [1500.0, 2700.0, 6504.0, 30_000.0] {
            let peak = 2.897_771_955e6 / kelvin;
            let samples = blackbody(kelvin, LUMINANCE_OF_ONE / planck(peak, kelvin));
            let expected = to_rgb(&Colour::Spectrum(SpectrumValue::Sampled(samples)), Use::Emission).unwrap();
            for (found, expected) in heat.at(kelvin).into_iter().zip(expected.to_rgb()) {
                assert!(
                    (found - f64::from(expected)).abs() <= 2e-3 * f64::from(expected),
                    "{kelvin}: {found}, not {expected}"
                );
            }
        }
        // At 6504 K the spectrum is largest at 446 nm and even enough: its luminance is nearly that of 1 everywhere.
        let [r, g, b] = heat.at(6504.0);
        let luminance = 0.212_6 * r + 0.715_2 * g + 0.072_2 * b;
        assert!((luminance / LUMINANCE_OF_ONE - 0.88).abs() < 0.03, "{luminance}");
        assert_eq!(heat.at(100.0), [0.0; 3]);
        assert_eq!(heat.at(f64::NAN), [0.0; 3]);
        assert_eq!(heat.at(1e9), heat.at(1e5));
    }
}
