//! Stochastic progressive photon mapping (Hachisuka and Jensen 2009): `pppm` with a radius of each pixel's own, which
//! shrinks with the photons that the pixel has seen. So an iteration needs what the one before it left.
//!
//! The paper keeps the flux `tau` of each pixel, scales it by `R_{i+1}^2 / R_i^2` after every iteration (its equation 6), and divides it
//! by `pi R_N^2` and by all light paths in the end (its equation 7). Of the flux `phi_i` that iteration `i` found this leaves
//! `phi_i / R_i^2`, whatever comes after: the estimate is the mean of the images `phi_i / (M pi R_i^2)`. So iterations are images that are
//! added up, as those of every integrator are, and only the radius and the number of photons are handed on.

pub(super) mod settings;

use super::pppm::{Discs, gather_image};
use super::{Iteration, Job, Observer, RenderError};
use crate::math::sqr;
use crate::settings::{PppmSettings, STATISTICS_PER_PIXEL};

/// Renders an iteration. `before`: squared radius [squared scene units] and number of photons of each pixel after the iteration
/// before; empty for the first one, where every radius is `first_radius`.
pub(super) fn render(
    job: &Job,
    settings: &PppmSettings,
    first_radius: f32,
    before: &[f32],
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let first = [sqr(first_radius), 0.0];
    check(job, before)?;
    let (before, _) = before.as_chunks::<STATISTICS_PER_PIXEL>();
    let known = |pixel: usize| before.get(pixel).copied().unwrap_or(first);
    let discs = Discs {
        radius_of: |pixel| known(pixel)[0].sqrt(),
        widest: match before {
            [] => first_radius,
            _ => before.iter().map(|[radius2, _]| *radius2).fold(0.0, f32::max).sqrt(),
        },
    };
    let gathered = gather_image(job, settings, &discs, observer)?;
    let found = gathered.photons.iter().enumerate();
    Ok(Iteration {
        statistics: found
            .flat_map(|(pixel, found)| shrink(known(pixel), *found, settings.alpha))
            .collect(),
        pixels: gathered.pixels,
        counts: gathered.counts,
    })
}

/// Squared radius and number of photons after `found` more (equations 3 to 5).
fn shrink([radius2, photons]: [f32; STATISTICS_PER_PIXEL], found: f32, alpha: f32) -> [f32; STATISTICS_PER_PIXEL] {
    if found == 0.0 {
        return [radius2, photons];
    }
    let kept = photons + alpha * found;
    [radius2 * (kept / (photons + found)), kept]
}

/// Whether statistics can be those of an iteration of this scene.
fn check(job: &Job, before: &[f32]) -> Result<(), RenderError> {
    let expected = job.pixel_count() * STATISTICS_PER_PIXEL;
    let refuse = |reason| {
        Err(RenderError::Statistics {
            iteration: job.iteration,
            reason,
        })
    };
    if !before.is_empty() && before.len() != expected {
        return refuse(format!("{} statistics for an image that has {expected}", before.len()));
    }
    let (pixels, _) = before.as_chunks::<STATISTICS_PER_PIXEL>();
    let can_be = |[radius2, photons]: &[f32; STATISTICS_PER_PIXEL]| {
        radius2.is_normal() && *radius2 > 0.0 && photons.is_finite() && *photons >= 0.0
    };
    match pixels.iter().position(|pixel| !can_be(pixel)) {
        Some(bad) => {
            let [radius2, photons] = pixels[bad];
            refuse(format!(
                "pixel {bad} has a squared radius of {radius2} and {photons} photons"
            ))
        }
        None => Ok(()),
    }
}

/// The largest and the smallest radius of what an iteration left [scene units].
#[must_use]
pub fn radius_range(statistics: &[f32]) -> Option<[f32; 2]> {
    let (pixels, _) = statistics.as_chunks::<STATISTICS_PER_PIXEL>();
    let squares = || pixels.iter().map(|[radius2, _]| *radius2);
    Some([squares().reduce(f32::max)?.sqrt(), squares().reduce(f32::min)?.sqrt()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrator::{Unobserved, render_iteration, render_next, test_scenes};
    use crate::scene::Scene;
    use crate::settings::{IntegratorSettings, SppmSettings};

    const ALPHA: f32 = 0.7;
    const PHOTONS: u32 = 2_000;

    fn scene() -> Scene {
        test_scenes::load("mirror-glass", 12)
    }

    fn settings() -> IntegratorSettings {
        IntegratorSettings::Sppm(SppmSettings(PppmSettings {
            photons: PHOTONS,
            samples: 2,
            alpha: ALPHA,
            sigma1: Some(0.4),
            ..Default::default()
        }))
    }

    fn chain(scene: &Scene, iterations: u32) -> Vec<Iteration> {
        let mut done: Vec<Iteration> = Vec::new();
        for i in 1..=iterations {
            let before = done.last().map_or(&[][..], |last| &last.statistics);
            done.push(render_next(scene, &settings(), 5, i, before, &Unobserved).unwrap());
        }
        done
    }

    /// The paper's recursion, kept at double precision: flux scaled with the disc, divided once in the end. What is not
    /// an estimate by photons (direct light) goes through it unchanged, as `phi = L pi R^2`.
    #[test]
    fn the_mean_of_the_iterations_is_the_estimate_of_the_paper() {
        const ITERATIONS: u32 = 6;
        let scene = scene();
        let chain = chain(&scene, ITERATIONS);
        let luminance = |iteration: &Iteration, pixel: usize| f64::from(iteration.pixels[pixel].luminance());
        let mut seen = 0;
        for pixel in 0..chain[0].pixels.len() {
            let (mut tau, mut radius2, mut photons) = (0.0_f64, f64::from(0.4_f32).powi(2), 0.0_f64);
            for iteration in &chain {
                let [after2, after] = [0, 1].map(|i| f64::from(iteration.statistics[2 * pixel + i]));
                let found = (after - photons) / f64::from(ALPHA);
                let phi = luminance(iteration, pixel) * std::f64::consts::PI * radius2 * f64::from(PHOTONS);
                let shrunk = match found > 0.0 {
                    true => (photons + f64::from(ALPHA) * found) / (photons + found),
                    false => 1.0,
                };
                assert!((after2 / (radius2 * shrunk) - 1.0).abs() < 1e-4);
                tau = (tau + phi) * (after2 / radius2);
                (radius2, photons) = (after2, after);
                seen += u32::from(found > 0.0);
            }
            let paper = tau / (std::f64::consts::PI * radius2 * f64::from(PHOTONS * ITERATIONS));
            let mean = chain.iter().map(|iteration| luminance(iteration, pixel)).sum::<f64>() / f64::from(ITERATIONS);
            assert!((paper - mean).abs() <= 1e-5 * mean, "pixel {pixel}: {paper} and {mean}");
        }
        assert!(seen > 100, "photons were found {seen} times");
    }

    #[test]
    fn radii_shrink_where_photons_are_found_and_nowhere_else() {
        let scene = scene();
        let chain = chain(&scene, 2);
        let [before, after] = [&chain[0].statistics, &chain[1].statistics];
        let pixels = before.chunks(2).zip(after.chunks(2));
        let (mut shrunk, mut kept) = (0, 0);
        for (before, after) in pixels {
            match after[1] > before[1] {
                true => shrunk += u32::from(after[0] < before[0]),
                false => kept += u32::from(after == before),
            }
        }
        assert_eq!(shrunk + kept, 144);
        assert!(shrunk > 50, "{shrunk} radii shrank");
        let [widest, narrowest] = radius_range(after).unwrap();
        assert!(widest <= 0.4 + 1e-6 && narrowest < widest);
        assert_eq!(shrink([2.0, 3.0], 1.0, 0.5), [2.0 * (3.5 / 4.0), 3.5]);
    }

    #[test]
    fn statistics_that_cannot_be_are_refused() {
        let scene = scene();
        let good = chain(&scene, 1).remove(0).statistics;
        let next = |settings: &IntegratorSettings, iteration, before: &[f32]| {
            let result = render_next(&scene, settings, 5, iteration, before, &Unobserved);
            result.map(drop).map_err(|error| error.to_string())
        };
        let mut zero = good.clone();
        zero[6] = 0.0;
        let mut infinite = good.clone();
        infinite[7] = f32::INFINITY;
        let refused = [
            (next(&settings(), 2, &[]), "goes on from the statistics"),
            (next(&settings(), 1, &good), "after the first"),
            (
                next(&settings(), 2, &good[2..]),
                "286 statistics for an image that has 288",
            ),
            (next(&settings(), 2, &zero), "pixel 3 has a squared radius of 0"),
            (next(&settings(), 2, &infinite), "inf photons"),
        ];
        for (result, reason) in refused {
            let error = result.unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
        let pppm = IntegratorSettings::Pppm(PppmSettings::default());
        assert!(next(&pppm, 2, &good).is_err() && next(&settings(), 2, &good).is_ok());
        assert!(render_iteration(&scene, &settings(), 5, 2, &Unobserved).is_err());
    }
}
