//! Path tracing: the unbiased reference.

pub(super) mod settings;

use super::camera_path::CameraPath;
use super::{Counts, Iteration, Job, Observer, Phase, RenderError, edge_limit, render_pixels};
use crate::settings::PathSettings;

pub(super) fn render(job: &Job, settings: &PathSettings, observer: &dyn Observer) -> Result<Iteration, RenderError> {
    observer.phase(Phase::TraceCamera);
    let max_edges = edge_limit(settings.max_depth);
    let mut counts = Counts::default();
    let pixels = render_pixels(job, settings.samples, observer, &mut counts, |sample| {
        let mut path = CameraPath::new(sample.tracer, sample.camera.ray, sample.random, max_edges);
        loop {
            let met = path.trace_edge();
            let Some(vertex) = path.arrive(&met) else { break };
            path.add_next_event(&vertex);
            if path.go_on(&vertex).is_none() {
                break;
            }
        }
        path.radiance
    })?;
    Ok(Iteration {
        pixels,
        counts,
        statistics: Vec::new(),
    })
}
