//! Settings of `pppm`.

use crate::integrator::bandwidth::shrinking_radius;
use crate::integrator::media::settings::{MEDIA, MediaEstimator};
use crate::integrator::{Bandwidth, Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::Setting;
use crate::settings::shared::{ALPHA, MAX_DEPTH, PHOTONS, SAMPLES, SAMPLING, SIGMA1};
use serde::{Deserialize, Serialize};

/// The settings of [`PppmSettings`].
pub(in crate::integrator) const SETTINGS: &[Setting] = &[PHOTONS, SAMPLES, SAMPLING, ALPHA, SIGMA1, MEDIA, MAX_DEPTH];

/// Probabilistic progressive photon mapping.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "pppm",
    summary: "Probabilistic progressive photon mapping",
    settings: SETTINGS,
    ignored: Ignored::Integers(&[]),
    statistics_per_pixel: 0,
};

/// Settings of `pppm`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PppmSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Share of the photons that the shrinking radius keeps, in (0, 1).
    pub alpha: f32,
    /// First radius [scene units]; `None`: from the scene and the pixel footprint.
    pub sigma1: Option<f32>,
    /// How light is estimated that media scatter.
    pub media: MediaEstimator,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PppmSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 1,
            sampling: Sampling::Sobol,
            alpha: 2.0 / 3.0,
            sigma1: None,
            media: MediaEstimator::Paths,
            max_depth: None,
        }
    }
}

impl PppmSettings {
    /// Radius of the photons' disc in iteration `iteration` (1, 2, ...) [scene units].
    fn radius(&self, scene: &Scene, iteration: u32) -> f32 {
        shrinking_radius(scene, self.sigma1, self.photons, self.alpha, iteration)
    }
}

impl Estimator for PppmSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.max_depth
    }

    fn bandwidth(&self, scene: &Scene, iteration: u32) -> Option<Bandwidth> {
        Some(Bandwidth::of_photons(self.radius(scene, iteration)))
    }

    fn render(&self, job: &Job, _before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, self, self.radius(job.at_rest, job.iteration), observer)
    }
}
