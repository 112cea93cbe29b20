//! Bidirectional path tracing (Lafortune and Willems 1993; Veach 1997, chapter 10): every technique that connects a light
//! subpath with a camera subpath, weighted by the balance heuristic.

pub(super) mod settings;

use super::bidirectional::{self, Only, Plan, Techniques};
use super::{Iteration, Job, Observer, RenderError, edge_limit};
use crate::settings::BdptSettings;

pub(super) fn render(job: &Job, settings: &BdptSettings, observer: &dyn Observer) -> Result<Iteration, RenderError> {
    let plan = Plan {
        light_paths: settings.photons,
        samples: settings.samples,
        max_edges: edge_limit(settings.max_depth),
        techniques: Techniques {
            merge: false,
            ..Techniques::ALL
        },
        radius: None,
        only: Some(Only {
            s: settings.light_vertices,
            t: settings.camera_vertices,
            weighted: settings.weighted,
        }),
    };
    bidirectional::render(job, plan, observer)
}
