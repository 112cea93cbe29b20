//! Integrators: one file each, and the one function that the farm calls.

use crate::scene::Scene;
use crate::settings::IntegratorSettings;
use crate::spectrum::Spectrum;
use thiserror::Error;

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
    #[error("setting `{name}`: {reason}")]
    Setting { name: &'static str, reason: String },
    /// An estimate that is not finite or is negative: a defect of the renderer, never averaged in.
    #[error("iteration {iteration}: pixel ({x}, {y}) is not a finite, non-negative radiance")]
    BadPixel { iteration: u32, x: u32, y: u32 },
}

/// Renders iteration `iteration` (1, 2, ...) of a job on the current rayon pool.
///
/// Pure: the same scene, settings, seed and iteration give the same bits with any number of threads.
pub fn render_iteration(
    _scene: &Scene,
    _settings: &IntegratorSettings,
    _seed: u64,
    _iteration: u32,
    _observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    unimplemented!()
}

/// The spatial bandwidth sigma (or radius) of an iteration, and the angular bandwidth theta [radians]; `None` for `path`.
#[must_use]
pub fn bandwidth(_scene: &Scene, _settings: &IntegratorSettings, _iteration: u32) -> Option<(f32, Option<f32>)> {
    unimplemented!()
}
