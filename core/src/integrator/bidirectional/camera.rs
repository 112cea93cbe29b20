//! Camera subpaths: what they find, and what they are connected and merged with.

use super::light::LightPaths;
use super::merge::MergeQuery;
use super::{End, Estimator, Spectrum};
use crate::integrator::Sample;
use crate::math::{DVec2, FRAC_1_PI, Vec3, sqr};
use crate::path::{AT_LIGHT, Met, Partial, Towards, Tracer, Walk};
use crate::random::PathRandom;

impl<'a> Estimator<'a> {
    /// Estimates the radiance along a camera ray but for merges, which it asks for in `merges`.
    pub(super) fn radiance(
        &self,
        sample: Sample<'a, '_>,
        light: &LightPaths,
        merges: &mut Vec<MergeQuery<'a>>,
    ) -> Spectrum {
        let Sample {
            tracer,
            camera,
            random,
            pixel,
            in_picture,
            index,
            ..
        } = sample;
        let sensor = tracer.scene.pdf_we(&camera);
        let camera_path = in_picture as u64 * u64::from(self.plan.samples) + u64::from(index);
        let light_path = (camera_path % u64::from(self.plan.light_paths)) as u32;
        let mut partial = Partial {
            edge: 1.0 / sensor.pdf,
            // A light path that hits the lens.
            before: sensor.pdf_lens.map_or(0.0, |pdf_lens| {
                self.camera_edges.first * sensor.cos / (pdf_lens * sensor.pdf)
            }),
        };
        let (mut total, mut walk) = (Spectrum::ZERO, Walk::from_camera(tracer.scene, camera.ray, random));
        while walk.has_edge_left(self.plan.max_edges) {
            let from = walk.ray.origin;
            let mut met = walk.advance(tracer, random);
            let edges = walk.edges;
            let finds = self.uses(0, edges + 1) && walk.states & AT_LIGHT != 0;
            loop {
                if finds {
                    total += walk.carried.beta() * self.emission(tracer, &walk, from, &met, partial);
                }
                match walk.pass(tracer, &met, random) {
                    Some(behind) => met = behind,
                    None => break,
                }
            }
            if finds {
                // Nothing else finds it.
                total += walk.glow;
            }
            if !walk.may_go_on(self.plan.max_edges) {
                break;
            }
            let Some(vertex) = walk.arrive(tracer.scene, &met) else {
                break;
            };
            let distance = walk.length(&met);
            let distance2 = match edges {
                1 if sensor.parallel => 1.0,
                1 => sqr(distance + sensor.clipped),
                _ => sqr(distance),
            };
            partial = partial.arrived(distance2, vertex.cos_geometric(vertex.wo), walk.expected_transmittance);
            let end = End { vertex, partial };
            let vertex = &end.vertex;
            if !vertex.is_delta() {
                if self.plan.techniques.next_event {
                    // Drawn also where only other techniques are shown, so that these find what they find beside it.
                    let (choice, u) = (random.next_choice(), random.next_choice_2d());
                    let left = vertex.counted_edges < self.plan.max_edges;
                    if left && self.uses(1, edges + 1) && vertex.states.smooth & AT_LIGHT != 0 {
                        total += vertex.beta * self.next_event(tracer, &end, choice, u, random);
                    }
                }
                for other in light.vertices(light_path) {
                    let light_edges = other.vertex.edges;
                    if other.vertex.states.smooth & vertex.states.smooth == 0 {
                        continue;
                    }
                    let counted = vertex.counted_edges + 1 + other.vertex.counted_edges;
                    if counted <= self.plan.max_edges && self.uses(light_edges + 1, edges + 1) {
                        total += vertex.beta * self.connect(tracer, &end, other, random);
                    }
                }
                if self.merge_radius.is_some() && vertex.surface().is_some() {
                    merges.push(MergeQuery {
                        end: end.clone(),
                        pixel: pixel as u32,
                    });
                }
            }
            let Some(scattered) = vertex.sample(random) else {
                break;
            };
            if !walk.go_on(vertex, &scattered, random) {
                break;
            }
            partial = self.partial_after(vertex, partial, self.camera_edges.of(edges), &scattered);
        }
        total
    }

    /// Light emitted towards the last vertex, at `from`, by what the walk has met (`s = 0`), with its share.
    fn emission(&self, tracer: &Tracer, walk: &Walk, from: Vec3, met: &Met, partial: Partial) -> Spectrum {
        let (scene, lights) = (tracer.scene, &tracer.scene.lights);
        let (ray, edges) = (&walk.ray, walk.edges);
        // Nothing connects a light with the lens directly.
        let connections = if edges == 1 { 0.0 } else { self.light_edges.first };
        let share = |connected: f32, emitted: f32| {
            let others =
                connections * connected * partial.edge / walk.expected_transmittance + emitted * partial.before;
            self.share(others)
        };
        if met.is_nothing() {
            let found = lights.beyond(ray).map(|beyond| {
                let radiance = beyond.radiance(ray.direction);
                if radiance.is_black() {
                    return radiance;
                }
                let (connected, emitted) = beyond.densities(from, ray.direction);
                radiance * share(connected, emitted)
            });
            return found.sum();
        }
        let lamp = met.surface().and_then(|point| Some((point, scene.light_at(point)?)));
        let Some((point, light)) = lamp else {
            return Spectrum::ZERO;
        };
        let radiance = lights.emitted(light, point, -ray.direction);
        if radiance.is_black() {
            return radiance;
        }
        // The density of the direction is its cosine over pi; the cosine turns what the path kept into terms of area.
        let connected = lights.pdf_area(&scene.geometry, light, from, point);
        radiance * share(connected, lights.pdf_emission_position(light) * FRAC_1_PI)
    }

    /// Direct light at the end of a camera path by a connection with a point of a light (`s = 1`).
    fn next_event(&self, tracer: &mut Tracer, end: &End, choice: f64, u: DVec2, random: &mut PathRandom) -> Spectrum {
        let vertex = &end.vertex;
        let Some(light) = tracer.sample_light(vertex, choice, u) else {
            return Spectrum::ZERO;
        };
        let Towards { f, pdf, pdf_rev } = vertex.towards(light.wi);
        if f.is_black() {
            return f;
        }
        let passed = tracer.transmittance(&vertex.way_to(light.wi, light.distance), random);
        if passed.share.is_black() {
            return passed.share;
        }
        let found = match light.delta {
            false if self.plan.techniques.hit => pdf * passed.expected / light.pdf,
            _ => 0.0,
        };
        let more_light = end.partial.over_connection(
            light.arrival * vertex.cos_geometric(light.wi) * passed.expected,
            pdf_rev,
            self.camera_edges.of(vertex.edges),
            self.merges_at(vertex),
        );
        let share = self.share(found + more_light);
        let value = f * light.radiance * (vertex.cos_shading(light.wi) * share / light.pdf);
        value * passed.share
    }

    /// Connects the ends of a camera path and of a light path.
    fn connect(&self, tracer: &mut Tracer, end: &End, other: &End, random: &mut PathRandom) -> Spectrum {
        let (camera, light) = (&end.vertex, &other.vertex);
        let offset = light.position() - camera.position();
        let distance2 = offset.length_squared();
        let distance = distance2.sqrt();
        let wi = offset / distance;
        let (at_camera, at_light) = (camera.towards(wi), light.towards(-wi));
        let f = at_camera.f * at_light.f;
        if f.is_black() || distance2 == 0.0 {
            return Spectrum::ZERO;
        }
        let passed = tracer.transmittance(&camera.way_to(wi, distance), random);
        if passed.share.is_black() {
            return passed.share;
        }
        let per_area = 1.0 / distance2;
        let light_cos = light.cos_geometric(wi);
        let more_camera = other.partial.over_connection(
            at_camera.pdf * light_cos * per_area * passed.expected,
            at_light.pdf_rev,
            self.light_edges.of(light.edges),
            self.merges_at(light),
        );
        let more_light = end.partial.over_connection(
            at_light.pdf * camera.cos_geometric(wi) * per_area * passed.expected,
            at_camera.pdf_rev,
            self.camera_edges.of(camera.edges),
            self.merges_at(camera),
        );
        let share = self.share(more_camera + more_light);
        f * light.beta * (camera.cos_shading(wi) * light_cos * per_area * share) * passed.share
    }
}
