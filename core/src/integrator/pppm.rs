//! Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
//!
//! Camera paths go on through specular and glossy surfaces and end at the first vertex that is rough enough, where the
//! map is read. Direct light there comes from next-event estimation, so photons that come straight from a light
//! are not stored: a path with `k` camera edges and `j` light edges is counted by the map where `j >= 2`, and by the
//! camera path where `j <= 1`.

use super::camera_path::{self, Visit};
use super::light_path::{LightPaths, batches};
use super::vertex::Vertex;
use super::{Counts, GLOSSY_ROUGHNESS, Iteration, Job, Observer, Phase, RenderError, edge_limit, render_pixels};
use crate::map::{Reach, RecordMap, count_edges};
use crate::math::{PI, sqr};
use crate::settings::PppmSettings;
use crate::spectrum::Spectrum;
use std::ops::Range;

/// Renders an iteration with photons gathered within `radius` [scene units].
///
/// More light paths than a batch holds are worked through batch by batch, with the same camera paths: the image is the mean of
/// the batches' images, weighted by their number of light paths.
pub(super) fn render(
    job: &Job,
    settings: &PppmSettings,
    radius: f32,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let mut counts = Counts::default();
    let mut pixels = vec![Spectrum::ZERO; job.pixel_count()];
    for batch in batches(settings.photons) {
        let share = batch.len() as f32 / settings.photons as f32;
        let image = render_batch(job, settings, batch, radius, observer, &mut counts)?;
        for (pixel, estimate) in pixels.iter_mut().zip(image) {
            *pixel += estimate * share;
        }
    }
    Ok(Iteration { pixels, counts })
}

fn render_batch(
    job: &Job,
    settings: &PppmSettings,
    batch: Range<u32>,
    radius: f32,
    observer: &dyn Observer,
    counts: &mut Counts,
) -> Result<Vec<Spectrum>, RenderError> {
    let max_edges = edge_limit(settings.max_depth);
    let scale = 1.0 / (batch.len() as f32 * PI * sqr(radius));

    observer.phase(Phase::TraceLight);
    let paths = LightPaths {
        sequence: job.light_sequence(settings.photons),
        range: batch,
        max_edges: max_edges.saturating_sub(1),
    };
    let photons = paths.trace(job.scene, observer, counts, |arrival, photons| {
        let vertex = arrival.vertex;
        if arrival.edges >= 2 && !vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
            photons.push(vertex.record(vertex.wo, arrival.flux, arrival.edges));
        }
    })?;

    observer.phase(Phase::BuildMap);
    let reach = Reach::new(radius, PI);
    let map = RecordMap::build(photons, &reach, false);

    observer.phase(Phase::TraceCamera);
    render_pixels(job, settings.samples, observer, counts, |sample| {
        let counts = sample.counts;
        camera_path::radiance(
            sample.tracer,
            sample.ray,
            sample.random,
            max_edges,
            |vertex, edges, _| {
                if vertex.is_glossier_than(GLOSSY_ROUGHNESS) {
                    return Visit::Walk;
                }
                let limit = count_edges(max_edges - edges);
                Visit::AddAndEndAfterDirect(gather(&map, &reach, vertex, limit, counts) * scale)
            },
        )
    })
}

/// `sum_j f(wo, w_j) Phi_j` over the photons in reach that came by at most `limit` edges.
fn gather(map: &RecordMap, reach: &Reach, vertex: &Vertex, limit: u8, counts: &mut Counts) -> Spectrum {
    let mut sum = Spectrum::ZERO;
    let mut counted = 0;
    counts.records_read += map.query(vertex.point.position, reach, |photon| {
        if photon.edges() <= limit {
            counted += 1;
            sum += vertex.eval(photon.direction()) * photon.weight();
        }
    });
    counts.records_counted += counted;
    sum
}
