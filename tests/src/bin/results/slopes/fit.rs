//! Slopes of bias and variance of an average, with intervals from groups of independent runs.

use photonfarm_tests::statistics::student_quantile;

/// Runs that a variance is taken over.
pub(super) const RUNS_OF_GROUP: usize = 4;

/// What one group of runs, or all together, says about the average over the first `N` iterations, for each `N` of interest.
#[derive(Clone, Debug)]
pub(super) struct Curves {
    /// Mean of the average less the true value, over the true value.
    pub(super) bias: Vec<f64>,
    /// Variance of the average over the squared true value.
    pub(super) variance: Vec<f64>,
}

/// A fitted slope.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slope {
    /// Exponent of `N`.
    pub(crate) value: f64,
    /// Its standard error.
    pub(crate) error: f64,
    /// Degrees of freedom of the error.
    freedom: usize,
}

impl Slope {
    /// Half the width of the interval that holds the true slope with probability `confidence`.
    pub(crate) fn half_width(&self, confidence: f64) -> f64 {
        self.error * student_quantile(1.0 - confidence, self.freedom)
    }

    /// Whether `slope` lies in the interval.
    pub(crate) fn holds(&self, slope: f64, confidence: f64) -> bool {
        (slope - self.value).abs() <= self.half_width(confidence)
    }
}

/// Curves of one group: `runs[r][i - 1]` is the estimate of iteration `i` by run `r`.
///
/// Iterations are independent, so the variance of their average is the sum of their variances, each taken over the runs
/// of the group, over `N^2`. No assumption is made on how the variance depends on the iteration.
pub(super) fn curves_of_group(runs: &[&[f64]], truth: f64, counts: &[u32]) -> Curves {
    let n_runs = runs.len() as f64;
    let mut sums = (0.0, 0.0);
    let mut running = Vec::with_capacity(runs[0].len());
    for i in 0..runs[0].len() {
        let mean = runs.iter().map(|run| run[i]).sum::<f64>() / n_runs;
        let squares: f64 = runs.iter().map(|run| (run[i] - mean).powi(2)).sum();
        sums.0 += mean;
        sums.1 += squares / (n_runs - 1.0);
        running.push(sums);
    }
    let at = |n: &u32| (f64::from(*n), running[*n as usize - 1]);
    Curves {
        bias: counts.iter().map(at).map(|(n, s)| s.0 / n / truth - 1.0).collect(),
        variance: counts
            .iter()
            .map(at)
            .map(|(n, s)| s.1 / (n * n) / (truth * truth))
            .collect(),
    }
}

/// The mean of curves.
fn mean<'a>(curves: impl Iterator<Item = &'a [f64]>) -> Vec<f64> {
    let mut total = Vec::new();
    let mut count = 0.0;
    for curve in curves {
        total.resize(curve.len(), 0.0);
        total.iter_mut().zip(curve).for_each(|(t, c)| *t += c);
        count += 1.0;
    }
    total.into_iter().map(|t| t / count).collect()
}

/// The mean of one curve of each group, with its standard error at each point.
pub(super) fn mean_with_error(groups: &[&[f64]]) -> (Vec<f64>, Vec<f64>) {
    let centre = mean(groups.iter().copied());
    let n = groups.len() as f64;
    let error = |i: usize| {
        let squares: f64 = groups.iter().map(|g| (g[i] - centre[i]).powi(2)).sum();
        (squares / (n - 1.0) / n).sqrt()
    };
    let errors = (0..centre.len()).map(error).collect();
    (centre, errors)
}

/// Least-squares slope of `ln |y|` over `ln n`, every point with the same weight.
pub(super) fn log_log_slope(counts: &[u32], curve: &[f64]) -> f64 {
    let x: Vec<f64> = counts.iter().map(|n| f64::from(*n).ln()).collect();
    let y: Vec<f64> = curve.iter().map(|v| v.abs().ln()).collect();
    let n = x.len() as f64;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let covariance: f64 = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    covariance / x.iter().map(|x| (x - mean_x).powi(2)).sum::<f64>()
}

/// The slope of the mean of one curve of each group; its error by leaving out each group in turn (the jackknife).
pub(super) fn slope(counts: &[u32], groups: &[&[f64]]) -> Slope {
    let value = log_log_slope(counts, &mean(groups.iter().copied()));
    let without: Vec<f64> = (0..groups.len())
        .map(|left_out| {
            let others = groups
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != left_out)
                .map(|(_, g)| *g);
            log_log_slope(counts, &mean(others))
        })
        .collect();
    let n = without.len() as f64;
    let centre = without.iter().sum::<f64>() / n;
    let squares: f64 = without.iter().map(|s| (s - centre).powi(2)).sum();
    Slope {
        value,
        error: ((n - 1.0) / n * squares).sqrt(),
        freedom: groups.len() - 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::random::{PathRandom, Stream};

    const COUNTS: [u32; 5] = [16, 32, 64, 128, 256];

    /// Estimates of mean `1 + i^-0.4` and variance `i^0.8` / 10^4: by theory slopes near -0.4 and -0.2.
    fn runs(seed: u64) -> Vec<Vec<f64>> {
        let run = |r: u64| {
            let mut random = PathRandom::new(seed, 1, Stream::Probe, r);
            let estimate = |i: u32| {
                let i = f64::from(i);
                // A sum of twelve uniform numbers, less 6, has variance 1.
                let noise = (0..12).map(|_| f64::from(random.next_1d())).sum::<f64>() - 6.0;
                1.0 + i.powf(-0.4) + 0.01 * i.powf(0.4) * noise
            };
            (1..=256).map(estimate).collect()
        };
        (0..40).map(run).collect()
    }

    #[test]
    fn slopes_of_known_noise_are_found_within_their_errors() {
        let runs = runs(5);
        let rows: Vec<&[f64]> = runs.iter().map(Vec::as_slice).collect();
        let groups: Vec<Curves> = rows
            .chunks(RUNS_OF_GROUP)
            .map(|g| curves_of_group(g, 1.0, &COUNTS))
            .collect();
        let bias = slope(&COUNTS, &groups.iter().map(|g| g.bias.as_slice()).collect::<Vec<_>>());
        let variance = slope(
            &COUNTS,
            &groups.iter().map(|g| g.variance.as_slice()).collect::<Vec<_>>(),
        );
        let exact = |term: fn(f64) -> f64, power: f64| {
            let total = |n: &u32| (1..=*n).map(|i| term(f64::from(i))).sum::<f64>() / f64::from(*n).powf(power);
            log_log_slope(&COUNTS, &COUNTS.iter().map(total).collect::<Vec<_>>())
        };
        let exact_bias = exact(|i| i.powf(-0.4), 1.0);
        let exact_variance = exact(|i| i.powf(0.8), 2.0);
        assert!(
            bias.holds(exact_bias, 0.999) && bias.half_width(0.95) < 0.02,
            "{bias:?} {exact_bias}"
        );
        assert!(
            variance.holds(exact_variance, 0.999) && variance.half_width(0.95) < 0.05,
            "{variance:?} {exact_variance}"
        );
        assert!(!bias.holds(exact_bias - 0.1, 0.999), "the test has power");
    }
}
