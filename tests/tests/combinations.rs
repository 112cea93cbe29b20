//! Every combination of settings against a room whose radiance is known: each is right, or refused.
//!
//! The room is a furnace: a sphere that emits 1 and reflects half of what arrives shows the radiance 2 everywhere, and so do a
//! perfect mirror, a glossy one, and a lamp that emits 1 and reflects half. A plate of these three closes the room and is all that
//! the camera sees. Whatever counts a path twice or not at all, or loses directions, shows another value.
//!
//! Each combination is held against 2 by the mean of a few runs, with a standard error pooled over those that aim and look up alike;
//! then every value of a setting, and every pair of values, by the mean over all combinations that have it. The noisiest pair has a standard
//! error of 11 %: this notices light that is lost or counted twice; smaller shares are noticed by `techniques.rs`. Seeds are fixed, so a test that passes once passes always.

use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    DirectionSampler, IntegratorSettings, KernelShape, LookupVertex, PathSettings, PcfSettings, PppmSettings,
    SppmSettings,
};
use photonfarm_tests::render::{self, mean_luminance};
use photonfarm_tests::scenes::{self, View};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Radiance everywhere in the room.
const RADIANCE: f64 = 2.0;

/// Runs of each combination, of seeds of their own.
const RUNS: u64 = 2;

/// Share by which the kernels' bias may miss the truth: what lies below the horizon of a query is missing, and at the rim of the
/// plate the disc is bent.
const BIAS: f64 = 0.03;

/// Standard errors that a mean may miss the truth by: a normal variable exceeds 5 with probability 6e-7, and there are some 1500 means.
const DEVIATIONS: f64 = 5.0;

fn furnace() -> Scene {
    let strip = |from: f32, to: f32, inside: &str| {
        format!(
            r#"<shape type="rectangle">
                <transform name="to_world">
                    <scale x="{}" y="0.9" z="1"/><translate x="{}" y="0" z="-0.5"/>
                </transform>
                {inside}
            </shape>"#,
            0.5 * (to - from),
            0.5 * (to + from)
        )
    };
    let lamp = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>"#;
    let glossy = r#"<bsdf type="roughconductor"><float name="alpha" value="0.05"/></bsdf>"#;
    let objects = format!(
        r#"<shape type="sphere"><boolean name="flip_normals" value="true"/>{lamp}</shape>{}{}{}"#,
        strip(-0.9, -0.15, r#"<bsdf type="conductor"/>"#),
        strip(-0.15, 0.15, glossy),
        strip(0.15, 0.9, lamp),
    );
    let view = View {
        origin: "0, 0, 0.3",
        target: "0, 0, -1",
        up: "0, 1, 0",
        fov: 56.0,
        resolution: [6, 3],
    };
    scenes::seen(&view, &objects).expect("the scene loads")
}

/// Mean luminance of the last of `iterations` iterations over the truth.
fn ratio(scene: &Scene, settings: &IntegratorSettings, seed: u64, iterations: u32) -> f64 {
    let last = match settings.is_sequential() {
        true => render::iterations(scene, settings, seed, iterations).last(),
        false => Some(render_iteration(scene, settings, seed, iterations, &Unobserved)),
    };
    let image = last
        .expect("there is an iteration")
        .unwrap_or_else(|e| panic!("{settings:?}: {e}"));
    mean_luminance(&image.pixels) / RADIANCE
}

/// Mean of values and the sum of their squared deviations from it.
fn spread(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, values.iter().map(|value| (value - mean).powi(2)).sum())
}

/// A combination of settings, the number of the value of each, and what it showed.
struct Combination {
    settings: IntegratorSettings,
    values: Vec<usize>,
    /// Combinations of the same kind are about as noisy.
    kind: usize,
    ratios: Vec<f64>,
}

impl Combination {
    fn mean(&self) -> f64 {
        spread(&self.ratios).0
    }
}

/// Renders what the settings accept; what they refuse must be said by name.
fn measure(scene: &Scene, combinations: Vec<(IntegratorSettings, Vec<usize>, usize)>) -> Vec<Combination> {
    let numbered = combinations.into_par_iter().enumerate();
    let accepted = numbered.filter_map(|(index, (settings, values, kind))| {
        if let Err(refusal) = settings.validate() {
            assert!(!refusal.name.is_empty() && !refusal.expected.is_empty(), "{refusal}");
            return None;
        }
        // With the same seed combinations would share their photons, and means over them would not be as good as they seem.
        let seeds = (0..RUNS).map(|run| index as u64 * RUNS + run);
        let ratios = seeds.map(|seed| ratio(scene, &settings, seed, 2)).collect();
        Some(Combination {
            settings,
            values,
            kind,
            ratios,
        })
    });
    accepted.collect()
}

/// Squared standard error of the mean of one combination, by kind.
fn squared_errors(combinations: &[Combination]) -> BTreeMap<usize, f64> {
    let mut sums: BTreeMap<usize, (f64, f64)> = BTreeMap::new();
    for combination in combinations {
        let (squares, freedom) = sums.entry(combination.kind).or_default();
        *squares += spread(&combination.ratios).1;
        *freedom += (RUNS - 1) as f64;
    }
    sums.into_iter()
        .map(|(kind, (squares, freedom))| (kind, squares / freedom / RUNS as f64))
        .collect()
}

fn hold(label: &str, mean: f64, error: f64, failures: &mut Vec<String>) {
    let reach = BIAS + DEVIATIONS * error;
    if (mean - 1.0).abs() > reach {
        failures.push(format!("{label}: {mean:.4} +- {error:.4}"));
    }
}

/// Holds each combination, each value and each pair of values of different settings against the truth.
fn check(combinations: &[Combination]) {
    let errors = squared_errors(combinations);
    let mut failures = Vec::new();
    let mut groups: BTreeMap<[(usize, usize); 2], Vec<&Combination>> = BTreeMap::new();
    for combination in combinations {
        let label = format!("{:?}", combination.settings);
        hold(
            &label,
            combination.mean(),
            errors[&combination.kind].sqrt(),
            &mut failures,
        );
        let values = combination.values.iter().copied().enumerate();
        for a in values.clone() {
            for b in values.clone().filter(|b| a.0 <= b.0) {
                groups.entry([a, b]).or_default().push(combination);
            }
        }
    }
    let mut largest = (0.0_f64, 0.0_f64);
    for (pair, members) in &groups {
        let n = members.len() as f64;
        let mean = members.iter().map(|c| c.mean()).sum::<f64>() / n;
        let error = members.iter().map(|c| errors[&c.kind]).sum::<f64>().sqrt() / n;
        largest = (largest.0.max((mean - 1.0).abs()), largest.1.max(error));
        hold(&format!("settings {pair:?} of {n}"), mean, error, &mut failures);
    }
    println!(
        "{} combinations, {} groups: largest difference {:.2} %, largest error of a group {:.2} %",
        combinations.len(),
        groups.len(),
        100.0 * largest.0,
        100.0 * largest.1
    );
    assert!(failures.is_empty(), "{} fail:\n{}", failures.len(), failures.join("\n"));
}

/// All of some values, the last setting changing fastest.
fn product(sizes: &[usize]) -> Vec<Vec<usize>> {
    sizes.iter().fold(vec![Vec::new()], |all, size| {
        let extend = |values: &Vec<usize>| {
            let values = values.clone();
            (0..*size).map(move |value| [&values[..], &[value]].concat())
        };
        all.iter().flat_map(extend).collect()
    })
}

/// All combinations of what chooses another computation. Settings that change a number within it (`mis_beta`, `p`, `theta_glossy`) and those
/// shared with other integrators take turns, so that each meets each value of the others many times.
#[test]
fn every_combination_of_pcf_is_right_or_refused() {
    use DirectionSampler::{Bsdf, Camera, Importon};
    let samplers: [&[DirectionSampler]; 7] = [
        &[Bsdf],
        &[Camera],
        &[Importon],
        &[Bsdf, Camera],
        &[Bsdf, Importon],
        &[Camera, Importon],
        &[Bsdf, Camera, Importon],
    ];
    let lookups = [
        LookupVertex::Auto,
        LookupVertex::Fixed(1),
        LookupVertex::Fixed(2),
        LookupVertex::Fixed(3),
    ];
    let combinations = product(&[samplers.len(), lookups.len(), 2, 2, 2, 2]);
    let all = combinations.into_iter().enumerate().map(|(index, mut values)| {
        // Odd multipliers of their own for each setting that takes turns.
        let turn = |multiplier: usize| ((index * multiplier) >> 3) & 1;
        values.extend([3, 5, 7, 11, 13].map(turn));
        let on = |setting: usize| values[setting] == 1;
        let settings = PcfSettings {
            photons: 6_000,
            samples: 8,
            sigma1: Some(0.3),
            theta1: 18.0,
            samplers: samplers[values[0]].to_vec(),
            lookup_vertex: lookups[values[1]],
            nested: on(2),
            kernel: if on(3) {
                KernelShape::Epanechnikov
            } else {
                KernelShape::Box
            },
            sigma_by_length: if on(4) { vec![0.6, 0.8, 1.0] } else { Vec::new() },
            surface_test: on(5),
            sampling: if on(6) { Sampling::Independent } else { Sampling::Sobol },
            theta_glossy: if on(7) { 0.6 } else { 1.0 },
            mis_beta: if on(8) { 1.0 } else { 2.0 },
            p: if on(9) { 2.0 } else { 1.0 },
            max_depth: on(10).then_some(40),
            ..Default::default()
        };
        let kind = values[0] * lookups.len() + values[1];
        (IntegratorSettings::Pcf(settings), values, kind)
    });
    let measured = measure(&furnace(), all.collect());
    assert_eq!(measured.len(), 7 * 4 * 16, "nothing of this is refused");
    check(&measured);
}

#[test]
fn every_combination_of_the_other_integrators_is_right() {
    let all = product(&[3, 2, 2, 2, 2]).into_iter().map(|values| {
        let sampling = [Sampling::Sobol, Sampling::Independent][values[1]];
        let max_depth = [None, Some(40)][values[2]];
        let samples = [2, 7][values[3]];
        let photons = PppmSettings {
            photons: 4_000,
            samples,
            sampling,
            alpha: [0.3, 0.8][values[4]],
            sigma1: Some(0.3),
            max_depth,
            ..Default::default()
        };
        let settings = match values[0] {
            0 => IntegratorSettings::Path(PathSettings {
                samples: 100 * samples,
                sampling,
                max_depth,
            }),
            1 => IntegratorSettings::Pppm(photons),
            _ => IntegratorSettings::Sppm(SppmSettings(photons)),
        };
        let kind = values[0];
        (settings, values, kind)
    });
    check(&measure(&furnace(), all.collect()));
}
