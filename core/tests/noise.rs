//! The standard error that a picture states against the one that it has: that of pictures of the same scene under 32 seeds.
//!
//! Seeds are fixed, so a test that passes once passes always. Ratios are of means over pixels and seeds: the error of a ratio
//! is some 3 %, more where the pixels of one picture depend on each other, as those that share photons do.

mod scenes;

use photonfarm_core::film::{Image, Node};
use photonfarm_core::integrator::{Unobserved, render_next};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings, SppmSettings};
use photonfarm_core::tree::Average;
use rayon::prelude::*;
use std::ops::Range;

const SEEDS: u64 = 32;
/// Pixels across and down.
const SIZE: usize = 12;
const PHOTONS: u32 = 1000;

fn settings(integrator: &str, sampling: Sampling) -> IntegratorSettings {
    let pppm = PppmSettings {
        photons: PHOTONS,
        sampling,
        sigma1: Some(0.3),
        ..Default::default()
    };
    match integrator {
        "path" => IntegratorSettings::Path(PathSettings {
            sampling,
            ..Default::default()
        }),
        "pppm" => IntegratorSettings::Pppm(pppm),
        "sppm" => IntegratorSettings::Sppm(SppmSettings(pppm)),
        _ => IntegratorSettings::Pcf(PcfSettings {
            photons: PHOTONS,
            samples: 1,
            sampling,
            sigma1: Some(0.3),
            ..Default::default()
        }),
    }
}

/// Numbers of iterations; not all are powers of two.
const COUNTS: [u32; 3] = [4, 13, 16];

/// The pictures of the first iterations of a job, as many as [`COUNTS`] says.
fn pictures(scene: &Scene, settings: &IntegratorSettings, seed: u64) -> Vec<Image> {
    let mut leaves = Vec::new();
    let mut before = Vec::new();
    for leaf in 0..COUNTS[COUNTS.len() - 1] {
        let rendered = render_next(scene, settings, seed, leaf + 1, &before, &Unobserved).unwrap();
        leaves.push(Node::leaf(leaf, SIZE as u32, SIZE as u32, &rendered.pixels).unwrap());
        before = rendered.statistics;
    }
    let average = |count: u32| {
        let mut average = Average::default();
        let mut first = leaves[..count as usize].iter();
        first.try_for_each(|leaf| average.push(leaf.clone())).unwrap();
        average.finish().unwrap()
    };
    COUNTS.map(average).into()
}

/// The standard error that pictures state over the one that they have: mean over pixels of the standard deviation over seeds; and the same for
/// the noise, which leaves out fireflies.
fn stated_over_true(pictures: &[Image]) -> [f64; 2] {
    let n = pictures.len() as f64;
    let mut deviations = Vec::new();
    let (mut stated, mut luminance) = (0.0, 0.0);
    for pixel in 0..SIZE * SIZE {
        let values = pictures.iter().map(|image| f64::from(image.pixels[pixel].luminance()));
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / n;
        let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        deviations.push((squares / (n - 1.0)).sqrt());
        luminance += mean;
        let errors = pictures.iter().map(|image| f64::from(image.standard_error[pixel]));
        stated += errors.sum::<f64>() / n;
    }
    let truth: f64 = deviations.iter().sum();
    let noise = pictures.iter().map(|image| image.noise().unwrap()).sum::<f64>() / n;
    [stated / truth, noise / (truth / luminance)]
}

/// Holds the ratios of some scenes and integrators against the smallest and the largest that they may have.
fn check(cases: &[(&str, &str)], sampling: Sampling, allowed: Range<f64>) {
    let mut worst = Vec::new();
    for (name, integrator) in cases {
        let (scene, settings) = (scenes::named(name, SIZE as u32), settings(integrator, sampling));
        let jobs: Vec<Vec<Image>> = (1..=SEEDS)
            .into_par_iter()
            .map(|seed| pictures(&scene, &settings, seed))
            .collect();
        for (index, count) in COUNTS.into_iter().enumerate() {
            let of_count: Vec<Image> = jobs.iter().map(|job| job[index].clone()).collect();
            let ratios = stated_over_true(&of_count);
            println!("{name}, {integrator}, {sampling:?}, {count} iterations: {ratios:.2?}");
            if !ratios.iter().all(|ratio| allowed.contains(ratio)) {
                worst.push((*name, *integrator, count, ratios));
            }
        }
    }
    assert!(worst.is_empty(), "{worst:?} are not within {allowed:?}");
}

#[test]
fn the_stated_error_of_independent_iterations_is_the_true_one() {
    let cases = [
        ("diffuse-box", "path"),
        ("mirror-glass", "path"),
        ("diffuse-box", "pppm"),
        ("diffuse-box", "pcf"),
    ];
    check(&cases, Sampling::Independent, 0.8..1.2);
}

#[test]
fn the_stated_error_of_low_discrepancy_iterations_is_not_too_small_and_not_many_times_too_large() {
    let cases = [
        ("diffuse-box", "path"),
        ("mirror-glass", "path"),
        ("environment", "path"),
        ("diffuse-box", "pppm"),
        ("diffuse-box", "pcf"),
        ("diffuse-box", "sppm"),
    ];
    check(&cases, Sampling::Sobol, 0.85..2.5);
}
