//! An iteration is a pure function: the same bits with any number of threads and on any run.

mod scenes;

use photonfarm_core::integrator::{INTEGRATORS, Unobserved, render_iteration, render_next};
use photonfarm_core::scene::{Limits, Scene};
use photonfarm_core::settings::{IntegratorSettings, LookupVertex, PcfSettings, PppmSettings, SppmSettings};
use photonfarm_core::spectrum::Spectrum;
use std::collections::BTreeMap;

/// Pixels across and down.
const SIZE: u32 = 24;

/// The bits of iteration 3, on a scene built and rendered with `threads` threads.
fn bits(name: &str, settings: &IntegratorSettings, threads: usize) -> Vec<[u32; 3]> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let image = pool
        .install(|| render_iteration(&scenes::named(name, SIZE), settings, 42, 3, &Unobserved))
        .unwrap();
    image.pixels.iter().map(|p| p.to_rgb().map(f32::to_bits)).collect()
}

fn check(settings: &IntegratorSettings) {
    for scene in ["mirror-glass", "environment", "motion", "media"] {
        let one = bits(scene, settings, 1);
        assert!(
            one.iter().any(|p| p.iter().any(|c| *c != 0)),
            "{scene} by {}: the image is not black",
            settings.name()
        );
        for threads in [1, 2, 7] {
            assert!(
                bits(scene, settings, threads) == one,
                "{scene} by {}: other bits with {threads} threads",
                settings.name()
            );
        }
    }
}

#[test]
fn every_integrator_has_the_same_bits_with_any_number_of_threads() {
    for integrator in INTEGRATORS.into_iter().filter(|it| it.statistics_per_pixel == 0) {
        let photons = integrator.setting("photons");
        // A ray crosses much of what light paths sweep out.
        let count = if integrator.name == "surfaces" { 200 } else { 30_000 };
        let given = photons.map(|setting| (setting.name.to_owned(), count.into()));
        check(&integrator.read(given.into_iter().collect()).unwrap());
    }
}

/// A sky without anything below it is the same in every pixel.
#[test]
fn a_sky_alone_is_rendered_by_every_integrator() {
    let xml = "<scene version='3.0.0'><sensor type='perspective'><film type='hdrfilm'><integer name='width' value='8'/>\
        <integer name='height' value='8'/></film></sensor>\
        <emitter type='constant'><rgb name='radiance' value='0.5'/></emitter></scene>";
    let files = BTreeMap::from([("sky.xml".to_owned(), xml.as_bytes().to_vec())]);
    let scene = Scene::load(&files, "sky.xml", &BTreeMap::new(), &Limits::default()).unwrap();
    for integrator in INTEGRATORS {
        let settings = integrator.read(Default::default()).unwrap();
        let pixels = render_next(&scene, &settings, 1, 1, &[], &Unobserved).unwrap().pixels;
        let even = |pixel: &Spectrum| pixel.to_rgb().iter().all(|value| (value - 0.5).abs() < 1e-6);
        assert!(pixels.iter().all(even), "{}: {:?}", integrator.name, pixels[0]);
    }
}

#[test]
fn an_sppm_chain_has_the_same_bits_with_any_number_of_threads_and_wherever_it_is_cut() {
    let settings = IntegratorSettings::Sppm(SppmSettings(PppmSettings {
        photons: 10_000,
        ..Default::default()
    }));
    for scene in ["mirror-glass", "motion", "media"] {
        check_chain(&scenes::named(scene, SIZE), &settings);
    }
}

fn check_chain(scene: &Scene, settings: &IntegratorSettings) {
    let chain = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut before = Vec::new();
        let iterations = (1..=3).map(|i| {
            let next = || render_next(scene, settings, 42, i, &before, &Unobserved).unwrap();
            let image = pool.install(next);
            before = image.statistics.clone();
            let pixels = image.pixels.iter().flat_map(|p| p.to_rgb());
            pixels.chain(image.statistics).map(f32::to_bits).collect::<Vec<_>>()
        });
        iterations.collect::<Vec<_>>()
    };
    let one = chain(1);
    assert!(one[0] != one[1] && chain(2) == one && chain(7) == one);
}

#[test]
fn pcf_at_the_first_vertex_has_the_same_bits_with_any_number_of_threads() {
    check(&IntegratorSettings::Pcf(PcfSettings {
        photons: 30_000,
        lookup_vertex: LookupVertex::Fixed(1),
        ..Default::default()
    }));
}
