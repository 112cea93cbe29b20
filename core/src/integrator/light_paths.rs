//! The light paths of an iteration, traced on all threads.

use super::{Counts, Observer, RenderError};
use crate::geometry::Ray;
use crate::light::{EmissionSample, Origin};
use crate::medium::Space;
use crate::path::{Met, Scattered, Tracer, Vertex, Walk, Way};
use crate::random::{PathRandom, Sequence};
use crate::scene::Scene;
use rayon::prelude::*;
use std::ops::Range;

/// Light paths that one task traces.
pub(super) const CHUNK: u32 = 4096;

/// A vertex of a light path.
pub(super) struct Arrival<'b> {
    pub(super) vertex: &'b Vertex<'b>,
    /// Index of the light path in its iteration.
    pub(super) path: u32,
    /// Where the path goes on, sampled from the BSDF.
    pub(super) scattered: Option<&'b Scattered>,
    /// Whether it comes straight from a light that no connection and no ray finds.
    pub(super) is_found_alone: bool,
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

/// Starts a light path; `None` where it would carry nothing.
#[inline]
pub(super) fn start(tracer: &mut Tracer, random: &mut PathRandom) -> Option<EmissionSample> {
    let (choice, u_position, u_direction) = (random.next_choice(), random.next_choice_2d(), random.next_choice_2d());
    let Scene { lights, geometry, .. } = tracer.scene;
    let start = lights.sample_emission(geometry, choice, u_position, u_direction)?;
    let Some(before) = before(tracer.scene, &start) else {
        return Some(start);
    };
    let passed = tracer.transmittance(&before, random).share;
    (!passed.is_black()).then(|| EmissionSample {
        flux: start.flux * passed,
        ..start
    })
}

/// The way that the light of a path has come before its ray, back to infinity, where something may lie on it.
fn before(scene: &Scene, start: &EmissionSample) -> Option<Way> {
    let around = scene.media.as_ref().and_then(|media| media.around);
    let through_medium = || {
        let behind = Ray {
            direction: -start.ray.direction,
            max_distance: f32::INFINITY,
            ..start.ray
        };
        (start.origin.is_infinite() && around.is_some()).then_some(behind)
    };
    let ray = scene.lights.way_before(start).or_else(through_medium)?;
    Some(Way {
        ray,
        length: f32::INFINITY,
        space: Space::filled(around),
    })
}

/// Traces the next edge of a light path, through all that only bounds media.
#[inline]
pub(super) fn advance(walk: &mut Walk, tracer: &mut Tracer, random: &mut PathRandom) -> Met {
    let mut met = walk.advance(tracer, random);
    while let Some(behind) = walk.pass(tracer, &met, random) {
        met = behind;
    }
    met
}

impl LightPaths {
    /// Traces the paths on the current rayon pool, a chunk of [`CHUNK`] by each task; `trace` follows one from its start and puts what
    /// becomes of it into the chunk's result. Results come back in the order of paths.
    pub(super) fn trace_with<'s, T: Default + Send>(
        &self,
        scene: &'s Scene,
        observer: &dyn Observer,
        counts: &mut Counts,
        trace: impl Fn(&mut Tracer<'s>, u32, Option<EmissionSample>, &mut PathRandom, &mut T) + Sync,
    ) -> Result<Vec<T>, RenderError> {
        let count = self.range.len() as u32;
        let chunks: Vec<(T, u64)> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                if observer.cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let mut tracer = Tracer::new(scene);
                let mut result = T::default();
                let first = self.range.start + chunk * CHUNK;
                for path in first..self.range.end.min(first + CHUNK) {
                    let mut random = self.sequence.path(path);
                    let start = start(&mut tracer, &mut random);
                    trace(&mut tracer, path, start, &mut random, &mut result);
                }
                Ok((result, tracer.rays))
            })
            .collect::<Result<_, _>>()?;
        counts.light_paths += u64::from(count);
        counts.rays += chunks.iter().map(|(_, rays)| rays).sum::<u64>();
        Ok(chunks.into_iter().map(|(result, _)| result).collect())
    }

    /// Traces the paths; `store` puts the records of each arrival into what the chunk leaves. Chunks come back in the order of paths.
    pub(super) fn trace<T: Default + Send>(
        &self,
        scene: &Scene,
        observer: &dyn Observer,
        counts: &mut Counts,
        store: impl Fn(&Arrival, &mut T) + Sync,
    ) -> Result<Vec<T>, RenderError> {
        self.trace_edges(scene, observer, counts, |_, _, _, _| {}, store)
    }

    /// As [`Self::trace`]; `depart` looks at each edge before it is traced.
    pub(super) fn trace_edges<T: Default + Send>(
        &self,
        scene: &Scene,
        observer: &dyn Observer,
        counts: &mut Counts,
        depart: impl Fn(&Walk, &mut Tracer, &mut PathRandom, &mut T) + Sync,
        store: impl Fn(&Arrival, &mut T) + Sync,
    ) -> Result<Vec<T>, RenderError> {
        self.trace_with(
            scene,
            observer,
            counts,
            |tracer, path, start, random, records: &mut T| {
                let Some(start) = start else { return };
                let mut walk = Walk::from_light(scene, &start, random);
                while walk.has_edge_left(self.max_edges) {
                    depart(&walk, tracer, random, records);
                    let met = advance(&mut walk, tracer, random);
                    let Some(vertex) = walk.arrive(scene, &met) else { return };
                    let scattered = vertex.sample(random);
                    let arrival = Arrival {
                        vertex: &vertex,
                        path,
                        scattered: scattered.as_ref(),
                        is_found_alone: vertex.edges == 1 && matches!(start.origin, Origin::Normals(_)),
                    };
                    store(&arrival, records);
                    if !scattered.is_some_and(|scattered| walk.go_on(&vertex, &scattered, random)) {
                        return;
                    }
                }
            },
        )
    }
}
