//! Cones in media against path tracing, and against photons there.

use super::*;
use crate::integrator::media::tests::room;
use crate::integrator::{IntegratorSettings, render_iteration};
use crate::medium::tests::{estimate, path, scene, scene_with, vol};
use crate::random::Sampling;
use crate::settings::{MediaEstimator, PppmSettings};
use crate::spectrum::CHANNELS;

const COLOURED: &str = "<medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0.5 1 2'/><rgb name='albedo' value='0.9 0.8 0.6'/>\
     <phase type='hg'><float name='g' value='0.4'/></phase></medium>";

/// A z-value beyond which a test fails: with fewer than 100 means, there is a false alarm with a probability below 1e-4.
const Z: f64 = 5.0;

fn cones(sigma1: f32, theta1: f32) -> PcfSettings {
    PcfSettings {
        samples: 64,
        photons: 8_000,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        theta1,
        media: ConesInMedia::Cones,
        ..Default::default()
    }
}

/// Compares cones with path tracing, up to the noise and twice what doubling the widths changes: a bias of the first order, as at the borders of media, where balls reach out of
/// them, is what that adds; one of the second order is a third of it, and may hide half of the other.
fn agree(label: &str, scene: &Scene, change: impl Fn(&mut PcfSettings)) {
    let settings = |factor: f32| {
        let mut settings = cones(0.12 * factor, 8.0 * factor);
        change(&mut settings);
        settings
    };
    let max_depth = settings(1.0).max_depth;
    let expected = estimate(scene, &path(64, max_depth), 32);
    let [narrow, wide] = [1.0, 2.0].map(|factor| estimate(scene, &IntegratorSettings::Pcf(settings(factor)), 16));
    for channel in 0..CHANNELS {
        let (mean, error) = narrow[channel];
        let blur = (wide[channel].0 - mean).abs();
        let (expected, of_expected) = expected[channel];
        let error = error.hypot(of_expected);
        let label = format!("{label}, channel {channel}: {mean} +- {error}, blur {blur}, not {expected}");
        assert!(error < 0.1 * expected && blur < 0.15 * expected, "{label}");
        assert!((mean - expected).abs() < Z * error + 2.0 * blur, "{label}");
    }
}

#[test]
fn cones_agree_with_path_tracing() {
    agree("room", &scene(&room(COLOURED)), |_| {});
}

/// A lattice in fog: cones of one medium do not count in the other.
#[test]
fn cones_agree_with_path_tracing_in_two_media() {
    let medium = "<medium name='interior' type='heterogeneous'><volume name='sigma_t' type='gridvolume'>\
         <string name='filename' value='sigma.vol'/><transform name='to_world'><translate value='-0.5 -0.5 -0.5'/><scale value='2'/></transform>\
         </volume><rgb name='albedo' value='0.9 0.7 0.4'/><float name='scale' value='2'/>\
         <phase type='hg'><float name='g' value='0.5'/></phase></medium>";
    let values = vol([12, 9, 17], |x, y, z| {
        if y > 6 { 0.0 } else { 0.1 * ((x + 2 * y + z) % 7) as f32 }
    });
    let fog = "<medium id='fog' type='homogeneous'><float name='sigma_t' value='0.1'/><float name='albedo' value='0.9'/></medium>";
    let body = format!("{fog}{}", room(&format!("{medium}<ref name='exterior' id='fog'/>")))
        .replace("<film", "<ref id='fog'/><film");
    agree("lattice in fog", &scene_with(&body, &[("sigma.vol", values)]), |_| {});
}

/// Each sort of path is counted once.
#[test]
fn each_sort_of_path_is_counted_once() {
    let mut scene = scene(&room(COLOURED));
    for expression in ["L V E", "L D V E", "L V D E"] {
        scene.paths = Some(expression.parse().unwrap());
        agree(expression, &scene, |settings| {
            settings.max_depth = Some(3);
            settings.lookup_vertex = LookupVertex::Fixed(1);
        });
    }
}

/// Paths that end before the lookup vertex, in media and on surfaces, are counted once too.
#[test]
fn a_later_lookup_vertex_agrees_with_path_tracing() {
    let scene = scene(&room(COLOURED));
    for nested in [false, true] {
        agree(&format!("nested: {nested}"), &scene, |settings| {
            settings.lookup_vertex = LookupVertex::Fixed(2);
            settings.nested = nested;
            settings.max_depth = Some(4);
        });
    }
}

/// A cone of all directions forgets the phase function: light that is scattered once is that of photons in a ball in a medium that scatters evenly, to rounding.
#[test]
fn cones_of_all_directions_are_photons_of_an_isotropic_medium() {
    let fog = |g: f32| {
        let medium = format!(
            "<medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0.5 1 2'/><rgb name='albedo' value='0.9 0.8 0.6'/>\
             <phase type='hg'><float name='g' value='{g}'/></phase></medium>"
        );
        let mut scene = scene(&room(&medium));
        scene.paths = Some("L V E".parse().unwrap());
        scene
    };
    let image = |scene: &Scene, settings| render_iteration(scene, &settings, 7, 1, &Unobserved).unwrap();
    let photons = image(
        &fog(0.0),
        IntegratorSettings::Pppm(PppmSettings {
            samples: 64,
            photons: 8_000,
            sampling: Sampling::Independent,
            sigma1: Some(0.2),
            media: MediaEstimator::Points,
            max_depth: Some(2),
            ..Default::default()
        }),
    );
    for g in [0.0, 0.6] {
        let all = PcfSettings {
            samplers: vec![DirectionSampler::Bsdf],
            max_depth: Some(2),
            ..cones(0.2, 180.0)
        };
        let found = image(&fog(g), IntegratorSettings::Pcf(all));
        assert!(found.counts.records_counted > 5_000, "{:?}", found.counts);
        for (found, expected) in found.pixels.iter().zip(&photons.pixels) {
            for channel in 0..CHANNELS {
                let (found, expected) = (found[channel], expected[channel]);
                assert!(
                    (found - expected).abs() <= 1e-4 * expected,
                    "g = {g}: {found}, not {expected}"
                );
            }
        }
    }
}

/// An iteration is a pure function, whatever the number of threads; cones that no query counts change no bit, and batches no more than rounding.
#[test]
fn threads_and_culling_change_no_bit_and_batches_only_rounding() {
    let fog = "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.1 0.2 0.3'/></medium>";
    let body = format!("{fog}{}", room(&format!("{COLOURED}<ref name='exterior' id='fog'/>")));
    let scene = scene(&body.replace("<film", "<ref id='fog'/><film"));
    let all = vec![
        DirectionSampler::Bsdf,
        DirectionSampler::Camera,
        DirectionSampler::Importon,
    ];
    for settings in [
        PcfSettings {
            photons: 4_000,
            ..cones(0.3, 18.0)
        },
        PcfSettings {
            photons: 4_000,
            lookup_vertex: LookupVertex::Fixed(2),
            samplers: all,
            nested: true,
            kernel: KernelShape::Epanechnikov,
            sigma_by_length: vec![0.7, 1.0],
            surface_test: true,
            ..cones(0.4, 40.0)
        },
    ] {
        let on_threads = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| render(&scene, &settings, 3, true))
        };
        let one = on_threads(1);
        assert!(one.counts.records_counted > 1_000, "{:?}", one.counts);
        for threads in [2, 7] {
            let other = on_threads(threads);
            assert!(bits(&other) == bits(&one), "{threads} threads: {settings:?}");
            assert_eq!(other.counts, one.counts);
        }
        let whole = render(&scene, &settings, 3, false);
        assert!(bits(&whole) == bits(&one), "without culling: {settings:?}");
        assert!(one.counts.records_stored < whole.counts.records_stored);
        let batches = Batches {
            light_paths: 1_001,
            ..Default::default()
        };
        let in_batches = render_in(batches, &scene, &settings, 3, true);
        assert_eq!(one.counts.records_counted, in_batches.counts.records_counted);
        for (a, b) in one.pixels.iter().zip(&in_batches.pixels) {
            let (a, b) = (a.luminance(), b.luminance());
            assert!((a - b).abs() <= 1e-5 * a, "{a} in one batch, {b} in four");
        }
    }
}

/// Without media the setting says nothing.
#[test]
fn without_media_cones_are_as_paths() {
    let scene = test_scenes::load("mirror-glass", 16);
    let image = |media| {
        let settings = PcfSettings {
            photons: 2_000,
            samples: 1,
            media,
            ..Default::default()
        };
        render(&scene, &settings, 2, true)
    };
    let [paths, cones] = [ConesInMedia::Paths, ConesInMedia::Cones].map(image);
    assert!(bits(&paths) == bits(&cones));
}
