//! Integrators: one file each, and the one function that the farm calls.

mod bandwidth;
mod camera_path;
mod cone_sampler;
mod light_path;
mod path;
mod pcf;
mod pppm;
mod vertex;

pub use bandwidth::{Bandwidth, bandwidth};

use crate::geometry::Ray;
use crate::math::Vec2;
use crate::random::{PathRandom, Stream};
use crate::scene::Scene;
use crate::settings::{IntegratorSettings, SettingError};
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use thiserror::Error;
use vertex::Tracer;

/// Microfacet roughness below which a surface is too glossy for a density estimate: camera paths walk on instead.
/// A lobe of roughness 0.1 has a peak of some 30 times the diffuse one, which a disc of ten photons cannot resolve.
pub const GLOSSY_ROUGHNESS: f32 = 0.1;

/// Watches an iteration. The renderer keeps no clock: whoever wants times takes them here.
pub trait Observer: Sync {
    /// A phase begins; the one before has ended.
    fn phase(&self, _phase: Phase) {}
    /// Asked often: whether to give up.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Watches nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;
impl Observer for Unobserved {}

/// The parts of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Tracing paths from the lights and storing records.
    TraceLight,
    /// Sorting records into the map.
    BuildMap,
    /// Tracing paths from the camera and reading the map.
    TraceCamera,
    /// The iteration is over.
    Done,
}

/// Counts of one iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counts {
    /// Paths traced from the lights.
    pub light_paths: u64,
    /// Photons or cones stored.
    pub records_stored: u64,
    /// Records that queries looked at.
    pub records_read: u64,
    /// Records that lay within the kernel.
    pub records_counted: u64,
    /// Rays traced, shadow rays included.
    pub rays: u64,
}

impl std::ops::AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.light_paths += other.light_paths;
        self.records_stored += other.records_stored;
        self.records_read += other.records_read;
        self.records_counted += other.records_counted;
        self.rays += other.rays;
    }
}

/// The result of one iteration.
#[derive(Clone, Debug)]
pub struct Iteration {
    /// Mean radiance of each pixel, row by row from the top left.
    pub pixels: Vec<Spectrum>,
    /// What it took.
    pub counts: Counts,
}

/// Why an iteration has no image.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The observer asked to stop.
    #[error("the iteration was cancelled")]
    Cancelled,
    /// Settings that no image can be made with.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// An estimate that is not finite or is negative: a defect of the renderer, never averaged in.
    #[error("iteration {iteration}: pixel ({x}, {y}) is not a finite, non-negative radiance")]
    BadPixel {
        /// Iteration index.
        iteration: u32,
        /// Column.
        x: u32,
        /// Row.
        y: u32,
    },
}

/// One iteration to be rendered.
struct Job<'a> {
    scene: &'a Scene,
    seed: u64,
    iteration: u32,
}

/// Renders iteration `iteration` (1, 2, ...) of a job on the current rayon pool.
///
/// Pure: the same scene, settings, seed and iteration give the same bits with any number of threads.
///
/// # Errors
/// Settings out of range, a cancelled observer, or a pixel that is not a radiance.
pub fn render_iteration(
    scene: &Scene,
    settings: &IntegratorSettings,
    seed: u64,
    iteration: u32,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    settings.validate()?;
    let job = Job { scene, seed, iteration };
    let result = match (settings, bandwidth(scene, settings, iteration)) {
        (IntegratorSettings::Pppm(s), Some(bandwidth)) => pppm::render(&job, s, bandwidth.sigma, observer)?,
        (IntegratorSettings::Pcf(s), Some(bandwidth)) => pcf::render(&job, s, bandwidth, observer)?,
        (IntegratorSettings::Path(s), None) => path::render(&job, s, observer)?,
        (_, bandwidth) => unreachable!("{settings:?} with {bandwidth:?}"),
    };
    observer.phase(Phase::Done);
    if let Some(bad) = result.pixels.iter().position(|p| !p.is_valid()) {
        let width = scene.film.resolution[0];
        return Err(RenderError::BadPixel {
            iteration,
            x: bad as u32 % width,
            y: bad as u32 / width,
        });
    }
    Ok(result)
}

/// `max_depth` as a number of edges.
fn edge_limit(max_depth: Option<u32>) -> u32 {
    max_depth.unwrap_or(u32::MAX)
}

/// Averages `samples` estimates per pixel, a row of pixels a task. Every camera path has its own random numbers.
fn render_pixels<'a>(
    job: &Job<'a>,
    samples: u32,
    observer: &dyn Observer,
    counts: &mut Counts,
    estimate: impl Fn(&mut Tracer<'a>, Ray, &mut PathRandom, &mut Counts) -> Spectrum + Sync,
) -> Result<Vec<Spectrum>, RenderError> {
    let (sensor, film) = (&job.scene.sensor, &job.scene.film);
    let [width, height] = film.resolution;
    let mut pixels = vec![Spectrum::ZERO; width as usize * height as usize];
    let rows: Vec<Counts> = pixels
        .par_chunks_mut(width as usize)
        .enumerate()
        .map(|(y, row)| {
            if observer.cancelled() {
                return Err(RenderError::Cancelled);
            }
            let mut tracer = Tracer::new(job.scene);
            let mut counts = Counts::default();
            for (x, pixel) in row.iter_mut().enumerate() {
                let first_path = (y as u64 * u64::from(width) + x as u64) * u64::from(samples);
                for sample in 0..u64::from(samples) {
                    let mut random = PathRandom::new(job.seed, job.iteration, Stream::Camera, first_path + sample);
                    let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    let ray = sensor.ray(centre + film.filter.sample(random.next_2d()), random.next_2d());
                    *pixel += estimate(&mut tracer, ray, &mut random, &mut counts);
                }
                *pixel *= 1.0 / samples as f32;
            }
            counts.rays += tracer.rays;
            Ok(counts)
        })
        .collect::<Result<_, _>>()?;
    for row in rows {
        *counts += row;
    }
    Ok(pixels)
}
