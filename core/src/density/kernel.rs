//! Kernels: how much a record counts by its distance, and by the angle between directions. Each integrates to one over its reach.

use crate::math::{FRAC_1_PI, PI, TAU, acos, sqr, warp::one_minus_cos};
use serde::{Deserialize, Serialize};

/// A kernel's shape, in position and direction alike (thesis, sections 3.1 and 3.7.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KernelShape {
    /// Constant.
    Box,
    /// Falling with the square of the distance to zero at the rim.
    Epanechnikov,
}

/// What a kernel covers of the places about its middle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// A disc, on surfaces.
    Disc,
    /// A ball, in media.
    Ball,
}

impl Extent {
    /// Its dimensions.
    #[must_use]
    pub fn dimensions(self) -> u32 {
        match self {
            Self::Disc => 2,
            Self::Ball => 3,
        }
    }

    /// What the measure of a radius grows by where the radius grows by `ratio`.
    #[must_use]
    #[inline]
    pub fn growth(self, ratio: f32) -> f32 {
        match self {
            Self::Disc => sqr(ratio),
            Self::Ball => sqr(ratio) * ratio,
        }
    }

    /// Height of the middle of the parabola over that of the box.
    fn parabola_height(self) -> f32 {
        match self {
            Self::Disc => 2.0,
            Self::Ball => 2.5,
        }
    }
}

impl KernelShape {
    /// The kernel over the height of the box of the same reach, at `distance2` of the squared radius and `chord2` of the squared
    /// distance on the unit sphere that is in reach.
    #[must_use]
    #[inline]
    pub fn value(self, extent: Extent, distance2: f32, chord2: f32) -> f32 {
        match self {
            Self::Box => 1.0,
            Self::Epanechnikov => extent.parabola_height() * (1.0 - distance2) * 2.0 * (1.0 - chord2).max(0.0),
        }
    }

    /// Squared distance, over the squared radius, of a point of the disc that is distributed as the kernel.
    #[must_use]
    pub fn sample_distance2(self, u: f32) -> f32 {
        match self {
            Self::Box => u,
            Self::Epanechnikov => 1.0 - (1.0 - u).sqrt(),
        }
    }

    /// Share of the kernel on a disc of radius one on the near side of a line at the distance `x` from its middle.
    #[must_use]
    pub fn share_above(self, x: f32) -> f32 {
        if x >= 1.0 {
            return 1.0;
        }
        let chord = x * (1.0 - x * x).sqrt();
        let beyond = match self {
            Self::Box => chord,
            Self::Epanechnikov => chord * (5.0 - 2.0 * x * x) / 3.0,
        };
        1.0 - FRAC_1_PI * (acos(x) - beyond)
    }
}

/// Height of the box of radius `radius` over positions: `1 / (pi r^2)` (Hachisuka and Jensen 2009, equation 1) [1/unit^2].
#[must_use]
pub fn disc_height(radius: f32) -> f32 {
    1.0 / (PI * sqr(radius))
}

/// Height of the box over positions in a ball of radius `radius`: `3 / (4 pi r^3)` [1/unit^3].
#[must_use]
pub fn ball_height(radius: f32) -> f32 {
    0.75 / (PI * radius * sqr(radius))
}

/// Height of the box of radius `sigma` and half angle `theta` \[radians\] over positions and directions:
/// `1 / (pi sigma^2 2 pi (1 - cos theta))` on a disc (thesis, equation 3.6) [1 / (unit^2 sr)], and `3 / (4 pi sigma^3 2 pi (1 - cos theta))`
/// in a ball (section 3.7.2) [1 / (unit^3 sr)].
#[must_use]
pub fn cone_height(extent: Extent, sigma: f32, theta: f32) -> f32 {
    match extent {
        Extent::Disc => 1.0 / (PI * sqr(sigma) * TAU * one_minus_cos(theta)),
        Extent::Ball => ball_height(sigma) / (TAU * one_minus_cos(theta)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_a_cut_disc_are_those_of_a_sum_over_it() {
        const STEPS: usize = 400;
        for shape in [KernelShape::Box, KernelShape::Epanechnikov] {
            for x in [0.0, 0.3, 0.8, 1.0] {
                let (mut near, mut whole) = (0.0, 0.0);
                for i in 0..STEPS * STEPS {
                    let at = |step: usize| 2.0 * (step as f32 + 0.5) / STEPS as f32 - 1.0;
                    let (a, b) = (at(i % STEPS), at(i / STEPS));
                    let inside = 1.0 - sqr(a) - sqr(b);
                    if inside > 0.0 {
                        let value = if shape == KernelShape::Box {
                            1.0
                        } else {
                            f64::from(inside)
                        };
                        whole += value;
                        near += if a < x { value } else { 0.0 };
                    }
                }
                let share = f64::from(shape.share_above(x));
                assert!(
                    (share - near / whole).abs() < 2e-3,
                    "{shape:?} {x}: {share} for {}",
                    near / whole
                );
            }
        }
    }
}
