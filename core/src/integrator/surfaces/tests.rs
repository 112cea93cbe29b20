//! Photon surfaces against path tracing, for each kind of path and each technique by itself.

use crate::integrator::{IntegratorSettings, Unobserved, render_iteration};
use crate::random::Sampling;
use crate::scene::{Limits, Scene};
use crate::settings::{PathSettings, SurfaceKind, SurfacesSettings, Weights};
use crate::spectrum::{CHANNELS, Spectrum};
use SurfaceKind::{Cones, Connections, Cylinders, Discs, Planes, Spheres};
use std::collections::BTreeMap;

/// A z-value beyond which a test fails: with fewer than 200 means a false alarm has a probability below 200 x 6e-7 = 1.2e-4, if they were
/// normal. Those of one technique alone have heavier tails.
const Z: f64 = 5.0;

/// Mean cosines of scattering.
const FORWARD: f32 = 0.9;
const EVENLY: f32 = 0.1;

/// Fog of coloured extinction, with `g` as the mean cosine of scattering, in a cube of an index as the air's, with an occluder and a floor.
fn scene(paths: &str, g: f32) -> Scene {
    let text = format!(
        "<scene version='3.0.0'>\
        <medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.4 0.6 0.9'/><rgb name='albedo' value='0.9 0.8 0.7'/>\
        <phase type='hg'><float name='g' value='{g}'/></phase></medium>\
        <sensor type='perspective'><float name='fov' value='30'/><transform name='to_world'>\
        <lookat origin='0, 0, -5' target='0, 0, 0' up='0, 1, 0'/></transform>\
        <film type='hdrfilm'><integer name='width' value='4'/><integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
        <shape type='cube'><bsdf type='null'/><ref name='interior' id='fog'/></shape>\
        <shape type='rectangle'><transform name='to_world'><scale value='3'/><rotate x='1' angle='-90'/><translate y='-1.2'/></transform>\
        <bsdf type='diffuse'/></shape>\
        <shape type='sphere'><point name='center' x='0.3' y='0.5' z='-0.3'/><float name='radius' value='0.2'/></shape>\
        <shape type='rectangle'><transform name='to_world'><scale value='0.5'/><rotate x='1' angle='120'/><translate y='1.6' z='0.6'/></transform>\
        <emitter type='area'><rgb name='radiance' value='9 8 7'/></emitter></shape></scene>"
    );
    let files = BTreeMap::from([("main.xml".to_owned(), text.as_bytes().to_vec())]);
    let mut scene = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    scene.paths = Some(paths.parse().unwrap());
    scene
}

fn path() -> IntegratorSettings {
    IntegratorSettings::Path(PathSettings {
        samples: 128,
        sampling: Sampling::Independent,
        max_depth: Some(6),
    })
}

fn surfaces(used: &[SurfaceKind], weights: Weights) -> IntegratorSettings {
    IntegratorSettings::Surfaces(SurfacesSettings {
        photons: 200,
        samples: 1,
        sampling: Sampling::Independent,
        surfaces: used.to_vec(),
        weights,
        max_depth: Some(6),
    })
}

/// The mean over pixels of each channel, and its standard error over iterations.
fn estimate(scene: &Scene, settings: &IntegratorSettings, iterations: u32) -> [(f64, f64); CHANNELS] {
    let images: Vec<Spectrum> = (1..=iterations)
        .map(|iteration| {
            let pixels = render_iteration(scene, settings, 3, iteration, &Unobserved)
                .unwrap()
                .pixels;
            Spectrum::average(pixels.into_iter())
        })
        .collect();
    std::array::from_fn(|channel| {
        let values: Vec<f64> = images.iter().map(|image| f64::from(image[channel])).collect();
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (count - 1.0);
        (mean, (variance / count).sqrt())
    })
}

fn compare(paths: &str, g: f32, techniques: &[&[SurfaceKind]]) {
    let scene = scene(paths, g);
    let expected = estimate(&scene, &path(), 256);
    for used in techniques {
        for weights in [Weights::Average, Weights::Balance] {
            if used.len() == 1 && weights == Weights::Balance {
                continue;
            }
            let found = estimate(&scene, &surfaces(used, weights), 200);
            for channel in 0..CHANNELS {
                let ((mean, error), (wanted, its)) = (found[channel], expected[channel]);
                println!(
                    "{paths} {used:?} {weights:?} {channel}: {mean:.6} +- {error:.6}, path {wanted:.6} +- {its:.6}"
                );
                assert!(
                    (mean - wanted).abs() < Z * error.hypot(its),
                    "{paths} {used:?} {weights:?} {channel}: {mean} +- {error}, not {wanted} +- {its}"
                );
                assert!(error < 0.2 * mean, "{paths} {used:?}: {mean} +- {error} says nothing");
            }
        }
    }
}

/// All of them.
const EVERY: [SurfaceKind; 6] = [Planes, Spheres, Cones, Cylinders, Discs, Connections];

/// Those that find light which was scattered twice, each by itself. Connections by themselves say little where media scatter forward.
const ONE_BY_ONE: [&[SurfaceKind]; 6] = [&[Planes], &[Spheres], &[Cones], &[Cylinders], &[Discs], &EVERY];

#[test]
fn light_scattered_once_comes_from_lights() {
    let all = [Spheres, Cones, Connections];
    compare("L V E", FORWARD, &[&[Connections], &[Spheres], &[Cones], &all]);
}

#[test]
fn light_scattered_once_comes_from_surfaces() {
    let all = [Spheres, Cones, Connections];
    compare("L D V E", FORWARD, &[&[Spheres], &[Cones], &all]);
    compare("L D V E", EVENLY, &[&[Connections]]);
}

#[test]
fn light_scattered_twice_comes_from_lights() {
    compare("L V V E", FORWARD, &ONE_BY_ONE);
    compare("L V V E", EVENLY, &[&[Connections], &EVERY]);
}

#[test]
fn light_scattered_three_times_comes_from_anywhere() {
    compare("L V V V E", FORWARD, &ONE_BY_ONE);
    compare("L V V V E", EVENLY, &[&[Connections], &EVERY]);
}

/// All light at once.
#[test]
fn all_light_is_counted_once() {
    compare("L .* E", FORWARD, &[&[Spheres, Cones, Connections], &EVERY]);
}
