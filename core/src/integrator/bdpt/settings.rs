//! Settings of `bdpt`.

use crate::integrator::bidirectional::LIGHT_PATHS;
use crate::integrator::{Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::settings::shared::{MAX_DEPTH, SAMPLES, SAMPLING};
use crate::settings::{Instead, Kind, Setting};
use serde::{Deserialize, Serialize};

/// Bidirectional path tracing. Mitsuba 0.6 has a plugin of this name, whose settings are left out.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "bdpt",
    summary: "Bidirectional path tracing",
    settings: &[
        LIGHT_PATHS,
        SAMPLES,
        SAMPLING,
        LIGHT_VERTICES,
        CAMERA_VERTICES,
        WEIGHTED,
        MAX_DEPTH,
    ],
    ignored: Ignored::All,
    statistics_per_pixel: 0,
};

const LIGHT_VERTICES: Setting = Setting {
    name: "light_vertices",
    kind: Kind::Integer { least: 0, most: 64 },
    instead: Some(Instead::Null(&["all"])),
    unit: "",
    help: "Show only what techniques of so many vertices on the light's side find",
};

const CAMERA_VERTICES: Setting = Setting {
    name: "camera_vertices",
    kind: Kind::Integer { least: 0, most: 64 },
    instead: Some(Instead::Null(&["all"])),
    unit: "",
    help: "Show only what techniques of so many vertices on the camera's side find, the lens included",
};

const WEIGHTED: Setting = Setting {
    name: "weighted",
    kind: Kind::Truth,
    instead: None,
    unit: "",
    help: "Whether each technique counts with its share; false: each counts in full, so that the picture is the sum of theirs",
};

/// Settings of `bdpt`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BdptSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Vertices of the light subpath of the techniques that count (`s`); `None`: all.
    pub light_vertices: Option<u32>,
    /// Vertices of the camera subpath, the lens included, of the techniques that count (`t`); `None`: all.
    pub camera_vertices: Option<u32>,
    /// Whether techniques count with their share.
    pub weighted: bool,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for BdptSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 1,
            sampling: Sampling::Sobol,
            light_vertices: None,
            camera_vertices: None,
            weighted: true,
            max_depth: None,
        }
    }
}

impl Estimator for BdptSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.max_depth
    }

    fn why_black(&self) -> Option<&'static str> {
        let some_alone = self.light_vertices.is_some() || self.camera_vertices.is_some();
        some_alone.then_some(
            "`light_vertices` and `camera_vertices` show what some techniques find, and these find nothing here: `all` shows what all do",
        )
    }

    fn render(&self, job: &Job, _before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, self, observer)
    }
}
