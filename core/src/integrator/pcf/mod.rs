//! Photon cone focusing (Chang 2019).
//!
//! Camera paths go first. Each walks to its lookup vertex and leaves a query there: radiance wanted, from this position in
//! this direction. Light paths follow and store cones: at every vertex, whatever its material, outgoing radiance in a
//! sampled direction. A query adds up the cones that are close in position and direction. No BSDF is evaluated there,
//! so delta materials are no exception. Knowing the queries, light paths store only cones that one of them may count, and
//! can aim cones at them (importons).
//!
//! A path whose lookup vertex is the `k`-th camera vertex is counted by the map where its light scatters at that vertex, and
//! by the walk (emission and next-event estimation) where it is shorter. With nested PCF the walk leaves a query at the vertices
//! before the `k`-th too, for light that arrives there straight from a light, and the walk itself counts only what the
//! camera sees directly.
//!
//! A lookup vertex with a delta lobe beside a rough one, as under a coat, is a mirror too. With a fixed `k` its query counts the cones
//! of both lobes. With `lookup_vertex=auto`, which walks through mirrors, it counts those of the rough lobe, and the walk goes on
//! along the delta lobe: no cones are stored for that, and what the camera sees along it counts in full, nested or not.

mod camera_lobe;
mod clip;
mod cone_sampler;
mod importons;
mod kernel;
mod queries;
mod query;
pub(super) mod settings;
pub mod workload;

use super::light_paths::LightPaths;
use super::{Bandwidth, Counts, Iteration, Job, Observer, Phase, RenderError, edge_limit};
use crate::density::{Cone, ConeMap, Occupancy};
use crate::settings::{LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;
use cone_sampler::ConeSampler;
use importons::Importons;
use kernel::Kernel;
use queries::Queries;
use std::ops::Range;

/// Renders an iteration with cones counted within `bandwidth` in position and direction.
///
/// More camera paths than a pass holds are worked through pass by pass, each with all light paths; more light paths than a
/// batch holds are stored and counted batch by batch.
pub(super) fn render(
    job: &Job,
    settings: &PcfSettings,
    bandwidth: Bandwidth,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    render_culling(job, settings, bandwidth, observer, true)
}

/// Without `culling`, cones that no query can count are stored too: the image has the same bits.
fn render_culling(
    job: &Job,
    settings: &PcfSettings,
    bandwidth: Bandwidth,
    observer: &dyn Observer,
    culling: bool,
) -> Result<Iteration, RenderError> {
    let mut counts = Counts::default();
    let mut pixels = Vec::with_capacity(job.pixel_count());
    for range in job.passes(job.batches.camera_paths, settings.samples) {
        let pass = Pass::trace_camera(job, settings, bandwidth, range, observer, &mut counts)?;
        pixels.extend(pass.finish(observer, culling, &mut counts)?);
    }
    Ok(Iteration {
        pixels,
        counts,
        statistics: Vec::new(),
    })
}

/// A range of pixels, once their camera paths have been traced.
struct Pass<'a> {
    job: &'a Job<'a>,
    settings: &'a PcfSettings,
    kernel: Kernel<'a>,
    queries: Queries,
    cones: ConeSampler<'a>,
}

impl<'a> Pass<'a> {
    fn trace_camera(
        job: &'a Job<'a>,
        settings: &'a PcfSettings,
        bandwidth: Bandwidth,
        pixels: Range<usize>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Self, RenderError> {
        observer.phase(Phase::TraceCamera);
        let kernel = Kernel::new(settings, bandwidth);
        let mut queries = Queries::trace(job, settings, pixels, observer, counts)?;
        if settings.surface_test {
            counts.rays += queries.clip(job, &kernel);
        }
        queries.group(kernel.reach());
        let importons = Importons::build(&queries, settings, bandwidth);
        Ok(Self {
            job,
            settings,
            kernel,
            queries,
            cones: ConeSampler::new(job, settings, bandwidth, importons),
        })
    }

    /// Traces the light paths, counts their cones, and returns the pixels.
    fn finish(
        mut self,
        observer: &dyn Observer,
        culling: bool,
        counts: &mut Counts,
    ) -> Result<Vec<Spectrum>, RenderError> {
        let occupancy = culling.then(|| self.queries.occupancy(self.kernel.reach()));
        for batch in self.job.batches.of_light_paths(self.settings.photons) {
            let records = self.trace_light(batch, occupancy.as_ref(), observer, counts)?;
            observer.phase(Phase::BuildMap);
            let map = ConeMap::build(records, self.kernel.reach(), self.settings.surface_test);
            observer.phase(Phase::ReadMap);
            self.queries.read(&map, &self.kernel, observer, counts)?;
        }
        Ok(self.queries.into_pixels(self.settings.photons, self.settings.samples))
    }

    /// Cones of the light paths `batch`; without an `occupancy`, those too that no query can count.
    fn trace_light(
        &self,
        batch: Range<u32>,
        occupancy: Option<&Occupancy>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Vec<Vec<Cone>>, RenderError> {
        observer.phase(Phase::TraceLight);
        let paths = LightPaths {
            sequence: self.job.light_sequence(self.settings.photons),
            range: batch,
            max_edges: longest_light_path(self.settings),
        };
        paths.trace(self.job.scene, observer, counts, |arrival, records| {
            self.cones.store(arrival, occupancy, records);
        })
    }
}

/// Most edges of a light path whose cones some query counts.
fn longest_light_path(settings: &PcfSettings) -> u32 {
    let nearest_lookup = match settings.lookup_vertex {
        LookupVertex::Fixed(k) if !settings.nested => k,
        _ => 1,
    };
    edge_limit(settings.max_depth).saturating_sub(nearest_lookup)
}

#[cfg(test)]
mod tests;
