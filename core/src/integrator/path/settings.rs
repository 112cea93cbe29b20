//! Settings of `path`.

use crate::integrator::{Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::settings::shared::{MAX_DEPTH, SAMPLES, SAMPLING};
use serde::{Deserialize, Serialize};

/// Path tracing.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "path",
    summary: "Path tracing",
    settings: &[SAMPLES, SAMPLING, MAX_DEPTH],
    ignored: Ignored::Integers(&["rr_depth"]),
    statistics_per_pixel: 0,
};

/// Settings of `path`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PathSettings {
    /// Camera samples per pixel and iteration.
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self {
            samples: 4,
            sampling: Sampling::Sobol,
            max_depth: None,
        }
    }
}

impl Estimator for PathSettings {
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
