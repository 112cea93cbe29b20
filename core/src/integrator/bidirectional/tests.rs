use super::*;
use crate::integrator::Sample;
use crate::integrator::light_paths;
use crate::integrator::test_scenes;
use crate::integrator::{Batches, Unobserved};
use crate::math::Vec2;
use crate::path::Tracer;
use crate::random::{PathRandom, Sampling, Stream};
use crate::scene::Scene;

fn job(scene: &Scene, sampling: Sampling) -> Job<'_> {
    Job {
        scene,
        at_rest: scene,
        seed: 4,
        iteration: 2,
        sampling,
        batches: Batches::default(),
    }
}

fn plan(techniques: Techniques, only: Option<Only>) -> Plan {
    Plan {
        light_paths: 5_000,
        samples: 3,
        max_edges: 4,
        techniques,
        radius: Some(0.1),
        only,
    }
}

fn image(scene: &Scene, techniques: Techniques, only: Option<Only>) -> Vec<Spectrum> {
    render(&job(scene, Sampling::Sobol), plan(techniques, only), &Unobserved)
        .unwrap()
        .pixels
}

/// What the techniques show one by one, each with its share, adds up to what they show together.
#[test]
fn techniques_one_by_one_add_up_to_all() {
    let scene = test_scenes::load("mirror-glass", 16);
    let connections = Techniques {
        merge: false,
        ..Techniques::ALL
    };
    let all = image(&scene, connections, None);
    let mut sums = vec![Spectrum::ZERO; all.len()];
    for vertices in 2..=5 {
        for s in 0..=vertices {
            let only = Only {
                s: Some(s),
                t: Some(vertices - s),
                weighted: true,
            };
            for (sum, pixel) in sums.iter_mut().zip(image(&scene, connections, Some(only))) {
                *sum += pixel;
            }
        }
    }
    for (pixel, (sum, all)) in sums.iter().zip(&all).enumerate() {
        let (sum, all) = (sum.luminance(), all.luminance());
        assert!(
            (sum - all).abs() <= 1e-4 * all.max(1e-3),
            "pixel {pixel}: {sum}, not {all}"
        );
    }
}

/// A path that is driven by the numbers written down of another one is that path, to the last bit.
#[test]
fn paths_replayed_from_recorded_numbers_have_the_same_bits() {
    let scene = test_scenes::load("mirror-glass", 16);
    for sampling in [Sampling::Sobol, Sampling::Independent] {
        let job = job(&scene, sampling);
        let estimator = Estimator::new(&job, plan(Techniques::ALL, None));
        let light = estimator.trace_light(&Unobserved, &mut Counts::default()).unwrap();
        let camera = |pixel: usize, random: &mut PathRandom| {
            let place = Vec2::new((pixel % 16) as f32, (pixel / 16) as f32) + random.next_2d();
            let (mut tracer, mut merges) = (Tracer::new(&scene), Vec::new());
            let sample = Sample {
                tracer: &mut tracer,
                camera: scene.camera_ray(place, random.next_2d()),
                random,
                pixel,
                in_picture: pixel,
                index: 1,
            };
            let radiance = estimator.radiance(sample, &light, &mut merges);
            let carried = merges.iter().map(|query| query.end.vertex.beta);
            let spectra: Vec<_> = [radiance].into_iter().chain(carried).collect();
            (
                spectra.iter().map(|s| s.to_rgb().map(f32::to_bits)).collect::<Vec<_>>(),
                tracer.rays,
            )
        };
        let light_path = |path: u32, random: &mut PathRandom| {
            let mut tracer = Tracer::new(&scene);
            let mut out = light::Chunk::default();
            if let Some(start) = light_paths::start(&mut tracer, random) {
                estimator.trace_light_path(&mut tracer, path, &start, random, &mut out);
            }
            let flux = |end: &End| end.vertex.beta.to_rgb().map(f32::to_bits);
            (out.vertices().iter().map(flux).collect::<Vec<_>>(), tracer.rays)
        };
        let mut vertices = 0;
        for number in 0..256 {
            let sequence = sampling.sequence(4, 2, Stream::Camera, number, 3);
            let mut random = sequence.path(1);
            let seen = camera(number as usize, &mut random);
            let mut again = sequence.path(2).replay(&random.recorded());
            assert_eq!(camera(number as usize, &mut again), seen, "camera path {number}");

            let sequence = job.light_sequence(5_000);
            let mut random = sequence.path(number as u32);
            let seen = light_path(number as u32, &mut random);
            vertices += seen.0.len();
            let mut again = sequence.path(4_000).replay(&random.recorded());
            assert_eq!(light_path(number as u32, &mut again), seen, "light path {number}");
        }
        assert!(vertices > 256, "light paths have vertices");
    }
}
