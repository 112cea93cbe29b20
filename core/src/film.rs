//! Iteration images, the nodes of the reduction tree, and the reconstruction filter.

use crate::math::{Vec2, safe_sqrt};
use crate::settings::STATISTICS_PER_PIXEL;
use crate::spectrum::{CHANNELS, Spectrum};
use std::sync::LazyLock;
use thiserror::Error;

/// Size and filter of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmSettings {
    /// Pixels across and down.
    pub resolution: [u32; 2],
    /// Reconstruction filter.
    pub filter: Filter,
}

/// Reconstruction filter. It is importance-sampled (Ernst, Stamminger and Greiner 2006), so that a camera sample
/// belongs to one pixel and has weight one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// Constant within `radius` [pixels].
    Box {
        /// Half width [pixels].
        radius: f32,
    },
    /// Linear to zero at `radius`.
    Tent {
        /// Half width [pixels].
        radius: f32,
    },
    /// Gaussian of standard deviation `stddev`, cut at four of them and lowered to reach zero there, as Mitsuba's.
    Gaussian {
        /// Standard deviation [pixels].
        stddev: f32,
    },
}

impl Filter {
    /// Offset from the pixel's centre [pixels], distributed as the filter, by inversion along each axis.
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Vec2 {
        match *self {
            Self::Box { radius } => radius * (2.0 * u - Vec2::ONE),
            Self::Tent { radius } => radius * u.map(sample_tent),
            Self::Gaussian { stddev } => stddev * u.map(sample_gaussian),
        }
    }
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

/// The elementwise sum of a power of two of iteration images: a node of the reduction tree. Level 0 is one iteration.
///
/// Sums are in `f32`, row by row from the top left. Leaf `k` is the image of iteration `k + 1`; node `(level, index)` covers leaves
/// `[index 2^level, (index + 1) 2^level)`, and its value is always left child plus right child.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Height in the tree.
    pub level: u32,
    /// Place within the level.
    pub index: u32,
    /// Sum of radiance, `CHANNELS` values a pixel.
    pub sum: Vec<f32>,
    /// Sum of the squared luminance, one value a pixel.
    pub sum_of_squares: Vec<f32>,
    /// What a sequential integrator goes on from after the node's last iteration
    /// ([`Iteration::statistics`](crate::integrator::Iteration::statistics)); empty for the others.
    pub statistics: Vec<f32>,
}

/// Why two nodes cannot be added, or a leaf cannot enter the tree.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FilmError {
    /// Not the two children of one node.
    #[error(
        "node ({left_level}, {left_index}) and node ({right_level}, {right_index}) are not the left and right child of one node"
    )]
    NotSiblings {
        /// Level of the left operand.
        left_level: u32,
        /// Index of the left operand.
        left_index: u32,
        /// Level of the right operand.
        right_level: u32,
        /// Index of the right operand.
        right_index: u32,
    },
    /// Different image sizes, or a buffer of another length than its size says.
    #[error("image sizes differ: {0}")]
    Size(String),
    /// A value of a pixel that is not finite or is negative.
    #[error("pixel ({x}, {y}) has the value {value}: neither a radiance nor a statistic is negative or not finite")]
    Pixel {
        /// Column.
        x: u32,
        /// Row.
        y: u32,
        /// What was found.
        value: f32,
    },
}

impl Node {
    /// A leaf from the pixels of iteration `index + 1`.
    pub fn leaf(index: u32, width: u32, height: u32, pixels: &[Spectrum]) -> Result<Self, FilmError> {
        let sum = pixels.iter().flat_map(|p| p.to_rgb()).collect();
        let sum_of_squares = pixels.iter().map(|p| p.luminance() * p.luminance()).collect();
        let node = Self {
            width,
            height,
            level: 0,
            index,
            sum,
            sum_of_squares,
            statistics: Vec::new(),
        };
        node.check()?;
        Ok(node)
    }

    /// The node with what a sequential integrator goes on from after it.
    pub fn with_statistics(self, statistics: Vec<f32>) -> Result<Self, FilmError> {
        let node = Self { statistics, ..self };
        node.check()?;
        Ok(node)
    }

    /// Number of iterations summed.
    #[must_use]
    pub fn iterations(&self) -> u64 {
        1 << self.level
    }

    /// Checks lengths and pixels; call it on anything received.
    pub fn check(&self) -> Result<(), FilmError> {
        let pixels = self.width as usize * self.height as usize;
        let statistics = self.statistics.len();
        let whole = statistics == 0 || statistics == pixels * STATISTICS_PER_PIXEL;
        if self.sum.len() != pixels * CHANNELS || self.sum_of_squares.len() != pixels || !whole {
            return Err(FilmError::Size(format!(
                "{} x {} pixels with {} sums, {} squares and {statistics} statistics",
                self.width,
                self.height,
                self.sum.len(),
                self.sum_of_squares.len()
            )));
        }
        let bad = |values: &[f32], per_pixel: usize| {
            values
                .iter()
                .position(|v| !v.is_finite() || *v < 0.0)
                .map(|i| (i / per_pixel, values[i]))
        };
        let bad = bad(&self.sum, CHANNELS)
            .or_else(|| bad(&self.sum_of_squares, 1))
            .or_else(|| bad(&self.statistics, STATISTICS_PER_PIXEL));
        match bad {
            Some((pixel, value)) => Err(FilmError::Pixel {
                x: pixel as u32 % self.width,
                y: pixel as u32 / self.width,
                value,
            }),
            None => Ok(()),
        }
    }

    /// The parent: left child plus right child, in that order, with the right child's statistics.
    pub fn merge(mut self, right: &Self) -> Result<Self, FilmError> {
        if self.level != right.level || !self.index.is_multiple_of(2) || right.index != self.index + 1 {
            return Err(FilmError::NotSiblings {
                left_level: self.level,
                left_index: self.index,
                right_level: right.level,
                right_index: right.index,
            });
        }
        if self.statistics.len() != right.statistics.len() {
            let (left, right) = (self.statistics.len(), right.statistics.len());
            return Err(FilmError::Size(format!("{left} and {right} statistics")));
        }
        self.add(right)?;
        self.statistics.clone_from(&right.statistics);
        self.level += 1;
        self.index /= 2;
        Ok(self)
    }

    pub(crate) fn add(&mut self, other: &Self) -> Result<(), FilmError> {
        if (self.width, self.height) != (other.width, other.height) {
            return Err(FilmError::Size(format!(
                "{} x {} and {} x {}",
                self.width, self.height, other.width, other.height
            )));
        }
        for (a, b) in self.sum.iter_mut().zip(&other.sum) {
            *a += b;
        }
        for (a, b) in self.sum_of_squares.iter_mut().zip(&other.sum_of_squares) {
            *a += b;
        }
        Ok(())
    }
}

/// An image: the average of iterations.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Iterations averaged.
    pub iterations: u64,
    /// Mean radiance, row by row from the top left.
    pub pixels: Vec<Spectrum>,
    /// Standard error of each pixel's luminance as if iterations were independent; empty for fewer than two iterations. Under
    /// [`Sampling::Sobol`](crate::random::Sampling::Sobol) iterations balance each other, and the error is smaller.
    pub standard_error: Vec<f32>,
}

impl Image {
    /// The average over the maximal nodes of a tree, added in the order given: ascending first leaf.
    pub fn average(nodes: &[Node]) -> Result<Self, FilmError> {
        let (first, rest) = nodes
            .split_first()
            .ok_or_else(|| FilmError::Size("no nodes to average".into()))?;
        let mut total = first.clone();
        let mut iterations = first.iterations();
        for node in rest {
            total.add(node)?;
            iterations += node.iterations();
        }
        Ok(Self::from_sum(&total, iterations))
    }

    /// The average of a sum of `iterations` iterations.
    pub(crate) fn from_sum(total: &Node, iterations: u64) -> Self {
        let n = iterations as f32;
        let pixels: Vec<Spectrum> = total
            .sum
            .chunks_exact(CHANNELS)
            .map(|c| Spectrum::from_rgb([c[0] / n, c[1] / n, c[2] / n]))
            .collect();
        let standard_error = if iterations < 2 {
            Vec::new()
        } else {
            let error =
                |(p, s): (&Spectrum, &f32)| ((s / n - p.luminance() * p.luminance()).max(0.0) / (n - 1.0)).sqrt();
            pixels.iter().zip(&total.sum_of_squares).map(error).collect()
        };
        Self {
            width: total.width,
            height: total.height,
            iterations,
            pixels,
            standard_error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

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

    fn leaf(index: u32, value: f32) -> Node {
        Node::leaf(index, 2, 1, &[Spectrum::splat(value), Spectrum::splat(2.0 * value)]).unwrap()
    }

    #[test]
    fn only_the_children_of_one_node_merge() {
        let parent = leaf(2, 1.0).merge(&leaf(3, 4.0)).unwrap();
        assert_eq!((parent.level, parent.index, parent.iterations()), (1, 1, 2));
        assert_eq!(parent.sum, [5.0, 5.0, 5.0, 10.0, 10.0, 10.0]);
        for (left, right) in [
            (leaf(1, 1.0), leaf(2, 1.0)),
            (leaf(3, 1.0), leaf(2, 1.0)),
            (parent, leaf(2, 1.0)),
        ] {
            assert!(matches!(left.merge(&right), Err(FilmError::NotSiblings { .. })));
        }
    }

    #[test]
    fn the_average_has_the_mean_and_its_standard_error() {
        let nodes = [leaf(0, 1.0).merge(&leaf(1, 3.0)).unwrap(), leaf(2, 5.0)];
        let image = Image::average(&nodes).unwrap();
        assert_eq!(image.iterations, 3);
        assert_eq!(image.pixels[0], Spectrum::splat(3.0));
        let expected = (8.0_f32 / 3.0 / 2.0).sqrt();
        assert!((image.standard_error[0] / expected - 1.0).abs() < 1e-5);
    }

    #[test]
    fn statistics_are_those_after_the_last_iteration() {
        let with = |index, value: f32| leaf(index, 1.0).with_statistics(vec![value; 4]).unwrap();
        let parent = with(0, 5.0).merge(&with(1, 3.0)).unwrap();
        assert_eq!(parent.statistics, [3.0; 4]);
        assert!(matches!(with(0, 5.0).merge(&leaf(1, 1.0)), Err(FilmError::Size(_))));
        let bad = |statistics| leaf(0, 1.0).with_statistics(statistics).unwrap_err();
        assert!(matches!(bad(vec![1.0; 3]), FilmError::Size(_)));
        assert!(matches!(
            bad(vec![1.0, 1.0, 1.0, -1.0]),
            FilmError::Pixel { x: 1, y: 0, .. }
        ));
    }

    #[test]
    fn a_leaf_with_a_bad_pixel_or_size_is_refused() {
        for value in [f32::NAN, f32::INFINITY, -1.0] {
            let error = Node::leaf(0, 2, 1, &[Spectrum::ONE, Spectrum::splat(value)]).unwrap_err();
            assert!(matches!(error, FilmError::Pixel { x: 1, y: 0, .. }));
        }
        assert!(matches!(
            Node::leaf(0, 2, 2, &[Spectrum::ONE; 3]),
            Err(FilmError::Size(_))
        ));
    }
}
