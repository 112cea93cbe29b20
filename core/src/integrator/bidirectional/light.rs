//! Light subpaths: their vertices, which camera paths are connected and merged with, and what they give to pixels themselves.

use super::merge::MergePayload;
use super::{Counts, End, Estimator, Observer, RenderError, Splat};
use crate::density::{Point, count_edges};
use crate::integrator::light_paths::{self, CHUNK};
use crate::light::{EmissionSample, Origin};
use crate::math::sqr;
use crate::path::{Met, Partial, Passed, Towards, Tracer, Walk, Way};
use crate::random::{PathRandom, Stream};
use crate::sensor::SensorSample;
use crate::spectrum::Spectrum;

/// The light paths of an iteration, in chunks of [`CHUNK`].
pub(super) struct LightPaths<'s> {
    chunks: Vec<Chunk<'s>>,
}

#[derive(Default)]
pub(super) struct Chunk<'s> {
    vertices: Vec<End<'s>>,
    /// For each path, where its vertices end.
    ends: Vec<u32>,
    merge_points: Vec<Point<MergePayload>>,
    splats: Vec<Splat>,
}

#[cfg(test)]
impl<'s> Chunk<'s> {
    pub(super) fn vertices(&self) -> &[End<'s>] {
        &self.vertices
    }
}

impl<'s> LightPaths<'s> {
    /// Vertices of a path that are no delta functions.
    pub(super) fn vertices(&self, path: u32) -> &[End<'s>] {
        let chunk = &self.chunks[(path / CHUNK) as usize];
        let index = (path % CHUNK) as usize;
        let start = index.checked_sub(1).map_or(0, |before| chunk.ends[before]);
        &chunk.vertices[start as usize..chunk.ends[index] as usize]
    }

    pub(super) fn take_merge_points(&mut self) -> Vec<Vec<Point<MergePayload>>> {
        self.chunks
            .iter_mut()
            .map(|chunk| std::mem::take(&mut chunk.merge_points))
            .collect()
    }

    pub(super) fn splats(&self) -> impl Iterator<Item = &Splat> {
        self.chunks.iter().flat_map(|chunk| &chunk.splats)
    }
}

impl<'a> Estimator<'a> {
    /// Traces all light paths on the current rayon pool.
    pub(super) fn trace_light(
        &self,
        observer: &dyn Observer,
        counts: &mut Counts,
    ) -> Result<LightPaths<'a>, RenderError> {
        let paths = light_paths::LightPaths {
            sequence: self.job.light_sequence(self.plan.light_paths),
            range: 0..self.plan.light_paths,
            max_edges: self.plan.max_edges,
        };
        let scene = self.job.scene;
        let chunks = paths.trace_with(
            scene,
            observer,
            counts,
            |tracer, path, start, random, out: &mut Chunk| {
                if let Some(start) = start {
                    self.trace_light_path(tracer, path, &start, random, out);
                }
                out.ends.push(out.vertices.len() as u32);
            },
        )?;
        counts.records_stored += chunks.iter().map(|chunk| chunk.vertices.len() as u64).sum::<u64>();
        Ok(LightPaths { chunks })
    }

    pub(super) fn trace_light_path(
        &self,
        tracer: &mut Tracer<'a>,
        path: u32,
        start: &EmissionSample,
        random: &mut PathRandom,
        out: &mut Chunk<'a>,
    ) {
        let scene = tracer.scene;
        let infinite = start.origin.is_infinite();
        let mut walk = Walk::from_light(scene, start, random);
        let mut partial = self.first_light_partial(start);
        while walk.has_edge_left(self.plan.max_edges) {
            let (carried, way) = (walk.carried.beta(), walk.way());
            let met = light_paths::advance(&mut walk, tracer, random);
            let edges = walk.edges;
            let parallel = infinite && edges == 1;
            if self.uses(edges + 1, 0) && walk.states & scene.states_at_camera() != 0 {
                let mut random = self.lens_random(path, edges);
                if let Some((seen, passed)) = hit_lens(tracer, way, &met, parallel, &mut random) {
                    let value =
                        carried * passed.share * self.lens_share(&seen, partial, edges, parallel, passed.expected);
                    self.splat(&seen, value, &mut random, out);
                }
            }
            if !walk.may_go_on(self.plan.max_edges) {
                return;
            }
            let Some(vertex) = walk.arrive(scene, &met) else { return };
            let distance2 = if parallel { 1.0 } else { sqr(walk.length(&met)) };
            if edges == 1 {
                partial.edge *= scene
                    .lights
                    .connection_over_emission(&scene.geometry, start, vertex.position());
                partial.before *= f32::from(u8::from(self.plan.techniques.hit));
            }
            partial = partial.arrived(distance2, vertex.cos_geometric(vertex.wo), walk.expected_transmittance);
            let end = End { vertex, partial };
            let vertex = &end.vertex;
            if !vertex.is_delta() {
                self.connect_with_lens(tracer, &end, &mut self.lens_random(path, edges), out);
                if let Some(point) = vertex.surface().filter(|_| self.merge_radius.is_some()) {
                    let payload = MergePayload {
                        wi: vertex.wo,
                        flux: vertex.beta,
                        edges: count_edges(vertex.counted_edges),
                        states: vertex.states.arrived,
                        partial: Partial {
                            edge: partial.edge * self.light_edges.of(edges),
                            ..partial
                        },
                    };
                    out.merge_points.push(Point {
                        position: point.position,
                        payload,
                    });
                }
                if self.plan.techniques.connect {
                    out.vertices.push(end.clone());
                }
            }
            let Some(scattered) = vertex.sample(random) else {
                return;
            };
            if !walk.go_on(vertex, &scattered, random) {
                return;
            }
            partial = self.partial_after(vertex, partial, self.light_edges.of(edges), &scattered);
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
    fn connect_with_lens(&self, tracer: &mut Tracer, end: &End, random: &mut PathRandom, out: &mut Chunk) {
        let vertex = &end.vertex;
        if vertex.counted_edges == self.plan.max_edges || !self.uses(vertex.edges + 1, 1) {
            return;
        }
        let scene = tracer.scene;
        if vertex.states.smooth & scene.states_at_camera() == 0 {
            return;
        }
        if scene.hide_emitters && vertex.surface().is_some_and(|point| scene.light_at(point).is_some()) {
            return;
        }
        let Some(seen) = tracer.scene.sample_we(vertex.position(), random.next_2d()) else {
            return;
        };
        let Towards { f, pdf, pdf_rev } = vertex.towards(seen.direction);
        if f.is_black() {
            return;
        }
        // Density of camera rays by area at the vertex.
        let cos = vertex.cos_geometric(seen.direction);
        let pdf_area = seen.pdf_area() * cos;
        let way = vertex.way_to(seen.direction, seen.visible_distance());
        let passed = tracer.transmittance_to_camera(&way, random);
        if passed.share.is_black() {
            return;
        }
        let more_camera = end.partial.over_connection(
            pdf_area * passed.expected,
            pdf_rev,
            self.light_edges.of(vertex.edges),
            self.merges_at(vertex),
        );
        let hits_lens = seen.pdf.pdf_lens.map_or(0.0, |pdf_lens| {
            pdf * passed.expected * seen.pdf.cos / (sqr(seen.distance) * pdf_lens)
        });
        let camera_paths = self.plan.samples as f32 / self.plan.light_paths as f32;
        let share = self.share(more_camera * camera_paths + hits_lens);
        let value = vertex.beta * f * (pdf_area * share);
        if !value.is_black() {
            self.splat(&seen, value * passed.share, random, out);
        }
    }

    /// Importance of the lens for a light path that hits it (`t = 0`) [1/(W per radiance)], times its share.
    fn lens_share(&self, seen: &SensorSample, partial: Partial, edges: u32, parallel: bool, passed: f32) -> f32 {
        let pdf_lens = seen.pdf.pdf_lens.unwrap_or(0.0);
        let distance2 = if parallel { 1.0 } else { sqr(seen.distance) };
        let at_lens = partial.arrived(distance2, seen.pdf.cos, passed);
        // Nothing connects a light with the lens directly.
        let connected = if edges == 1 { 0.0 } else { at_lens.edge };
        let camera_paths = self.plan.samples as f32 / self.plan.light_paths as f32;
        let others = pdf_lens * (connected + camera_paths * seen.pdf.pdf * at_lens.before);
        pdf_lens * seen.pdf.pdf / seen.pdf.cos * self.share(others)
    }

    /// Gives `value` to one of the pixels about the place where the camera sees the path.
    fn splat(&self, seen: &SensorSample, value: Spectrum, random: &mut PathRandom, out: &mut Chunk) {
        let film = &self.job.scene.film;
        let chosen = film.filter.choose_pixel(seen.pixel, film.resolution, random.next_2d());
        if let Some((pixel, factor)) = chosen
            && let Some(pixel) = film.rendered(pixel)
        {
            out.splats.push(Splat {
                pixel: pixel as u32,
                value: value * factor,
            });
        }
    }
}

/// Where the next edge of a light path, which takes `way` and comes to `met`, hits the lens, and what comes through to it.
fn hit_lens(
    tracer: &mut Tracer,
    way: Way,
    met: &Met,
    parallel: bool,
    random: &mut PathRandom,
) -> Option<(SensorSample, Passed)> {
    let scene = tracer.scene;
    if scene.media.is_some() {
        let seen = scene.sensor.hit_lens(&way.ray, f32::INFINITY, parallel)?;
        let passed = tracer.transmittance_to_camera(&way.up_to(seen.visible_distance()), random);
        return Some((seen, passed));
    }
    let free = match scene.hide_emitters {
        true => tracer.intersect_from_camera(&way.ray).map(|point| point.distance),
        false => met.surface().map(|point| point.distance),
    };
    let seen = scene
        .sensor
        .hit_lens(&way.ray, free.unwrap_or(f32::INFINITY), parallel)?;
    Some((seen, Passed::ALL))
}
