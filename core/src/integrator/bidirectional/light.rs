//! Light subpaths: their vertices, which camera paths are connected and merged with, and what they give to pixels themselves.

use super::partial::Partial;
use super::{Counts, Estimator, Observer, RenderError, Splat};
use crate::integrator::light_path::go_on;
use crate::integrator::vertex::{Tracer, Vertex};
use crate::light::{EmissionSample, Origin};
use crate::map::Record;
use crate::material::TransportMode;
use crate::math::sqr;
use crate::random::{PathRandom, Sequence, Stream};
use crate::sensor::SensorSample;
use crate::spectrum::Spectrum;
use rayon::prelude::*;

/// Light paths that one task traces.
const CHUNK: u32 = 4096;

/// A vertex of a light path that camera paths can be connected with.
#[derive(Clone, Copy)]
pub(super) struct LightVertex {
    pub(super) vertex: Vertex,
    /// Flux that arrives [W], corrected for the shading normal.
    pub(super) flux: Spectrum,
    pub(super) partial: Partial,
    /// From the light.
    pub(super) edges: u32,
}

/// What a merge needs to know of a light path besides its record: its sums, the first with how often the edge is connected.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MergePayload {
    pub(super) edge: f32,
    pub(super) before: f32,
}

/// The light paths of an iteration, in chunks of [`CHUNK`].
pub(super) struct LightPaths {
    chunks: Vec<Chunk>,
}

#[derive(Default)]
struct Chunk {
    vertices: Vec<LightVertex>,
    /// For each path, where its vertices end.
    ends: Vec<u32>,
    records: Vec<Record<MergePayload>>,
    splats: Vec<Splat>,
    rays: u64,
}

impl LightPaths {
    /// Vertices of a path that are no delta functions.
    pub(super) fn vertices(&self, path: u32) -> &[LightVertex] {
        let chunk = &self.chunks[(path / CHUNK) as usize];
        let index = (path % CHUNK) as usize;
        let start = index.checked_sub(1).map_or(0, |before| chunk.ends[before]);
        &chunk.vertices[start as usize..chunk.ends[index] as usize]
    }

    pub(super) fn take_records(&mut self) -> Vec<Vec<Record<MergePayload>>> {
        self.chunks
            .iter_mut()
            .map(|chunk| std::mem::take(&mut chunk.records))
            .collect()
    }

    pub(super) fn splats(&self) -> impl Iterator<Item = &Splat> {
        self.chunks.iter().flat_map(|chunk| &chunk.splats)
    }
}

impl<'a> Estimator<'a> {
    /// Traces all light paths on the current rayon pool.
    pub(super) fn trace_light(&self, observer: &dyn Observer, counts: &mut Counts) -> Result<LightPaths, RenderError> {
        let count = self.plan.light_paths;
        let sequence = self.job.light_sequence(count);
        let chunks: Vec<Chunk> = (0..count.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                if observer.cancelled() {
                    return Err(RenderError::Cancelled);
                }
                let mut tracer = Tracer::new(self.job.scene);
                let mut out = Chunk::default();
                let first = chunk * CHUNK;
                for path in first..count.min(first + CHUNK) {
                    self.trace_light_path(&mut tracer, &sequence, path, &mut out);
                    out.ends.push(out.vertices.len() as u32);
                }
                out.rays = tracer.rays;
                Ok(out)
            })
            .collect::<Result<_, _>>()?;
        counts.light_paths += u64::from(count);
        counts.rays += chunks.iter().map(|chunk| chunk.rays).sum::<u64>();
        counts.records_stored += chunks.iter().map(|chunk| chunk.vertices.len() as u64).sum::<u64>();
        Ok(LightPaths { chunks })
    }

    fn trace_light_path(&self, tracer: &mut Tracer<'a>, sequence: &Sequence, path: u32, out: &mut Chunk) {
        let scene = tracer.scene;
        let mut random = sequence.path(path);
        let (choice, u_position, u_direction) =
            (random.next_choice(), random.next_choice_2d(), random.next_choice_2d());
        let Some(start) = scene
            .lights
            .sample_emission(&scene.geometry, choice, u_position, u_direction)
        else {
            return;
        };
        let infinite = start.origin.is_infinite();
        let (mut ray, mut flux) = (start.ray, start.flux);
        let mut partial = self.first_light_partial(&start);
        for edges in 1..=self.plan.max_edges {
            let hit = tracer.intersect(&ray);
            let parallel = infinite && edges == 1;
            if self.uses(edges + 1, 0) {
                let free = hit.as_ref().map_or(f32::INFINITY, |point| point.distance);
                if let Some(seen) = scene.sensor.hit_lens(&ray, free, parallel) {
                    let value = flux * self.lens_share(&seen, partial, edges, parallel);
                    self.splat(&seen, value, &mut self.lens_random(path, edges), out);
                }
            }
            let Some(point) = hit else { return };
            if edges == self.plan.max_edges {
                return;
            }
            let vertex = Vertex::new(scene, point, -ray.direction, TransportMode::Flux);
            let distance2 = if parallel { 1.0 } else { sqr(point.distance) };
            if edges == 1 {
                partial.edge *= scene
                    .lights
                    .connection_over_emission(&scene.geometry, &start, point.position);
                partial.before *= f32::from(u8::from(self.plan.techniques.hit));
            }
            partial = partial.arrived(distance2, vertex.cos_geometric(vertex.wo));
            flux *= vertex.arrival_correction();
            if !vertex.is_delta() {
                let end = LightVertex {
                    vertex,
                    flux,
                    partial,
                    edges,
                };
                self.connect_with_lens(tracer, &end, &mut self.lens_random(path, edges), out);
                if self.reach.is_some() {
                    let payload = MergePayload {
                        edge: partial.edge * self.light_edges.of(edges),
                        before: partial.before,
                    };
                    out.records.push(vertex.record(vertex.wo, flux, edges).with(payload));
                }
                if self.plan.techniques.connect {
                    out.vertices.push(end);
                }
            }
            let Some(scattered) = vertex.sample(&mut random) else {
                return;
            };
            let Some(next) = go_on(&vertex, flux, &scattered, edges, &mut random) else {
                return;
            };
            flux = next;
            partial = self.partial_after(&vertex, partial, self.light_edges.of(edges), &scattered);
            ray = point.ray_towards(scattered.wi);
        }
    }

    /// Random numbers for what becomes of a vertex at the lens: its own, so that they are the same whatever else is used.
    fn lens_random(&self, path: u32, edges: u32) -> PathRandom {
        let vertex = u64::from(path) << 32 | u64::from(edges);
        PathRandom::new(self.job.seed, self.job.iteration, Stream::Lens, vertex)
    }

    /// The sums at the start of a light path. Its edge still lacks the density with which the start is connected with, which depends
    /// on the first vertex.
    fn first_light_partial(&self, start: &EmissionSample) -> Partial {
        let (along, across) = (start.pdf_direction, start.pdf_position);
        let found = match &start.origin {
            Origin::Area(_, point) => point.geometric_normal.dot(start.ray.direction) / (along * across),
            _ if start.origin.is_hit_by_chance() => 1.0 / (along * across),
            _ => 0.0,
        };
        Partial {
            edge: 1.0 / if start.origin.is_infinite() { across } else { along },
            before: found,
        }
    }

    /// Connects the end of a light path with the lens (`t = 1`).
    fn connect_with_lens(&self, tracer: &mut Tracer, end: &LightVertex, random: &mut PathRandom, out: &mut Chunk) {
        let (s, vertex) = (end.edges + 1, &end.vertex);
        if !self.uses(s, 1) {
            return;
        }
        let Some(seen) = tracer.scene.sensor.sample_we(vertex.point.position, random.next_2d()) else {
            return;
        };
        let f = vertex.eval(seen.direction);
        if f.is_black() {
            return;
        }
        // Density of camera rays by area at the vertex.
        let cos = vertex.cos_geometric(seen.direction);
        let pdf_area = seen.pdf_area() * cos;
        let more_camera = end.partial.over_connection(
            pdf_area,
            vertex.pdf_rev(seen.direction),
            self.light_edges.of(end.edges),
            self.merges,
        );
        let hits_lens = seen.pdf.pdf_lens.map_or(0.0, |pdf_lens| {
            vertex.pdf(seen.direction) * seen.pdf.cos / (sqr(seen.distance) * pdf_lens)
        });
        let camera_paths = self.plan.samples as f32 / self.plan.light_paths as f32;
        let share = self.share(more_camera * camera_paths + hits_lens);
        let value = end.flux * f * (pdf_area * share);
        if value.is_black() || tracer.occluded(&vertex.point.shadow_ray(seen.direction, seen.visible_distance())) {
            return;
        }
        self.splat(&seen, value, random, out);
    }

    /// Importance of the lens for a light path that hits it (`t = 0`) [1/(W per radiance)], times its share.
    fn lens_share(&self, seen: &SensorSample, partial: Partial, edges: u32, parallel: bool) -> f32 {
        let pdf_lens = seen.pdf.pdf_lens.unwrap_or(0.0);
        let distance2 = if parallel { 1.0 } else { sqr(seen.distance) };
        let at_lens = partial.arrived(distance2, seen.pdf.cos);
        // Nothing connects a light with the lens directly.
        let connected = if edges == 1 { 0.0 } else { at_lens.edge };
        let camera_paths = self.plan.samples as f32 / self.plan.light_paths as f32;
        let others = pdf_lens * (connected + camera_paths * seen.pdf.pdf * at_lens.before);
        pdf_lens * seen.pdf.pdf / seen.pdf.cos * self.share(others)
    }

    /// Gives `value` to one of the pixels about the place where the camera sees the path.
    fn splat(&self, seen: &SensorSample, value: Spectrum, random: &mut PathRandom, out: &mut Chunk) {
        let film = &self.job.scene.film;
        if let Some((pixel, factor)) = film.filter.choose_pixel(seen.pixel, film.resolution, random.next_2d()) {
            out.splats.push(Splat {
                pixel: pixel as u32,
                value: value * factor,
            });
        }
    }
}
