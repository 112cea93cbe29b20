//! Images over all directions in which every texel has the same solid angle.

use crate::math::{DVec2, DiscreteRows, PI, Transform, Vec2, Vec3, atan2, sin_cos};
use crate::spectrum::Spectrum;
use crate::texture::Bitmap;
use std::sync::Arc;

/// A square image of the sphere, folded like an octahedron: the middle is +z, the corners are all -z (Clarberg 2008, "Fast Equal-Area
/// Mapping of the (Hemi)Sphere using SIMD"). The values of pbrt-v4's images hold at the middles of texels and are interpolated
/// bilinearly, across the fold as well.
#[derive(Clone, Debug)]
pub(super) struct EqualArea {
    image: Arc<Bitmap>,
    scale: f32,
    to_local: Transform,
    /// Chooses a texel, in proportion to the mean of the interpolated luminance over it.
    texels: DiscreteRows,
    /// The weights that it is chosen by.
    weights: Arc<[f32]>,
}

impl EqualArea {
    /// `image` is square and has at least one texel; `to_world` turns and mirrors only.
    pub(super) fn new(image: Arc<Bitmap>, scale: f32, to_world: &Transform) -> Self {
        let size = image.width;
        let weights: Vec<f32> = (0..size * size)
            .map(|index| mean_luminance(&image, (index % size) as i64, (index / size) as i64))
            .collect();
        let rows = weights
            .chunks(size)
            .map(|row| row.iter().map(|weight| f64::from(*weight)));
        Self {
            texels: DiscreteRows::new(size, rows),
            weights: weights.into(),
            image,
            scale,
            to_local: to_world.inverted(),
        }
    }

    /// The same image with another `to_world`.
    pub(super) fn turned(&self, to_world: &Transform) -> Self {
        Self {
            to_local: to_world.inverted(),
            ..self.clone()
        }
    }

    /// The value in the unit direction `direction`.
    pub(super) fn value(&self, direction: Vec3) -> Spectrum {
        let at = self.place(direction) * self.image.width as f32 - Vec2::splat(0.5);
        let (corner, within) = (at.floor(), at - at.floor());
        let (i, j) = (corner.x as i64, corner.y as i64);
        let row = |j| texel(&self.image, i, j) * (1.0 - within.x) + texel(&self.image, i + 1, j) * within.x;
        (row(j) * (1.0 - within.y) + row(j + 1) * within.y) * self.scale
    }

    /// A direction with density [`Self::pdf`]; `None` for a black image.
    pub(super) fn sample(&self, u: DVec2) -> Option<Vec3> {
        let [(column, x), (row, y)] = self.texels.sample(u)?;
        let at = Vec2::new(column as f32 + x, row as f32 + y) / self.image.width as f32;
        Some(self.to_local.inverted().vector(square_to_sphere(at)).normalize())
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        let total = self.texels.total() as f32;
        if total <= 0.0 {
            return 0.0;
        }
        let size = self.image.width;
        let texel = (self.place(direction) * size as f32)
            .floor()
            .clamp(Vec2::ZERO, Vec2::splat(size as f32 - 1.0));
        let weight = self.weights[texel.y as usize * size + texel.x as usize];
        weight / total * self.weights.len() as f32 / (4.0 * PI)
    }

    /// Luminance averaged over the sphere.
    pub(super) fn mean_luminance(&self) -> f32 {
        self.texels.total() as f32 / self.weights.len() as f32 * self.scale
    }

    /// Where in the unit square a direction lies.
    fn place(&self, direction: Vec3) -> Vec2 {
        sphere_to_square(self.to_local.vector(direction).normalize())
    }
}

/// The texel of column `i` and row `j`, either of which may lie one beyond an edge: there the sphere goes on at the same edge, mirrored
/// at its middle.
fn texel(image: &Bitmap, i: i64, j: i64) -> Spectrum {
    let size = image.width as i64;
    let fold = |along: i64, across: i64| match along {
        along if along < 0 => (-along - 1, size - 1 - across),
        along if along >= size => (2 * size - 1 - along, size - 1 - across),
        _ => (along, across),
    };
    let (i, j) = fold(i, j);
    let (j, i) = fold(j, i);
    image.texels.get((j * size + i) as usize)
}

/// The mean over a texel of the interpolated luminance: that of the texel itself counts six times as much as each neighbour's, along
/// either axis.
fn mean_luminance(image: &Bitmap, i: i64, j: i64) -> f32 {
    let mut sum = 0.0;
    for (row, across) in [(-1, 1.0), (0, 6.0), (1, 1.0)] {
        for (column, along) in [(-1, 1.0), (0, 6.0), (1, 1.0)] {
            sum += across * along * texel(image, i + column, j + row).luminance().max(0.0);
        }
    }
    sum / 64.0
}

/// The place of a unit direction in the unit square.
fn sphere_to_square(direction: Vec3) -> Vec2 {
    let [x, y, z] = direction.abs().to_array();
    let radius = (1.0 - z).max(0.0).sqrt();
    let phi = atan2(y, x) * (2.0 / PI);
    let (mut u, mut v) = (radius * (1.0 - phi), radius * phi);
    if direction.z < 0.0 {
        (u, v) = (1.0 - v, 1.0 - u);
    }
    let folded = Vec2::new(u.copysign(direction.x), v.copysign(direction.y));
    (0.5 * (folded + Vec2::ONE)).clamp(Vec2::ZERO, Vec2::ONE)
}

/// The unit direction of a place in the unit square.
fn square_to_sphere(at: Vec2) -> Vec3 {
    let folded = 2.0 * at - Vec2::ONE;
    let [u, v] = folded.abs().to_array();
    let height = 1.0 - (u + v);
    let radius = 1.0 - height.abs();
    let phi = if radius == 0.0 {
        0.0
    } else {
        ((v - u) / radius + 1.0) * (PI / 4.0)
    };
    let (sin_phi, cos_phi) = sin_cos(phi);
    let sine = radius * (2.0 - radius * radius).sqrt();
    Vec3::new(
        (sine * cos_phi).copysign(folded.x),
        (sine * sin_phi).copysign(folded.y),
        (1.0 - radius * radius).copysign(height),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The two maps are inverse to each other, and areas become solid angles in proportion.
    #[test]
    fn the_map_has_an_inverse_and_keeps_areas() {
        let step = 1e-3;
        for j in 0..40 {
            for i in 0..40 {
                let at = Vec2::new((i as f32 + 0.37) / 40.0, (j as f32 + 0.61) / 40.0);
                let direction = square_to_sphere(at);
                assert!((direction.length() - 1.0).abs() < 1e-5);
                assert!((sphere_to_square(direction) - at).length() < 1e-4, "{at}");
                let along = |offset: Vec2| square_to_sphere(at + offset) - square_to_sphere(at - offset);
                let [x, y] = [Vec2::X, Vec2::Y].map(|axis| along(0.5 * step * axis) / step);
                assert!((x.cross(y).length() - 4.0 * PI).abs() < 0.05, "{at}: {x} {y}");
            }
        }
        assert!((square_to_sphere(Vec2::splat(0.5)) - Vec3::Z).length() < 1e-6);
        assert!((square_to_sphere(Vec2::ZERO) + Vec3::Z).length() < 1e-6);
        assert!((square_to_sphere(Vec2::new(1.0, 0.5)) - Vec3::X).length() < 1e-6);
        assert!((square_to_sphere(Vec2::new(0.5, 1.0)) - Vec3::Y).length() < 1e-6);
    }

    /// Values go over the fold without a step.
    #[test]
    fn values_are_continuous_across_the_edges_of_the_square() {
        let size = 8;
        let texels = (0..size * size)
            .map(|i| Spectrum::splat((i * 7 % 13) as f32))
            .collect::<Vec<_>>();
        let image = Bitmap {
            width: size,
            height: size,
            texels: texels.into(),
            wrap: crate::texture::WrapMode::Clamp,
            filter: crate::texture::TextureFilter::Bilinear,
        };
        let map = EqualArea::new(Arc::new(image), 1.0, &Transform::default());
        for step in 1..40 {
            let along = step as f32 / 40.0;
            for edge in [
                Vec2::new(along, 1e-5),
                Vec2::new(1e-5, along),
                Vec2::new(along, 1.0 - 1e-5),
            ] {
                let inside = square_to_sphere(edge);
                let mirrored = if edge.x < 1e-4 || edge.x > 1.0 - 1e-4 {
                    Vec2::new(edge.x, 1.0 - edge.y)
                } else {
                    Vec2::new(1.0 - edge.x, edge.y)
                };
                let across = square_to_sphere(mirrored);
                assert!((inside - across).length() < 1e-3, "the same place: {inside} {across}");
                let [a, b] = [inside, across].map(|direction| map.value(direction)[0]);
                assert!((a - b).abs() < 0.02, "{edge}: {a} {b}");
            }
        }
    }
}
