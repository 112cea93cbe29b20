//! Maps from the unit square to discs, hemispheres, spheres and cones, each with its density.

use super::{FRAC_1_PI, PI, Vec2, Vec3, cos, safe_sqrt, sin_cos, sqr};

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

/// A uniform direction within the cone of half angle `acos(cos_max)` about +z; density `1 / (2 pi (1 - cos_max))` [1/sr].
#[must_use]
pub fn square_to_cone(u: Vec2, cos_max: f32) -> Vec3 {
    let z = 1.0 - u.x * (1.0 - cos_max);
    let r = safe_sqrt(1.0 - z * z);
    let (sin_phi, cos_phi) = sin_cos(2.0 * PI * u.y);
    Vec3::new(r * cos_phi, r * sin_phi, z)
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
