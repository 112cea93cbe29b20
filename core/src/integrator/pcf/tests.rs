mod measure;
mod media;

use super::*;
use crate::integrator::test_scenes;
use crate::integrator::{Batches, Unobserved};
use crate::scene::Scene;
use crate::settings::{DirectionSampler, KernelShape};

fn render(scene: &Scene, settings: &PcfSettings, iteration: u32, culling: bool) -> Iteration {
    render_in(Batches::default(), scene, settings, iteration, culling)
}

fn render_in(batches: Batches, scene: &Scene, settings: &PcfSettings, iteration: u32, culling: bool) -> Iteration {
    let widths = settings.widths(scene, iteration);
    let job = Job {
        scene,
        at_rest: scene,
        seed: 5,
        iteration,
        sampling: settings.sampling,
        batches,
    };
    render_culling(&job, settings, widths, &Unobserved, culling).unwrap()
}

fn bits(image: &Iteration) -> Vec<[u32; 3]> {
    image.pixels.iter().map(|p| p.to_rgb().map(f32::to_bits)).collect()
}

#[test]
fn culling_changes_no_bit() {
    let all = vec![
        DirectionSampler::Bsdf,
        DirectionSampler::Camera,
        DirectionSampler::Importon,
    ];
    let base = PcfSettings {
        photons: 20_000,
        samples: 2,
        sigma1: Some(0.1),
        ..Default::default()
    };
    let cases = [
        base.clone(),
        PcfSettings {
            lookup_vertex: LookupVertex::Fixed(1),
            p: 2.0,
            ..base.clone()
        },
        PcfSettings {
            lookup_vertex: LookupVertex::Fixed(2),
            samplers: all.clone(),
            nested: true,
            theta_glossy: 0.5,
            ..base.clone()
        },
        PcfSettings {
            samplers: all,
            kernel: KernelShape::Epanechnikov,
            sigma_by_length: vec![0.5, 1.0],
            surface_test: true,
            theta1: 60.0,
            ..base
        },
    ];
    for name in ["mirror-glass", "environment"] {
        let scene = test_scenes::load(name, 24);
        for settings in &cases {
            for iteration in [1, 400] {
                let whole = render(&scene, settings, iteration, false);
                let culled = render(&scene, settings, iteration, true);
                assert!(
                    bits(&whole) == bits(&culled),
                    "{name}, iteration {iteration}: {settings:?}"
                );
                assert_eq!(whole.counts.records_counted, culled.counts.records_counted);
                assert!(
                    culled.counts.records_counted > 100,
                    "the map is read: {:?}",
                    culled.counts
                );
                assert!(culled.counts.records_stored < whole.counts.records_stored);
            }
        }
    }
}

/// Passes over the camera paths change no bit; batches of light paths, whose sums are added up, no more than rounding. Importons are
/// those of a pass, and guide cones in every pass another way.
#[test]
fn one_batch_or_several_make_one_image() {
    let scene = test_scenes::load("mirror-glass", 24);
    let whole = Batches::default();
    let camera_paths = 2 * 24 * 9;
    let passes = Batches { camera_paths, ..whole };
    let batches = Batches {
        light_paths: 3_001,
        ..whole
    };
    for settings in [
        PcfSettings {
            photons: 8_000,
            samples: 2,
            sigma1: Some(0.1),
            ..Default::default()
        },
        PcfSettings {
            photons: 8_000,
            samples: 2,
            sigma1: Some(0.1),
            lookup_vertex: LookupVertex::Fixed(2),
            nested: true,
            surface_test: true,
            sigma_by_length: vec![0.5, 1.0],
            ..Default::default()
        },
    ] {
        let one = render_in(whole, &scene, &settings, 3, true);
        let three_passes = render_in(passes, &scene, &settings, 3, true);
        let clipped = settings.surface_test;
        // The discs of a pass are numbered from its first query, so that the probes of surface tests differ.
        assert!(clipped || bits(&one) == bits(&three_passes));
        assert_eq!(
            three_passes.counts.light_paths,
            3 * 8_000,
            "each pass has all light paths"
        );
        assert_eq!(one.counts.records_counted, three_passes.counts.records_counted);
        let three_batches = render_in(batches, &scene, &settings, 3, true);
        assert_eq!(three_batches.counts.light_paths, 8_000);
        assert_eq!(one.counts.records_counted, three_batches.counts.records_counted);
        assert!(one.counts.records_counted > 1_000);
        for (a, b) in one.pixels.iter().zip(&three_batches.pixels) {
            let (a, b) = (a.luminance(), b.luminance());
            assert!((a - b).abs() <= 1e-5 * a, "{a} in one batch, {b} in three");
        }
    }
}
