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
//!
//! Media scatter camera paths as glossy surfaces do, unless the setting `media` says `cones`. Then camera paths go straight through media, with the share of
//! light that comes through, and leave a query besides at one point of each piece of medium on their edges. Light paths store cones where media scatter
//! them, of outgoing radiance per volume, and a query counts those in a ball and a cone: the kernel has five dimensions, `3 / (4 pi sigma^3 2 pi (1 - cos theta))`
//! (thesis, section 3.7.2), and shrinks by a schedule of its own ([`crate::density::schedule::pcf_sigma_ratio`]). A path is counted there where its last vertex
//! in a medium, seen from the camera, is the first that is not on a surface and lies before the lookup vertex: by cones of light paths of any length, direct
//! light too. Every other path has surfaces alone up to the lookup vertex, and is counted as above, with connections and edges that cross media. So each path
//! is counted once: the places of its first vertices from the camera say where.

mod camera_lobe;
mod clip;
mod cone_sampler;
mod importons;
mod kernel;
mod places;
mod queries;
mod query;
pub(super) mod settings;
pub mod workload;

use super::light_paths::LightPaths;
use super::{Counts, Iteration, Job, Observer, Phase, RenderError, edge_limit};
use crate::density::{Cone, ConeMap, Extent, Occupancy};
use crate::settings::{ConesInMedia, LookupVertex, PcfSettings};
use crate::spectrum::Spectrum;
use cone_sampler::ConeSampler;
use importons::Importons;
use kernel::Kernel;
use places::{ByPlace, Place};
use queries::{CameraPaths, Queries};
use settings::Widths;
use std::ops::Range;

/// Renders an iteration with cones counted within `widths` in position and direction.
///
/// More camera paths than a pass holds are worked through pass by pass, each with all light paths; more light paths than a
/// batch holds are stored and counted batch by batch.
pub(super) fn render(
    job: &Job,
    settings: &PcfSettings,
    widths: Widths,
    observer: &dyn Observer,
) -> Result<Iteration, RenderError> {
    render_culling(job, settings, widths, observer, true)
}

/// Without `culling`, cones that no query can count are stored too: the image has the same bits.
fn render_culling(
    job: &Job,
    settings: &PcfSettings,
    widths: Widths,
    observer: &dyn Observer,
    culling: bool,
) -> Result<Iteration, RenderError> {
    let mut counts = Counts::default();
    let mut pixels = Vec::with_capacity(job.pixel_count());
    for range in job.passes(job.batches.camera_paths, settings.samples) {
        let pass = Pass::trace_camera(job, settings, widths, range, observer, &mut counts)?;
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
    /// Sums of what camera paths have gathered themselves.
    pixels: Vec<Spectrum>,
    /// Surfaces, then media ([`Place::index`]).
    gatherings: Vec<Gathering<'a>>,
}

/// What camera paths want at places of one sort, and how light paths leave it there.
struct Gathering<'a> {
    kernel: Kernel<'a>,
    queries: Queries,
    cones: ConeSampler<'a>,
}

impl<'a> Pass<'a> {
    fn trace_camera(
        job: &'a Job<'a>,
        settings: &'a PcfSettings,
        widths: Widths,
        pixels: Range<usize>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Self, RenderError> {
        observer.phase(Phase::TraceCamera);
        let paths = CameraPaths::trace(job, settings, pixels, observer, counts)?;
        let gathering = |(place, mut queries): (usize, Queries)| {
            let (extent, bandwidth) = match place {
                0 => (Extent::Disc, widths.on_surfaces),
                _ => (Extent::Ball, widths.in_media),
            };
            let kernel = Kernel::new(settings, extent, bandwidth);
            if kernel.tests_surfaces() {
                counts.rays += queries.clip(job, &kernel);
            }
            queries.group(kernel.reach());
            let importons = Importons::build(&queries, settings, bandwidth);
            Gathering {
                cones: ConeSampler::new(job, settings, (extent, bandwidth), importons),
                kernel,
                queries,
            }
        };
        Ok(Self {
            job,
            settings,
            pixels: paths.pixels,
            gatherings: paths.queries.into_iter().enumerate().map(gathering).collect(),
        })
    }

    /// Traces the light paths, counts their cones, and returns the pixels.
    fn finish(
        mut self,
        observer: &dyn Observer,
        culling: bool,
        counts: &mut Counts,
    ) -> Result<Vec<Spectrum>, RenderError> {
        let occupancies = culling.then(|| self.occupancies());
        for batch in self.job.batches.of_light_paths(self.settings.photons) {
            let records = self.trace_light(batch, occupancies.as_deref(), observer, counts)?;
            observer.phase(Phase::BuildMap);
            let build = |(gathering, records): (&Gathering, Vec<Vec<Cone>>)| {
                ConeMap::build(records, gathering.kernel.reach(), gathering.kernel.tests_surfaces())
            };
            let maps: Vec<ConeMap> = self.gatherings.iter().zip(records).map(build).collect();
            observer.phase(Phase::ReadMap);
            for (gathering, map) in self.gatherings.iter_mut().zip(&maps) {
                gathering.queries.read(map, &gathering.kernel, observer, counts)?;
            }
        }
        for gathering in &self.gatherings {
            gathering.queries.add_to(&mut self.pixels, self.settings.photons);
        }
        for pixel in &mut self.pixels {
            *pixel *= 1.0 / self.settings.samples as f32;
        }
        Ok(self.pixels)
    }

    /// Where queries look, for each place.
    fn occupancies(&self) -> Vec<Occupancy> {
        let gatherings = self.gatherings.iter();
        gatherings
            .map(|gathering| gathering.queries.occupancy(gathering.kernel.reach()))
            .collect()
    }

    /// Cones of the light paths `batch`, for each place; without `occupancies`, those too that no query can count.
    fn trace_light(
        &self,
        batch: Range<u32>,
        occupancies: Option<&[Occupancy]>,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<Vec<Vec<Vec<Cone>>>, RenderError> {
        observer.phase(Phase::TraceLight);
        let paths = LightPaths {
            sequence: self.job.light_sequence(self.settings.photons),
            range: batch,
            max_edges: longest_light_path(self.settings),
        };
        let chunks = paths.trace(self.job.scene, observer, counts, |arrival, records: &mut ByPlace<_>| {
            let Some(place) = Place::of(arrival.vertex, self.job.scene) else {
                return;
            };
            if let Some(gathering) = self.gatherings.get(place.index()) {
                let occupancy = occupancies.map(|all| &all[place.index()]);
                gathering.cones.store(arrival, occupancy, records.list(place));
            }
        })?;
        let records = ByPlace::sort(chunks, self.gatherings.len());
        counts.records_stored += records.iter().flatten().map(|list| list.len() as u64).sum::<u64>();
        Ok(records)
    }
}

/// Most edges of a light path whose cones some query counts.
fn longest_light_path(settings: &PcfSettings) -> u32 {
    let nearest_lookup = match settings.lookup_vertex {
        LookupVertex::Fixed(k) if !settings.nested && settings.media == ConesInMedia::Paths => k,
        _ => 1,
    };
    edge_limit(settings.max_depth).saturating_sub(nearest_lookup)
}

#[cfg(test)]
mod tests;
