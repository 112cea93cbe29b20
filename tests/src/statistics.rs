//! Means with their standard errors, and z-tests with a stated false-alarm rate.

use std::ops::Range;

/// Running mean and variance of vectors of equal length (Welford 1962).
#[derive(Clone, Debug, Default)]
pub struct Moments {
    count: f64,
    mean: Vec<f64>,
    sum_of_squares: Vec<f64>,
}

impl Moments {
    /// Adds one observation.
    ///
    /// # Panics
    /// If its length is not that of the observations before.
    pub fn push(&mut self, values: &[f64]) {
        if self.mean.is_empty() {
            self.mean = vec![0.0; values.len()];
            self.sum_of_squares = vec![0.0; values.len()];
        }
        assert_eq!(values.len(), self.mean.len());
        self.count += 1.0;
        for ((mean, squares), value) in self.mean.iter_mut().zip(&mut self.sum_of_squares).zip(values) {
            let delta = value - *mean;
            *mean += delta / self.count;
            *squares += delta * (value - *mean);
        }
    }

    /// Means that are known exactly.
    #[must_use]
    pub fn exact(values: &[f64]) -> Self {
        let mut moments = Self::default();
        moments.push(values);
        moments.push(values);
        moments
    }

    /// Some of the components.
    #[must_use]
    pub fn components(&self, range: Range<usize>) -> Self {
        Self {
            count: self.count,
            mean: self.mean[range.clone()].to_vec(),
            sum_of_squares: self.sum_of_squares[range].to_vec(),
        }
    }

    /// The mean of each component.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Squared standard error of each mean.
    #[must_use]
    pub fn squared_error(&self) -> Vec<f64> {
        self.sum_of_squares
            .iter()
            .map(|s| s / (self.count - 1.0) / self.count)
            .collect()
    }
}

/// The outcome of comparing two vectors of means.
#[derive(Clone, Copy, Debug)]
pub struct ZTest {
    /// Largest |z| over the components.
    pub largest: f64,
    /// What it may reach: all components together exceed it with the false-alarm rate.
    pub threshold: f64,
    /// Mean over components of the standard error of the difference, over the mean of the second vector.
    pub relative_noise: f64,
    /// Mean over components of the difference, over the mean of the second vector.
    pub relative_difference: f64,
}

impl ZTest {
    /// Compares two independent vectors of means. `false_alarms` is the probability of failing where they are equal,
    /// shared among the components after Sidak.
    #[must_use]
    pub fn compare(a: &Moments, b: &Moments, false_alarms: f64) -> Self {
        let errors: Vec<f64> = a
            .squared_error()
            .iter()
            .zip(b.squared_error())
            .map(|(a, b)| (a + b).sqrt())
            .collect();
        let n = errors.len() as f64;
        let z = |i: usize| {
            let difference = (a.mean[i] - b.mean[i]).abs();
            if difference == 0.0 { 0.0 } else { difference / errors[i] }
        };
        let scale: f64 = b.mean.iter().sum();
        Self {
            largest: (0..errors.len()).map(z).fold(0.0, f64::max),
            threshold: two_sided_quantile(1.0 - (1.0 - false_alarms).powf(1.0 / n)),
            relative_noise: errors.iter().sum::<f64>() / scale,
            relative_difference: (a.mean.iter().sum::<f64>() - scale) / scale,
        }
    }

    /// Whether no component differs by more than the threshold.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.largest <= self.threshold
    }
}

/// The `z` that a standard normal variable exceeds in absolute value with probability `p`.
fn two_sided_quantile(p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if libm::erfc(middle / std::f64::consts::SQRT_2) > p {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// The `t` that Student's variable with `freedom` degrees of freedom exceeds in absolute value with probability `p`.
///
/// The density is integrated by Simpson's rule; good to about six digits for `p` from 1e-6 and `freedom` from 3.
#[must_use]
pub fn student_quantile(p: f64, freedom: usize) -> f64 {
    const STEPS: usize = 400;
    let n = freedom as f64;
    let constant = (libm::lgamma(0.5 * (n + 1.0)) - libm::lgamma(0.5 * n)).exp() / (n * std::f64::consts::PI).sqrt();
    let density = |t: f64| constant * (1.0 + t * t / n).powf(-0.5 * (n + 1.0));
    // With t = tan(x) the interval is finite and the integrand smooth.
    let integrand = |x: f64| density(x.tan()) / x.cos().powi(2);
    let within = |t: f64| {
        let step = t.atan() / STEPS as f64;
        let sum: f64 = (0..STEPS)
            .map(|i| {
                let x = i as f64 * step;
                integrand(x) + 4.0 * integrand(x + 0.5 * step) + integrand(x + step)
            })
            .sum();
        2.0 * sum * step / 6.0
    };
    let (mut low, mut high) = (0.0, 1e4);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        if 1.0 - within(middle) > p {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        assert!((two_sided_quantile(0.05) - 1.959_964).abs() < 1e-5);
        assert!((two_sided_quantile(0.001) - 3.290_527).abs() < 1e-5);
        assert!((student_quantile(0.05, 9) - 2.262_157).abs() < 1e-5);
        assert!((student_quantile(0.001, 9) - 4.780_913).abs() < 1e-5);
    }

    #[test]
    fn a_shift_of_many_standard_errors_fails_and_none_passes() {
        let observe = |shift: f64| {
            let mut moments = Moments::default();
            for i in 0..100 {
                moments.push(&[shift + f64::from(i % 10), f64::from(i % 7)]);
            }
            moments
        };
        assert!(ZTest::compare(&observe(0.0), &observe(0.0), 1e-3).passes());
        assert!(!ZTest::compare(&observe(3.0), &observe(0.0), 1e-3).passes());
    }
}
