//! The reconstruction filter.

use crate::math::{Vec2, safe_sqrt};
use std::sync::LazyLock;

/// Reconstruction filter. It is importance-sampled (Ernst, Stamminger and Greiner 2006), so that a camera sample
/// belongs to one pixel and has weight one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// Constant within `radius` \[pixels\].
    Box {
        /// Half width \[pixels\].
        radius: f32,
    },
    /// Linear to zero at `radius`.
    Tent {
        /// Half width \[pixels\].
        radius: f32,
    },
    /// Gaussian of standard deviation `stddev`, cut at four of them and lowered to reach zero there, as Mitsuba's.
    Gaussian {
        /// Standard deviation \[pixels\].
        stddev: f32,
    },
}

impl Filter {
    /// Offset from the pixel's centre \[pixels\], distributed as the filter, by inversion along each axis.
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Vec2 {
        match *self {
            Self::Box { radius } => radius * (2.0 * u - Vec2::ONE),
            Self::Tent { radius } => radius * u.map(sample_tent),
            Self::Gaussian { stddev } => stddev * u.map(sample_gaussian),
        }
    }

    /// The pixel that a path through the image position `at` \[pixels\] counts for, row by row from the top left, and its factor.
    ///
    /// The filter spreads the path over pixels about it: one of them is chosen with a probability in proportion to its share, and the
    /// factor is the sum of their shares, 1 for a filter that adds up to one over the pixels. `None` beside the image.
    #[must_use]
    pub fn choose_pixel(&self, at: Vec2, resolution: [u32; 2], u: Vec2) -> Option<(usize, f32)> {
        let (x, share_x) = self.choose(at.x, resolution[0], u.x)?;
        let (y, share_y) = self.choose(at.y, resolution[1], u.y)?;
        Some((y * resolution[0] as usize + x, share_x * share_y))
    }

    /// The same along one axis.
    fn choose(&self, at: f32, pixels: u32, u: f32) -> Option<(usize, f32)> {
        let radius = self.radius();
        let beyond = |offset: f32| (at - 0.5 + offset).ceil();
        let (first, end) = (beyond(-radius), beyond(radius));
        if end <= 0.0 || first >= pixels as f32 || end <= first {
            return None;
        }
        let share = |pixel: f32| self.value(at - (pixel + 0.5));
        let candidates = || (0..(end - first) as u32).map(|offset| first + offset as f32);
        let sum: f32 = candidates().map(share).sum();
        let mut left = u * sum;
        let chosen = candidates().find(|pixel| {
            left -= share(*pixel);
            left < 0.0
        });
        let pixel = chosen.unwrap_or(end - 1.0);
        (pixel >= 0.0 && pixel < pixels as f32).then_some((pixel as usize, sum))
    }

    /// Distance beyond which the filter is zero \[pixels\].
    fn radius(&self) -> f32 {
        match *self {
            Self::Box { radius } | Self::Tent { radius } => radius,
            Self::Gaussian { stddev } => GAUSSIAN_CUT as f32 * stddev,
        }
    }

    /// Density along one axis of [`Self::sample`] at the offset [1/pixel] within the radius.
    fn value(&self, offset: f32) -> f32 {
        match *self {
            Self::Box { radius } => 0.5 / radius,
            Self::Tent { radius } => (1.0 - offset.abs() / radius).max(0.0) / radius,
            Self::Gaussian { stddev } => gaussian(offset / stddev) / stddev,
        }
    }
}

/// The unit Gaussian, cut and lowered, as [`sample_gaussian`] draws from it.
fn gaussian(x: f32) -> f32 {
    let place = f64::from(x.abs()) * GAUSSIAN_CELLS as f64 / GAUSSIAN_CUT;
    let cell = place as usize;
    if cell >= GAUSSIAN_CELLS {
        return 0.0;
    }
    let (start, end) = (GAUSSIAN[cell][0], GAUSSIAN[cell + 1][0]);
    let value = start + (end - start) * (place - cell as f64);
    (0.5 * value / GAUSSIAN[GAUSSIAN_CELLS][1]) as f32
}

/// The unit tent.
fn sample_tent(u: f32) -> f32 {
    if u < 0.5 {
        safe_sqrt(2.0 * u) - 1.0
    } else {
        1.0 - safe_sqrt(2.0 * (1.0 - u))
    }
}

/// Cells of the table of the Gaussian's positive half.
const GAUSSIAN_CELLS: usize = 256;
/// Where the Gaussian is cut [standard deviations].
const GAUSSIAN_CUT: f64 = 4.0;

/// The positive half of the unit Gaussian, lowered to zero at the cut, and its integral from zero, at the cells' ends.
static GAUSSIAN: LazyLock<[[f64; 2]; GAUSSIAN_CELLS + 1]> = LazyLock::new(|| {
    let value = |x: f64| libm::exp(-0.5 * x * x) - libm::exp(-0.5 * GAUSSIAN_CUT * GAUSSIAN_CUT);
    let width = GAUSSIAN_CUT / GAUSSIAN_CELLS as f64;
    let mut integral = 0.0;
    std::array::from_fn(|i| {
        let x = i as f64 * width;
        if i > 0 {
            integral += 0.5 * width * (value(x - width) + value(x));
        }
        [value(x).max(0.0), integral]
    })
});

/// The unit Gaussian, cut and lowered, as straight lines between the entries of [`GAUSSIAN`]: off by less than
/// 4e-5 of its peak anywhere.
fn sample_gaussian(u: f32) -> f32 {
    let signed = 2.0 * f64::from(u) - 1.0;
    let target = signed.abs() * GAUSSIAN[GAUSSIAN_CELLS][1];
    let cell = GAUSSIAN[1..GAUSSIAN_CELLS].partition_point(|entry| entry[1] <= target);
    let width = GAUSSIAN_CUT / GAUSSIAN_CELLS as f64;
    let ([f0, start], [f1, _]) = (GAUSSIAN[cell], GAUSSIAN[cell + 1]);
    let area = (target - start) / width;
    let root = (f0 * f0 + 2.0 * (f1 - f0) * area).max(0.0).sqrt();
    let within = if area > 0.0 {
        (2.0 * area / (f0 + root)).min(1.0)
    } else {
        0.0
    };
    ((cell as f64 + within) * width).copysign(signed) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

    /// Every pixel is chosen with its share of the filter, in the mean over the choice.
    #[test]
    fn paths_count_for_pixels_as_the_filter_spreads_them() {
        const STEPS: u32 = 1 << 14;
        for filter in [
            Filter::Box { radius: 0.5 },
            Filter::Box { radius: 0.3 },
            Filter::Box { radius: 1.2 },
            Filter::Tent { radius: 1.0 },
            Filter::Gaussian { stddev: 0.5 },
        ] {
            for at in [0.1, 3.5, 3.99, 9.3] {
                let mut found = [0.0_f32; 10];
                for step in 0..STEPS {
                    let u = (step as f32 + 0.5) / STEPS as f32;
                    if let Some((pixel, factor)) = filter.choose_pixel(Vec2::new(at, 2.5), [10, 5], Vec2::new(u, 0.5)) {
                        assert_eq!(pixel / 10, 2, "{filter:?}: the middle row is nearest to the place");
                        found[pixel % 10] += factor / STEPS as f32;
                    }
                }
                let across = filter.choose(2.5, 5, 0.5).map_or(0.0, |(_, share)| share);
                for (pixel, found) in found.iter().enumerate() {
                    let offset = at - (pixel as f32 + 0.5);
                    let inside = offset.abs() < filter.radius();
                    let expected = if inside { across * filter.value(offset) } else { 0.0 };
                    assert!(
                        (found - expected).abs() < 2e-3,
                        "{filter:?} at {at}, pixel {pixel}: {found}, not {expected}"
                    );
                }
            }
        }
    }

    /// The values of a filter along an axis are the density of its samples: they are the derivative of the distribution.
    #[test]
    fn values_of_filters_are_the_density_of_their_samples() {
        for filter in [
            Filter::Box { radius: 0.7 },
            Filter::Tent { radius: 1.5 },
            Filter::Gaussian { stddev: 0.6 },
        ] {
            let at = |u: f32| filter.sample(Vec2::splat(u)).x;
            for step in 1..200 {
                let u = step as f32 / 200.0;
                let width = 2.0 / 1024.0;
                let slope = width / (at(u + 0.5 * width) - at(u - 0.5 * width));
                let value = filter.value(at(u));
                assert!(
                    (slope - value).abs() < 0.02 * (0.2 + value),
                    "{filter:?} at {u}: {slope}, not {value}"
                );
            }
        }
    }

    /// Largest distance of the empirical distribution along one axis from the filter's integral, by Simpson's rule.
    fn kolmogorov_smirnov(filter: Filter, radius: f64, value: impl Fn(f64) -> f64) -> f64 {
        const SAMPLES: usize = 200_000;
        const STEPS: usize = 4_000;
        let step = 2.0 * radius / STEPS as f64;
        let cells: Vec<f64> = (0..STEPS)
            .map(|i| {
                let x = -radius + i as f64 * step;
                (value(x) + 4.0 * value(x + 0.5 * step) + value(x + step)) / 6.0
            })
            .collect();
        let total: f64 = cells.iter().sum();
        let mut random = PathRandom::new(3, 1, Stream::Camera, 0);
        let offsets: Vec<Vec2> = (0..SAMPLES).map(|_| filter.sample(random.next_2d())).collect();
        let mut worst: f64 = 0.0;
        for axis in 0..2 {
            let mut sorted: Vec<f64> = offsets.iter().map(|o| f64::from(o[axis])).collect();
            sorted.sort_by(f64::total_cmp);
            assert!(sorted[0] >= -radius && sorted[SAMPLES - 1] <= radius);
            let (mut below, mut cell) = (0.0, 0);
            for (rank, x) in sorted.into_iter().enumerate() {
                let position = (x + radius) / step;
                while cell + 1 < STEPS && ((cell + 1) as f64) < position {
                    below += cells[cell];
                    cell += 1;
                }
                let expected = (below + cells[cell] * (position - cell as f64)) / total;
                worst = worst.max((expected - rank as f64 / SAMPLES as f64).abs());
            }
        }
        worst * (SAMPLES as f64).sqrt()
    }

    /// Six statistics; each exceeds 2 with probability 2 exp(-8) = 7e-4 under a right sampler (Kolmogorov), so a
    /// false alarm among them has probability 4e-3, fixed by the seed.
    #[test]
    fn offsets_are_distributed_as_the_filter() {
        let lowered = |x: f64| libm::exp(-2.0 * x * x) - libm::exp(-8.0);
        assert!(kolmogorov_smirnov(Filter::Box { radius: 0.5 }, 0.5, |_| 1.0) < 2.0);
        assert!(kolmogorov_smirnov(Filter::Tent { radius: 1.5 }, 1.5, |x| 1.5 - x.abs()) < 2.0);
        assert!(kolmogorov_smirnov(Filter::Gaussian { stddev: 0.5 }, 2.0, lowered) < 2.0);
        let unlowered = |x: f64| libm::exp(-1.9 * x * x);
        assert!(
            kolmogorov_smirnov(Filter::Gaussian { stddev: 0.5 }, 2.0, unlowered) > 2.0,
            "the test has power"
        );
    }

    #[test]
    fn offsets_stay_within_the_radius_at_the_ends_of_the_unit_interval() {
        for u in [0.0, 0.5, crate::math::ONE_MINUS_EPSILON] {
            for (filter, radius) in [
                (Filter::Box { radius: 0.5 }, 0.5),
                (Filter::Tent { radius: 1.0 }, 1.0),
                (Filter::Gaussian { stddev: 0.5 }, 2.0),
            ] {
                assert!(filter.sample(Vec2::splat(u)).abs().max_element() <= radius);
            }
        }
        assert_eq!(Filter::Gaussian { stddev: 0.5 }.sample(Vec2::splat(0.5)), Vec2::ZERO);
    }
}
