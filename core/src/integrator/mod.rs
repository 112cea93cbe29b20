//! Integrators: a folder for each, one list of all, and the one function that the farm calls.
//!
//! The list is [`INTEGRATORS`], [`IntegratorSettings`] and what stands between them below. Nothing else in the code names
//! all integrators.

mod bandwidth;
mod bdpt;
mod bidirectional;
mod camera_path;
mod description;
pub mod layers;
mod light;
mod light_paths;
mod media;
mod path;
pub mod pcf;
#[cfg(test)]
mod portals;
mod pppm;
#[cfg(test)]
mod seen;
mod sppm;
mod surfaces;
#[cfg(test)]
mod test_scenes;
mod vcm;

pub use bandwidth::{Bandwidth, bandwidth};
pub use description::{Ignored, Integrator, schema};
pub use sppm::radius_range;

use description::Estimator;
use layers::{Layers, Memory};

use crate::film::{FilmSettings, WindowError};
use crate::math::Vec2;
use crate::meter::CameraRay;
use crate::path::{AT_LIGHT, Tracer};
use crate::random::{PathRandom, Sampling, Sequence, Stream};
use crate::scene::Scene;
use crate::settings::SettingError;
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use thiserror::Error;

/// All integrators.
pub const INTEGRATORS: [&Integrator; 8] = [
    &path::settings::INTEGRATOR,
    &light::settings::INTEGRATOR,
    &bdpt::settings::INTEGRATOR,
    &vcm::settings::INTEGRATOR,
    &pppm::settings::INTEGRATOR,
    &sppm::settings::INTEGRATOR,
    &pcf::settings::INTEGRATOR,
    &surfaces::settings::INTEGRATOR,
];

/// The types of their settings, which [`crate::settings`] shows.
pub(crate) mod types {
    pub use super::bdpt::settings::*;
    pub use super::light::settings::*;
    pub use super::media::settings::*;
    pub use super::path::settings::*;
    pub use super::pcf::settings::*;
    pub use super::pppm::settings::*;
    pub use super::sppm::settings::*;
    pub use super::surfaces::settings::*;
    pub use super::vcm::settings::*;
}

/// An integrator with its settings. In JSON, `type` is its name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum IntegratorSettings {
    /// Path tracing with next-event estimation.
    Path(types::PathSettings),
    /// Light tracing.
    Light(types::LightSettings),
    /// Bidirectional path tracing (Veach 1997).
    Bdpt(types::BdptSettings),
    /// Vertex connection and merging (Georgiev et al. 2012).
    Vcm(types::VcmSettings),
    /// Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
    Pppm(types::PppmSettings),
    /// Stochastic progressive photon mapping (Hachisuka and Jensen 2009): sequential.
    Sppm(types::SppmSettings),
    /// Photon cone focusing (Chang 2019).
    Pcf(types::PcfSettings),
    /// Photon surfaces in media (Deng et al. 2019).
    Surfaces(types::SurfacesSettings),
}

impl IntegratorSettings {
    fn estimator(&self) -> &dyn Estimator {
        match self {
            Self::Path(settings) => settings,
            Self::Light(settings) => settings,
            Self::Bdpt(settings) => settings,
            Self::Vcm(settings) => settings,
            Self::Pppm(settings) => settings,
            Self::Sppm(settings) => settings,
            Self::Pcf(settings) => settings,
            Self::Surfaces(settings) => settings,
        }
    }
}

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
    /// Tracing paths from the camera.
    TraceCamera,
    /// Adding up the records that camera paths want.
    ReadMap,
    /// The iteration is over.
    Done,
}

/// Counts of one iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// Mean radiance of each pixel, row by row from the top left; of a window of the picture, of its pixels alone.
    pub pixels: Vec<Spectrum>,
    /// What it took.
    pub counts: Counts,
    /// What a sequential integrator goes on from, [`IntegratorSettings::statistics_per_pixel`] values for each pixel in the
    /// order of pixels; empty for the others.
    pub statistics: Vec<f32>,
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
    /// Layers that the scene or the integrator has not.
    #[error(transparent)]
    Layer(#[from] layers::LayerError),
    /// A window that the integrator cannot render.
    #[error(transparent)]
    Window(#[from] WindowError),
    /// What a sequential integrator is to go on from cannot be what the iteration before left.
    #[error("iteration {iteration}: {reason}")]
    Statistics {
        /// Iteration index.
        iteration: u32,
        /// In words.
        reason: String,
    },
    /// Textures that lie in a temporary file could not be read.
    #[error(
        "iteration {iteration}: a texture could not be read from the temporary file that it was written to: {reason}"
    )]
    Textures {
        /// Iteration index.
        iteration: u32,
        /// What the system says.
        reason: String,
    },
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
    /// The scene at the iteration's time.
    scene: &'a Scene,
    /// The scene at rest, which gives all iterations of a job the same first kernel width.
    at_rest: &'a Scene,
    seed: u64,
    iteration: u32,
    sampling: Sampling,
    batches: Batches,
}

/// How much of an iteration is held in memory at a time, so that memory has a bound for any number of paths.
#[derive(Clone, Copy, Debug)]
struct Batches {
    /// Light paths whose records are held.
    light_paths: u32,
    /// Light paths whose beams are held: each is cut into tens of pieces, of some 200 bytes while their boxes are sorted.
    light_paths_of_beams: u32,
    /// Camera paths whose queries `pcf` holds.
    camera_paths: usize,
    /// Camera paths whose vertices, of some 280 bytes each, are held by integrators that evaluate materials when they read a map.
    vertices: usize,
    /// The same where several maps are read, for each of which light paths are traced.
    vertices_of_batches: usize,
}

impl Default for Batches {
    fn default() -> Self {
        Self {
            light_paths: 1 << 20,
            light_paths_of_beams: 1 << 15,
            camera_paths: 1 << 22,
            vertices: 1 << 16,
            vertices_of_batches: 1 << 20,
        }
    }
}

impl Batches {
    /// Splits the light paths `0..count` of an iteration.
    fn of_light_paths(self, count: u32) -> impl Iterator<Item = Range<u32>> {
        let size = self.light_paths;
        (0..count.div_ceil(size)).map(move |batch| batch * size..(batch + 1).saturating_mul(size).min(count))
    }

    /// The same where light paths leave beams.
    fn of_beams(self) -> Self {
        Self {
            light_paths: self.light_paths.min(self.light_paths_of_beams),
            ..self
        }
    }
}

impl Job<'_> {
    /// Splits the pixels into ranges of `camera_paths` paths at most where a pixel has `samples`, or else of one pixel.
    fn passes(&self, camera_paths: usize, samples: u32) -> impl Iterator<Item = Range<usize>> + use<> {
        let total = self.pixel_count();
        let size = (camera_paths / samples as usize).max(1);
        (0..total)
            .step_by(size)
            .map(move |first| first..total.min(first.saturating_add(size)))
    }

    fn pixel_count(&self) -> usize {
        self.scene.film.pixel_count()
    }

    /// Random numbers of the iteration's `count` light paths.
    fn light_sequence(&self, count: u32) -> Sequence {
        self.sampling
            .sequence(self.seed, self.iteration, Stream::Light, 0, count)
    }
}

/// Renders iteration `iteration` (1, 2, ...) of a job on the current rayon pool. Those of a sequential integrator after the
/// first are rendered by [`render_next`].
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
    render_next(scene, settings, seed, iteration, &[], observer)
}

/// Renders iteration `iteration` (1, 2, ...) of a job on the current rayon pool, going on from the statistics that the one before
/// it left: none for the first iteration and where the integrator is not sequential.
///
/// Pure: the same scene, settings, seed, iteration and statistics give the same bits with any number of threads.
///
/// # Errors
/// Settings out of range, statistics that cannot be, a cancelled observer, or a pixel that is not a radiance.
pub fn render_next(
    scene: &Scene,
    settings: &IntegratorSettings,
    seed: u64,
    iteration: u32,
    before: &[f32],
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let (layers, memory) = Default::default();
    render_with_layers(scene, (&layers, &memory), settings, seed, iteration, before, observer)
}

/// As [`render_next`], with the planes of layers below the picture ([`Layers::stacked`]), and the memory of layers that iterations of
/// this scene share, in which nothing lies that they would not find again by themselves.
///
/// # Errors
/// As [`render_next`]; also where a layer is not one of the scene or the integrator.
pub fn render_with_layers(
    scene: &Scene,
    (layers, memory): (&Layers, &Memory),
    settings: &IntegratorSettings,
    seed: u64,
    iteration: u32,
    before: &[f32],
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    settings.validate()?;
    settings.check_window(scene.film.window)?;
    layers.check_integrator(settings)?;
    layers.check_scene(scene)?;
    if before.is_empty() == (settings.is_sequential() && iteration > 1) {
        let reason = match before.is_empty() {
            true => format!(
                "{} goes on from the statistics of the iteration before it",
                settings.name()
            ),
            false => "statistics are for iterations of a sequential integrator after the first".into(),
        };
        return Err(RenderError::Statistics { iteration, reason });
    }
    let frame = scene.frame(seed, iteration);
    let job = Job {
        scene: frame.as_ref().unwrap_or(scene),
        at_rest: scene,
        seed,
        iteration,
        sampling: settings.sampling(),
        batches: Batches::default(),
    };
    let mut result = render_job(&job, settings, before, observer)?;
    if *layers != Layers::default() {
        result = layers::render(&job, (layers, memory), settings, &result, observer)?;
    }
    observer.phase(Phase::Done);
    if let Some(reason) = scene.tiles.as_ref().and_then(|tiles| tiles.take_failure()) {
        return Err(RenderError::Textures { iteration, reason });
    }
    if let Some(bad) = result.pixels.iter().position(|p| !p.is_valid()) {
        let (width, pixel) = (scene.film.resolution[0], scene.film.in_picture(bad % job.pixel_count()));
        return Err(RenderError::BadPixel {
            iteration,
            x: pixel as u32 % width,
            y: pixel as u32 / width,
        });
    }
    Ok(result)
}

/// The image of an iteration: of a window the pixels that it has of the whole picture, bit for bit.
fn render_job(
    job: &Job,
    settings: &IntegratorSettings,
    before: &[f32],
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let (estimator, film) = (settings.estimator(), &job.scene.film);
    let mut result = match film.window.is_some() && estimator.needs_all_pixels() {
        false => estimator.render(job, before, observer)?,
        true => {
            let whole = Scene {
                film: FilmSettings {
                    window: None,
                    ..film.clone()
                },
                ..job.scene.clone()
            };
            let whole = estimator.render(&Job { scene: &whole, ..*job }, before, observer)?;
            let pixels = 0..film.pixel_count();
            Iteration {
                pixels: pixels.map(|pixel| whole.pixels[film.in_picture(pixel)]).collect(),
                ..whole
            }
        }
    };
    let response = job.scene.sensor.response();
    if response != 1.0 {
        result.pixels.iter_mut().for_each(|pixel| *pixel *= response);
    }
    Ok(result)
}

/// `max_depth` as a number of edges.
fn edge_limit(max_depth: Option<u32>) -> u32 {
    max_depth.unwrap_or(u32::MAX)
}

/// Camera paths that one task traces, but for those of one pixel.
const PATHS_PER_TASK: usize = 256;

/// A camera path about to be traced.
struct Sample<'a, 't> {
    tracer: &'t mut Tracer<'a>,
    camera: CameraRay,
    random: &'t mut PathRandom,
    /// Index of its pixel among those that are rendered, row by row from the top left.
    pixel: usize,
    /// Index of its pixel in the whole picture.
    in_picture: usize,
    /// Its number among the camera paths of the pixel, from 0.
    index: u32,
}

/// Sums `samples` estimates for each pixel of the range `pixels`, of those that are rendered, on the current rayon pool; `estimate` may put further things
/// into its task's list. Lists come back in the order of pixels. Every camera path has its own random numbers.
fn trace_pixels<'a, T: Send>(
    job: &Job<'a>,
    samples: u32,
    pixels: Range<usize>,
    observer: &dyn Observer,
    counts: &mut Counts,
    estimate: impl Fn(Sample<'a, '_>, &mut Vec<T>) -> Spectrum + Sync,
) -> Result<(Vec<Spectrum>, Vec<Vec<T>>), RenderError> {
    trace_pixels_into(job, samples, pixels, observer, counts, estimate)
}

/// As [`trace_pixels`], with anything in the place of lists.
fn trace_pixels_into<'a, L: Default + Send>(
    job: &Job<'a>,
    samples: u32,
    pixels: Range<usize>,
    observer: &dyn Observer,
    counts: &mut Counts,
    estimate: impl Fn(Sample<'a, '_>, &mut L) -> Spectrum + Sync,
) -> Result<(Vec<Spectrum>, Vec<L>), RenderError> {
    let film = &job.scene.film;
    let has_unseen_lights = job.scene.lights.any_delta() && job.scene.states_at_camera() & AT_LIGHT != 0;
    let width = film.resolution[0] as usize;
    let mut sums = vec![Spectrum::ZERO; pixels.len()];
    let pixels_per_task = (PATHS_PER_TASK / samples as usize).max(1);
    let tasks: Vec<(L, u64)> = sums
        .par_chunks_mut(pixels_per_task)
        .enumerate()
        .map(|(task, sums)| {
            if observer.cancelled() {
                return Err(RenderError::Cancelled);
            }
            let mut tracer = Tracer::new(job.scene);
            let mut list = L::default();
            for (offset, sum) in sums.iter_mut().enumerate() {
                let pixel = pixels.start + task * pixels_per_task + offset;
                let in_picture = film.in_picture(pixel);
                let centre = Vec2::new((in_picture % width) as f32 + 0.5, (in_picture / width) as f32 + 0.5);
                let sequence =
                    job.sampling
                        .sequence(job.seed, job.iteration, Stream::Camera, in_picture as u64, samples);
                for index in 0..samples {
                    let mut random = sequence.path(index);
                    let place = centre + film.filter.sample(random.next_2d());
                    let camera = job.scene.camera_ray(place, random.next_2d());
                    if let Some(normal) = camera.normal
                        && has_unseen_lights
                    {
                        *sum += tracer.unseen_light(camera.ray.origin, normal, &mut random);
                    }
                    let sample = Sample {
                        tracer: &mut tracer,
                        camera,
                        random: &mut random,
                        pixel,
                        in_picture,
                        index,
                    };
                    *sum += estimate(sample, &mut list);
                }
            }
            Ok((list, tracer.rays))
        })
        .collect::<Result<_, _>>()?;
    let mut lists = Vec::with_capacity(tasks.len());
    for (list, rays) in tasks {
        counts.rays += rays;
        lists.push(list);
    }
    Ok((sums, lists))
}

/// What a query of a map of points found.
struct Found {
    /// Index of its pixel, row by row from the top left.
    pixel: u32,
    /// What it adds to the sum of the pixel's camera paths.
    value: Spectrum,
    /// Points that were looked at, and that counted.
    read: u64,
    counted: u32,
}

impl Found {
    /// Adds it to its pixel's sum.
    fn add_to(&self, sums: &mut [Spectrum], counts: &mut Counts) {
        sums[self.pixel as usize] += self.value;
        counts.records_read += self.read;
        counts.records_counted += u64::from(self.counted);
    }
}

/// Averages `samples` estimates for each pixel.
fn render_pixels<'a>(
    job: &Job<'a>,
    samples: u32,
    observer: &dyn Observer,
    counts: &mut Counts,
    estimate: impl Fn(Sample<'a, '_>) -> Spectrum + Sync,
) -> Result<Vec<Spectrum>, RenderError> {
    let nothing = |sample: Sample<'a, '_>, _: &mut Vec<()>| estimate(sample);
    let (mut pixels, _) = trace_pixels(job, samples, 0..job.pixel_count(), observer, counts, nothing)?;
    for pixel in &mut pixels {
        *pixel *= 1.0 / samples as f32;
    }
    Ok(pixels)
}
