//! Vectors, deterministic elementary functions, frames, transforms and warps.
//!
//! The platform's `sin`, `exp` and friends differ in the last bit between machines, so the renderer calls the
//! functions of this module only. They come from the `libm` crate, which is the same code everywhere; `sqrt` is
//! correctly rounded by IEEE 754 and may come from the hardware.

mod animated;
mod discrete;
mod frame;
mod transform;
pub mod warp;

pub use animated::AnimatedTransform;
pub(crate) use discrete::{Discrete, DiscreteRows};
pub use frame::Frame;
pub use glam::{DVec2, DVec3, Vec2, Vec3};
pub use std::f32::consts::{FRAC_1_PI, PI, TAU};
pub use transform::Transform;

// Vectors of `glam` must come as scalar code, also where another crate asks for it with other features.
const _: () = assert!(
    align_of::<glam::Vec4>() == align_of::<f32>(),
    "glam lacks the feature scalar-math"
);

/// The largest `f32` below one: the upper end of a unit random number.
pub const ONE_MINUS_EPSILON: f32 = 1.0 - f32::EPSILON / 2.0;

/// A uniform number at single precision: below 1 although it is rounded.
#[must_use]
pub fn to_unit_f32(u: f64) -> f32 {
    (u as f32).clamp(0.0, ONE_MINUS_EPSILON)
}

/// Two uniform numbers at single precision.
#[must_use]
pub fn to_unit_vec2(u: DVec2) -> Vec2 {
    Vec2::new(to_unit_f32(u.x), to_unit_f32(u.y))
}

/// Sine of `x` in radians.
#[must_use]
pub fn sin(x: f32) -> f32 {
    libm::sinf(x)
}

/// Cosine of `x` in radians.
#[must_use]
pub fn cos(x: f32) -> f32 {
    libm::cosf(x)
}

/// Sine and cosine of `x` in radians.
#[must_use]
pub fn sin_cos(x: f32) -> (f32, f32) {
    libm::sincosf(x)
}

/// Tangent of `x` in radians.
#[must_use]
pub fn tan(x: f32) -> f32 {
    libm::tanf(x)
}

/// Arc cosine in radians; the argument is clamped to [-1, 1].
#[must_use]
pub fn acos(x: f32) -> f32 {
    libm::acosf(x.clamp(-1.0, 1.0))
}

/// Arc tangent of `y / x` in radians, in (-pi, pi].
#[must_use]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// Natural exponential.
#[must_use]
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm.
#[must_use]
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// `x` to the power `y`.
#[must_use]
pub fn pow(x: f32, y: f32) -> f32 {
    libm::powf(x, y)
}

/// `e^x - 1` without cancellation at small `x`.
#[must_use]
pub fn exp_m1(x: f32) -> f32 {
    libm::expm1f(x)
}

/// `ln(1 + x)` without cancellation at small `x`.
#[must_use]
pub fn ln_1p(x: f32) -> f32 {
    libm::log1pf(x)
}

/// Complementary error function, `1 - erf(x)`.
#[must_use]
pub fn erfc(x: f32) -> f32 {
    libm::erfcf(x)
}

/// `x * x`.
#[must_use]
pub fn sqr(x: f32) -> f32 {
    x * x
}

/// Square root of `x`, zero where rounding has made `x` negative.
#[must_use]
pub fn safe_sqrt(x: f32) -> f32 {
    x.max(0.0).sqrt()
}
