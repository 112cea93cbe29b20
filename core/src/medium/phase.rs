//! Phase functions: how a medium scatters, by the cosine between the way on and the way so far.

use crate::math::{FRAC_1_PI, Frame, TAU, Vec2, Vec3, safe_sqrt, sin_cos, sqr};
use std::sync::Arc;

/// The density of directions after scattering \[1/sr\], which depends on the angle of deflection alone: forward is a cosine of 1.
#[derive(Clone, Debug)]
pub enum Phase {
    /// The same in all directions.
    Isotropic,
    /// Henyey and Greenstein 1941, with the mean cosine g, which lies in (-1, 1).
    HenyeyGreenstein(f32),
    /// Scattering by what is much smaller than the wavelength: 3 (1 + cos^2) / (16 pi).
    Rayleigh,
    /// Values at cosines that are spaced evenly.
    Tabulated(Arc<PhaseTable>),
    /// A weighted sum; the weights are positive and add up to 1.
    Mixture(Arc<[(f32, Phase)]>),
}

/// Henyey and Greenstein's function is taken for isotropic where g is smaller: its sampling divides by g.
const LEAST_G: f32 = 1e-3;

impl Phase {
    /// The density of going on along `wi` for a path that came along `-wo`, both unit vectors \[1/sr\].
    #[must_use]
    pub fn pdf(&self, wo: Vec3, wi: Vec3) -> f32 {
        self.of_cosine((-wo).dot(wi).clamp(-1.0, 1.0))
    }

    fn of_cosine(&self, cosine: f32) -> f32 {
        match self {
            Self::Isotropic => 0.25 * FRAC_1_PI,
            Self::HenyeyGreenstein(g) => {
                let spread = 1.0 + sqr(*g) - 2.0 * g * cosine;
                0.25 * FRAC_1_PI * (1.0 - sqr(*g)) / (spread * spread.sqrt())
            }
            Self::Rayleigh => 3.0 / 16.0 * FRAC_1_PI * (1.0 + sqr(cosine)),
            Self::Tabulated(table) => table.pdf(cosine),
            Self::Mixture(parts) => parts
                .iter()
                .map(|(weight, phase)| weight * phase.of_cosine(cosine))
                .sum(),
        }
    }

    /// A direction on from a path that came along `-wo`, with density [`Self::pdf`]. `choice` chooses among the parts of a mixture.
    #[must_use]
    pub fn sample(&self, wo: Vec3, choice: f32, u: Vec2) -> Vec3 {
        let cosine = self.sample_cosine(choice, u.x);
        let sine = safe_sqrt(1.0 - sqr(cosine));
        let (sin_phi, cos_phi) = sin_cos(TAU * u.y);
        let local = Vec3::new(sine * cos_phi, sine * sin_phi, cosine);
        Frame::from_normal(-wo).to_world(local).normalize()
    }

    fn sample_cosine(&self, choice: f32, u: f32) -> f32 {
        match self {
            Self::HenyeyGreenstein(g) if g.abs() >= LEAST_G => {
                let part = (1.0 - sqr(*g)) / (1.0 - g + 2.0 * g * u);
                ((1.0 + sqr(*g) - sqr(part)) / (2.0 * g)).clamp(-1.0, 1.0)
            }
            Self::Isotropic | Self::HenyeyGreenstein(_) => 2.0 * u - 1.0,
            Self::Rayleigh => {
                // The real root of c^3 + 3 c = 8 u - 4 (Frisvad 2011).
                let half = f64::from(4.0 * u - 2.0);
                let root = libm::cbrt(half + (half * half + 1.0).sqrt());
                ((root - 1.0 / root) as f32).clamp(-1.0, 1.0)
            }
            Self::Tabulated(table) => table.sample(u),
            Self::Mixture(parts) => {
                let mut left = choice;
                for (weight, phase) in parts.iter() {
                    if left < *weight {
                        return phase.sample_cosine(left / weight, u);
                    }
                    left -= weight;
                }
                parts.last().map_or(0.0, |(_, phase)| phase.sample_cosine(0.0, u))
            }
        }
    }
}

/// A density that is linear between values at cosines from -1 to 1, spaced evenly.
#[derive(Clone, Debug)]
pub struct PhaseTable {
    /// \[1/sr\].
    densities: Vec<f64>,
    /// For each piece, the probability of it or one before it.
    cumulative: Vec<f64>,
}

impl PhaseTable {
    /// A density in proportion to at least two `values`, not negative and not all zero; the first is that of scattering straight back.
    /// `None` where there is no such density.
    #[must_use]
    pub fn new(values: &[f64]) -> Option<Self> {
        let pieces = values.len().checked_sub(1).filter(|pieces| *pieces > 0)?;
        if !values.iter().all(|value| value.is_finite() && *value >= 0.0) {
            return None;
        }
        let mut sum = 0.0;
        let mut cumulative: Vec<f64> = values
            .windows(2)
            .map(|ends| {
                sum += 0.5 * (ends[0] + ends[1]);
                sum
            })
            .collect();
        if !(sum > 0.0 && sum.is_finite()) {
            return None;
        }
        for part in &mut cumulative {
            *part /= sum;
        }
        // Over a piece of width 2 / pieces the density by the cosine integrates to its share; about the axis there are 2 pi.
        let scale = pieces as f64 / (2.0 * sum * std::f64::consts::TAU);
        Some(Self {
            densities: values.iter().map(|value| value * scale).collect(),
            cumulative,
        })
    }

    fn pdf(&self, cosine: f32) -> f32 {
        let pieces = self.cumulative.len();
        let place = (f64::from(cosine) + 1.0) * 0.5 * pieces as f64;
        let piece = (place as usize).min(pieces - 1);
        let within = place - piece as f64;
        (self.densities[piece] * (1.0 - within) + self.densities[piece + 1] * within) as f32
    }

    fn sample(&self, u: f32) -> f32 {
        let u = f64::from(u);
        let pieces = self.cumulative.len();
        let piece = self.cumulative.partition_point(|part| *part <= u).min(pieces - 1);
        let before = piece.checked_sub(1).map_or(0.0, |last| self.cumulative[last]);
        let share = (u - before) / (self.cumulative[piece] - before);
        let (first, last) = (self.densities[piece], self.densities[piece + 1]);
        // The root of first x + (last - first) x^2 / 2 = share (first + last) / 2, without cancellation.
        let area = 0.5 * (first + last) * share;
        let root = (first * first + 2.0 * (last - first) * area).max(0.0).sqrt();
        let within = if first + root > 0.0 {
            2.0 * area / (first + root)
        } else {
            0.0
        };
        ((piece as f64 + within.clamp(0.0, 1.0)) * 2.0 / pieces as f64 - 1.0) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chi_square::chi_square_directions;

    fn all() -> Vec<(&'static str, Phase)> {
        let table = PhaseTable::new(&[0.0, 1.0, 0.25, 4.0]).unwrap();
        let parts = [
            (0.25, Phase::HenyeyGreenstein(-0.5)),
            (0.5, Phase::HenyeyGreenstein(0.9)),
            (0.25, Phase::Rayleigh),
        ];
        vec![
            ("isotropic", Phase::Isotropic),
            ("g = 0.9", Phase::HenyeyGreenstein(0.9)),
            ("g = -0.3", Phase::HenyeyGreenstein(-0.3)),
            ("g = 0.0005", Phase::HenyeyGreenstein(0.0005)),
            ("rayleigh", Phase::Rayleigh),
            ("table", Phase::Tabulated(Arc::new(table))),
            ("mixture", Phase::Mixture(Arc::new(parts))),
        ]
    }

    /// Directions are those of the density, which integrates to one (the expected numbers are its integrals over the cells).
    #[test]
    fn samples_follow_the_density() {
        for (label, phase) in all() {
            let outcome = chi_square_directions(
                200_000,
                7,
                |random| Some(phase.sample(-Vec3::Z, random.next_1d(), random.next_2d())),
                |wi| phase.pdf(-Vec3::Z, wi),
            );
            assert!(outcome.passes(all().len()), "{label}: {outcome:?}");
        }
    }

    /// The mean cosine of Henyey and Greenstein's function is g, that of a table is that of its trapezia.
    #[test]
    fn mean_cosines_are_those_of_closed_forms() {
        let mean = |phase: &Phase| {
            let steps = 200_000;
            let sum: f64 = (0..steps)
                .map(|step| {
                    let cosine = -1.0 + 2.0 * (f64::from(step) + 0.5) / f64::from(steps);
                    cosine * f64::from(phase.of_cosine(cosine as f32))
                })
                .sum();
            sum * std::f64::consts::TAU * 2.0 / f64::from(steps)
        };
        for g in [-0.7_f32, 0.2, 0.9] {
            assert!((mean(&Phase::HenyeyGreenstein(g)) - f64::from(g)).abs() < 1e-4, "{g}");
        }
        // The density by the cosine is (1 + c) / 2, whose mean is 1/3.
        let rising = PhaseTable::new(&[0.0, 1.0]).unwrap();
        assert!((mean(&Phase::Tabulated(Arc::new(rising))) - 1.0 / 3.0).abs() < 1e-6);
        assert!(mean(&Phase::Rayleigh).abs() < 1e-6);
    }

    #[test]
    fn tables_without_a_density_are_refused() {
        for values in [
            &[][..],
            &[1.0],
            &[0.0, 0.0],
            &[1.0, -1.0],
            &[f64::NAN, 1.0],
            &[f64::INFINITY, 1.0],
        ] {
            assert!(PhaseTable::new(values).is_none(), "{values:?}");
        }
    }
}
