//! Camera paths with the light that they find by scattering and by connections with lights, of which each counts with its share.

use crate::geometry::Ray;
use crate::light::Lights;
use crate::math::{DVec2, Vec3};
use crate::path::{AT_LIGHT, Crossed, Met, Scattered, Tracer, Vertex, Walk, power_heuristic};
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
        /// Solid-angle density of the edge's direction \[1/sr\].
        pdf: f32,
    },
    /// Not at all: the integrator has counted it.
    No,
}

/// Which light counts that edges and connections find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Counted {
    All,
    /// That of lights at infinity.
    Beyond,
    Nothing,
}

impl Counted {
    /// Whether light counts that comes from infinity, or does not.
    fn includes(self, from_infinity: bool) -> bool {
        match self {
            Self::All => true,
            Self::Beyond => from_infinity,
            Self::Nothing => false,
        }
    }
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
    counted: Counted,
    pub(super) radiance: Spectrum,
}

impl<'t, 'a> CameraPath<'t, 'a> {
    pub(super) fn new(tracer: &'t mut Tracer<'a>, ray: Ray, random: &'t mut PathRandom, max_edges: u32) -> Self {
        let found = match tracer.scene.hide_emitters {
            true => Found::No,
            false => Found::InFull,
        };
        let walk = Walk::from_camera(tracer.scene, ray, random);
        Self {
            found,
            ..Self::going_on(tracer, walk, random, max_edges)
        }
    }

    /// A path that has come to a vertex.
    pub(super) fn going_on(tracer: &'t mut Tracer<'a>, walk: Walk, random: &'t mut PathRandom, max_edges: u32) -> Self {
        Self {
            tracer,
            random,
            walk,
            max_edges,
            found: Found::InFull,
            counted: Counted::All,
            radiance: Spectrum::ZERO,
        }
    }

    /// From now on no other light counts, but for what media emit.
    pub(super) fn count(&mut self, counted: Counted) {
        self.counted = counted;
    }

    /// From now on media do not scatter the path: it carries on what comes through.
    pub(super) fn cross_media(&mut self) {
        self.walk.cross_media();
    }

    /// The pieces of the last edge in media that the path has crossed.
    pub(super) fn take_crossed(&mut self) -> impl Iterator<Item = Crossed> + '_ {
        self.walk.take_crossed()
    }

    /// The vertex at the end of the edge that was traced last; `None` where it leaves the scene.
    #[inline(always)]
    pub(super) fn arrive(&mut self, met: &Met) -> Option<Vertex<'a>> {
        self.walk.arrive(self.tracer.scene, met)
    }

    /// Traces the last edge and adds the light that it finds.
    pub(super) fn end_with_edge(mut self) -> Spectrum {
        self.trace_edge();
        self.radiance
    }

    /// Traces the next edge, adds the light that it finds, and tells where it ends.
    #[inline(always)]
    pub(super) fn trace_edge(&mut self) -> Met {
        let mut met = self.walk.advance(self.tracer, self.random);
        self.add_found(&met);
        while let Some(behind) = self.walk.pass(self.tracer, &met, self.random) {
            met = behind;
            self.add_found(&met);
        }
        // No connection finds it.
        if self.walk.states & AT_LIGHT != 0 {
            self.radiance += self.walk.glow;
        }
        met
    }

    /// Adds the light of a surface, or of what surrounds the scene, that the edge has come to.
    #[inline(always)]
    fn add_found(&mut self, met: &Met) {
        if self.counted.includes(met.is_nothing()) && self.walk.states & AT_LIGHT != 0 {
            self.radiance += self.found.emission(self.tracer.scene, &self.walk, met);
        }
    }

    /// Adds direct light at a vertex by one connection with a light. A path of as many edges as it may have is connected with none.
    #[inline(always)]
    pub(super) fn add_next_event(&mut self, vertex: &Vertex) {
        if vertex.counted_edges == self.max_edges || vertex.is_delta() {
            return;
        }
        let (choice, u) = (self.random.next_choice(), self.random.next_choice_2d());
        if vertex.states.smooth & AT_LIGHT != 0 {
            let found = self.direct_light(vertex, choice, u);
            self.radiance += found;
        }
    }

    /// What a vertex gives to the camera by a connection with the point of a light that `choice` and `u` choose, with its share.
    fn direct_light(&mut self, vertex: &Vertex, choice: f64, u: DVec2) -> Spectrum {
        let light = self.tracer.sample_light(vertex, choice, u);
        let Some(light) = light.filter(|light| self.counted.includes(light.distance.is_infinite())) else {
            return Spectrum::ZERO;
        };
        let f = vertex.eval(light.wi);
        if f.is_black() {
            return f;
        }
        let passed = self
            .tracer
            .transmittance(&vertex.way_to(light.wi, light.distance), self.random)
            .share;
        if passed.is_black() {
            return passed;
        }
        let found = if light.delta { 0.0 } else { vertex.pdf(light.wi) };
        if self.tracer.scene.media.is_some() {
            // A path that crosses media finds the light whatever they extinguish.
            let finds = if self.walk.crosses_media() {
                Spectrum::ONE
            } else {
                passed
            };
            let beta = self.walk.carried.beta_of_connection(finds, found / light.pdf);
            return beta * (f * passed * light.radiance * (vertex.cos_shading(light.wi) / light.pdf));
        }
        let share = if light.delta {
            1.0
        } else {
            power_heuristic(light.pdf, found)
        };
        vertex.beta * (f * passed * light.radiance * (vertex.cos_shading(light.wi) * share / light.pdf))
    }

    /// Goes on in a direction sampled at the vertex; `None` where the path ends there. Light that the next edge finds counts beside
    /// [`Self::add_next_event`].
    #[inline(always)]
    pub(super) fn go_on(&mut self, vertex: &Vertex) -> Option<Scattered> {
        if !self.walk.may_go_on(self.max_edges) {
            return None;
        }
        let scattered = vertex.sample(self.random)?;
        self.found = match scattered.bsdf.delta {
            true => Found::InFull,
            false => Found::WithShare {
                from: vertex.position(),
                pdf: scattered.bsdf.pdf,
            },
        };
        let goes_on = self.walk.go_on(vertex, &scattered, self.random) && self.walk.has_edge_left(self.max_edges);
        goes_on.then_some(scattered)
    }

    /// Leaves the light that the next edge finds to the integrator, which counts it by other means.
    pub(super) fn count_no_light_on_next_edge(&mut self) {
        self.found = Found::No;
    }
}

impl Found {
    /// What a path brings to the camera of the light emitted against its ray by what it met, or by what surrounds the scene, with its share.
    fn emission(&self, scene: &Scene, walk: &Walk, met: &Met) -> Spectrum {
        let from = match self {
            Self::No => return Spectrum::ZERO,
            Self::InFull => None,
            Self::WithShare { from, pdf } => Some((*from, *pdf)),
        };
        let lights = &scene.lights;
        let weighted = |radiance: Spectrum, connected: &dyn Fn(Vec3) -> f32| match from.filter(|_| !radiance.is_black())
        {
            None => walk.carried.beta() * radiance,
            Some((from, pdf)) if scene.media.is_some() => {
                walk.carried.beta_beside_connection(connected(from) / pdf) * radiance
            }
            Some((from, pdf)) => walk.carried.beta() * (radiance * power_heuristic(pdf, connected(from))),
        };
        let ray = &walk.ray;
        if met.is_nothing() {
            return surroundings(lights, ray, weighted);
        }
        let lamp = met.surface().and_then(|point| Some((point, scene.light_at(point)?)));
        let Some((point, light)) = lamp else {
            return Spectrum::ZERO;
        };
        let radiance = lights.emitted(light, point, -ray.direction);
        weighted(radiance, &|from| lights.pdf_area(&scene.geometry, light, from, point))
    }
}

/// What light that arrives along a ray which hits nothing brings to the camera; `weighted` gives what radiance brings that a connection with
/// a vertex finds with some density.
#[inline(never)]
fn surroundings(lights: &Lights, ray: &Ray, weighted: impl Fn(Spectrum, &dyn Fn(Vec3) -> f32) -> Spectrum) -> Spectrum {
    let found = lights.beyond(ray).map(|beyond| {
        weighted(beyond.radiance(ray.direction), &|from| {
            beyond.pdf_direct(from, ray.direction)
        })
    });
    found.sum()
}
