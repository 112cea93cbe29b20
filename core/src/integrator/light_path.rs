//! Paths from the lights, shared by the photon integrators.

use super::camera_path::{ROULETTE_EDGES, ROULETTE_SURVIVAL};
use super::vertex::{Scattered, Tracer, Vertex};
use super::{Counts, Observer, RenderError};
use crate::map::Record;
use crate::material::TransportMode;
use crate::random::{PathRandom, Sequence};
use crate::scene::Scene;
use crate::spectrum::Spectrum;
use rayon::prelude::*;
use std::ops::Range;

/// Light paths that one task traces.
const CHUNK: u32 = 4096;

/// A vertex of a light path, `edges` from the light.
pub(super) struct Arrival<'b> {
    pub(super) vertex: &'b Vertex,
    /// Flux that arrives [W], corrected for the shading normal.
    pub(super) flux: Spectrum,
    pub(super) edges: u32,
    /// Index of the light path in its iteration.
    pub(super) path: u32,
    /// Where the path goes on, sampled from the BSDF.
    pub(super) scattered: Option<&'b Scattered>,
}

/// Which light paths to trace.
pub(super) struct LightPaths {
    /// Their random numbers.
    pub(super) sequence: Sequence,
    /// Indices of the paths, of all M of the iteration.
    pub(super) range: Range<u32>,
    /// Most edges from the light to a vertex.
    pub(super) max_edges: u32,
}

impl LightPaths {
    /// Traces the paths on the current rayon pool; `store` puts the records of each arrival into the chunk's list. Chunks come back in the order of paths.
    pub(super) fn trace(
        &self,
        scene: &Scene,
        observer: &dyn Observer,
        counts: &mut Counts,
        store: impl Fn(&Arrival, &mut Vec<Record>) + Sync,
    ) -> Result<Vec<Vec<Record>>, RenderError> {
        let count = self.range.len() as u32;
        let chunks: Vec<(Vec<Record>, u64)> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                if observer.cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let mut tracer = Tracer::new(scene);
                let mut records = Vec::new();
                let first = self.range.start + chunk * CHUNK;
                for path in first..self.range.end.min(first + CHUNK) {
                    self.trace_one(&mut tracer, path, |arrival| store(arrival, &mut records));
                }
                Ok((records, tracer.rays))
            })
            .collect::<Result<_, _>>()?;
        counts.light_paths += u64::from(count);
        counts.rays += chunks.iter().map(|(_, rays)| rays).sum::<u64>();
        counts.records_stored += chunks.iter().map(|(records, _)| records.len() as u64).sum::<u64>();
        Ok(chunks.into_iter().map(|(records, _)| records).collect())
    }

    fn trace_one(&self, tracer: &mut Tracer, path: u32, mut arrive: impl FnMut(&Arrival)) {
        let mut random = self.sequence.path(path);
        let scene = tracer.scene;
        let (choice, u_position, u_direction) =
            (random.next_choice(), random.next_choice_2d(), random.next_choice_2d());
        let Some(start) = scene
            .lights
            .sample_emission(&scene.geometry, choice, u_position, u_direction)
        else {
            return;
        };
        let (mut ray, mut flux) = (start.ray, start.flux);
        for edges in 1..=self.max_edges {
            let Some(point) = tracer.intersect(&ray) else {
                return;
            };
            let vertex = Vertex::new(scene, point, -ray.direction, TransportMode::Flux);
            flux *= vertex.arrival_correction();
            let scattered = vertex.sample(&mut random);
            arrive(&Arrival {
                vertex: &vertex,
                flux,
                edges,
                path,
                scattered: scattered.as_ref(),
            });
            let Some(scattered) = scattered else { return };
            let Some(next) = go_on(&vertex, flux, &scattered, edges, &mut random) else {
                return;
            };
            flux = next;
            ray = point.ray_towards(scattered.wi);
        }
    }
}

/// Flux that goes on along a direction sampled at a vertex `edges` from the light; `None` where Russian roulette, by the share that
/// is scattered, ends the path.
#[inline]
pub(super) fn go_on(
    vertex: &Vertex,
    flux: Spectrum,
    scattered: &Scattered,
    edges: u32,
    random: &mut PathRandom,
) -> Option<Spectrum> {
    let next = flux * vertex.continuation_weight(scattered);
    let highest = if edges < ROULETTE_EDGES { 1.0 } else { ROULETTE_SURVIVAL };
    let survival = (next.max_component() / flux.max_component()).min(highest);
    let survives = !survival.is_nan() && random.next_choice() < f64::from(survival);
    survives.then(|| next * (1.0 / survival))
}
