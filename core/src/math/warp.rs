//! Maps from the unit square to discs, hemispheres, spheres and cones, each with its density.

use super::{FRAC_1_PI, Frame, PI, TAU, Vec2, Vec3, cos, safe_sqrt, sin_cos, sqr};

/// A point on the unit disc, uniform by area; concentric map (Shirley and Chiu 1997). Density 1/pi.
#[must_use]
pub fn square_to_disk(u: Vec2) -> Vec2 {
    let offset = 2.0 * u - Vec2::ONE;
    if offset.x == 0.0 && offset.y == 0.0 {
        return Vec2::ZERO;
    }
    let (radius, phi) = if offset.x.abs() > offset.y.abs() {
        (offset.x, PI / 4.0 * (offset.y / offset.x))
    } else {
        (offset.y, PI / 2.0 - PI / 4.0 * (offset.x / offset.y))
    };
    let (sin_phi, cos_phi) = sin_cos(phi);
    radius * Vec2::new(cos_phi, sin_phi)
}

/// A direction about +z with density cos / pi [1/sr].
#[must_use]
pub fn square_to_cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = square_to_disk(u);
    Vec3::new(d.x, d.y, safe_sqrt(1.0 - d.length_squared()))
}

/// Density of [`square_to_cosine_hemisphere`] [1/sr].
#[must_use]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// A uniform direction on the unit sphere, density 1 / (4 pi) [1/sr].
#[must_use]
pub fn square_to_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = safe_sqrt(1.0 - z * z);
    let (sin_phi, cos_phi) = sin_cos(2.0 * PI * u.y);
    Vec3::new(r * cos_phi, r * sin_phi, z)
}

/// A circular cone of directions, sampled uniformly by solid angle. It is kept as `1 - cos`: the cosine of an angle of 1e-3 has no
/// more than three digits that differ from one.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    one_minus_cos: f32,
}

/// Angle by which rounding moves a unit vector, at most \[radians\].
const ROUNDING: f32 = 4e-7;

impl Cone {
    /// The cone of half angle `theta` \[radians\], in (0, pi].
    #[must_use]
    pub fn of_angle(theta: f32) -> Self {
        Self {
            one_minus_cos: one_minus_cos(theta),
        }
    }

    /// The cone whose half angle, below a right angle, has the sine `sine`.
    #[must_use]
    pub fn of_sine(sine: f32) -> Self {
        let squared = sqr(sine);
        Self {
            one_minus_cos: squared / (1.0 + safe_sqrt(1.0 - squared)),
        }
    }

    /// A direction within the cone about +z, with density [`Self::pdf`].
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Vec3 {
        about_z(u.x * self.one_minus_cos, u.y)
    }

    /// Density of [`Self::sample`] [1/sr].
    #[must_use]
    pub fn pdf(&self) -> f32 {
        1.0 / (TAU * self.one_minus_cos)
    }

    /// A unit direction within the cone about the unit vector `axis`.
    #[must_use]
    pub fn sample_about(&self, axis: Vec3, u: Vec2) -> Vec3 {
        Frame::from_normal(axis).to_world(self.sample(u)).normalize()
    }

    /// Whether the cone about `axis` holds `direction`, both unit vectors: every sample at least, rounded as it is.
    #[must_use]
    pub fn holds(&self, axis: Vec3, direction: Vec3) -> bool {
        let chord2 = 2.0 * self.one_minus_cos;
        (direction - axis).length_squared() <= sqr(chord2.sqrt() + ROUNDING)
    }
}

/// The unit direction whose angle with +z has the cosine `1 - one_minus_cos`, at the share `turn` of a turn about +z.
#[must_use]
pub fn about_z(one_minus_cos: f32, turn: f32) -> Vec3 {
    let sine = safe_sqrt(one_minus_cos * (2.0 - one_minus_cos));
    let (sin_phi, cos_phi) = sin_cos(TAU * turn);
    Vec3::new(sine * cos_phi, sine * sin_phi, 1.0 - one_minus_cos)
}

/// `1 - cos(theta)` without cancellation at small angles.
#[must_use]
pub fn one_minus_cos(theta: f32) -> f32 {
    if theta < 0.5 {
        2.0 * sqr(super::sin(theta / 2.0))
    } else {
        1.0 - cos(theta)
    }
}

/// Barycentric coordinates `(b1, b2)` of a point uniform on a triangle.
#[must_use]
pub fn square_to_triangle(u: Vec2) -> Vec2 {
    let root = safe_sqrt(1.0 - u.x);
    Vec2::new(1.0 - root, root * u.y)
}
