//! Bandwidth schedules: closed functions of the iteration index, so that iterations need nothing from each other.

/// Share of the first iteration's squared bandwidth that is left in iteration `i` (1, 2, ...):
/// `prod_{k=1}^{i-1} (k + alpha) / (k + 1)` (Knaus and Zwicker 2011, equation 15; thesis equation 3.27).
fn remaining_share(iteration: u32, alpha: f64) -> f64 {
    (1..iteration)
        .map(|k| (f64::from(k) + alpha) / (f64::from(k) + 1.0))
        .product()
}

/// Radius of iteration `iteration` (1, 2, ...) over the first radius, for PPPM: `r_i^2 = r_1^2 prod (k + alpha) / (k + 1)`
/// (Knaus and Zwicker 2011, equation 15).
#[must_use]
pub fn pppm_radius_ratio(iteration: u32, alpha: f64) -> f64 {
    remaining_share(iteration, alpha).sqrt()
}

/// Radius of iteration `iteration` (1, 2, ...) over the first radius, for a kernel over `dimensions` (1, 2 or 3):
/// `r_i^d = r_1^d prod (k + alpha) / (k + 1)`, so that the variance grows as (i + 1) / (i + alpha) whatever `d` is.
#[must_use]
pub fn radius_ratio(iteration: u32, alpha: f64, dimensions: u32) -> f64 {
    let share = remaining_share(iteration, alpha);
    match dimensions {
        1 => share,
        2 => share.sqrt(),
        _ => libm::cbrt(share),
    }
}

/// Spatial bandwidth of iteration `iteration` (1, 2, ...) over the first one, for PCF: the root `s` of
/// `s^d (1 - cos(theta_1 s^p)) = (1 - cos theta_1) prod (k + alpha) / (k + 1)`, with `d` dimensions of positions: 2 on surfaces (thesis equation
/// 3.27), 3 in media.
///
/// The thesis says of media that only the spatial domain changes (section 3.7.2): the variance goes as the inverse of the kernel's measure (lemma
/// 3.1), which is `sigma^3 (1 - cos theta)` there, and may grow by (i + 1) / (i + alpha), so that the average's falls as N^-alpha. With small angles
/// `sigma_i` falls as i^((alpha - 1) / (2 p + d)), and the averaged bias, which is of the order sigma^2 whatever `d` is (lemma 3.2 and the footnote of section
/// 3.7.2), as N^(2 (alpha - 1) / (2 p + d)): for `d` = 2 that is lemma 3.3.
///
/// `theta1` in radians, in (0, pi]; `p` at least 1. The left side grows with `s`, so bisection finds the root to the
/// last bit of an `f64`.
#[must_use]
pub fn pcf_sigma_ratio(iteration: u32, alpha: f64, p: f64, theta1: f64, dimensions: u32) -> f64 {
    let target = one_minus_cos(theta1) * remaining_share(iteration, alpha);
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    loop {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            return high;
        }
        let measure = match dimensions {
            2 => middle * middle,
            _ => middle * middle * middle,
        };
        if measure * one_minus_cos(theta1 * libm::pow(middle, p)) < target {
            low = middle;
        } else {
            high = middle;
        }
    }
}

/// Angular bandwidth \[radians\] at the spatial bandwidth `sigma_ratio` times the first one: `t(sigma) = theta_1 (sigma / sigma_1)^p`.
#[must_use]
pub fn pcf_theta(sigma_ratio: f64, p: f64, theta1: f64) -> f64 {
    theta1 * libm::pow(sigma_ratio, p)
}

fn one_minus_cos(angle: f64) -> f64 {
    let half = libm::sin(0.5 * angle);
    2.0 * half * half
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pppm_matches_the_gamma_function_form() {
        let alpha = 2.0 / 3.0;
        for i in [1_u32, 2, 10, 1000] {
            let n = f64::from(i);
            let closed = libm::exp(libm::lgamma(n + alpha) - libm::lgamma(1.0 + alpha) - libm::lgamma(n + 1.0));
            let ratio = pppm_radius_ratio(i, alpha);
            assert!(
                (ratio * ratio / closed - 1.0).abs() < 1e-10,
                "iteration {i}: {} against {closed}",
                ratio * ratio
            );
        }
    }

    /// The kernel's measure shrinks alike in all dimensions.
    #[test]
    fn kernels_of_all_dimensions_keep_the_same_share() {
        for iteration in [1, 2, 100] {
            let share = pppm_radius_ratio(iteration, 0.5).powi(2);
            for dimensions in 1..=3 {
                let ratio = radius_ratio(iteration, 0.5, dimensions);
                assert!((ratio.powi(dimensions as i32) / share - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn pcf_solves_its_equation_and_starts_at_one() {
        let theta1 = 18.0_f64.to_radians();
        for (alpha, p) in [(0.2, 1.0), (0.2, 2.0), (0.7, 1.5)] {
            for dimensions in [2, 3] {
                assert_eq!(pcf_sigma_ratio(1, alpha, p, theta1, dimensions), 1.0);
                for i in [2_u32, 17, 1000] {
                    let s = pcf_sigma_ratio(i, alpha, p, theta1, dimensions);
                    let left = s.powi(dimensions as i32) * one_minus_cos(pcf_theta(s, p, theta1));
                    let right = one_minus_cos(theta1) * remaining_share(i, alpha);
                    assert!((left / right - 1.0).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn pcf_shrinks_at_the_rate_of_the_small_angle_limit() {
        let (alpha, p, theta1) = (0.2, 1.5, 0.1_f64.to_radians());
        let i = 500_u32;
        for dimensions in [2, 3] {
            let sigma = |i| pcf_sigma_ratio(i, alpha, p, theta1, dimensions);
            let ratio = sigma(i) / sigma(i + 1);
            let expected = f64::from(i + 1) / (f64::from(i) + alpha);
            assert!((libm::pow(ratio, 2.0 * p + f64::from(dimensions)) / expected - 1.0).abs() < 1e-6);
        }
    }
}
