//! Light tracing: light paths are connected with the lens, or hit it (Veach 1997, section 10.3: `t = 1` and `t = 0`).
//!
//! Lights that the camera sees itself are found by its rays. What it sees through delta surfaces stays black, unless paths
//! hit a lens: nothing connects a delta surface with the camera.

pub(super) mod settings;

use super::bidirectional::{self, Plan, Techniques};
use super::{Iteration, Job, Observer, RenderError, edge_limit};
use crate::settings::LightSettings;

pub(super) fn render(job: &Job, settings: &LightSettings, observer: &dyn Observer) -> Result<Iteration, RenderError> {
    let plan = Plan {
        light_paths: settings.photons,
        samples: settings.samples,
        max_edges: edge_limit(settings.max_depth),
        techniques: Techniques {
            splat: true,
            ..Techniques::NONE
        },
        radius: None,
        only: None,
    };
    bidirectional::render(job, plan, observer)
}
