//! Estimators in media against closed forms and against path tracing.

pub(in crate::integrator) mod measure;

use super::*;
use crate::integrator::{Batches, IntegratorSettings, Unobserved, render_iteration, render_next};
use crate::medium::tests::{agrees, estimate, narrow_camera, path, scene, scene_with, vol};
use crate::random::Sampling;
use crate::settings::SppmSettings;
use crate::spectrum::CHANNELS;

const KINDS: [MediaEstimator; 4] = [
    MediaEstimator::Points,
    MediaEstimator::Radiance,
    MediaEstimator::Beams,
    MediaEstimator::ShortBeams,
];

/// What kernels of the widths here blur, as a relative error: of smooth light it is far less.
const BLUR: f64 = 0.02;

fn settings(media: MediaEstimator, samples: u32, photons: u32, max_depth: Option<u32>) -> PppmSettings {
    PppmSettings {
        samples,
        photons,
        sampling: Sampling::Independent,
        sigma1: Some(0.05),
        media,
        max_depth,
        ..PppmSettings::default()
    }
}

const BEAMS: &[MediaEstimator] = &[MediaEstimator::Beams, MediaEstimator::ShortBeams];

fn pppm(media: MediaEstimator, samples: u32, photons: u32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Pppm(settings(media, samples, photons, max_depth))
}

/// The settings of a kind with which it has about the noise of the others in the scenes here.
fn with_effort(media: MediaEstimator, max_depth: Option<u32>) -> PppmSettings {
    let (samples, photons, radius) = match media {
        MediaEstimator::Points => (16, 60_000, 0.12),
        MediaEstimator::Radiance => (4, 30_000, 0.05),
        _ => (4, 10_000, 0.05),
    };
    PppmSettings {
        sigma1: Some(radius),
        ..settings(media, samples, photons, max_depth)
    }
}

/// Compares some kinds with path tracing of so many samples, by errors of less than a quarter. Here and below five standard errors are allowed, in some 150 means: a false alarm
/// has a probability below 1e-4.
fn agree(
    label: &str,
    scene: &Scene,
    samples: u32,
    max_depth: Option<u32>,
    (kinds, iterations): (&[MediaEstimator], u32),
) {
    let expected = estimate(scene, &path(samples, max_depth), 32);
    for media in kinds {
        let settings = IntegratorSettings::Pppm(with_effort(*media, max_depth));
        let found = estimate(scene, &settings, iterations);
        for channel in 0..CHANNELS {
            let (mean, error) = expected[channel];
            let label = format!("{label}, {media:?}, channel {channel}");
            let error = found[channel].1.hypot(error);
            assert!(
                error < 0.25 * mean,
                "{label}: {:?} and {:?}",
                found[channel],
                expected[channel]
            );
            agrees(&label, (found[channel].0, error), mean, BLUR);
        }
    }
}

/// Light of a point light that a medium which fills all space scatters once: the integral over the camera's ray of
/// `sigma_s p I / d^2` times what comes through.
#[test]
fn single_scattering_of_a_point_light_is_the_integral() {
    for g in [0.0, 0.6] {
        let scene = scene(&format!(
            "<medium id='fog' type='homogeneous'><rgb name='sigma_t' value='0.2 0.4 0.8'/><rgb name='albedo' value='0.9 0.5 0.3'/>\
             <phase type='hg'><float name='g' value='{g}'/></phase></medium>\
             {}<emitter type='point'><point name='position' x='1' y='0' z='2'/><rgb name='intensity' value='3'/></emitter>\
             <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='180'/><translate z='4'/></transform>\
             <bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf></shape>",
            narrow_camera("0 0 0").replace("<film", "<ref id='fog'/><film")
        ));
        let expected = |sigma_t: f64, albedo: f64| {
            let steps = 20_000;
            let step = 4.0 / f64::from(steps);
            let integrand = |t: f64| {
                let offset = [1.0, 2.0 - t];
                let distance = offset[0].hypot(offset[1]);
                let cosine = (2.0 - t) / distance;
                let phase =
                    (1.0 - g * g) / (4.0 * std::f64::consts::PI * (1.0_f64 + g * g - 2.0 * g * cosine).powf(1.5));
                albedo * sigma_t * phase * 3.0 / (distance * distance) * (-sigma_t * (t + distance)).exp()
            };
            (0..steps).map(|i| integrand((f64::from(i) + 0.5) * step)).sum::<f64>() * step
        };
        for media in KINDS {
            let found = estimate(&scene, &pppm(media, 16, 10_000, Some(2)), 20);
            for (channel, (sigma_t, albedo)) in [(0.2, 0.9), (0.4, 0.5), (0.8, 0.3)].into_iter().enumerate() {
                let label = format!("g = {g}, channel {channel}, {media:?}");
                agrees(&label, found[channel], expected(sigma_t, albedo), BLUR);
            }
        }
    }
}

/// A box on a floor whose inside is `medium`, with something in it that casts a shadow, lit by a lamp of some size from above.
pub(in crate::integrator) fn room(medium: &str) -> String {
    format!(
        "<sensor type='perspective'><float name='fov' value='32'/><transform name='to_world'>\
         <lookat origin='0.3, 0.4, -4' target='0, 0, 0' up='0, 1, 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='5'/><integer name='height' value='5'/><rfilter type='box'/></film></sensor>\
         <shape type='cube'><bsdf type='null'/>{medium}</shape>\
         <shape type='sphere'><point name='center' x='0.3' y='0.2' z='0'/><float name='radius' value='0.3'/>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0.8 0.5 0.2'/></bsdf></shape>\
         <shape type='rectangle'><transform name='to_world'><scale value='3'/><rotate x='1' angle='-90'/><translate y='-1.01'/></transform>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0.3 0.6 0.9'/></bsdf></shape>\
         <shape type='rectangle'><transform name='to_world'><scale value='0.4'/><rotate x='1' angle='90'/><translate y='1.4'/></transform>\
         <emitter type='area'><rgb name='radiance' value='10'/></emitter></shape>"
    )
}

const COLOURED: &str = "<medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0.5 1 2'/><rgb name='albedo' value='0.9 0.8 0.6'/>\
     <phase type='hg'><float name='g' value='0.9'/></phase></medium>";

#[test]
fn kinds_agree_with_path_tracing_behind_an_occluder() {
    let scene = scene(&room(COLOURED));
    agree("all paths", &scene, 64, None, (&KINDS, 24));
}

/// Each kind counts each sort of path once.
#[test]
fn each_sort_of_path_is_counted_once() {
    let mut scene = scene(&room(COLOURED));
    // Photons where light collides say little where few come by.
    for (expression, kinds, iterations) in [
        ("L V E", &KINDS[..], 24),
        ("L V V E", BEAMS, 24),
        ("L D V E", BEAMS, 120),
        ("L V D E", BEAMS, 24),
    ] {
        scene.paths = Some(expression.parse().unwrap());
        agree(expression, &scene, 128, Some(3), (kinds, iterations));
    }
}

/// A lattice of grey extinction and coloured albedo.
#[test]
fn kinds_agree_with_path_tracing_in_a_lattice() {
    let medium = "<medium name='interior' type='heterogeneous'><volume name='sigma_t' type='gridvolume'>\
         <string name='filename' value='sigma.vol'/><transform name='to_world'><translate value='-0.5 -0.5 -0.5'/><scale value='2'/></transform>\
         </volume><rgb name='albedo' value='0.9 0.7 0.4'/><float name='scale' value='2'/>\
         <phase type='hg'><float name='g' value='0.5'/></phase></medium>";
    let values = vol([12, 9, 17], |x, y, z| {
        if y > 6 { 0.0 } else { 0.1 * ((x + 2 * y + z) % 7) as f32 }
    });
    let scene = scene_with(&room(medium), &[("sigma.vol", values)]);
    agree("lattice", &scene, 64, None, (&KINDS, 24));
}

/// Light that a ball of glass gathers in fog, which no connection finds.
#[test]
fn a_volumetric_caustic_is_that_of_path_tracing() {
    let mut scene = scene(
        "<medium id='fog' type='homogeneous'><float name='sigma_t' value='0.5'/><float name='albedo' value='0.9'/></medium>\
         <sensor type='perspective'><float name='fov' value='30'/><ref id='fog'/><transform name='to_world'>\
         <lookat origin='0, 0, -3.5' target='0, -1.2, 0' up='0, 1, 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='3'/><integer name='height' value='3'/><rfilter type='box'/></film></sensor>\
         <shape type='sphere'><float name='radius' value='4.5'/><boolean name='flip_normals' value='true'/>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf><ref name='exterior' id='fog'/></shape>\
         <shape type='sphere'><float name='radius' value='0.8'/><bsdf type='dielectric'/><ref name='exterior' id='fog'/></shape>\
         <shape type='rectangle'><transform name='to_world'><scale value='1.5'/><rotate x='1' angle='90'/><translate y='2.5'/></transform>\
         <emitter type='area'><rgb name='radiance' value='10'/></emitter></shape>",
    );
    scene.paths = Some("L S+ V E".parse().unwrap());
    agree("caustic", &scene, 512, None, (BEAMS, 24));
}

/// A glowing slab without scattering has the radiance of the closed form, and one with a mirror behind it is seen twice.
#[test]
fn what_media_emit_is_seen_along_crossed_segments() {
    let medium = "<medium name='interior' type='homogeneous'><rgb name='sigma_t' value='0.5 1 3'/><float name='albedo' value='0'/>\
         <rgb name='emission' value='2 1 4'/></medium>";
    let scene = scene(&format!(
        "{}<emitter type='constant'><rgb name='radiance' value='1'/></emitter><shape type='cube'><bsdf type='null'/>{medium}</shape>",
        narrow_camera("0 0 -5")
    ));
    for media in KINDS {
        let found = estimate(&scene, &pppm(media, 4, 100, None), 2);
        for (channel, (sigma, emission)) in [(0.5, 2.0), (1.0, 1.0), (3.0_f64, 4.0)].into_iter().enumerate() {
            let through = (-2.0 * sigma).exp();
            let expected = emission * (1.0 - through) / sigma + through;
            agrees(&format!("{media:?}, channel {channel}"), found[channel], expected, 1e-4);
        }
    }
}

/// The chain of `sppm` finds the same.
#[test]
fn sppm_estimates_in_media_as_well() {
    let scene = scene(&room(COLOURED));
    let expected = estimate(&scene, &path(64, None), 32);
    for media in [MediaEstimator::Beams, MediaEstimator::Radiance] {
        let settings = IntegratorSettings::Sppm(SppmSettings(with_effort(media, None)));
        let mut before = Vec::new();
        let images: Vec<Spectrum> = (1..=32)
            .map(|iteration| {
                let image = render_next(&scene, &settings, 3, iteration, &before, &Unobserved).unwrap();
                before = image.statistics;
                Spectrum::average(image.pixels.into_iter())
            })
            .collect();
        for (channel, (expected, error)) in expected.into_iter().enumerate() {
            let values = || images.iter().map(|image| f64::from(image[channel]));
            let mean = values().sum::<f64>() / 32.0;
            let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / 31.0;
            let found = (mean, (variance / 32.0).sqrt().hypot(error));
            agrees(&format!("{media:?}, channel {channel}"), found, expected, BLUR);
        }
    }
}

/// An iteration is a pure function, whatever the number of threads, and batches change it by no more than rounding.
#[test]
fn threads_change_no_bit_and_batches_only_rounding() {
    let lattice = "<medium name='interior' type='heterogeneous'><volume name='sigma_t' type='gridvolume'>\
         <string name='filename' value='sigma.vol'/><transform name='to_world'><translate value='-0.5 -0.5 -0.5'/><scale value='2'/></transform>\
         </volume></medium>";
    let files = [("sigma.vol", vol([9, 9, 9], |x, y, z| 0.1 * ((x * y + z) % 5) as f32))];
    for medium in [COLOURED, lattice] {
        for media in KINDS {
            let settings = PppmSettings {
                sigma1: Some(0.3),
                ..settings(media, 2, 3_000, None)
            };
            let bits = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let settings = IntegratorSettings::Pppm(settings.clone());
                let image = pool.install(|| {
                    let scene = scene_with(&room(medium), &files);
                    render_iteration(&scene, &settings, 42, 3, &Unobserved).unwrap()
                });
                let channels = image.pixels.iter().flat_map(|pixel| pixel.channels());
                (channels.map(f32::to_bits).collect::<Vec<_>>(), image.counts)
            };
            let one = bits(1);
            assert!(one.1.records_counted > 100, "{:?}", one.1);
            assert!(
                bits(2) == one && bits(7) == one,
                "{media:?}: other bits with other threads"
            );

            let scene = scene_with(&room(medium), &files);
            let gather = |light_paths| {
                let job = Job {
                    scene: &scene,
                    at_rest: &scene,
                    seed: 5,
                    iteration: 3,
                    sampling: Sampling::Sobol,
                    batches: Batches {
                        light_paths,
                        light_paths_of_beams: light_paths,
                        ..Default::default()
                    },
                };
                crate::integrator::pppm::render(&job, &settings, 0.1, &Unobserved).unwrap()
            };
            let (all, three) = (gather(1 << 20), gather(1_001));
            assert_eq!(all.counts.records_counted, three.counts.records_counted, "{media:?}");
            for (a, b) in all.pixels.iter().zip(&three.pixels) {
                let (a, b) = (a.luminance(), b.luminance());
                assert!((a - b).abs() <= 1e-5 * a, "{media:?}: {a} in one batch, {b} in three");
            }
        }
    }
}
