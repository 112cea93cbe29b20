//! How bias and variance of cones in media fall with their widths and with the number of iterations: `docs/results/media.md`.
//!
//! The fog of [`crate::integrator::media::tests::measure`] with a phase function that depends on the angle. What cones expect of light that is scattered once is an integral
//! along the ray of means over balls of light times means over cones of directions of the phase function.

use super::*;
use crate::density::schedule::{pcf_sigma_ratio, pcf_theta};
use crate::integrator::media::tests::measure::{
    HEAD_BY_ITERATIONS, NEXT_TO_LIGHT, SIGMA, bias_of, fog, integral, row_by_iterations, row_by_radius, slope,
};
use crate::integrator::{IntegratorSettings, render_iteration};
use crate::random::Sampling;
use std::f64::consts::PI;

/// Mean cosine of the phase function.
const G: f64 = 0.6;
const ALPHA: f64 = 0.5;
/// First widths \[scene units, radians\].
const SIGMA1: f64 = 0.7;
const THETA1: f64 = 0.7;

/// Mean over a cone of directions of half angle `theta` \[radians\] of the phase function, by the cosine between the cone's axis and the light's way. Its Legendre
/// series has the coefficients g^l; the mean over a cone multiplies each by `(P_(l-1) - P_(l+1)) / ((2 l + 1) (1 - cos theta))` (Funk and Hecke).
struct MeanPhase(Vec<f64>);

const STEPS: usize = 400;

impl MeanPhase {
    fn new(theta: f64) -> Self {
        const TERMS: usize = 40;
        let of_theta = legendre(theta.cos(), TERMS + 1);
        let factors: Vec<f64> = (0..TERMS)
            .map(|l| match l {
                0 => 1.0,
                _ if theta == 0.0 => (2 * l + 1) as f64 * G.powi(l as i32),
                _ => G.powi(l as i32) * (of_theta[l - 1] - of_theta[l + 1]) / (1.0 - theta.cos()),
            })
            .collect();
        let at = |step: usize| {
            let values = legendre(2.0 * step as f64 / STEPS as f64 - 1.0, TERMS);
            factors
                .iter()
                .zip(values)
                .map(|(factor, value)| factor * value)
                .sum::<f64>()
                / (4.0 * PI)
        };
        Self((0..=STEPS + 1).map(|step| at(step.min(STEPS))).collect())
    }

    fn at(&self, cosine: f64) -> f64 {
        let place = 0.5 * (cosine.clamp(-1.0, 1.0) + 1.0) * STEPS as f64;
        let (step, rest) = (place as usize, place.fract());
        self.0[step] + rest * (self.0[step + 1] - self.0[step])
    }
}

/// P_0 to P_last.
fn legendre(x: f64, last: usize) -> Vec<f64> {
    let mut values = vec![1.0, x];
    for l in 1..last {
        let l_ = l as f64;
        values.push(((2.0 * l_ + 1.0) * x * values[l] - l_ * values[l - 1]) / (l_ + 1.0));
    }
    values
}

/// What cones of these widths expect \[scene units, radians\]; zero for the truth.
fn expected(sigma: f64, theta: f64) -> f64 {
    let phase = MeanPhase::new(theta);
    // Offset from the light; the camera lies towards -z.
    let scattered = |x: f64, y: f64, z: f64| {
        let distance = (x * x + y * y + z * z).sqrt();
        SIGMA * (-SIGMA * distance).exp() / (distance * distance) * phase.at(-z / distance)
    };
    let mean_in_ball = |z: f64| {
        if sigma == 0.0 {
            return scattered(-1.0, 0.0, z);
        }
        let shell = |share: f64| {
            let radius = sigma * share.cbrt();
            let ring = |cosine: f64| {
                let across = radius * (1.0 - cosine * cosine).sqrt();
                let at = |angle: f64| {
                    let (sin, cos) = angle.sin_cos();
                    scattered(-1.0 + across * cos, across * sin, z + radius * cosine)
                };
                integral(0.0, PI, 8, at) / PI
            };
            0.5 * integral(-1.0, 1.0, 10, ring)
        };
        integral(0.0, 1.0, 10, shell)
    };
    integral(0.0, 16.0, 400, |t| (-SIGMA * t).exp() * mean_in_ball(t - NEXT_TO_LIGHT))
}

fn truth() -> f64 {
    expected(0.0, 0.0)
}

/// The estimate of one iteration of a schedule of order `p` that begins with these widths.
fn one(scene: &Scene, (sigma1, theta1): (f64, f64), p: f64, seed: u64, iteration: u32) -> f64 {
    let settings = IntegratorSettings::Pcf(PcfSettings {
        samples: 1_024,
        photons: 10_000,
        sampling: Sampling::Independent,
        alpha: ALPHA as f32,
        p: p as f32,
        sigma1: Some(sigma1 as f32),
        theta1: theta1.to_degrees() as f32,
        media: ConesInMedia::Cones,
        max_depth: Some(2),
        ..Default::default()
    });
    let image = render_iteration(scene, &settings, seed, iteration, &Unobserved).unwrap();
    f64::from(image.pixels[0][0])
}

/// Means are those of the quadrature, within five standard errors, for widths of which one or the other blurs; the bias is of the second order.
#[test]
fn bias_of_cones_is_that_of_the_kernel_and_of_second_order() {
    let (scene, truth) = (fog(G), truth());
    for (sigma, theta) in [(0.7, 0.7), (0.7, 0.2), (0.35, 1.4)] {
        let (found, error) = bias_of(|seed| one(&scene, (sigma, theta), 1.0, seed, 1) / truth, 16);
        let expected = expected(sigma, theta) / truth - 1.0;
        assert!(
            (found - expected).abs() < 5.0 * error + 2e-3,
            "{sigma}, {theta}: {found} +- {error}, not {expected}"
        );
    }
    let order = slope(&[0.1, 0.2].map(|width| (width, expected(width, width) / truth - 1.0)));
    assert!((order - 2.0).abs() < 0.1, "the order is {order}");
}

/// Writes the tables of cones in `docs/results/media.md`, in some minutes:
/// `cargo test --release -p photonfarm-core --lib measure_cones -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes"]
fn measure_cones() {
    let (scene, truth) = (fog(G), truth());
    println!("| kind | bias at radius 0.25 | 0.35 | 0.5 | 0.7 | slope | slope expected |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let angle = |sigma: f64| THETA1 * sigma / SIGMA1;
    row_by_radius(
        "cones",
        |sigma| bias_of(|seed| one(&scene, (sigma, angle(sigma)), 1.0, seed, 1) / truth, 200),
        |sigma| expected(sigma, angle(sigma)) / truth - 1.0,
    );
    println!("{HEAD_BY_ITERATIONS}");
    for p in [1.0, 2.0] {
        let widths = |i: u32| {
            let ratio = pcf_sigma_ratio(i, ALPHA, p, THETA1, 3);
            (SIGMA1 * ratio, pcf_theta(ratio, p, THETA1))
        };
        row_by_iterations(
            &format!("cones, p = {p}"),
            |seed, i| one(&scene, (SIGMA1, THETA1), p, seed, i) / truth,
            |i| {
                let (sigma, theta) = widths(i);
                expected(sigma, theta) / truth - 1.0
            },
            |i| {
                let (sigma, theta) = widths(i);
                sigma.powi(3) * (1.0 - theta.cos())
            },
            [2.0 * (ALPHA - 1.0) / (2.0 * p + 3.0), -ALPHA],
        );
    }
}
