//! Camera paths with the light that they find by scattering and by connections with lights, of which each counts with its share.

use crate::geometry::{Ray, SurfacePoint};
use crate::math::Vec3;
use crate::path::{Scattered, Tracer, Vertex, Walk, power_heuristic};
use crate::random::PathRandom;
use crate::spectrum::Spectrum;

/// How light counts that the next edge finds.
enum Found {
    /// In full: nothing else finds it.
    InFull,
    /// With its share: the vertex that the edge leaves is connected with lights too.
    WithShare {
        from: Vec3,
        /// Solid-angle density of the edge's direction [1/sr].
        pdf: f32,
    },
    /// Not at all: the integrator has counted it.
    No,
}

/// A camera path and the radiance that it has found so far.
///
/// An integrator asks for one vertex after the other, adds direct light there or what else it knows of, and goes on.
pub(super) struct CameraPath<'t, 'a> {
    tracer: &'t mut Tracer<'a>,
    random: &'t mut PathRandom,
    walk: Walk,
    /// Most edges of a path.
    max_edges: u32,
    found: Found,
    pub(super) radiance: Spectrum,
}

impl<'t, 'a> CameraPath<'t, 'a> {
    pub(super) fn new(tracer: &'t mut Tracer<'a>, ray: Ray, random: &'t mut PathRandom, max_edges: u32) -> Self {
        Self {
            tracer,
            random,
            walk: Walk::from_camera(ray),
            max_edges,
            found: Found::InFull,
            radiance: Spectrum::ZERO,
        }
    }

    /// Traces the next edge, adds the light that it finds, and gives the vertex where it ends; `None` where it leaves the scene.
    pub(super) fn next_vertex(&mut self) -> Option<Vertex> {
        let point = self.trace_edge()?;
        Some(self.walk.arrive(self.tracer.scene, point))
    }

    /// Traces the last edge and adds the light that it finds.
    pub(super) fn end_with_edge(mut self) -> Spectrum {
        self.trace_edge();
        self.radiance
    }

    fn trace_edge(&mut self) -> Option<SurfacePoint> {
        let hit = self.walk.advance(self.tracer);
        self.radiance += self.walk.beta * self.emission(hit.as_ref());
        hit
    }

    /// Adds direct light at a vertex by one connection with a light. A path of as many edges as it may have is connected with none.
    pub(super) fn add_next_event(&mut self, vertex: &Vertex) {
        if vertex.edges == self.max_edges || vertex.is_delta() {
            return;
        }
        let (choice, u) = (self.random.next_choice(), self.random.next_choice_2d());
        let Some((light, f)) = self.tracer.connect_with_light(vertex, choice, u) else {
            return;
        };
        let share = if light.delta {
            1.0
        } else {
            power_heuristic(light.pdf, vertex.pdf(light.wi))
        };
        self.radiance += vertex.beta * (f * light.radiance * (vertex.cos_shading(light.wi) * share / light.pdf));
    }

    /// Goes on in a direction sampled at the vertex; `None` where the path ends there. Light that the next edge finds counts beside
    /// [`Self::add_next_event`].
    pub(super) fn go_on(&mut self, vertex: &Vertex) -> Option<Scattered> {
        if vertex.edges == self.max_edges {
            return None;
        }
        let scattered = vertex.sample(self.random)?;
        self.found = match scattered.bsdf.delta {
            true => Found::InFull,
            false => Found::WithShare {
                from: vertex.point.position,
                pdf: scattered.bsdf.pdf,
            },
        };
        self.walk.go_on(vertex, &scattered, self.random).then_some(scattered)
    }

    /// Leaves the light that the next edge finds to the integrator, which counts it by other means.
    pub(super) fn count_no_light_on_next_edge(&mut self) {
        self.found = Found::No;
    }

    /// Light emitted back along the edge by what it found, with its share.
    fn emission(&self, hit: Option<&SurfacePoint>) -> Spectrum {
        let (from, pdf) = match self.found {
            Found::No => return Spectrum::ZERO,
            Found::InFull => (None, 1.0),
            Found::WithShare { from, pdf } => (Some(from), pdf),
        };
        let scene = self.tracer.scene;
        let (lights, direction) = (&scene.lights, self.walk.ray.direction);
        let light = hit.map(|point| (scene.light_at(point), point));
        let radiance = match light {
            None => lights.background(direction),
            Some((Some(light), point)) => lights.emitted(light, point, -direction),
            Some((None, _)) => return Spectrum::ZERO,
        };
        let Some(from) = from.filter(|_| !radiance.is_black()) else {
            return radiance;
        };
        let light_pdf = match light {
            Some((Some(light), point)) => lights.pdf_area(&scene.geometry, light, from, point),
            _ => lights.pdf_background(direction),
        };
        radiance * power_heuristic(pdf, light_pdf)
    }
}
