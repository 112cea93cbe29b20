//! Photon cone focusing (Chang 2019).
//!
//! Light paths store cones: at every vertex, whatever its material, outgoing radiance in a sampled direction. A camera
//! path walks to its lookup vertex and adds up the cones that are close in position and direction. No BSDF is
//! evaluated there, so delta materials are no exception. A path whose lookup vertex is the `k`-th camera vertex is
//! counted by the map where its light scatters at that vertex, and by the walk (emission and next-event estimation)
//! where it is shorter.

use super::camera_path::{self, Visit};
use super::cone_sampler::{CameraLobe, cones};
use super::light_path::LightPaths;
use super::vertex::Vertex;
use super::{
    Bandwidth, Counts, GLOSSY_ROUGHNESS, Iteration, Job, Observer, Phase, RenderError, edge_limit, render_pixels,
};
use crate::map::RecordMap;
use crate::math::{PI, TAU, Vec3, sqr, warp::one_minus_cos};
use crate::settings::{LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;

/// Renders an iteration with cones counted within `bandwidth` in position and direction.
pub(super) fn render(
    job: &Job,
    settings: &PcfSettings,
    bandwidth: Bandwidth,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    let max_edges = edge_limit(settings.max_depth);
    let mut counts = Counts::default();

    observer.phase(Phase::TraceLight);
    let lobe = CameraLobe::new(&job.scene.sensor, bandwidth.theta);
    let paths = LightPaths {
        seed: job.seed,
        iteration: job.iteration,
        count: settings.photons,
        max_edges: max_edges.saturating_sub(nearest_lookup(settings.lookup_vertex)),
    };
    let records = paths.trace(job.scene, observer, &mut counts, |arrival, random, records| {
        cones(arrival, &settings.samplers, &lobe, random, records);
    })?;

    observer.phase(Phase::BuildMap);
    let map = RecordMap::build(records, bandwidth.sigma);

    observer.phase(Phase::TraceCamera);
    let kernel = Kernel::new(bandwidth);
    let scale = kernel.height / settings.photons as f32;
    let pixels = render_pixels(
        job,
        settings.samples,
        observer,
        &mut counts,
        |tracer, ray, random, counts| {
            camera_path::radiance(tracer, ray, random, max_edges, |vertex, edges, _| {
                if is_lookup(settings.lookup_vertex, vertex, edges) {
                    Visit::AddAndEnd(kernel.sum(&map, vertex, max_edges - edges, counts) * scale)
                } else {
                    Visit::Walk
                }
            })
        },
    )?;
    Ok(Iteration { pixels, counts })
}

/// The lowest camera vertex at which the map can be read.
fn nearest_lookup(lookup: LookupVertex) -> u32 {
    match lookup {
        LookupVertex::Fixed(k) => k,
        LookupVertex::Auto => 1,
    }
}

fn is_lookup(lookup: LookupVertex, vertex: &Vertex, edges: u32) -> bool {
    match lookup {
        LookupVertex::Fixed(k) => edges == k,
        LookupVertex::Auto => !vertex.is_glossier_than(GLOSSY_ROUGHNESS),
    }
}

/// The kernel of thesis equation 3.6: constant within `sigma` of the position and `theta` of the direction.
struct Kernel {
    /// Squared distance on the unit sphere of two directions `theta` apart: `2 (1 - cos theta)`.
    chord2: f32,
    /// `1 / (pi sigma^2 2 pi (1 - cos theta))` [1 / (unit^2 sr)].
    height: f32,
}

impl Kernel {
    fn new(bandwidth: Bandwidth) -> Self {
        let one_minus_cos = one_minus_cos(bandwidth.theta);
        Self {
            chord2: 2.0 * one_minus_cos,
            height: 1.0 / (PI * sqr(bandwidth.sigma) * TAU * one_minus_cos),
        }
    }

    /// Sum of the weights of the cones within the kernel that came by at most `max_edges` edges.
    fn sum(&self, map: &RecordMap, vertex: &Vertex, max_edges: u32, counts: &mut Counts) -> Spectrum {
        let mut sum = Spectrum::ZERO;
        let mut counted = 0;
        counts.records_read += map.query(vertex.point.position, |cone| {
            if self.covers(cone.direction(), vertex.wo) && cone.edges() <= max_edges {
                counted += 1;
                sum += cone.weight();
            }
        });
        counts.records_counted += counted;
        sum
    }

    fn covers(&self, cone: Vec3, direction: Vec3) -> bool {
        (cone - direction).length_squared() < self.chord2
    }
}
