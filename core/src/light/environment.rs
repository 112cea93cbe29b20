//! Environment maps.
//!
//! The image is a grid of values at (longitude, colatitude) nodes, interpolated bilinearly as in Mitsuba: column `i`
//! of `w` lies at longitude `2 pi (i + 1/2) / w`, row `j` of `h` at colatitude `pi j / (h - 1)`. Sampling chooses a
//! cell between four nodes in proportion to its mean luminance times the sine of its middle colatitude, then a point
//! within it in proportion to the interpolated luminance. So the density follows the looked-up radiance but for the
//! sine within one cell.

use crate::math::{DVec2, DiscreteRows, PI, TAU, Transform, Vec2, Vec3, atan2, sin, sin_cos};
use crate::spectrum::Spectrum;
use crate::texture::Bitmap;
use std::sync::Arc;

/// A latitude-longitude image around the scene, up is +y.
#[derive(Clone, Debug)]
pub(super) struct Environment {
    image: Arc<Bitmap>,
    scale: f32,
    to_local: Transform,
    /// Absolute determinant of the linear part of `to_local`; one for a rotation.
    determinant: f32,
    /// Chooses a cell.
    cells: DiscreteRows,
}

/// Where in the grid a direction lies.
struct GridPoint {
    column: usize,
    row: usize,
    /// Within the cell, in [0, 1].
    within: Vec2,
    /// Sine of the colatitude.
    sine: f32,
    /// Density of world directions per local direction.
    stretch: f32,
}

/// Rows of cells of an image: at least one, also where the image is a single row.
fn rows_of_cells(image: &Bitmap) -> usize {
    (image.height - 1).max(1)
}

/// The four nodes of a cell: upper left and right, lower left and right.
fn corners(image: &Bitmap, column: usize, row: usize) -> [Spectrum; 4] {
    let right = if column + 1 < image.width { column + 1 } else { 0 };
    let upper = row * image.width;
    let lower = (row + 1).min(image.height - 1) * image.width;
    [upper + column, upper + right, lower + column, lower + right].map(|i| image.texels.get(i))
}

fn luminances(image: &Bitmap, column: usize, row: usize) -> [f32; 4] {
    corners(image, column, row).map(|texel| texel.luminance().max(0.0))
}

fn middle_sine(image: &Bitmap, row: usize) -> f32 {
    sin(PI * (row as f32 + 0.5) / rows_of_cells(image) as f32)
}

/// The point of [0, 1] at which the integral of the line from `a` to `b` reaches the part `u`.
fn sample_line(a: f32, b: f32, u: f32) -> f32 {
    let denominator = a + (a * a + (b * b - a * a) * u).max(0.0).sqrt();
    if denominator > 0.0 {
        (u * (a + b) / denominator).min(1.0)
    } else {
        u
    }
}

fn determinant(map: &Transform) -> f32 {
    map.matrix().determinant().abs() as f32
}

impl Environment {
    /// `image` has at least one texel.
    pub(super) fn new(image: Arc<Bitmap>, scale: f32, to_world: &Transform) -> Self {
        let to_local = to_world.inverted();
        let weights = (0..rows_of_cells(&image)).map(|row| {
            let (image, sine) = (&image, f64::from(middle_sine(&image, row)));
            let mean = move |column| f64::from(luminances(image, column, row).into_iter().sum::<f32>()) / 4.0;
            (0..image.width).map(move |column| mean(column) * sine)
        });
        let cells = DiscreteRows::new(image.width, weights);
        let determinant = determinant(&to_local);
        Self {
            image,
            scale,
            to_local,
            determinant,
            cells,
        }
    }

    /// The same image with another `to_world`.
    pub(super) fn turned(&self, to_world: &Transform) -> Self {
        let to_local = to_world.inverted();
        Self {
            to_local,
            determinant: determinant(&to_local),
            ..self.clone()
        }
    }

    /// Number of cells.
    fn cell_count(&self) -> f32 {
        (self.cells.rows() * self.image.width) as f32
    }

    fn grid_point(&self, direction: Vec3) -> GridPoint {
        let local = self.to_local.vector(direction);
        let length = local.length();
        let local = local / length;
        let sine = (local.x * local.x + local.z * local.z).sqrt();
        let turn = atan2(local.x, -local.z) / TAU;
        let width = self.image.width as f32;
        let x = turn * width - 0.5;
        let x = if x < 0.0 { x + width } else { x };
        let y = atan2(sine, local.y) / PI * self.cells.rows() as f32;
        let column = (x as usize).min(self.image.width - 1);
        let row = (y as usize).min(self.cells.rows() - 1);
        let within = Vec2::new(x - column as f32, y - row as f32).clamp(Vec2::ZERO, Vec2::ONE);
        GridPoint {
            column,
            row,
            within,
            sine,
            stretch: self.determinant / (length * length * length),
        }
    }

    /// Radiance that arrives from `direction`.
    pub(super) fn radiance(&self, direction: Vec3) -> Spectrum {
        let GridPoint {
            column, row, within, ..
        } = self.grid_point(direction);
        let [a, b, c, d] = corners(&self.image, column, row);
        let upper = a * (1.0 - within.x) + b * within.x;
        let lower = c * (1.0 - within.x) + d * within.x;
        (upper * (1.0 - within.y) + lower * within.y) * self.scale
    }

    /// A direction with density [`Self::pdf`]; `None` for a black image.
    pub(super) fn sample(&self, u: DVec2) -> Option<Vec3> {
        let [(column, rest_x), (row, rest_y)] = self.cells.sample(u)?;
        let [a, b, c, d] = luminances(&self.image, column, row);
        let y = sample_line(a + b, c + d, rest_y);
        let x = sample_line(a + (c - a) * y, b + (d - b) * y, rest_x);
        let phi = TAU * (column as f32 + x + 0.5) / self.image.width as f32;
        let theta = PI * (row as f32 + y) / self.cells.rows() as f32;
        let (sin_phi, cos_phi) = sin_cos(phi);
        let (sin_theta, cos_theta) = sin_cos(theta);
        let local = Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi);
        Some(self.to_local.inverted().vector(local).normalize())
    }

    /// Solid-angle density [1/sr]: that of the grid's unit square over `2 pi^2 sin(theta)`.
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        let point = self.grid_point(direction);
        let total = self.cells.total() as f32;
        if total <= 0.0 || point.sine <= 0.0 {
            return 0.0;
        }
        let [a, b, c, d] = luminances(&self.image, point.column, point.row);
        let Vec2 { x, y } = point.within;
        let luminance = (a * (1.0 - x) + b * x) * (1.0 - y) + (c * (1.0 - x) + d * x) * y;
        let grid = luminance * middle_sine(&self.image, point.row) / total * self.cell_count();
        grid / (2.0 * PI * PI * point.sine) * point.stretch
    }

    /// Luminance averaged over the sphere, by the middle of each cell.
    pub(super) fn mean_luminance(&self) -> f32 {
        let mean = self.cells.total() as f32 / self.cell_count();
        mean * 0.5 * PI * self.scale
    }
}
