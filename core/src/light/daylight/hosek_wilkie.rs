//! The sky model of Hosek and Wilkie (2012, "An Analytic Model for Full Spectral Sky-Dome Radiance") and their sun (2013, "Adding a
//! Solar-Radiance Function to the Hosek-Wilkie Skylight Model").
//!
//! The numbers come from the authors, under the licence in `hosek_wilkie.license`; `core/tools/daylight_table.py` writes them. No crate
//! is used for the model: the one that there is (`hw-skymodel`) has no sun, and powers by the platform's mathematics, which differ in the
//! last bit between machines.

use super::Y_INTEGRAL;
use glam::DVec3;
use std::f64::consts::FRAC_PI_2;

/// Turbidities 1, 2, ..., 10.
const TURBIDITIES: usize = 10;
/// Albedos of the ground, 0 and 1.
const ALBEDOS: usize = 2;
/// Control points of a Bezier curve over the sun's elevation.
const CONTROL_POINTS: usize = 6;
const CHANNELS: usize = 3;
/// Parameters of the sky's formula.
const PARAMETERS: usize = 9;
/// Segments of the sun's elevation, in each of which irradiance is a polynomial.
const SEGMENTS: usize = 45;
/// Coefficients of the polynomial.
const COEFFICIENTS: usize = 4;

const SKY_PARAMETERS: usize = TURBIDITIES * ALBEDOS * CONTROL_POINTS * CHANNELS * PARAMETERS;
const SKY_RADIANCES: usize = TURBIDITIES * ALBEDOS * CONTROL_POINTS * CHANNELS;
const SUN_COEFFICIENTS: usize = TURBIDITIES * SEGMENTS * CHANNELS * COEFFICIENTS;

/// The parameters of the sky, then its radiances, then the coefficients of the sun's irradiance, as little-endian `f32`; the last index
/// of each table runs fastest.
static TABLE: &[u8; 4 * (SKY_PARAMETERS + SKY_RADIANCES + SUN_COEFFICIENTS)] = include_bytes!("hosek_wilkie.bin");

fn entry(index: usize) -> f64 {
    let bytes: [u8; 4] = std::array::from_fn(|byte| TABLE[4 * index + byte]);
    f32::from_le_bytes(bytes).into()
}

/// The lower of the two turbidities between which `turbidity` lies, as an index, and the share of the upper one.
fn between_turbidities(turbidity: f64) -> (usize, f64) {
    let place = turbidity.clamp(1.0, TURBIDITIES as f64) - 1.0;
    let lower = (place as usize).min(TURBIDITIES - 2);
    (lower, place - lower as f64)
}

/// The clear sky above a ground, for one place of the sun.
#[derive(Clone, Debug)]
pub struct Sky {
    /// Unit direction to the sun; +z is up.
    sun: DVec3,
    /// Parameters A to I of equation 8 by channel, in the order of the authors' code, where H and I are exchanged.
    parameters: [[f64; PARAMETERS]; CHANNELS],
    /// The radiance that the formula is a factor of, by channel.
    radiance: [f64; CHANNELS],
}

impl Sky {
    /// The sky for the unit direction `sun` to the sun, at or above the horizon. Turbidity lies in [1, 10]; the ground's albedo, by
    /// channel, in [0, 1].
    #[must_use]
    pub fn new(sun: DVec3, turbidity: f64, albedo: [f64; CHANNELS]) -> Self {
        let elevation = FRAC_PI_2 - libm::acos(sun.z.clamp(0.0, 1.0));
        let bezier = bernstein(libm::cbrt(elevation / FRAC_PI_2));
        let (lower, share) = between_turbidities(turbidity);
        // A value of one of the tables, whose entries of a turbidity, albedo and control point are `stride` numbers.
        let value = |first: usize, stride: usize, at: usize, albedo: f64| -> f64 {
            let of = |turbidity: usize, ground: usize| -> f64 {
                let curve = (turbidity * ALBEDOS + ground) * CONTROL_POINTS;
                let point = |i: usize| bezier[i] * entry(first + (curve + i) * stride + at);
                (0..CONTROL_POINTS).map(point).sum()
            };
            let over_ground = |turbidity| of(turbidity, 0) * (1.0 - albedo) + of(turbidity, 1) * albedo;
            over_ground(lower) * (1.0 - share) + over_ground(lower + 1) * share
        };
        let of_channel = |channel: usize| {
            let parameter = |i| value(0, CHANNELS * PARAMETERS, channel * PARAMETERS + i, albedo[channel]);
            std::array::from_fn(parameter)
        };
        Self {
            sun,
            parameters: std::array::from_fn(of_channel),
            radiance: std::array::from_fn(|channel| value(SKY_PARAMETERS, CHANNELS, channel, albedo[channel])),
        }
    }

    /// Linear Rec. 709 radiance from the unit direction `towards`, which lies at or above the horizon: equation 8. Colours out of gamut
    /// are cut off at 0.
    #[must_use]
    pub fn radiance(&self, towards: DVec3) -> [f64; CHANNELS] {
        let cos_theta = towards.z.max(0.0);
        let cos_gamma = towards.dot(self.sun).clamp(-1.0, 1.0);
        let gamma = libm::acos(cos_gamma);
        std::array::from_fn(|channel| {
            let [a, b, c, d, e, f, g, i, h] = self.parameters[channel];
            let base = 1.0 + h * h - 2.0 * h * cos_gamma;
            let chi = (1.0 + cos_gamma * cos_gamma) / (base * base.sqrt());
            let gradient = 1.0 + a * libm::exp(b / (cos_theta + 0.01));
            let scattering = c + d * libm::exp(e * gamma) + f * cos_gamma * cos_gamma + g * chi + i * cos_theta.sqrt();
            (gradient * scattering * self.radiance[channel] / Y_INTEGRAL).max(0.0)
        })
    }
}

/// The polynomials of Bernstein of degree 5 at `x`.
fn bernstein(x: f64) -> [f64; CONTROL_POINTS] {
    let y = 1.0 - x;
    let power = |base: f64, exponent: usize| (0..exponent).fold(1.0, |product, _| product * base);
    let binomial = [1.0, 5.0, 10.0, 10.0, 5.0, 1.0];
    std::array::from_fn(|i| binomial[i] * power(x, i) * power(y, CONTROL_POINTS - 1 - i))
}

/// Linear Rec. 709 irradiance by the sun's disc of a surface that faces it, for a sun at `elevation` \[radians\] in [0, pi/2] above the
/// horizon and a turbidity in [1, 10]. Colours out of gamut are cut off at 0.
#[must_use]
pub fn sun_irradiance(elevation: f64, turbidity: f64) -> [f64; CHANNELS] {
    let share_of_quarter = (elevation / FRAC_PI_2).clamp(0.0, 1.0);
    let segment = ((libm::cbrt(share_of_quarter) * SEGMENTS as f64) as usize).min(SEGMENTS - 1);
    let start = segment as f64 / SEGMENTS as f64;
    let x = FRAC_PI_2 * (share_of_quarter - start * start * start);
    let (lower, share) = between_turbidities(turbidity);
    std::array::from_fn(|channel| {
        let of = |turbidity: usize| -> f64 {
            let first = SKY_PARAMETERS + SKY_RADIANCES;
            let row = first + ((turbidity * SEGMENTS + segment) * CHANNELS + channel) * COEFFICIENTS;
            (0..COEFFICIENTS).rev().fold(0.0, |sum, k| sum * x + entry(row + k))
        };
        ((of(lower) * (1.0 - share) + of(lower + 1) * share) / Y_INTEGRAL).max(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn direction(elevation: f64, azimuth: f64) -> DVec3 {
        let (elevation, azimuth) = (elevation.to_radians(), azimuth.to_radians());
        let cos = libm::cos(elevation);
        DVec3::new(cos * libm::cos(azimuth), cos * libm::sin(azimuth), libm::sin(elevation))
    }

    fn assert_near(label: &str, actual: [f64; 3], expected: [f64; 3], tolerance: f64) {
        for (a, e) in actual.iter().zip(expected) {
            assert!(
                (a - e.max(0.0)).abs() <= tolerance * e.abs(),
                "{label}: {actual:?} is not {expected:?}"
            );
        }
    }

    /// Values of Mitsuba 3.9.1 (`sunsky` without its sun, in single precision): turbidity, albedo and elevation of the sun at azimuth 0,
    /// then elevation and azimuth of a direction [degrees] and its radiance.
    #[test]
    fn the_sky_is_that_of_mitsuba() {
        let clear = (3.0, [0.3; 3], 40.0);
        let low = (1.0, [0.0, 0.5, 1.0], 10.0);
        let high = (6.7, [0.2, 0.1, 0.05], 75.0);
        let hazy = (10.0, [0.0; 3], 2.5);
        for ((turbidity, albedo, sun), view, expected) in [
            (clear, (0.5, 90.0), [0.126_014, 0.156_588, 0.160_442]),
            (clear, (20.0, 10.0), [0.166_155, 0.212_264, 0.268_315]),
            (clear, (40.0, 3.0), [0.192_331, 0.213_954, 0.236_708]),
            (clear, (60.0, 180.0), [0.019_370_1, 0.038_100_2, 0.079_709_6]),
            (clear, (89.0, 0.0), [0.021_519_8, 0.038_434_6, 0.077_571_5]),
            (low, (0.5, 90.0), [0.072_336_2, 0.096_051_3, 0.074_100_2]),
            (low, (40.0, 3.0), [0.021_718, 0.041_705_1, 0.065_929_2]),
            (low, (60.0, 180.0), [0.009_987_06, 0.022_191_3, 0.041_314]),
            (high, (0.5, 90.0), [0.131_473, 0.110_721, 0.121_904]),
            (high, (20.0, 10.0), [0.102_723, 0.130_972, 0.187_149]),
            (high, (89.0, 0.0), [0.274_838, 0.278_621, 0.279_91]),
            (hazy, (0.5, 90.0), [0.001_290_73, 0.001_505_07, 0.001_271_93]),
            (hazy, (20.0, 10.0), [0.077_376_9, 0.043_099_8, 0.022_329]),
            (hazy, (60.0, 180.0), [0.012_919_2, 0.014_05, 0.014_452_4]),
        ] {
            let sky = Sky::new(direction(sun, 0.0), turbidity, albedo);
            let label = format!("turbidity {turbidity}, sun {sun}, view {view:?}");
            assert_near(&label, sky.radiance(direction(view.0, view.1)), expected, 1e-3);
        }
    }

    /// Irradiances of Mitsuba 3.9.1 (`sunsky` without its sky, `complex_sun`, whose radiance was integrated over the disc by 1600 points in
    /// single precision): turbidity, elevation [degrees], irradiance.
    #[test]
    fn the_sun_is_that_of_mitsuba() {
        for (turbidity, elevation, expected) in [
            (1.0, 12.0, [1.225_54, 0.800_638, 0.330_369]),
            (1.0, 50.0, [1.532_53, 1.273_52, 0.954_252]),
            (1.0, 89.0, [1.563, 1.327_4, 1.049]),
            (2.5, 12.0, [1.129_95, 0.732_391, 0.303_382]),
            (2.5, 50.0, [1.498_8, 1.242_76, 0.932_42]),
            (3.0, 50.0, [1.483_76, 1.229_01, 0.922_564]),
            (10.0, 12.0, [0.162_607, 0.087_413_3, 0.040_154_8]),
            (10.0, 50.0, [0.888_289, 0.697_15, 0.538_802]),
            (10.0, 89.0, [1.029_58, 0.836_441, 0.677_01]),
        ] {
            let label = format!("turbidity {turbidity}, elevation {elevation}");
            let found = sun_irradiance(f64::to_radians(elevation), turbidity);
            assert_near(&label, found, expected, 1.5e-3);
        }
    }

    /// Both ends of all ranges are in the tables.
    #[test]
    fn the_models_hold_at_the_ends_of_their_ranges() {
        for turbidity in [1.0, 10.0] {
            for elevation in [0.0, 90.0] {
                for albedo in [0.0, 1.0] {
                    let sky = Sky::new(direction(elevation, 20.0), turbidity, [albedo; 3]);
                    let zenith = sky.radiance(DVec3::Z);
                    assert!(
                        zenith.iter().all(|channel| *channel > 0.0 && *channel < 2.0),
                        "{zenith:?}"
                    );
                }
                let sun = sun_irradiance(f64::to_radians(elevation), turbidity);
                assert!(sun.iter().all(|channel| (0.0..2.0).contains(channel)), "{sun:?}");
            }
        }
    }
}
