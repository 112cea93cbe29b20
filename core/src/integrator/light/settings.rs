//! Settings of `light`.

use crate::integrator::bidirectional::LIGHT_PATHS;
use crate::integrator::{Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::settings::shared::{MAX_DEPTH, SAMPLES, SAMPLING};
use serde::{Deserialize, Serialize};

/// Light tracing.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "light",
    summary: "Light tracing: light paths connected with the camera",
    settings: &[LIGHT_PATHS, SAMPLES, SAMPLING, MAX_DEPTH],
    ignored: Ignored::Integers(&[]),
    statistics_per_pixel: 0,
};

/// Settings of `light`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LightSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S), which find the lights in view.
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for LightSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 1,
            sampling: Sampling::Sobol,
            max_depth: None,
        }
    }
}

impl Estimator for LightSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.max_depth
    }

    fn render(&self, job: &Job, _before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, self, observer)
    }
}
