//! Camera paths with the light that they find by scattering and by connections with lights, of which each counts with its share.

use crate::geometry::{Ray, SurfacePoint};
use crate::light::Lights;
use crate::math::{DVec2, Vec3};
use crate::path::{AT_LIGHT, Scattered, Tracer, Vertex, Walk, power_heuristic};
use crate::random::PathRandom;
use crate::scene::Scene;
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
/// An integrator asks for one edge and its vertex after the other, adds direct light there or what else it knows of, and goes on.
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
        let found = match tracer.scene.hide_emitters {
            true => Found::No,
            false => Found::InFull,
        };
        let walk = Walk::from_camera(tracer.scene, ray);
        Self {
            tracer,
            random,
            walk,
            max_edges,
            found,
            radiance: Spectrum::ZERO,
        }
    }

    /// The vertex at the end of the edge that was traced last.
    #[inline(always)]
    pub(super) fn arrive(&mut self, point: SurfacePoint) -> Vertex {
        self.walk.arrive(self.tracer.scene, point)
    }

    /// Traces the last edge and adds the light that it finds.
    pub(super) fn end_with_edge(mut self) -> Spectrum {
        self.trace_edge();
        self.radiance
    }

    /// Traces the next edge, adds the light that it finds, and gives the point where it ends; `None` where it leaves the scene.
    #[inline(always)]
    pub(super) fn trace_edge(&mut self) -> Option<SurfacePoint> {
        let hit = self.walk.advance(self.tracer);
        if self.walk.states & AT_LIGHT != 0 {
            let emission = self.found.emission(self.tracer.scene, &self.walk.ray, hit.as_ref());
            self.radiance += self.walk.beta * emission;
        }
        hit
    }

    /// Adds direct light at a vertex by one connection with a light. A path of as many edges as it may have is connected with none.
    #[inline(always)]
    pub(super) fn add_next_event(&mut self, vertex: &Vertex) {
        if vertex.edges == self.max_edges || vertex.is_delta() {
            return;
        }
        let (choice, u) = (self.random.next_choice(), self.random.next_choice_2d());
        if vertex.states.smooth & AT_LIGHT != 0 {
            self.radiance += vertex.beta * direct_light(self.tracer, vertex, choice, u);
        }
    }

    /// Goes on in a direction sampled at the vertex; `None` where the path ends there. Light that the next edge finds counts beside
    /// [`Self::add_next_event`].
    #[inline(always)]
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
}

impl Found {
    /// Light emitted against the ray by what it hit, or by what surrounds the scene, with its share.
    fn emission(&self, scene: &Scene, ray: &Ray, hit: Option<&SurfacePoint>) -> Spectrum {
        let (from, pdf) = match self {
            Self::No => return Spectrum::ZERO,
            Self::InFull => (None, 1.0),
            Self::WithShare { from, pdf } => (Some(*from), *pdf),
        };
        let lights = &scene.lights;
        let Some(point) = hit else {
            return surroundings(lights, ray, from, pdf);
        };
        let Some(light) = scene.light_at(point) else {
            return Spectrum::ZERO;
        };
        let radiance = lights.emitted(light, point, -ray.direction);
        match from.filter(|_| !radiance.is_black()) {
            None => radiance,
            Some(from) => radiance * power_heuristic(pdf, lights.pdf_area(&scene.geometry, light, from, point)),
        }
    }
}

/// Light that arrives along a ray that hits nothing, in full, or with its share where `from` is connected with lights and has scattered
/// the ray with the density `pdf`.
#[inline(never)]
fn surroundings(lights: &Lights, ray: &Ray, from: Option<Vec3>, pdf: f32) -> Spectrum {
    let found = lights.beyond(ray).map(|beyond| {
        let radiance = beyond.radiance(ray.direction);
        match from.filter(|_| !radiance.is_black()) {
            None => radiance,
            Some(from) => radiance * power_heuristic(pdf, beyond.pdf_direct(from, ray.direction)),
        }
    });
    found.sum()
}

/// Radiance towards the camera at a vertex by a connection with the point of a light that `choice` and `u` choose, with its share.
fn direct_light(tracer: &mut Tracer, vertex: &Vertex, choice: f64, u: DVec2) -> Spectrum {
    let Some(light) = tracer.sample_light(vertex, choice, u) else {
        return Spectrum::ZERO;
    };
    let f = vertex.eval(light.wi);
    if f.is_black() {
        return f;
    }
    let transmittance = tracer.transmittance(&vertex.point.shadow_ray(light.wi, light.distance));
    if transmittance.is_black() {
        return transmittance;
    }
    let share = if light.delta {
        1.0
    } else {
        power_heuristic(light.pdf, vertex.pdf(light.wi))
    };
    f * transmittance * light.radiance * (vertex.cos_shading(light.wi) * share / light.pdf)
}
