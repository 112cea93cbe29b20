//! Every technique of photon cone focusing alone and with the others, against `path`.
//!
//! Radiance is compared path length by path length: the image with `max_depth` n less the image with n - 1, of the same
//! seed, holds the paths of n edges and nothing else, since random numbers do not depend on `max_depth`. Means over the image
//! are compared by z-tests, and the sum of the lengths whose light comes from cones; all these together fail by chance with probability
//! `FALSE_ALARMS`. Seeds are fixed, so a test that passes once passes always. Each check holds itself to the promise that it would fail
//! if all light from cones were too bright or too dark by a share that it states: 5 % for aimed cones, 10 to 30 % for noisier ones.

use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    DirectionSampler, IntegratorSettings, KernelShape, LookupVertex, PathSettings, PcfSettings,
};
use photonfarm_tests::render::luminance_by_length;
use photonfarm_tests::scenes;
use photonfarm_tests::statistics::{Moments, ZTest};

/// Probability with which a comparison of equal estimators fails.
const FALSE_ALARMS: f64 = 1e-4;

/// Share that the light from cones may not be off by unnoticed, where a check does not say a larger one: fixed lookup vertices
/// and directions from the material alone are noisier at equal cost.
const NOTICED: f64 = 0.05;

/// Iterations of an estimate.
const ITERATIONS: u32 = 24;

/// Pixels across and down.
const SIZE: usize = 16;

/// Path lengths that are compared: 1 to this number of edges.
const LONGEST: u32 = 5;

fn load(name: &str) -> Scene {
    scenes::named(name, SIZE).expect("the scene loads")
}

/// Mean luminance of each iteration by path length; `settings` makes settings of a `max_depth`.
fn by_length(scene: &Scene, seed: u64, iterations: u32, settings: impl Fn(u32) -> IntegratorSettings) -> Vec<Vec<f64>> {
    let lengths = |iteration| luminance_by_length(scene, seed, iteration, LONGEST, &settings);
    let each: Result<_, _> = (1..=iterations).map(lengths).collect();
    each.expect("the iterations render")
}

/// Moments of each path length, and at last of the sum of those of `counted` edges and more; all these are multiplied by `factor`.
fn moments(iterations: &[Vec<f64>], counted: usize, factor: f64) -> Moments {
    let mut moments = Moments::default();
    for lengths in iterations {
        let mut values = lengths.clone();
        values[counted - 1..].iter_mut().for_each(|value| *value *= factor);
        values.push(values[counted - 1..].iter().sum());
        moments.push(&values);
    }
    moments
}

fn reference(scene: &Scene) -> Vec<Vec<f64>> {
    by_length(scene, 1, 120, |depth| {
        IntegratorSettings::Path(PathSettings {
            samples: 16,
            sampling: Sampling::Independent,
            max_depth: Some(depth),
        })
    })
}

/// Kernels narrow enough that their bias stays below the noise. Many queries to few photons: a photon that no query counts is as good
/// as none.
fn narrow() -> PcfSettings {
    PcfSettings {
        photons: 10_000,
        samples: 32,
        sampling: Sampling::Independent,
        sigma1: Some(0.05),
        theta1: 12.0,
        ..Default::default()
    }
}

/// The shortest paths, in edges, whose light comes from cones. Direct light is the walk's up to the lookup vertex, unless nested.
fn shortest_counted(settings: &PcfSettings) -> usize {
    match settings.lookup_vertex {
        LookupVertex::Fixed(k) if !settings.nested => k as usize + 1,
        _ => 2,
    }
}

/// Holds an estimate against the truth, and the test to its promise: were all that comes from cones off by the share `noticed`, it would fail.
fn check(scene: &Scene, truth: &[Vec<f64>], label: &str, noticed: f64, settings: &PcfSettings) {
    let estimate = by_length(scene, 2, ITERATIONS, |depth| {
        IntegratorSettings::Pcf(PcfSettings {
            max_depth: Some(depth),
            ..settings.clone()
        })
    });
    let counted = shortest_counted(settings);
    let truth = moments(truth, counted, 1.0);
    let compare = |factor: f64| ZTest::compare(&moments(&estimate, counted, factor), &truth, FALSE_ALARMS);
    let (test, less, more) = (compare(1.0), compare(1.0 - noticed), compare(1.0 + noticed));
    println!(
        "{label}: largest |z| {:.2} of {:.2}, {:.2} and {:.2} where cones are {noticed} off; noise {:.2} %",
        test.largest,
        test.threshold,
        less.largest,
        more.largest,
        100.0 * test.relative_noise,
    );
    assert!(test.passes(), "{label}: {test:?}");
    assert!(
        !less.passes() && !more.passes(),
        "{label}: the test has power: {less:?}, {more:?}"
    );
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
    let scene = load("diffuse-box");
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
            let noticed = match (samplers, k) {
                ([Bsdf], 1) => 0.3,
                ([Bsdf] | [Bsdf, Camera], 2) => 0.2,
                _ => NOTICED,
            };
            check(&scene, &truth, &format!("{samplers:?}, k = {k}"), noticed, &settings);
        }
    }
}

#[test]
fn each_lookup_vertex_counts_each_path_length_once() {
    let scene = load("mirror-glass");
    let truth = reference(&scene);
    for nested in [false, true] {
        for (label, noticed, settings) in [
            ("1", 0.1, fixed(1)),
            ("2", 0.25, fixed(2)),
            ("3", 0.2, fixed(3)),
            ("auto", 0.1, narrow()),
        ] {
            let settings = PcfSettings { nested, ..settings };
            let nested = if nested { ", nested" } else { "" };
            check(&scene, &truth, &format!("k = {label}{nested}"), noticed, &settings);
        }
    }
}

#[test]
fn kernels_and_tests_of_surfaces_agree_with_path_tracing() {
    let scene = load("mirror-glass");
    let truth = reference(&scene);
    let epanechnikov = PcfSettings {
        kernel: KernelShape::Epanechnikov,
        ..narrow()
    };
    check(&scene, &truth, "Epanechnikov", NOTICED, &epanechnikov);
    let by_length = PcfSettings {
        sigma_by_length: vec![0.5, 0.7, 1.0],
        ..narrow()
    };
    check(&scene, &truth, "sigma by length", NOTICED, &by_length);
    let glossy = PcfSettings {
        theta_glossy: 0.5,
        ..fixed(1)
    };
    check(&scene, &truth, "narrow on glossy surfaces", 0.25, &glossy);
    let surfaces = PcfSettings {
        surface_test: true,
        sigma1: Some(0.03),
        ..narrow()
    };
    check(&scene, &truth, "surface test", 0.1, &surfaces);
}
