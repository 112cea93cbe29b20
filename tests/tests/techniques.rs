//! Every technique of photon cone focusing alone and with the others, against `path`.
//!
//! Radiance is compared path length by path length: the image with `max_depth` n less the image with n - 1, of the same
//! seed, holds the paths of n edges and nothing else, since random numbers do not depend on `max_depth`. Means over the image
//! are compared by z-tests; a test of all lengths together fails by chance with probability `FALSE_ALARMS`. Seeds are fixed,
//! so a test that passes once passes always. Errors of the whole image of a few percent, whatever the technique, are noticed by
//! `combinations.rs`.

use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::{Limits, Scene, SceneFolder};
use photonfarm_core::settings::{
    DirectionSampler, IntegratorSettings, KernelShape, LookupVertex, PathSettings, PcfSettings,
};
use photonfarm_tests::statistics::{Moments, ZTest};
use std::collections::BTreeMap;
use std::path::Path;

/// Probability with which a comparison of equal estimators fails.
const FALSE_ALARMS: f64 = 1e-4;

/// Pixels across and down.
const SIZE: usize = 16;

/// Path lengths that are compared: 1 to this number of edges.
const LONGEST: u32 = 5;

fn load(name: &str) -> Scene {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let defines = BTreeMap::from([("res".to_owned(), SIZE.to_string())]);
    let files = SceneFolder::new(&folder).expect("the scenes are there");
    Scene::load(&files, name, &defines, &Limits::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// Mean luminance of the image.
fn mean(scene: &Scene, settings: &IntegratorSettings, seed: u64, iteration: u32) -> f64 {
    let image = render_iteration(scene, settings, seed, iteration, &Unobserved).expect("the iteration renders");
    let sum: f64 = image.pixels.iter().map(|pixel| f64::from(pixel.luminance())).sum();
    sum / image.pixels.len() as f64
}

/// Mean luminance by path length and at last that of all lengths, over iterations; `settings` makes settings of a `max_depth`.
fn by_length(scene: &Scene, seed: u64, iterations: u32, settings: impl Fn(u32) -> IntegratorSettings) -> Moments {
    let mut moments = Moments::default();
    for iteration in 1..=iterations {
        let mut shorter = 0.0;
        let mut lengths: Vec<f64> = (1..=LONGEST)
            .map(|depth| {
                let upto = mean(scene, &settings(depth), seed, iteration);
                upto - std::mem::replace(&mut shorter, upto)
            })
            .collect();
        lengths.push(shorter);
        moments.push(&lengths);
    }
    moments
}

fn reference(scene: &Scene) -> Moments {
    by_length(scene, 1, 120, |depth| {
        IntegratorSettings::Path(PathSettings {
            samples: 16,
            sampling: Sampling::Independent,
            max_depth: Some(depth),
        })
    })
}

/// Kernels narrow enough that their bias stays below the noise.
fn narrow() -> PcfSettings {
    PcfSettings {
        photons: 20_000,
        samples: 2,
        sampling: Sampling::Independent,
        sigma1: Some(0.05),
        theta1: 12.0,
        ..Default::default()
    }
}

fn check(scene: &Scene, truth: &Moments, label: &str, settings: &PcfSettings) {
    let estimate = by_length(scene, 2, 40, |depth| {
        IntegratorSettings::Pcf(PcfSettings {
            max_depth: Some(depth),
            ..settings.clone()
        })
    });
    let test = ZTest::compare(&estimate, truth, FALSE_ALARMS);
    println!(
        "{label}: largest |z| {:.2} of {:.2}, noise {:.2} %, mean {:+.2} %",
        test.largest,
        test.threshold,
        100.0 * test.relative_noise,
        100.0 * test.relative_difference
    );
    assert!(test.passes(), "{label}: {test:?}");
    assert!(test.relative_noise < 0.1, "{label}: the test has power: {test:?}");
}

fn fixed(k: u32) -> PcfSettings {
    PcfSettings {
        lookup_vertex: LookupVertex::Fixed(k),
        ..narrow()
    }
}

#[test]
fn each_sampler_and_every_combination_agree_with_path_tracing() {
    use DirectionSampler::{Bsdf, Camera, Importon};
    let combinations: [&[DirectionSampler]; 7] = [
        &[Bsdf],
        &[Camera],
        &[Importon],
        &[Bsdf, Camera],
        &[Bsdf, Importon],
        &[Camera, Importon],
        &[Bsdf, Camera, Importon],
    ];
    let scene = load("diffuse-box.xml");
    let truth = reference(&scene);
    for samplers in combinations {
        for k in [1, 2] {
            // Camera connections alone leave directions away from the camera without a density.
            if (k == 1 && samplers.len() == 2) || (k == 2 && samplers == [Camera]) {
                continue;
            }
            let settings = PcfSettings {
                samplers: samplers.to_vec(),
                mis_beta: if k == 1 { 2.0 } else { 1.0 },
                ..fixed(k)
            };
            check(&scene, &truth, &format!("{samplers:?}, k = {k}"), &settings);
        }
    }
}

#[test]
fn each_lookup_vertex_counts_each_path_length_once() {
    let scene = load("mirror-glass.xml");
    let truth = reference(&scene);
    for nested in [false, true] {
        for (label, settings) in [("1", fixed(1)), ("2", fixed(2)), ("3", fixed(3)), ("auto", narrow())] {
            let settings = PcfSettings { nested, ..settings };
            let nested = if nested { ", nested" } else { "" };
            check(&scene, &truth, &format!("k = {label}{nested}"), &settings);
        }
    }
}

#[test]
fn kernels_and_tests_of_surfaces_agree_with_path_tracing() {
    let scene = load("mirror-glass.xml");
    let truth = reference(&scene);
    let epanechnikov = PcfSettings {
        kernel: KernelShape::Epanechnikov,
        ..narrow()
    };
    check(&scene, &truth, "Epanechnikov", &epanechnikov);
    let by_length = PcfSettings {
        sigma_by_length: vec![0.5, 0.7, 1.0],
        ..narrow()
    };
    check(&scene, &truth, "sigma by length", &by_length);
    let glossy = PcfSettings {
        theta_glossy: 0.5,
        ..fixed(1)
    };
    check(&scene, &truth, "narrow on glossy surfaces", &glossy);
    let surfaces = PcfSettings {
        surface_test: true,
        sigma1: Some(0.03),
        ..narrow()
    };
    check(&scene, &truth, "surface test", &surfaces);
}
