//! Vertex connection and merging (Georgiev et al. 2012; unified path space, Hachisuka et al. 2012): bidirectional path
//! tracing and photon mapping in one balance heuristic. The radius comes from the iteration alone, as that of `pppm`.
//!
//! Its techniques can be turned off: without merging it is `bdpt`, and with merging alone, beside the lights that camera
//! paths find, it is bidirectional photon mapping (Vorba 2011).

pub(super) mod settings;

use super::bidirectional::{self, Plan, Techniques};
use super::{Iteration, Job, Observer, RenderError, edge_limit};
use crate::settings::{Technique, VcmSettings};

/// Renders an iteration in which paths are merged within `radius` [scene units].
pub(super) fn render(
    job: &Job,
    settings: &VcmSettings,
    radius: f32,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let uses = |technique| settings.techniques.contains(&technique);
    let plan = Plan {
        light_paths: settings.photons,
        samples: settings.samples,
        max_edges: edge_limit(settings.max_depth),
        techniques: Techniques {
            hit: true,
            next_event: uses(Technique::NextEvent),
            connect: uses(Technique::Connect),
            splat: uses(Technique::Splat),
            merge: uses(Technique::Merge),
        },
        radius: Some(radius),
        only: None,
    };
    bidirectional::render(job, plan, observer)
}
