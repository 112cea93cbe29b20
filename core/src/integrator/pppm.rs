//! Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
//!
//! Camera paths go on through specular and glossy surfaces and end at the first vertex that is rough enough, where the
//! map is read. Direct light there comes from next-event estimation, so photons that come straight from a light
//! are not stored: a path with `k` camera edges and `j` light edges is counted by the map where `j >= 2`, and by the
//! camera path where `j <= 1`.

use super::camera_path::{self, Visit};
use super::light_path::LightPaths;
use super::vertex::Vertex;
use super::{Counts, GLOSSY_ROUGHNESS, Iteration, Job, Observer, Phase, RenderError, edge_limit, render_pixels};
use crate::map::RecordMap;
use crate::math::{PI, sqr};
use crate::settings::PppmSettings;
use crate::spectrum::Spectrum;

/// Renders an iteration with photons gathered within `radius` [scene units].
pub(super) fn render(
    job: &Job,
    settings: &PppmSettings,
    radius: f32,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let max_edges = edge_limit(settings.max_depth);
    let mut counts = Counts::default();

    observer.phase(Phase::TraceLight);
    let paths = LightPaths {
        seed: job.seed,
        iteration: job.iteration,
        count: settings.photons,
        max_edges: max_edges.saturating_sub(1),
    };
    let photons = paths.trace(job.scene, observer, &mut counts, |arrival, _, photons| {
        let vertex = arrival.vertex;
        if arrival.edges >= 2 && !vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            photons.push(vertex.record(vertex.wo, arrival.flux, arrival.edges));
        }
    })?;

    observer.phase(Phase::BuildMap);
    let map = RecordMap::build(photons, radius);

    observer.phase(Phase::TraceCamera);
    let scale = 1.0 / (settings.photons as f32 * PI * sqr(radius));
    let pixels = render_pixels(
        job,
        settings.samples,
        observer,
        &mut counts,
        |tracer, ray, random, counts| {
            camera_path::radiance(tracer, ray, random, max_edges, |vertex, edges, _| {
                if vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
                    return Visit::Walk;
                }
                Visit::AddAndEndAfterDirect(gather(&map, vertex, max_edges - edges, counts) * scale)
            })
        },
    )?;
    Ok(Iteration { pixels, counts })
}

/// `sum_j f(wo, w_j) Phi_j` over the photons in reach that came by at most `max_edges` edges.
fn gather(map: &RecordMap, vertex: &Vertex, max_edges: u32, counts: &mut Counts) -> Spectrum {
    let mut sum = Spectrum::ZERO;
    let mut counted = 0;
    counts.records_read += map.query(vertex.point.position, |photon| {
        if photon.edges() <= max_edges {
            counted += 1;
            sum += vertex.eval(photon.direction()) * photon.weight();
        }
    });
    counts.records_counted += counted;
    sum
}
