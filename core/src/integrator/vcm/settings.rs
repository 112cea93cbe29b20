//! Settings of `vcm`.

use crate::integrator::bandwidth::shrinking_radius;
use crate::integrator::bidirectional::LIGHT_PATHS;
use crate::integrator::{Bandwidth, Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::shared::{ALPHA, MAX_DEPTH, SAMPLES, SAMPLING, SIGMA1};
use crate::settings::{Kind, Setting};
use serde::{Deserialize, Serialize};

/// Vertex connection and merging.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "vcm",
    summary: "Vertex connection and merging",
    settings: &[LIGHT_PATHS, SAMPLES, SAMPLING, ALPHA, SIGMA1, TECHNIQUES, MAX_DEPTH],
    ignored: Ignored::Integers(&[]),
    statistics_per_pixel: 0,
};

const TECHNIQUES: Setting = Setting {
    name: "techniques",
    kind: Kind::Choices {
        words: &["next_event", "connect", "splat", "merge"],
        needed: &["next_event", "merge"],
    },
    instead: None,
    unit: "",
    help: "Techniques that are used besides lights that camera paths find: these are connected with lights, or with light paths; \
           light paths are connected with the camera; both are merged. What a point or a beam sends through glass or mirrors needs \
           merge or splat",
};

/// Settings of `vcm`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VcmSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Share of the light paths that the shrinking radius keeps, in (0, 1).
    pub alpha: f32,
    /// First radius within which paths are merged [scene units]; `None`: from the scene and the pixel footprint.
    pub sigma1: Option<f32>,
    /// Techniques that are used. Light that delta lights send to the first surface needs next-event estimation or merging.
    pub techniques: Vec<Technique>,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

/// A group of techniques of bidirectional methods. Besides, camera paths count the lights that they find.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Technique {
    /// A camera path is connected with a point of a light.
    NextEvent,
    /// A camera path is connected with a light path.
    Connect,
    /// A light path is connected with the lens, or hits it.
    Splat,
    /// A camera path is merged with light paths that end near its vertices.
    Merge,
}

impl Default for VcmSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 1,
            sampling: Sampling::Sobol,
            alpha: 2.0 / 3.0,
            sigma1: None,
            techniques: vec![
                Technique::NextEvent,
                Technique::Connect,
                Technique::Splat,
                Technique::Merge,
            ],
            max_depth: None,
        }
    }
}

impl VcmSettings {
    /// Radius within which paths are merged in iteration `iteration` (1, 2, ...) [scene units].
    fn radius(&self, scene: &Scene, iteration: u32) -> f32 {
        shrinking_radius(scene, self.sigma1, self.photons, self.alpha, iteration)
    }
}

impl Estimator for VcmSettings {
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
