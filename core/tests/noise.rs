//! The standard error that a picture states against the one that it has: that of pictures of the same scene under 32 seeds.
//!
//! Seeds are fixed, so a test that passes once passes always. Ratios are of means over pixels and seeds: the error of a ratio
//! is some 3 %, more where the pixels of one picture depend on each other, as those that share photons do.

use photonfarm_core::film::{Image, Node};
use photonfarm_core::integrator::{Unobserved, render_next};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::{Limits, Scene, SceneFolder};
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings};
use photonfarm_core::tree::Average;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

const SEEDS: u64 = 32;
/// Pixels across and down.
const SIZE: usize = 12;
const PHOTONS: u32 = 1000;

fn scene(name: &str) -> Scene {
    let files = SceneFolder::new(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/scenes")).unwrap();
    let defines = BTreeMap::from([("res".to_owned(), SIZE.to_string())]);
    Scene::load(&files, &format!("{name}.xml"), &defines, &Limits::default()).unwrap_or_else(|e| panic!("{e}"))
}

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
        "sppm" => IntegratorSettings::Sppm(pppm),
        _ => IntegratorSettings::Pcf(PcfSettings {
            photons: PHOTONS,
            samples: 1,
            sampling,
            sigma1: Some(0.3),
            ..Default::default()
        }),
    }
}

fn picture(scene: &Scene, settings: &IntegratorSettings, seed: u64, iterations: u32) -> Image {
    let mut average = Average::default();
    let mut before = Vec::new();
    for leaf in 0..iterations {
        let rendered = render_next(scene, settings, seed, leaf + 1, &before, &Unobserved).unwrap();
        average
            .push(Node::leaf(leaf, SIZE as u32, SIZE as u32, &rendered.pixels).unwrap())
            .unwrap();
        before = rendered.statistics;
    }
    average.finish().unwrap()
}

/// The standard error that pictures state over the one that they have: mean over pixels of the standard deviation over seeds; and the same for
/// the noise, which leaves out fireflies.
fn stated_over_true(name: &str, integrator: &str, sampling: Sampling, iterations: u32) -> [f64; 2] {
    let (scene, settings) = (scene(name), settings(integrator, sampling));
    let pictures: Vec<Image> = (1..=SEEDS)
        .into_par_iter()
        .map(|seed| picture(&scene, &settings, seed, iterations))
        .collect();
    let n = SEEDS as f64;
    let mut deviations = Vec::new();
    let (mut stated, mut luminance) = (0.0, 0.0);
    for pixel in 0..SIZE * SIZE {
        let values: Vec<f64> = pictures
            .iter()
            .map(|image| f64::from(image.pixels[pixel].luminance()))
            .collect();
        let mean = values.iter().sum::<f64>() / n;
        let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        deviations.push((squares / (n - 1.0)).sqrt());
        luminance += mean;
        stated += pictures
            .iter()
            .map(|image| f64::from(image.standard_error[pixel]))
            .sum::<f64>()
            / n;
    }
    let truth: f64 = deviations.iter().sum();
    let noise = pictures.iter().map(|image| image.noise().unwrap()).sum::<f64>() / n;
    let ratios = [stated / truth, noise / (truth / luminance)];
    println!(
        "{name}, {integrator}, {sampling:?}, {iterations} iterations: stated over true error {ratios:.2?}, noise {noise:.4}"
    );
    ratios
}

#[test]
fn the_stated_error_of_independent_iterations_is_the_true_one() {
    for (scene, integrator) in [
        ("diffuse-box", "path"),
        ("mirror-glass", "path"),
        ("diffuse-box", "pppm"),
        ("diffuse-box", "pcf"),
        ("diffuse-box", "sppm"),
    ] {
        for iterations in [4, 13, 32] {
            let [error, noise] = stated_over_true(scene, integrator, Sampling::Independent, iterations);
            assert!((0.8..1.3).contains(&error) && (0.8..1.3).contains(&noise));
        }
    }
}

#[test]
fn the_stated_error_of_low_discrepancy_iterations_is_never_too_small_and_at_most_twice_too_large() {
    for (scene, integrator) in [
        ("diffuse-box", "path"),
        ("mirror-glass", "path"),
        ("environment", "path"),
        ("diffuse-box", "pppm"),
        ("diffuse-box", "pcf"),
        ("diffuse-box", "sppm"),
    ] {
        for iterations in [4, 13, 32] {
            let [error, noise] = stated_over_true(scene, integrator, Sampling::Sobol, iterations);
            assert!((0.9..2.0).contains(&error) && (0.9..2.0).contains(&noise));
        }
    }
}
