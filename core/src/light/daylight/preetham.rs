//! The sun of Preetham, Shirley and Smits (1999, "A Practical Analytic Model for Daylight", appendix A.1): the spectrum of the sun outside
//! the atmosphere, less what the air takes away. Mitsuba 0.x has this sun beside the sky of Hosek and Wilkie.

use std::f64::consts::FRAC_PI_2;

/// The first wavelength of the table \[nm\].
const FIRST: f64 = 380.0;
/// The distance between its rows \[nm\].
const STEP: f64 = 10.0;

/// Radiance of the sun outside the atmosphere [W/(m^2 nm sr)], and the absorption coefficients of ozone [1/cm] and of water vapour [1/cm];
/// table 2 of the paper. Mixed gases absorb beyond it only.
#[rustfmt::skip]
const ROWS: [[f64; 3]; 38] = [
    [16_559.0, 0.0, 0.0], [16_233.7, 0.0, 0.0], [21_127.5, 0.0, 0.0], [25_888.2, 0.0, 0.0],
    [25_829.1, 0.0, 0.0], [24_232.3, 0.0, 0.0], [26_760.5, 0.0, 0.0], [29_658.3, 0.003, 0.0],
    [30_545.4, 0.006, 0.0], [30_057.5, 0.009, 0.0], [30_663.7, 0.014, 0.0], [28_830.4, 0.021, 0.0],
    [28_712.1, 0.03, 0.0], [27_825.0, 0.04, 0.0], [27_100.6, 0.048, 0.0], [27_233.6, 0.063, 0.0],
    [26_361.3, 0.075, 0.0], [25_503.8, 0.085, 0.0], [25_060.2, 0.103, 0.0], [25_311.6, 0.12, 0.0],
    [25_355.9, 0.12, 0.0], [25_134.2, 0.115, 0.0], [24_631.5, 0.125, 0.0], [24_173.2, 0.12, 0.0],
    [23_685.3, 0.105, 0.0], [23_212.1, 0.09, 0.0], [22_827.7, 0.079, 0.0], [22_339.8, 0.067, 0.0],
    [21_970.2, 0.057, 0.0], [21_526.7, 0.048, 0.0], [21_097.9, 0.036, 0.0], [20_728.3, 0.028, 0.016],
    [20_240.4, 0.023, 0.024], [19_870.8, 0.018, 0.012_5], [19_427.2, 0.014, 1.0], [19_072.4, 0.011, 0.87],
    [18_628.9, 0.01, 0.061], [18_259.2, 0.009, 0.001],
];

/// Ozone above the place \[cm\].
const OZONE: f64 = 0.35;
/// Precipitable water above the place \[cm\].
const WATER: f64 = 2.0;
/// Exponent of wavelength of the aerosols' scattering (Angstrom).
const AEROSOL_EXPONENT: f64 = 1.3;

/// Radiance of the sun's disc by wavelength [nm, W/(m^2 nm sr)], for a sun at `elevation` \[radians\] in [0, pi/2] above the horizon and a
/// turbidity of 1 and more.
#[must_use]
pub fn sun_spectrum(elevation: f64, turbidity: f64) -> Vec<(f64, f64)> {
    let zenith = FRAC_PI_2 - elevation;
    // Relative optical mass of the air on the way to the sun.
    let mass = 1.0 / (libm::sin(elevation) + 0.15 * libm::pow(93.885 - zenith.to_degrees(), -1.253));
    let aerosol = 0.046_083_658_220_5 * turbidity - 0.045_860_259_285_22;
    let row = |(index, [outside, ozone, water]): (usize, &[f64; 3])| {
        let wavelength = FIRST + STEP * index as f64;
        let micrometres = wavelength / 1000.0;
        let rayleigh = 0.008_735 * libm::pow(micrometres, -4.08);
        let scattered = rayleigh + aerosol * libm::pow(micrometres, -AEROSOL_EXPONENT);
        let vapour = 0.2385 * water * WATER / libm::pow(1.0 + 20.07 * water * WATER * mass, 0.45);
        let transmitted = libm::exp(-mass * (scattered + ozone * OZONE + vapour));
        (wavelength, outside * transmitted)
    };
    ROWS.iter().enumerate().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_air_takes_away_more_the_lower_the_sun_and_the_shorter_the_wave() {
        let share = |elevation: f64| {
            let spectrum = sun_spectrum(elevation, 1.0);
            let of = |index: usize| spectrum[index].1 / ROWS[index][0];
            [of(2), of(17), of(30)]
        };
        let high = share(FRAC_PI_2);
        // exp(-0.008735 * 0.55^-4.08 - 0.085 * 0.35) and the little that turbidity 1 scatters.
        assert!((high[1] - 0.878).abs() < 2e-3, "{high:?}");
        let low = share(0.1);
        assert!(high[0] < high[1] && high[1] < high[2] && low[0] < low[1] && low[1] < low[2]);
        assert!(low.iter().zip(high).all(|(low, high)| *low < high));
        let hazy = sun_spectrum(1.0, 8.0);
        assert!(
            hazy.iter()
                .zip(sun_spectrum(1.0, 2.0))
                .all(|(hazy, clear)| hazy.1 < clear.1)
        );
    }
}
