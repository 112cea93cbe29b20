//! Path tracing: the unbiased reference.

pub(super) mod settings;

use super::camera_path::{self, Visit};
use super::{Counts, Iteration, Job, Observer, Phase, RenderError, edge_limit, render_pixels};
use crate::settings::PathSettings;

pub(super) fn render(job: &Job, settings: &PathSettings, observer: &dyn Observer) -> Result<Iteration, RenderError> {
    observer.phase(Phase::TraceCamera);
    let max_edges = edge_limit(settings.max_depth);
    let mut counts = Counts::default();
    let pixels = render_pixels(job, settings.samples, observer, &mut counts, |sample| {
        camera_path::radiance(sample.tracer, sample.ray, sample.random, max_edges, |_, _, _| {
            Visit::Walk
        })
    })?;
    Ok(Iteration {
        pixels,
        counts,
        statistics: Vec::new(),
    })
}
