//! How far a picture is from another one.
//!
//! Of pictures `a` and `b` with `N` values each (pixels times three channels of linear Rec. 709 radiance):
//!
//! * mean squared error: `1/N sum (a - b)^2`;
//! * relative mean squared error: `1/N sum (a - b)^2 / (b^2 + epsilon)` (Rousselle, Knaus and Zwicker 2011), where `b` is the
//!   reference, and `epsilon` bounds the weight of dark pixels;
//! * structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004) of what the eye sees: grey values of the pictures as a
//!   screen shows them, between 0 and 1, in Gaussian windows of 11 by 11 pixels with a standard deviation of 1.5, those that
//!   lie within the picture.

use anyhow::{Result, bail, ensure};
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::spectrum::Spectrum;
use serde::{Deserialize, Serialize};

/// Added to the square of the reference where nothing else is asked for: that of a dark grey of 0.1.
pub(crate) const EPSILON: f64 = 0.01;
/// Pixels from the middle of a window to its edge.
const REACH: usize = 5;
const WINDOW: usize = 2 * REACH + 1;
/// Standard deviation of a window \[pixels\].
const DEVIATION: f64 = 1.5;
/// The constants of the paper, for values between 0 and 1.
const STABILISERS: [f64; 2] = [0.01 * 0.01, 0.03 * 0.03];

/// Linear values of a picture, row by row from the top left.
#[derive(Clone, Debug)]
pub(crate) struct Pixels {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) values: Vec<Spectrum>,
}

/// How far two pictures are from each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Errors {
    /// Mean squared error.
    pub(crate) mse: f64,
    /// Relative mean squared error.
    pub(crate) relmse: f64,
}

impl Pixels {
    /// Refuses values that are no numbers; `name` is that of the picture.
    pub(crate) fn check(&self, name: &str) -> Result<()> {
        let bad = |pixel: &Spectrum| pixel.to_rgb().iter().any(|value| !value.is_finite());
        if let Some(first) = self.values.iter().position(bad) {
            let count = self.values.iter().filter(|pixel| bad(pixel)).count();
            let (x, y) = (first % self.width as usize, first / self.width as usize);
            bail!(
                "{name} has {count} pixels that are infinite or no number, the first at {x},{y}: no error can be told from it"
            );
        }
        Ok(())
    }

    /// Refuses a picture of another size.
    pub(crate) fn check_size(&self, name: &str, other: &Self, other_name: &str) -> Result<()> {
        ensure!(
            (self.width, self.height) == (other.width, other.height),
            "{name} has {} by {} pixels and {other_name} {} by {}: only pictures of one size can be compared",
            self.width,
            self.height,
            other.width,
            other.height
        );
        Ok(())
    }

    /// Pairs of values with those of another picture of the same size.
    fn pairs<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (f64, f64)> + 'a {
        let both = self.values.iter().zip(&other.values);
        both.flat_map(|(a, b)| {
            let (a, b) = (a.to_rgb(), b.to_rgb());
            std::array::from_fn::<_, 3, _>(|i| (f64::from(a[i]), f64::from(b[i])))
        })
    }

    /// The errors against a reference of the same size.
    pub(crate) fn errors(&self, reference: &Self, epsilon: f64) -> Errors {
        let count = (3 * self.values.len()).max(1) as f64;
        let (mut squares, mut relative) = (0.0, 0.0);
        for (a, b) in self.pairs(reference) {
            let square = (a - b) * (a - b);
            squares += square;
            relative += square / (b * b + epsilon);
        }
        Errors {
            mse: squares / count,
            relmse: relative / count,
        }
    }

    /// Mean luminance.
    pub(crate) fn mean(&self) -> f64 {
        let sum: f64 = self.values.iter().map(|pixel| f64::from(pixel.luminance())).sum();
        sum / self.values.len().max(1) as f64
    }

    /// Linear values as a screen shows them, under a tone curve where there is one.
    pub(crate) fn shown(&self, curve: Option<&ToneCurve>) -> Vec<[f32; 3]> {
        let shown = |pixel: &Spectrum| match curve {
            Some(curve) => curve.apply(*pixel),
            None => pixel.to_rgb(),
        };
        self.values.iter().map(shown).collect()
    }

    /// Grey values between 0 and 1 as a screen shows them: in sRGB, under a tone curve where there is one.
    pub(crate) fn grey(&self, curve: Option<&ToneCurve>) -> Vec<f64> {
        let shown = self.shown(curve);
        let values = shown.into_iter().map(|pixel| Spectrum::from_rgb(pixel).luminance());
        values.map(|value| encoded(value.clamp(0.0, 1.0).into())).collect()
    }
}

/// The sRGB transfer function (IEC 61966-2-1).
pub(crate) fn encoded(linear: f64) -> f64 {
    match linear <= 0.003_130_8 {
        true => 12.92 * linear,
        false => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
    }
}

/// The inverse of [`encoded`].
pub(crate) fn decoded(value: f64) -> f64 {
    match value <= 0.040_45 {
        true => value / 12.92,
        false => ((value + 0.055) / 1.055).powf(2.4),
    }
}

/// Mean structural similarity of grey values of so many columns; nothing for pictures smaller than a window.
pub(crate) fn ssim(a: &[f64], b: &[f64], width: usize) -> Option<f64> {
    let height = a.len() / width.max(1);
    if width < WINDOW || height < WINDOW {
        return None;
    }
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>();
    let mean = |values: &[f64]| blurred(values, width, height);
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (square_a, square_b, both) = (mean(&product(a, a)), mean(&product(b, b)), mean(&product(a, b)));
    let [c1, c2] = STABILISERS;
    let sum: f64 = (0..both.len())
        .map(|i| {
            let (x, y) = (mean_a[i], mean_b[i]);
            let (xx, yy, xy) = (square_a[i] - x * x, square_b[i] - y * y, both[i] - x * y);
            (2.0 * x * y + c1) * (2.0 * xy + c2) / ((x * x + y * y + c1) * (xx + yy + c2))
        })
        .sum();
    Some(sum / both.len() as f64)
}

/// Weighted means over the windows that lie within the picture.
fn blurred(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let bell: [f64; WINDOW] = std::array::from_fn(|i| {
        let offset = i as f64 - REACH as f64;
        (-0.5 * (offset / DEVIATION).powi(2)).exp()
    });
    let total: f64 = bell.iter().sum();
    let weighted = |at: &dyn Fn(usize) -> f64| (0..WINDOW).map(|i| bell[i] / total * at(i)).sum::<f64>();
    let columns = width - 2 * REACH;
    let rows: Vec<f64> = (0..height * columns)
        .map(|at| {
            let first = at / columns * width + at % columns;
            weighted(&|i| values[first + i])
        })
        .collect();
    (0..(height - 2 * REACH) * columns)
        .map(|at| weighted(&|i| rows[at + i * columns]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(values: &[[f32; 3]]) -> Pixels {
        Pixels {
            width: values.len() as u32,
            height: 1,
            values: values.iter().map(|rgb| Spectrum::from_rgb(*rgb)).collect(),
        }
    }

    #[test]
    fn errors_are_those_of_their_formulas() {
        let (a, b) = (pixels(&[[1.0, 2.0, 0.5]]), pixels(&[[1.0, 1.0, 0.0]]));
        let errors = a.errors(&b, 0.25);
        assert!((errors.mse - 1.25 / 3.0).abs() < 1e-12, "{errors:?}");
        assert!((errors.relmse - (0.8 + 1.0) / 3.0).abs() < 1e-12, "{errors:?}");
        assert_eq!(a.errors(&a, EPSILON), Errors { mse: 0.0, relmse: 0.0 });
    }

    #[test]
    fn what_is_no_number_is_named_by_its_place() {
        let bad = pixels(&[[1.0; 3], [f32::NAN, 0.0, 0.0], [f32::INFINITY; 3]]);
        let error = bad.check("a.exr").unwrap_err().to_string();
        assert!(error.contains("a.exr has 2 pixels") && error.contains("1,0"), "{error}");
        pixels(&[[-1.0, 0.0, 1e30]]).check("b").unwrap();
    }

    /// Of constant pictures only the term of the means is left; of the same ones with opposite waves the term of structure.
    #[test]
    fn similarity_has_the_values_of_its_closed_forms() {
        let (width, count) = (16, 16 * 12);
        let (a, b) = (vec![0.5; count], vec![0.25; count]);
        let expected = (2.0 * 0.125 + 1e-4) / (0.25 + 0.0625 + 1e-4);
        assert!((ssim(&a, &b, width).unwrap() - expected).abs() < 1e-12);
        let wave = |sign: f64| -> Vec<f64> {
            let value = |i: usize| 0.5 + sign * if (i + i / width).is_multiple_of(2) { 0.25 } else { -0.25 };
            (0..count).map(value).collect()
        };
        assert!((ssim(&wave(1.0), &wave(1.0), width).unwrap() - 1.0).abs() < 1e-12);
        let opposite = ssim(&wave(1.0), &wave(-1.0), width).unwrap();
        let expected = (9e-4 - 2.0 * 0.0625) / (9e-4 + 2.0 * 0.0625);
        assert!((opposite - expected).abs() < 1e-3, "{opposite}");
        assert_eq!(ssim(&a[..100], &b[..100], 10), None);
    }

    #[test]
    fn screens_and_radiance_are_inverse() {
        for value in [0.0, 0.002, 0.0031308, 0.18, 1.0] {
            assert!((decoded(encoded(value)) - value).abs() < 1e-6, "{value}");
        }
    }
}
