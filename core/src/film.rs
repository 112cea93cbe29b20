//! Iteration images, the nodes of the reduction tree, and the reconstruction filter.

use crate::math::Vec2;
use crate::spectrum::{CHANNELS, Spectrum};
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
    Box { radius: f32 },
    /// Linear to zero at `radius`.
    Tent { radius: f32 },
    /// Gaussian of standard deviation `stddev`, cut at four of them and lowered to reach zero there, as Mitsuba's.
    Gaussian { stddev: f32 },
}

impl Filter {
    /// Offset from the pixel's centre [pixels], distributed as the filter.
    #[must_use]
    pub fn sample(&self, _u: Vec2) -> Vec2 {
        unimplemented!()
    }
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
}

/// Why two nodes cannot be added, or a leaf cannot enter the tree.
#[derive(Debug, Error, PartialEq)]
pub enum FilmError {
    /// Not the two children of one node.
    #[error(
        "node ({left_level}, {left_index}) and node ({right_level}, {right_index}) are not the left and right child of one node"
    )]
    NotSiblings {
        left_level: u32,
        left_index: u32,
        right_level: u32,
        right_index: u32,
    },
    /// Different image sizes, or a buffer of another length than its size says.
    #[error("image sizes differ: {0}")]
    Size(String),
    /// A pixel that is not finite or is negative.
    #[error("pixel ({x}, {y}) is {value}: not a finite, non-negative radiance")]
    Pixel { x: u32, y: u32, value: f32 },
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
        };
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
        if self.sum.len() != pixels * CHANNELS || self.sum_of_squares.len() != pixels {
            return Err(FilmError::Size(format!(
                "{} x {} pixels with {} sums and {} squares",
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
        match bad(&self.sum, CHANNELS).or_else(|| bad(&self.sum_of_squares, 1)) {
            Some((pixel, value)) => Err(FilmError::Pixel {
                x: pixel as u32 % self.width,
                y: pixel as u32 / self.width,
                value,
            }),
            None => Ok(()),
        }
    }

    /// The parent: left child plus right child, in that order.
    pub fn merge(mut self, right: &Self) -> Result<Self, FilmError> {
        if self.level != right.level || !self.index.is_multiple_of(2) || right.index != self.index + 1 {
            return Err(FilmError::NotSiblings {
                left_level: self.level,
                left_index: self.index,
                right_level: right.level,
                right_index: right.index,
            });
        }
        self.add(right)?;
        self.level += 1;
        self.index /= 2;
        Ok(self)
    }

    fn add(&mut self, other: &Self) -> Result<(), FilmError> {
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
    /// Standard error of each pixel's luminance; empty for fewer than two iterations.
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
        Ok(Self {
            width: total.width,
            height: total.height,
            iterations,
            pixels,
            standard_error,
        })
    }
}
