//! How wide the kernels of an iteration are.

use super::GLOSSY_ROUGHNESS;
use crate::density::schedule;
use crate::geometry::Ray;
use crate::material::TransportMode;
use crate::math::Vec2;
use crate::path::{Tracer, Vertex};
use crate::random::{PathRandom, Stream};
use crate::scene::Scene;
use crate::settings::{IntegratorSettings, PppmSettings};

/// Kernel sizes of an iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bandwidth {
    /// Radius of the disc in which photons or cones count [scene units].
    pub sigma: f32,
    /// Half angle within which cones count \[radians\]; pi, every direction, for photons.
    pub theta: f32,
}

/// Kernel sizes of iteration `iteration` (1, 2, ...), of `sppm` those of its first; `None` for an integrator without kernels.
///
/// A `sigma1` that the settings leave open is [`automatic_sigma1`].
#[must_use]
pub fn bandwidth(scene: &Scene, settings: &IntegratorSettings, iteration: u32) -> Option<Bandwidth> {
    settings.estimator().bandwidth(scene, iteration)
}

impl Bandwidth {
    /// Photons count within a radius [scene units], whatever their direction.
    pub(super) fn of_photons(radius: f32) -> Self {
        Self {
            sigma: radius,
            theta: std::f32::consts::PI,
        }
    }
}

/// The first radius [scene units]: `sigma1`, or else one for `photons` light paths.
pub(super) fn first_radius(scene: &Scene, sigma1: Option<f32>, photons: u32) -> f32 {
    sigma1.unwrap_or_else(|| automatic_sigma1(scene, photons))
}

/// Radius of a disc that shrinks as that of `pppm`, in iteration `iteration` (1, 2, ...) [scene units].
pub(super) fn shrinking_radius(scene: &Scene, sigma1: Option<f32>, photons: u32, alpha: f32, iteration: u32) -> f32 {
    let ratio = schedule::pppm_radius_ratio(iteration, f64::from(alpha));
    (f64::from(first_radius(scene, sigma1, photons)) * ratio) as f32
}

/// The first radius of kernels over `dimensions` in media \[scene units\]: `sigma1`, or else one for `photons` light paths.
pub(super) fn first_radius_in_media(scene: &Scene, sigma1: Option<f32>, photons: u32, dimensions: u32) -> f32 {
    sigma1.unwrap_or_else(|| automatic_radius(scene, photons, dimensions))
}

/// Radius of the kernels over `dimensions` (1, 2 or 3) in which records in media count, in iteration `iteration` (1, 2, ...) \[scene units\].
pub(super) fn media_radius(scene: &Scene, settings: &PppmSettings, iteration: u32, dimensions: u32) -> f32 {
    let first = first_radius_in_media(scene, settings.sigma1, settings.photons, dimensions);
    let ratio = schedule::radius_ratio(iteration, f64::from(settings.alpha), dimensions);
    (f64::from(first) * ratio) as f32
}

/// Records that the first disc would hold if the light paths of an iteration ended evenly over what the camera sees.
const RECORDS_IN_FIRST_DISC: f32 = 10.0;

/// Rays per side of the grid of probes through the image.
const PROBES: u32 = 24;

/// Specular bounces that a probe follows.
const PROBE_EDGES: u32 = 16;

/// A first bandwidth from the scene and the pixel footprint [scene units].
///
/// Probes through the image, a fixed grid of them, follow specular surfaces to the first rough one; the median of the
/// pixel's footprint over their lengths, times the number of pixels, stands for the area in view. The disc is as large
/// as holds [`RECORDS_IN_FIRST_DISC`] of the iteration's `photons` spread over that area, and at least one pixel.
///
/// Where the picture is a window of a film it is that of the whole film, so that the window shows what the whole film would.
fn automatic_sigma1(scene: &Scene, photons: u32) -> f32 {
    automatic_radius(scene, photons, 2)
}

/// As [`automatic_sigma1`], for a kernel over `dimensions`: a ball holds as many of the records that are spread over the cube on that area, and a strip of the
/// area of that width meets as many of the beams through the cube.
fn automatic_radius(scene: &Scene, photons: u32, dimensions: u32) -> f32 {
    let sensor = scene.whole.as_deref().unwrap_or(&scene.sensor);
    let [width, height] = sensor.resolution;
    let mut footprints: Vec<f32> = (0..PROBES * PROBES)
        .filter_map(|probe| {
            let cell = Vec2::new((probe % PROBES) as f32 + 0.5, (probe / PROBES) as f32 + 0.5) / PROBES as f32;
            let ray = match &scene.whole {
                Some(whole) => whole.ray(cell * Vec2::new(width as f32, height as f32), Vec2::splat(0.5)),
                None => {
                    scene
                        .camera_ray(cell * Vec2::new(width as f32, height as f32), Vec2::splat(0.5))
                        .ray
                }
            };
            probe_distance(scene, ray, probe)
        })
        .map(|distance| sensor.pixel_footprint(distance))
        .collect();
    footprints.sort_unstable_by(f32::total_cmp);
    let (low, high) = scene.geometry.bounds();
    let nothing_seen = sensor.pixel_footprint((high - low).length());
    let footprint = footprints.get(footprints.len() / 2).copied().unwrap_or(nothing_seen);
    let pixels = width as f32 * height as f32;
    let photons = photons as f32;
    // Radius over the edge of the area in view.
    let radius = match dimensions {
        1 => RECORDS_IN_FIRST_DISC / (2.0 * photons) * pixels.sqrt(),
        2 => (RECORDS_IN_FIRST_DISC * pixels / (std::f32::consts::PI * photons)).sqrt(),
        _ => {
            libm::cbrt(f64::from(
                0.75 * RECORDS_IN_FIRST_DISC / (std::f32::consts::PI * photons),
            )) as f32
                * pixels.sqrt()
        }
    };
    let sigma1 = footprint * radius.max(1.0);
    // A scene without shapes has no size, and no photon to count.
    if sigma1 > 0.0 { sigma1 } else { 1.0 }
}

/// Length of the path that begins with a ray of the camera to the first surface that is not specular or glossy.
fn probe_distance(scene: &Scene, mut ray: Ray, probe: u32) -> Option<f32> {
    let mut random = PathRandom::new(0, 0, Stream::Probe, u64::from(probe));
    let mut tracer = Tracer::new(scene);
    let mut distance = 0.0;
    for _ in 0..PROBE_EDGES {
        let point = tracer.intersect(&ray)?;
        distance += point.distance;
        let vertex = Vertex::new(scene, point, -ray.direction, TransportMode::Radiance);
        if !vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            return Some(distance);
        }
        ray = point.ray_towards(vertex.sample(&mut random)?.wi);
    }
    None
}
