//! Iteration images, and the nodes of the reduction tree.

mod filter;
mod window;

pub use filter::Filter;
pub use window::{Window, WindowError};

use crate::settings::STATISTICS_PER_PIXEL;
use crate::spectrum::{CHANNELS, Spectrum};
use thiserror::Error;

/// Size and filter of the image.
#[derive(Clone, Debug, PartialEq)]
pub struct FilmSettings {
    /// Pixels across and down.
    pub resolution: [u32; 2],
    /// Reconstruction filter.
    pub filter: Filter,
    /// The pixels that are rendered, where not all are.
    pub window: Option<Window>,
}

impl FilmSettings {
    /// Pixels across and down of what is rendered.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.window.map_or(self.resolution, Window::size)
    }

    /// Number of pixels that are rendered.
    #[must_use]
    pub fn pixel_count(&self) -> usize {
        let [width, height] = self.size();
        width as usize * height as usize
    }

    /// The number in the whole picture, row by row from the top left, of a pixel by its number among those that are rendered.
    #[must_use]
    #[inline]
    pub fn in_picture(&self, pixel: usize) -> usize {
        match self.window {
            None => pixel,
            Some(Window { x, y, width, .. }) => {
                let [column, row] = [pixel % width as usize, pixel / width as usize];
                (y as usize + row) * self.resolution[0] as usize + x as usize + column
            }
        }
    }

    /// The number among those that are rendered of a pixel by its number in the whole picture; `None` where it is not rendered.
    #[must_use]
    #[inline]
    pub fn rendered(&self, pixel: usize) -> Option<usize> {
        let Some(window) = self.window else {
            return Some(pixel);
        };
        let across = self.resolution[0] as usize;
        let column = (pixel % across).checked_sub(window.x as usize)?;
        let row = (pixel / across).checked_sub(window.y as usize)?;
        let width = window.width as usize;
        (column < width && row < window.height as usize).then_some(row * width + column)
    }
}

/// Values of each pixel of a [`Node`]: the sum of radiance, channel by channel, and the squared error of its luminance.
pub const VALUES_PER_PIXEL: usize = CHANNELS + 1;

/// Whether a value of a [`Node`], of its pixels or of its statistics, can be: the format has none that is negative or not finite. Whoever
/// makes pixels that may be negative, of colours out of gamut, needs another format.
#[must_use]
#[inline]
pub fn can_be(value: f32) -> bool {
    (0.0..f32::INFINITY).contains(&value)
}

/// Share of the pixels, those with the largest error, that [`Image::noise`] leaves out.
pub const NOISE_LEAVES_OUT: f64 = 0.01;

/// Pixels of a left child become those of its parent, `right` being those of the right child.
///
/// Radiance is added. The squared error of a sum `A + B` is taken to be
///
///     q(A + B) = max((A - B)^2, (q(A) + q(B)) / 2),    q(iteration) = 0
///
/// in luminance. The first term is the square of what the two halves differ by. If they are independent, its expected value is
/// the variance of `A + B`. If low-discrepancy points balance them against each other, it is greater: the variances `V(n)` of
/// the means of aligned blocks of `n` iterations satisfy `E[((a - b) / 2)^2] = V(n / 2) - V(n)` for the halves' means `a` and `b`, which
/// is `V(n)` where the variance falls as `1 / n`, and `2 V(n)` where it falls as `n^-1.58`. The second term is a floor, for
/// halves that agree by chance: an error falls at most by half when the iterations are doubled, as `1 / n`.
///
/// Values that no `f32` holds become the largest one, so that pixels that may be sent never become others.
pub fn add_pixels(left: &mut [f32], right: &[f32]) {
    let (left, _) = left.as_chunks_mut::<VALUES_PER_PIXEL>();
    let (right, _) = right.as_chunks::<VALUES_PER_PIXEL>();
    for (a, b) in left.iter_mut().zip(right) {
        let difference = luminance(a) - luminance(b);
        let floor = 0.5 * a[CHANNELS] + 0.5 * b[CHANNELS];
        for channel in 0..CHANNELS {
            a[channel] = (a[channel] + b[channel]).min(f32::MAX);
        }
        a[CHANNELS] = (difference * difference).max(floor).min(f32::MAX);
    }
}

/// The sum of radiance of a pixel's values.
fn radiance(pixel: &[f32; VALUES_PER_PIXEL]) -> Spectrum {
    Spectrum::from_channels(std::array::from_fn(|channel| pixel[channel]))
}

fn luminance(pixel: &[f32; VALUES_PER_PIXEL]) -> f32 {
    radiance(pixel).luminance().min(f32::MAX)
}

/// The sum of a power of two of iteration images: a node of the reduction tree. Level 0 is one iteration.
///
/// Leaf `k` is the image of iteration `k + 1`; node `(level, index)` covers leaves `[index 2^level, (index + 1) 2^level)`, and
/// its value is always that of left child and right child by [`add_pixels`].
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
    /// [`VALUES_PER_PIXEL`] values a pixel, row by row from the top left.
    pub pixels: Vec<f32>,
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
        let values = |pixel: &Spectrum| pixel.channels().into_iter().chain([0.0]);
        let node = Self {
            width,
            height,
            level: 0,
            index,
            pixels: pixels.iter().flat_map(values).collect(),
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
        if self.pixels.len() != pixels * VALUES_PER_PIXEL || !whole {
            return Err(FilmError::Size(format!(
                "{} x {} pixels with {} values and {statistics} statistics",
                self.width,
                self.height,
                self.pixels.len(),
            )));
        }
        let bad = |values: &[f32], per_pixel: usize| {
            values
                .iter()
                .position(|value| !can_be(*value))
                .map(|i| (i / per_pixel, values[i]))
        };
        let bad = bad(&self.pixels, VALUES_PER_PIXEL).or_else(|| bad(&self.statistics, STATISTICS_PER_PIXEL));
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
        self.check_size_of(right)?;
        add_pixels(&mut self.pixels, &right.pixels);
        self.statistics.clone_from(&right.statistics);
        self.level += 1;
        self.index /= 2;
        Ok(self)
    }

    fn check_size_of(&self, other: &Self) -> Result<(), FilmError> {
        if (self.width, self.height) == (other.width, other.height) {
            return Ok(());
        }
        Err(FilmError::Size(format!(
            "{} x {} and {} x {}",
            self.width, self.height, other.width, other.height
        )))
    }
}

/// The sum of nodes that need not be siblings.
#[derive(Debug)]
pub(crate) struct Total {
    node: Node,
    iterations: u64,
    /// Those with an odd index.
    odd_iterations: u64,
    /// Iterations of the nodes of which the error is known: those with more than one.
    iterations_with_error: u64,
}

impl Total {
    pub(crate) fn new(node: Node) -> Self {
        let mut total = Self {
            node,
            iterations: 0,
            odd_iterations: 0,
            iterations_with_error: 0,
        };
        total.count(total.node.level, total.node.index);
        total
    }

    /// Adds a node; the errors of two nodes are taken to be independent.
    pub(crate) fn add(&mut self, node: &Node) -> Result<(), FilmError> {
        self.node.check_size_of(node)?;
        for (a, b) in self.node.pixels.iter_mut().zip(&node.pixels) {
            *a = (*a + b).min(f32::MAX);
        }
        self.count(node.level, node.index);
        Ok(())
    }

    fn count(&mut self, level: u32, index: u32) {
        self.iterations += 1 << level;
        if level > 0 {
            self.iterations_with_error += 1 << level;
            self.odd_iterations += 1 << (level - 1);
        } else {
            // Leaf `k` is iteration `k + 1`.
            self.odd_iterations += u64::from(index.is_multiple_of(2));
        }
    }

    /// The average.
    pub(crate) fn into_image(self) -> Image {
        let n = self.iterations as f32;
        let (pixels, _) = self.node.pixels.as_chunks::<VALUES_PER_PIXEL>();
        let standard_error = match self.iterations_with_error {
            0 => Vec::new(),
            known => {
                // Iterations of which no error is known are taken to have that of the others.
                let scale = (self.iterations as f64 / known as f64).sqrt() as f32 / n;
                pixels.iter().map(|pixel| pixel[CHANNELS].sqrt() * scale).collect()
            }
        };
        Image {
            width: self.node.width,
            height: self.node.height,
            iterations: self.iterations,
            odd_iterations: self.odd_iterations,
            pixels: pixels.iter().map(|pixel| radiance(pixel).map(|sum| sum / n)).collect(),
            standard_error,
        }
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
    /// Those of them with an odd index.
    pub odd_iterations: u64,
    /// Mean radiance, row by row from the top left.
    pub pixels: Vec<Spectrum>,
    /// Standard error of each pixel's luminance, from the difference of the halves of its iterations ([`add_pixels`]): rough for one
    /// pixel, and right on average over many. Low-discrepancy iterations are better than it says, by up to two and a half times.
    /// Empty where no two iterations are the children of one node.
    pub standard_error: Vec<f32>,
}

impl Image {
    /// The average over the maximal nodes of a tree, added in the order given: ascending first leaf.
    pub fn average(nodes: &[Node]) -> Result<Self, FilmError> {
        let (first, rest) = nodes
            .split_first()
            .ok_or_else(|| FilmError::Size("no nodes to average".into()))?;
        let mut total = Total::new(first.clone());
        rest.iter().try_for_each(|node| total.add(node))?;
        Ok(total.into_image())
    }

    /// The noise of the image: the mean of the pixels' standard errors over the mean luminance, both without the hundredth of the pixels
    /// whose errors are largest ([`NOISE_LEAVES_OUT`]), so that a few fireflies do not stand for the picture.
    ///
    /// `None` where it is unknown: no errors, or nothing but black in the pixels that count, in which nothing was found yet.
    /// Sums run from the first pixel to the last at double precision: the same image gives the same noise.
    #[must_use]
    pub fn noise(&self) -> Option<f64> {
        let mut order: Vec<(f32, usize)> = self.standard_error.iter().copied().zip(0..).collect();
        let by_error = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let last = order
            .len()
            .checked_sub(1 + (order.len() as f64 * NOISE_LEAVES_OUT) as usize)?;
        let (_, largest, _) = order.select_nth_unstable_by(last, by_error);
        let largest = *largest;
        let (mut error, mut luminance) = (0.0, 0.0);
        for (index, (pixel, of_pixel)) in self.pixels.iter().zip(&self.standard_error).enumerate() {
            if by_error(&(*of_pixel, index), &largest).is_le() {
                error += f64::from(*of_pixel);
                luminance += f64::from(pixel.luminance());
            }
        }
        (luminance > 0.0).then(|| error / luminance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaf(index: u32, value: f32) -> Node {
        Node::leaf(index, 2, 1, &[Spectrum::splat(value), Spectrum::splat(2.0 * value)]).unwrap()
    }

    #[test]
    fn only_the_children_of_one_node_merge() {
        let parent = leaf(2, 1.0).merge(&leaf(3, 4.0)).unwrap();
        assert_eq!((parent.level, parent.index, parent.iterations()), (1, 1, 2));
        assert_eq!(parent.pixels, [5.0, 5.0, 5.0, 9.0, 10.0, 10.0, 10.0, 36.0]);
        for (left, right) in [
            (leaf(1, 1.0), leaf(2, 1.0)),
            (leaf(3, 1.0), leaf(2, 1.0)),
            (parent, leaf(2, 1.0)),
        ] {
            assert!(matches!(left.merge(&right), Err(FilmError::NotSiblings { .. })));
        }
    }

    /// The node of some leaves of one value each.
    fn of_leaves(values: &[f32]) -> Node {
        let mut nodes: Vec<Node> = (0..).zip(values).map(|(index, value)| leaf(index, *value)).collect();
        while nodes.len() > 1 {
            nodes = nodes
                .chunks(2)
                .map(|pair| pair[0].clone().merge(&pair[1]).unwrap())
                .collect();
        }
        nodes.remove(0)
    }

    fn near(value: f32, expected: f32) -> bool {
        (value / expected - 1.0).abs() < 1e-5
    }

    #[test]
    fn the_standard_error_is_that_of_halves_that_differ() {
        let image = Image::average(&[of_leaves(&[1.0, 2.0, 4.0, 5.0])]).unwrap();
        assert_eq!(image.pixels[0], Spectrum::splat(3.0));
        assert!(near(image.standard_error[0], 1.5) && near(image.standard_error[1], 3.0));
        // The error of one iteration beyond is that of the others.
        let image = Image::average(&[of_leaves(&[1.0, 3.0]), leaf(2, 5.0)]).unwrap();
        assert_eq!((image.iterations, image.pixels[0]), (3, Spectrum::splat(3.0)));
        assert!(near(image.standard_error[0], (4.0_f32 * 1.5).sqrt() / 3.0));
        assert!(
            Image::average(&[leaf(1, 1.0), leaf(2, 2.0)])
                .unwrap()
                .standard_error
                .is_empty()
        );
    }

    #[test]
    fn an_error_falls_at_most_by_half_where_halves_agree() {
        let error = |values: &[f32]| Image::average(&[of_leaves(values)]).unwrap().standard_error[0];
        assert!(near(error(&[1.0, 3.0]), 1.0));
        assert!(near(error(&[1.0, 3.0, 3.0, 1.0]), 0.5));
        assert!(near(
            error(&[1.0, 3.0, 3.0, 1.0, 2.0, 2.0, 2.0, 2.0]),
            0.25 * 0.5_f32.sqrt()
        ));
    }

    #[test]
    fn valid_pixels_never_become_others() {
        let huge = of_leaves(&[f32::MAX / 4.0, 0.0, f32::MAX / 4.0, f32::MAX / 4.0]);
        assert_eq!(huge.check(), Ok(()));
        assert_eq!(huge.pixels[4..], [f32::MAX; 4]);
    }

    /// An image of as many pixels as there are errors, of luminance one but where it says otherwise.
    fn with_errors(standard_error: Vec<f32>, bright: &[(usize, f32)]) -> Image {
        let mut pixels = vec![Spectrum::ONE; standard_error.len()];
        bright
            .iter()
            .for_each(|(at, value)| pixels[*at] = Spectrum::splat(*value));
        Image {
            width: pixels.len() as u32,
            height: 1,
            iterations: 4,
            odd_iterations: 2,
            pixels,
            standard_error,
        }
    }

    #[test]
    fn a_few_fireflies_do_not_stand_for_the_noise() {
        let mut errors = vec![0.03; 300];
        assert!((with_errors(errors.clone(), &[]).noise().unwrap() - 0.03).abs() < 1e-6);
        for at in [7, 100, 299] {
            errors[at] = 1e4;
        }
        let bright = [(7, 1e4), (100, 1e4), (299, 1e4)];
        assert!((with_errors(errors.clone(), &bright).noise().unwrap() - 0.03).abs() < 1e-6);
        errors[8] = 297.0;
        assert!(
            (with_errors(errors, &[]).noise().unwrap() - 1.03).abs() < 1e-3,
            "more than a few do"
        );
    }

    #[test]
    fn what_has_found_nothing_is_not_free_of_noise() {
        let found = |lit: usize| {
            let pixels = |value: f32| (0..200).map(move |at| Spectrum::splat(if at < lit { value } else { 0.0 }));
            let leaf = |index, value| Node::leaf(index, 200, 1, &pixels(value).collect::<Vec<_>>()).unwrap();
            let node = leaf(0, 0.0).merge(&leaf(1, 4.0)).unwrap();
            Image::average(&[node]).unwrap().noise()
        };
        assert_eq!((found(0), found(2)), (None, None));
        assert_eq!(found(10), Some(1.0));
        assert_eq!(with_errors(Vec::new(), &[]).noise(), None);
        assert_eq!(with_errors(vec![0.0; 5], &[]).noise(), Some(0.0));
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
