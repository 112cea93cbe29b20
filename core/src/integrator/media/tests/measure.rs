//! How bias and variance of the estimators fall with radius and with the number of iterations: `docs/results/media.md`.
//!
//! A point light in fog without end, at distance 1 from a camera ray; light that is scattered once. What an estimator expects with a kernel of some
//! radius is an integral without noise, and so is the truth.

use super::*;
use std::f64::consts::{PI as PI64, TAU};

pub(in crate::integrator) const SIGMA: f64 = 0.5;
/// Distance along the ray of the point next to the light.
pub(in crate::integrator) const NEXT_TO_LIGHT: f64 = 2.0;

/// Fog that scatters by the phase function of Henyey and Greenstein of mean cosine `g`.
pub(in crate::integrator) fn fog(g: f64) -> Scene {
    scene(&format!(
        "<medium id='fog' type='homogeneous'><float name='sigma_t' value='0.5'/><float name='albedo' value='1'/>\
         <phase type='hg'><float name='g' value='{g}'/></phase></medium>\
         {}<emitter type='point'><point name='position' x='1' y='0' z='2'/><rgb name='intensity' value='1'/></emitter>\
         <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate z='40'/></transform>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf></shape>",
        narrow_camera("0 0 0").replace("<film", "<ref id='fog'/><film")
    ))
}

/// The midpoint rule.
pub(in crate::integrator) fn integral(from: f64, to: f64, steps: u32, f: impl Fn(f64) -> f64) -> f64 {
    let step = (to - from) / f64::from(steps);
    (0..steps).map(|i| f(from + (f64::from(i) + 0.5) * step)).sum::<f64>() * step
}

/// Light that is scattered to a direction per volume, at a distance from the light.
fn scattered(distance: f64) -> f64 {
    SIGMA * (-SIGMA * distance).exp() / (distance * distance) / (4.0 * PI64)
}

/// The integral along the ray of a quantity by distance from the foot of the light's perpendicular.
fn along_ray(f: impl Fn(f64) -> f64) -> f64 {
    integral(0.0, 30.0, 3_000, |t| (-SIGMA * t).exp() * f(t - NEXT_TO_LIGHT))
}

fn truth() -> f64 {
    along_ray(|z| scattered(1.0_f64.hypot(z)))
}

/// What an estimator expects with a kernel of this radius, below 1.
fn expected(media: MediaEstimator, radius: f64) -> f64 {
    match media {
        // The part of a sphere of radius s about the light that lies in a ball at the distance d is pi s (r^2 - (d - s)^2) / d.
        MediaEstimator::Points => along_ray(|z| {
            let d = 1.0_f64.hypot(z);
            let volume = 4.0 / 3.0 * PI64 * radius.powi(3);
            let shell = |s: f64| scattered(s) * PI64 * s * (radius * radius - (d - s).powi(2)) / d;
            integral(d - radius, d + radius, 100, shell) / volume
        }),
        MediaEstimator::Radiance => along_ray(|z| {
            let ring = |share: f64| {
                let r = radius * share.sqrt();
                let at = |angle: f64| scattered((1.0 + r * r - 2.0 * r * angle.cos() + z * z).sqrt());
                integral(0.0, TAU, 24, at) / TAU
            };
            integral(0.0, 1.0, 24, ring)
        }),
        // In the projection along the ray, a beam at the angle a passes the ray at the distance |sin a|.
        _ => {
            let widest = radius.asin();
            let about = |a: f64| {
                let beam = |theta: f64| {
                    let along_beam = a.cos() / theta.sin();
                    let t = NEXT_TO_LIGHT + along_beam * theta.cos();
                    if t > 0.0 {
                        (-SIGMA * (along_beam + t)).exp()
                    } else {
                        0.0
                    }
                };
                integral(0.0, PI64, 4_000, beam)
            };
            SIGMA / (4.0 * PI64) / (2.0 * radius) * integral(-widest, widest, 40, about)
        }
    }
}

/// Camera and light paths of an iteration. A camera path gives the same as the other but where one point of it is chosen; beams count more often than photons.
fn paths(media: MediaEstimator) -> (u32, u32) {
    match media {
        MediaEstimator::Points => (2_048, 40_000),
        MediaEstimator::Radiance => (1, 80_000),
        _ => (1, 2_000),
    }
}

fn one(scene: &Scene, media: MediaEstimator, radius: f64, seed: u64, iteration: u32) -> f64 {
    let (samples, photons) = paths(media);
    let settings = IntegratorSettings::Pppm(PppmSettings {
        sigma1: Some(radius as f32),
        alpha: 0.5,
        ..settings(media, samples, photons, Some(2))
    });
    let image = render_iteration(scene, &settings, seed, iteration, &Unobserved).unwrap();
    f64::from(image.pixels[0][0])
}

/// Mean over seeds and its standard error, over the truth, less 1.
fn bias(scene: &Scene, media: MediaEstimator, radius: f64, seeds: u32) -> (f64, f64) {
    bias_of(|seed| one(scene, media, radius, seed, 1) / truth(), seeds)
}

/// As [`bias`], of any estimate over the truth by seed.
pub(in crate::integrator) fn bias_of(one: impl Fn(u64) -> f64, seeds: u32) -> (f64, f64) {
    let values: Vec<f64> = (0..seeds).map(|seed| one(u64::from(seed)) - 1.0).collect();
    mean_with_error(&values)
}

pub(in crate::integrator) fn mean_with_error(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0) / count).sqrt())
}

/// Least-squares slope of logarithms.
pub(in crate::integrator) fn slope(points: &[(f64, f64)]) -> f64 {
    let logs = || points.iter().map(|(x, y)| (x.ln(), y.abs().ln()));
    let count = points.len() as f64;
    let (x, y) = logs().fold((0.0, 0.0), |(x, y), point| (x + point.0 / count, y + point.1 / count));
    let covariance: f64 = logs().map(|point| (point.0 - x) * (point.1 - y)).sum();
    covariance / logs().map(|point| (point.0 - x).powi(2)).sum::<f64>()
}

/// Means are those of the quadrature, within five standard errors, and the bias of a 3-D kernel falls with the square of its radius: with half the
/// radius a quarter is left, and not an eighth.
#[test]
fn bias_is_that_of_the_kernel_and_of_second_order() {
    let scene = fog(0.0);
    for media in KINDS {
        for radius in [0.7, 0.35] {
            let (found, error) = bias(&scene, media, radius, 8);
            let expected = expected(media, radius) / truth() - 1.0;
            assert!(
                (found - expected).abs() < 5.0 * error + 1e-3,
                "{media:?}, radius {radius}: {found} +- {error}, not {expected}"
            );
        }
        let order = slope(&[0.1, 0.2].map(|radius| (radius, expected(media, radius) / truth() - 1.0)));
        assert!((order - 2.0).abs() < 0.1, "{media:?}: the order is {order}");
    }
}

/// Writes the tables of `docs/results/media.md`, in some minutes:
/// `cargo test --release -p photonfarm-core --lib measure -- --ignored --nocapture`.
#[test]
#[ignore = "takes minutes"]
fn measure_slopes() {
    let scene = fog(0.0);
    by_radius(&scene);
    by_iterations(&scene);
}

const RADII: [f64; 4] = [0.25, 0.35, 0.5, 0.7];

fn by_radius(scene: &Scene) {
    println!("| kind | bias at radius 0.25 | 0.35 | 0.5 | 0.7 | slope | slope expected |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for media in KINDS {
        row_by_radius(
            &format!("{media:?}"),
            |radius| bias(scene, media, radius, 400),
            |radius| expected(media, radius) / truth() - 1.0,
        );
    }
}

/// A row of the table of biases by radius: as found, with its standard error, and as expected.
pub(in crate::integrator) fn row_by_radius(
    label: &str,
    found: impl Fn(f64) -> (f64, f64),
    expected: impl Fn(f64) -> f64,
) {
    let found = RADII.map(found);
    let expected = RADII.map(|radius| (radius, expected(radius)));
    let measured: Vec<(f64, f64)> = RADII.into_iter().zip(found.map(|found| found.0)).collect();
    // Errors of logarithms, carried on to the slope.
    let middle = RADII.iter().map(|radius| radius.ln()).sum::<f64>() / 4.0;
    let spread: f64 = RADII.iter().map(|radius| (radius.ln() - middle).powi(2)).sum();
    let squares = found
        .iter()
        .zip(RADII)
        .map(|((bias, error), radius)| ((radius.ln() - middle) * error / bias).powi(2));
    let error = squares.sum::<f64>().sqrt() / spread;
    let cells = found.iter().zip(&expected).map(|((bias, error), (_, expected))| {
        format!("{:.2} ± {:.2} ({:.2})", 100.0 * bias, 100.0 * error, 100.0 * expected)
    });
    println!(
        "| {label} | {} | {:.2} ± {:.2} | {:.2} |",
        cells.collect::<Vec<_>>().join(" | "),
        slope(&measured),
        2.0 * error,
        slope(&expected)
    );
}

/// Bias and variance of averages over 4, 8, ..., 64 iterations with alpha 0.5.
fn by_iterations(scene: &Scene) {
    const FIRST_RADIUS: f64 = 0.7;
    println!("{HEAD_BY_ITERATIONS}");
    for media in KINDS {
        let dimensions = media.dimensions().unwrap();
        let radius = |i: u32| FIRST_RADIUS * crate::density::schedule::radius_ratio(i, 0.5, dimensions);
        row_by_iterations(
            &format!("{media:?}"),
            |seed, i| one(scene, media, FIRST_RADIUS, seed, i) / truth(),
            |i| expected(media, radius(i)) / truth() - 1.0,
            |i| radius(i).powi(dimensions as i32),
            [(-1.0 / f64::from(dimensions)).max(-1.0), -0.5],
        );
    }
}

pub(in crate::integrator) const HEAD_BY_ITERATIONS: &str = "\
| kind | bias: slope | expected at these N | in the limit | variance: slope | expected at these N | in the limit |
| --- | --- | --- | --- | --- | --- | --- |";

/// A row of the table of slopes of averages, of bias and of variance: by an estimate over the truth, which depends on seed and iteration, and as expected by the bias
/// and the kernel's measure of each iteration.
pub(in crate::integrator) fn row_by_iterations(
    label: &str,
    one: impl Fn(u64, u32) -> f64,
    bias: impl Fn(u32) -> f64,
    measure: impl Fn(u32) -> f64,
    limits: [f64; 2],
) {
    const GROUPS: usize = 8;
    const RUNS: usize = 32;
    let runs: Vec<Vec<f64>> = (0..RUNS)
        .map(|run| (1..=ITERATIONS).map(|i| one(1_000 + run as u64, i)).collect())
        .collect();
    // Without one group of runs, or with all.
    let slopes = |without: usize| {
        let kept: Vec<&Vec<f64>> = (0..RUNS)
            .filter(|run| run % GROUPS != without)
            .map(|run| &runs[run])
            .collect();
        slopes_of_averages(|i| {
            let values: Vec<f64> = kept.iter().map(|run| run[i as usize - 1]).collect();
            let (mean, error) = mean_with_error(&values);
            (mean - 1.0, error * error * kept.len() as f64)
        })
    };
    let expected = slopes_of_averages(|i| (bias(i), 1.0 / measure(i)));
    let all = slopes(GROUPS);
    let cells = [0, 1].map(|which| {
        let parts: Vec<f64> = (0..GROUPS).map(|group| slopes(group)[which]).collect();
        // The jackknife.
        let (_, error) = mean_with_error(&parts);
        let error = 2.0 * error * (GROUPS as f64 - 1.0);
        format!(
            "{:.2} ± {error:.2} | {:.2} | {:.2}",
            all[which], expected[which], limits[which]
        )
    });
    println!("| {label} | {} |", cells.join(" | "));
}

const ITERATIONS: u32 = 64;

/// Slopes of bias and variance of the averages over 4, 8, ..., 64 iterations, by those of each iteration.
fn slopes_of_averages(of_iteration: impl Fn(u32) -> (f64, f64)) -> [f64; 2] {
    let (mut sums, mut bias, mut variance) = ((0.0, 0.0), Vec::new(), Vec::new());
    for i in 1..=ITERATIONS {
        let (of_bias, of_variance) = of_iteration(i);
        sums = (sums.0 + of_bias, sums.1 + of_variance);
        if [4, 8, 16, 32, 64].contains(&i) {
            let n = f64::from(i);
            bias.push((n, sums.0 / n));
            variance.push((n, sums.1 / (n * n)));
        }
    }
    [slope(&bias), slope(&variance)]
}
