//! The highlight of the modified Phong model (Lafortune and Willems 1994, "Using the Modified Phong Reflectance Model for Physically
//! Based Rendering"): a power of the cosine with the mirror direction. Both directions are outside.

use crate::math::{Frame, TAU, Vec2, Vec3, pow, safe_sqrt, sin_cos, sqr};

/// Beyond it a highlight is narrower than directions in single precision can tell.
pub(super) const LARGEST_EXPONENT: f32 = 1e6;

/// Cosine of `wi` with the mirror direction of `wo`, zero beyond a right angle.
fn cosine(wo: Vec3, wi: Vec3) -> f32 {
    (wo.z * wi.z - wo.x * wi.x - wo.y * wi.y).clamp(0.0, 1.0)
}

/// `cos^n`, zero beyond a right angle also for n = 0.
fn power(cos: f32, exponent: f32) -> f32 {
    if cos > 0.0 { pow(cos, exponent) } else { 0.0 }
}

/// f(wo, wi) [1/sr] of a highlight of albedo one at normal incidence: `(n + 2) cos^n / 2 pi`.
pub(super) fn f(exponent: f32, wo: Vec3, wi: Vec3) -> f32 {
    (exponent + 2.0) / TAU * power(cosine(wo, wi), exponent)
}

/// Density of [`sample`] [1/sr]: `(n + 1) cos^n / 2 pi`.
pub(super) fn pdf(exponent: f32, wo: Vec3, wi: Vec3) -> f32 {
    (exponent + 1.0) / TAU * power(cosine(wo, wi), exponent)
}

/// A direction about the mirror direction; it may lead below the surface.
pub(super) fn sample(exponent: f32, wo: Vec3, u: Vec2) -> Vec3 {
    let cos = pow(u.y, 1.0 / (exponent + 1.0));
    let sin = safe_sqrt(1.0 - sqr(cos));
    let (sin_phi, cos_phi) = sin_cos(TAU * u.x);
    let mirrored = Vec3::new(-wo.x, -wo.y, wo.z);
    let about_it = Vec3::new(sin * cos_phi, sin * sin_phi, cos);
    Frame::from_normal(mirrored).to_world(about_it).normalize()
}
