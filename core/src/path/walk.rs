//! The walk of a subpath from vertex to vertex.

mod crossed;

pub(crate) use crossed::Crossed;

use super::expression::{ANY, AT_LIGHT, States};
use super::{Scattered, Tracer, Vertex, Way};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::EmissionSample;
use crate::material::TransportMode;
use crate::math::{Vec3, sqr};
use crate::medium::{Carried, Space};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::{CHANNELS, Spectrum};

/// Edges after which subpaths face Russian roulette, as Mitsuba's `rr_depth`.
const ROULETTE_EDGES: u32 = 5;

/// Highest probability of surviving Russian roulette, as Mitsuba's.
const ROULETTE_SURVIVAL: f32 = 0.95;

/// A subpath on its way.
pub(crate) struct Walk {
    /// Of the next edge, or of the part of it that is left.
    pub(crate) ray: Ray,
    /// What the subpath carries along the ray: from the camera, the share of the ray's radiance that reaches it; from a light,
    /// flux \[W\].
    pub(crate) carried: Carried,
    /// Edges that have been traced.
    pub(crate) edges: u32,
    /// Of these, those that limits of the length of paths count: in scenes with media an edge counts with the one before where the subpath has
    /// gone straight on through a pane or a mask, as in Mitsuba's `volpath`.
    pub(crate) counted_edges: u32,
    /// Whether the next edge counts with the one before.
    straight: bool,
    /// What media on the last edge have sent to a camera subpath by themselves, its weights applied.
    pub(crate) glow: Spectrum,
    /// Length of the last edge up to the ray, where it goes on behind what bounds a medium \[scene units\].
    passed: f32,
    /// What stands for the share of light that comes through the last edge where techniques are weighed: a function of the edge alone.
    pub(crate) expected_transmittance: f32,
    mode: TransportMode,
    /// Where it is among the words of the scene's path expression.
    pub(crate) states: States,
    /// Index of refraction at the end over that at the start.
    eta: f32,
    /// What the ray goes through.
    space: Space,
    /// The channel that chooses where media scatter the subpath.
    hero: usize,
    /// Where media do not scatter the subpath, what it has crossed of them.
    crossed: Option<Vec<Crossed>>,
    /// Whether the scene has media.
    in_media: bool,
}

/// What the next edge of a subpath ends at.
pub(crate) enum Met {
    Surface(SurfacePoint),
    /// Where a medium scatters.
    Medium(MediumPoint),
    Nothing,
}

/// A place in a medium.
pub(crate) struct MediumPoint {
    position: Vec3,
    /// Along the ray.
    distance: f32,
}

impl Met {
    /// The point of a surface.
    #[inline]
    pub(crate) fn surface(&self) -> Option<&SurfacePoint> {
        match self {
            Self::Surface(point) => Some(point),
            Self::Medium(_) | Self::Nothing => None,
        }
    }

    /// Whether the subpath leaves the scene.
    #[inline]
    pub(crate) fn is_nothing(&self) -> bool {
        matches!(self, Self::Nothing)
    }
}

impl Walk {
    /// A camera subpath that starts with `ray`.
    #[inline]
    pub(crate) fn from_camera(scene: &Scene, ray: Ray, random: &mut PathRandom) -> Self {
        Self {
            space: scene.space_of_camera(),
            ..Self::new(scene, ray, Spectrum::ONE, TransportMode::Radiance, random)
        }
    }

    /// A light subpath.
    #[inline]
    pub(crate) fn from_light(scene: &Scene, start: &EmissionSample, random: &mut PathRandom) -> Self {
        Self {
            space: scene.space_of_light(start),
            ..Self::new(scene, start.ray, start.flux, TransportMode::Flux, random)
        }
    }

    #[inline]
    fn new(scene: &Scene, ray: Ray, weight: Spectrum, mode: TransportMode, random: &mut PathRandom) -> Self {
        Self {
            ray,
            carried: Carried::new(weight),
            edges: 0,
            counted_edges: 0,
            straight: false,
            glow: Spectrum::ZERO,
            passed: 0.0,
            expected_transmittance: 1.0,
            mode,
            states: match mode {
                TransportMode::Radiance => scene.states_at_camera(),
                TransportMode::Flux => scene.paths.as_ref().map_or(ANY, |_| AT_LIGHT),
            },
            eta: 1.0,
            space: Space::EMPTY,
            in_media: scene.media.is_some(),
            hero: match &scene.media {
                Some(media) if !media.grey => (random.next_1d() * CHANNELS as f32) as usize,
                _ => 0,
            },
            crossed: None,
        }
    }

    /// Traces the next edge to what it ends at.
    #[inline]
    pub(crate) fn advance(&mut self, tracer: &mut Tracer, random: &mut PathRandom) -> Met {
        self.edges += 1;
        self.counted_edges = self.counted_with_next();
        let point = self.intersect(tracer);
        if tracer.scene.media.is_none() {
            return point.map_or(Met::Nothing, Met::Surface);
        }
        self.glow = Spectrum::ZERO;
        self.passed = 0.0;
        self.expected_transmittance = 1.0;
        self.fly(tracer.scene, point, random)
    }

    /// Goes on with the same edge through a surface that bounds a medium and does nothing else, or that a body covers; `None` where the
    /// surface is another.
    #[inline]
    pub(crate) fn pass(&mut self, tracer: &mut Tracer, met: &Met, random: &mut PathRandom) -> Option<Met> {
        tracer.scene.media.as_ref()?;
        let direction = self.ray.direction;
        let point = met
            .surface()
            .filter(|point| tracer.scene.is_passed(point, self.space, direction))?;
        self.passed += point.distance;
        let behind = self.way().behind(tracer.scene, point);
        (self.ray, self.space) = (behind.ray, behind.space);
        let behind = self.intersect(tracer);
        Some(self.fly(tracer.scene, behind, random))
    }

    /// Whether the next edge may belong to a path of at most `most` edges that count.
    #[inline]
    pub(crate) fn has_edge_left(&self, most: u32) -> bool {
        self.counted_with_next() <= most
    }

    /// Whether the last edge may be followed by one, in a path of at most `most` edges that count.
    #[inline]
    pub(crate) fn may_go_on(&self, most: u32) -> bool {
        self.counted_edges < most || self.in_media
    }

    #[inline]
    fn intersect(&self, tracer: &mut Tracer) -> Option<SurfacePoint> {
        match self.edges == 1 && self.mode == TransportMode::Radiance {
            true => tracer.intersect_from_camera(&self.ray),
            false => tracer.intersect(&self.ray),
        }
    }

    /// Goes through the medium before `point`, or before nothing.
    fn fly(&mut self, scene: &Scene, point: Option<SurfacePoint>, random: &mut PathRandom) -> Met {
        let end = point.map_or(Met::Nothing, Met::Surface);
        let Some((id, medium)) = scene.medium(self.space) else {
            return end;
        };
        let distance = point.map_or(self.ray.max_distance, |point| point.distance);
        if self.crosses_media() {
            self.cross(scene, (id, medium), distance, random);
            return end;
        }
        let flight = medium.fly(&self.ray, distance, self.hero, &mut self.carried, random);
        self.glow += flight.glow;
        let flown = flight.scattered_at.unwrap_or(distance);
        self.expected_transmittance *= medium.expected_transmittance(flown);
        match flight.scattered_at {
            Some(distance) => Met::Medium(MediumPoint {
                position: self.ray.origin + self.ray.direction * distance,
                distance,
            }),
            None => end,
        }
    }

    /// The length of the last edge, which has come to `met` \[scene units\].
    #[inline]
    pub(crate) fn length(&self, met: &Met) -> f32 {
        let rest = match met {
            Met::Surface(point) => point.distance,
            Met::Medium(point) => point.distance,
            Met::Nothing => f32::INFINITY,
        };
        self.passed + rest
    }

    /// The way that the next edge takes.
    pub(crate) fn way(&self) -> Way {
        Way {
            ray: self.ray,
            length: f32::INFINITY,
            space: self.space,
        }
    }

    /// The vertex at the end of the edge; `None` where the edge ends nowhere.
    #[inline(always)]
    pub(crate) fn arrive<'s>(&mut self, scene: &'s Scene, met: &Met) -> Option<Vertex<'s>> {
        let wo = -self.ray.direction;
        let mut vertex = match met {
            Met::Surface(point) => {
                let mut vertex = Vertex::new(scene, *point, wo, self.mode);
                if scene.media.is_some() {
                    let sides = scene.sides(point, self.space, self.ray.direction);
                    vertex.stand(sides, scene.index_outside(point, &sides));
                }
                vertex
            }
            Met::Medium(point) => {
                let (_, medium) = scene.medium(self.space)?;
                Vertex::in_medium(point.position, self.space, &medium.phase, wo, self.mode)
            }
            Met::Nothing => return None,
        };
        if self.mode == TransportMode::Flux {
            self.carried.scale(vertex.arrival_correction());
        }
        vertex.beta = self.carried.beta();
        vertex.edges = self.edges;
        vertex.counted_edges = self.counted_edges;
        if let Some(paths) = &scene.paths {
            vertex.note(paths, self.states);
        }
        Some(vertex)
    }

    /// Goes on in a direction sampled at the last vertex, unless Russian roulette ends the subpath there. Roulette goes by all that a
    /// camera subpath carries, and by the share that a light subpath keeps at the vertex.
    #[inline(always)]
    pub(crate) fn go_on(&mut self, vertex: &Vertex, scattered: &Scattered, random: &mut PathRandom) -> bool {
        self.ray = vertex.ray_towards(scattered.wi);
        self.space = vertex.space_towards(scattered.wi);
        self.straight = self.in_media && vertex.goes_straight(scattered);
        self.states = match scattered.bsdf.delta {
            true => vertex.states.delta,
            false => vertex.states.smooth,
        };
        let young = self.edges < ROULETTE_EDGES;
        let survival = match self.mode {
            TransportMode::Radiance => {
                self.carried.turned(scattered.weight());
                self.eta *= scattered.bsdf.eta;
                if young {
                    return !self.carried.is_black();
                }
                (self.carried.beta().max_component() * sqr(self.eta)).min(ROULETTE_SURVIVAL)
            }
            TransportMode::Flux => {
                self.carried.turned(vertex.continuation_weight(scattered));
                let kept = self.carried.beta().max_component() / vertex.beta.max_component();
                kept.min(if young { 1.0 } else { ROULETTE_SURVIVAL })
            }
        };
        let survives = !self.carried.is_black() && random.next_choice() < f64::from(survival);
        if survives {
            self.carried.scale(1.0 / survival);
        }
        survives
    }
}
