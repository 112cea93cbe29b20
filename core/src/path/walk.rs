//! The walk of a subpath from vertex to vertex.

use super::expression::{ANY, AT_LIGHT, States};
use super::{Scattered, Tracer, Vertex};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::EmissionSample;
use crate::material::TransportMode;
use crate::math::sqr;
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// Edges after which subpaths face Russian roulette, as Mitsuba's `rr_depth`.
const ROULETTE_EDGES: u32 = 5;

/// Highest probability of surviving Russian roulette, as Mitsuba's.
const ROULETTE_SURVIVAL: f32 = 0.95;

/// A subpath on its way.
pub(crate) struct Walk {
    /// Of the next edge.
    pub(crate) ray: Ray,
    /// What the subpath carries along the ray: from the camera, the share of the ray's radiance that reaches it; from a light,
    /// flux \[W\].
    pub(crate) beta: Spectrum,
    /// Edges that have been traced.
    pub(crate) edges: u32,
    mode: TransportMode,
    /// Where it is among the words of the scene's path expression.
    pub(crate) states: States,
    /// Index of refraction at the end over that at the start.
    eta: f32,
}

impl Walk {
    /// A camera subpath that starts with `ray`.
    pub(crate) fn from_camera(scene: &Scene, ray: Ray) -> Self {
        Self {
            ray,
            beta: Spectrum::ONE,
            edges: 0,
            mode: TransportMode::Radiance,
            states: scene.states_at_camera(),
            eta: 1.0,
        }
    }

    /// A light subpath.
    pub(crate) fn from_light(scene: &Scene, start: &EmissionSample) -> Self {
        Self {
            ray: start.ray,
            beta: start.flux,
            edges: 0,
            mode: TransportMode::Flux,
            states: scene.paths.as_ref().map_or(ANY, |_| AT_LIGHT),
            eta: 1.0,
        }
    }

    /// Traces the next edge to the surface that it hits.
    #[inline]
    pub(crate) fn advance(&mut self, tracer: &mut Tracer) -> Option<SurfacePoint> {
        self.edges += 1;
        if self.edges == 1 && self.mode == TransportMode::Radiance {
            return tracer.intersect_from_camera(&self.ray);
        }
        tracer.intersect(&self.ray)
    }

    /// The vertex at the end of the edge.
    #[inline(always)]
    pub(crate) fn arrive(&mut self, scene: &Scene, point: SurfacePoint) -> Vertex {
        let mut vertex = Vertex::new(scene, point, -self.ray.direction, self.mode);
        if self.mode == TransportMode::Flux {
            self.beta *= vertex.arrival_correction();
        }
        vertex.beta = self.beta;
        vertex.edges = self.edges;
        if let Some(paths) = &scene.paths {
            vertex.note(paths, self.states);
        }
        vertex
    }

    /// Goes on in a direction sampled at the last vertex, unless Russian roulette ends the subpath there. Roulette goes by all that a
    /// camera subpath carries, and by the share that a light subpath keeps at the vertex.
    #[inline(always)]
    pub(crate) fn go_on(&mut self, vertex: &Vertex, scattered: &Scattered, random: &mut PathRandom) -> bool {
        self.ray = vertex.point.ray_towards(scattered.wi);
        self.states = match scattered.bsdf.delta {
            true => vertex.states.delta,
            false => vertex.states.smooth,
        };
        let young = self.edges < ROULETTE_EDGES;
        let survival = match self.mode {
            TransportMode::Radiance => {
                self.beta *= scattered.weight();
                self.eta *= scattered.bsdf.eta;
                if young {
                    return !self.beta.is_black();
                }
                (self.beta.max_component() * sqr(self.eta)).min(ROULETTE_SURVIVAL)
            }
            TransportMode::Flux => {
                self.beta = vertex.beta * vertex.continuation_weight(scattered);
                let kept = self.beta.max_component() / vertex.beta.max_component();
                kept.min(if young { 1.0 } else { ROULETTE_SURVIVAL })
            }
        };
        let survives = !self.beta.is_black() && random.next_choice() < f64::from(survival);
        if survives {
            self.beta *= 1.0 / survival;
        }
        survives
    }
}
