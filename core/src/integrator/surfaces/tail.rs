//! The ends of light paths in media: what photon surfaces are made of.

use super::rates::Rates;
use crate::density::count_edges;
use crate::geometry::{Ray, SurfacePoint};
use crate::light::{EmissionSample, Lights, Origin};
use crate::math::{Frame, TAU, Vec2, Vec3, safe_sqrt, sin_cos};
use crate::medium::{Medium, MediumId, Space};
use crate::path::{ANY, AT_LIGHT, Event, Piece, States, Tracer, Vertex, Walk, Way};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// How the vertices of a tail lie, from where it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// One segment from a light or a surface.
    One,
    /// Two segments from a light or a surface, with a vertex in the medium between.
    Two,
    /// Three segments from any vertex, with two vertices in the medium between.
    Three,
}

/// Where a tail begins.
pub(super) enum Stem<'s> {
    /// On an edge of a light path, which the first segment follows.
    Edge,
    /// At a light, which sends light into all directions that it does.
    Light(Box<EmissionSample>),
    /// At a surface, which scatters light into all directions that it does.
    Surface(Box<Vertex<'s>>),
}

/// The last segments of a light path, as they were drawn.
///
/// Segments are numbered from the end: 0 leads to the place that a camera ray crosses.
pub(super) struct Tail<'s> {
    pub(super) stem: Stem<'s>,
    pub(super) kind: Kind,
    pub(super) start: Vec3,
    /// What arrives at the start, or goes along the first segment there \[W\].
    pub(super) flux: Spectrum,
    /// What the first segment begins in. It is that of an edge on its whole piece.
    space: Space,
    pub(super) rates: Rates,
    /// Unit vectors.
    pub(super) directions: [Vec3; 3],
    /// \[scene units\].
    pub(super) lengths: [f32; 3],
    /// How far the first segment can reach, where the stem is an edge \[scene units\].
    pub(super) end: f32,
    /// Of the whole light path, up to the place that a camera ray crosses.
    pub(super) edges: u8,
    /// Where its path is among the words of the scene's path expression, before it is scattered there.
    pub(super) states: States,
}

impl Kind {
    /// The number of the first segment.
    pub(super) fn first(self) -> usize {
        match self {
            Self::One => 0,
            Self::Two => 1,
            Self::Three => 2,
        }
    }
}

/// The density of the cosine between the axis and a segment that leaves a light or a surface: in proportion to the cosine.
pub(super) fn pdf_of_cosine(cosine: f32) -> f32 {
    cosine.abs()
}

impl<'s> Tail<'s> {
    /// The tail of a light, with directions about its normal, or about any axis.
    pub(super) fn of_light(scene: &Scene, start: &EmissionSample, random: &mut PathRandom) -> Option<Self> {
        let states = scene.paths.as_ref().map_or(ANY, |_| AT_LIGHT);
        let (at, axis) = match &start.origin {
            Origin::Area(_, point) => (point.position, point.geometric_normal),
            Origin::Point(_) => (start.ray.origin, Vec3::Z),
            _ => return None,
        };
        let space = scene.space_of_light(start);
        let stem = Stem::Light(Box::new(*start));
        Some(Self::free(
            scene,
            stem,
            [space, space],
            (at, axis),
            Spectrum::ONE,
            (1, states),
            random,
        ))
    }

    /// The tail of a surface that scatters light, with directions about its normal.
    pub(super) fn of_surface(
        scene: &Scene,
        vertex: &Vertex<'s>,
        point: &SurfacePoint,
        random: &mut PathRandom,
    ) -> Self {
        let axis = point.geometric_normal;
        let spaces = [axis, -axis].map(|direction| vertex.space_towards(direction));
        let counted = (vertex.counted_edges + 1, vertex.states.smooth);
        let stem = Stem::Surface(Box::new(vertex.clone()));
        Self::free(
            scene,
            stem,
            spaces,
            (point.position, axis),
            vertex.beta,
            counted,
            random,
        )
    }

    /// A tail of one segment into any direction.
    fn free(
        scene: &Scene,
        stem: Stem<'s>,
        spaces: [Space; 2],
        (start, axis): (Vec3, Vec3),
        flux: Spectrum,
        (edges, states): (u32, States),
        random: &mut PathRandom,
    ) -> Self {
        let rates = spaces
            .into_iter()
            .find_map(|space| Rates::of(scene.medium(space)?.1))
            .unwrap_or_else(|| {
                let (lower, upper) = scene.geometry.bounds();
                Rates::single(1.0 / (upper - lower).length().max(f32::MIN_POSITIVE))
            });
        // Both signs of the cosine, and each with a density in proportion to it.
        let u = 2.0 * random.next_1d() - 1.0;
        let cosine = safe_sqrt(u.abs()).copysign(u);
        let direction = about(axis, cosine, random.next_1d());
        Self {
            stem,
            kind: Kind::One,
            start,
            flux,
            space: spaces[0],
            rates,
            directions: [direction, axis, axis],
            lengths: [rates.sample(random), 0.0, 0.0],
            end: f32::INFINITY,
            edges: count_edges(edges),
            states,
        }
    }

    /// The place at the end of a segment.
    pub(super) fn after(&self, segment: usize) -> Vec3 {
        (segment..=self.kind.first()).fold(self.start, |place, index| {
            place + self.directions[index] * self.lengths[index]
        })
    }

    /// The place at the start of a segment.
    pub(super) fn before(&self, segment: usize) -> Vec3 {
        match segment == self.kind.first() {
            true => self.start,
            false => self.after(segment + 1),
        }
    }

    /// Whether the first segment ends where it can.
    pub(super) fn is_whole(&self) -> bool {
        self.lengths[self.kind.first()] < self.end
    }

    /// What of the light goes along `direction` from a stem that sends it into all directions, per solid angle \[W/sr\].
    pub(super) fn sent(&self, lights: &Lights, direction: Vec3) -> Spectrum {
        match &self.stem {
            Stem::Edge => self.flux,
            Stem::Light(start) => match &start.origin {
                Origin::Area(light, point) => {
                    let cosine = direction.dot(point.geometric_normal).max(0.0);
                    lights.emitted(*light, point, direction) * (cosine / start.pdf_position)
                }
                Origin::Point(light) => lights.intensity(*light, direction) * (1.0 / start.pdf_position),
                _ => Spectrum::ZERO,
            },
            Stem::Surface(vertex) => self.flux * vertex.eval(direction) * vertex.cos_geometric(direction),
        }
    }

    /// What comes through along the first segment, which leads along `direction`, and what its end lies in; `None` where something is in the way.
    pub(super) fn through_first(
        &self,
        direction: Vec3,
        length: f32,
        tracer: &mut Tracer,
        random: &mut PathRandom,
    ) -> Option<(Spectrum, Space)> {
        let scene = tracer.scene;
        match &self.stem {
            // The piece of an edge lies in one medium, and nothing is in the way.
            Stem::Edge => {
                let (_, medium) = self.medium(scene)?;
                let ray = Ray {
                    origin: self.start,
                    direction,
                    max_distance: length,
                };
                Some((medium.transmittance(&ray, length, random), self.space))
            }
            Stem::Surface(vertex) => tracer.follow(&vertex.way_to(direction, length), random),
            Stem::Light(start) => {
                let ray = match &start.origin {
                    Origin::Area(_, point) => point.ray_towards(direction),
                    _ => Ray { direction, ..start.ray },
                };
                let space = scene.space_of_light(&EmissionSample { ray, ..**start });
                tracer.follow(&Way { ray, length, space }.up_to(length), random)
            }
        }
    }

    /// The medium of the first segment of an edge.
    pub(super) fn medium<'m>(&self, scene: &'m Scene) -> Option<(MediumId, &'m Medium)> {
        scene.medium(self.space)
    }
}

/// Adds the tails that begin on the edge that a light path is about to take: pieces of it in different media have their own.
pub(super) fn add_along<'s>(
    walk: &Walk,
    from_medium: bool,
    tracer: &mut Tracer<'s>,
    random: &mut PathRandom,
    tails: &mut Vec<Tail<'s>>,
) {
    let scene = tracer.scene;
    let mut flux = walk.carried.beta();
    let counted = (walk.counted_with_next(), walk.states);
    tracer.for_each_piece(walk.way(), |inside, ray| {
        let medium = inside.medium;
        if let Some(rates) = Rates::of(medium) {
            let piece = Part { inside, rates, ray };
            tails.push(piece.tail(scene, Kind::Three, flux, counted, random));
            if !from_medium {
                tails.push(piece.tail(scene, Kind::Two, flux, counted, random));
            }
        }
        flux *= medium.transmittance(ray, ray.max_distance, random);
        !flux.is_black()
    });
}

/// A piece of a light path's edge in a medium.
struct Part<'p> {
    inside: Piece<'p>,
    rates: Rates,
    ray: &'p Ray,
}

impl Part<'_> {
    fn tail<'s>(
        &self,
        scene: &Scene,
        kind: Kind,
        flux: Spectrum,
        (edges, states): (u32, States),
        random: &mut PathRandom,
    ) -> Tail<'s> {
        let first = kind.first();
        let mut directions = [self.ray.direction; 3];
        for segment in (0..first).rev() {
            let choice = random.next_1d();
            directions[segment] = self
                .inside
                .medium
                .phase
                .sample(-directions[segment + 1], choice, random.next_2d());
        }
        let lengths = std::array::from_fn(|_| self.rates.sample(random));
        let states = match &scene.paths {
            Some(paths) => (0..first).fold(states, |states, _| paths.after(states, Event::Volume)),
            None => states,
        };
        Tail {
            stem: Stem::Edge,
            kind,
            start: self.ray.origin,
            flux,
            space: self.inside.space,
            rates: self.rates,
            directions,
            lengths,
            end: self.ray.max_distance,
            edges: count_edges(edges + first as u32),
            states,
        }
    }
}

/// The direction of this cosine with an axis, at the part `u` of the way about it.
fn about(axis: Vec3, cosine: f32, u: f32) -> Vec3 {
    let sine = safe_sqrt(1.0 - cosine * cosine);
    let (sin_phi, cos_phi) = sin_cos(TAU * u);
    let local: Vec2 = Vec2::new(cos_phi, sin_phi) * sine;
    Frame::from_normal(axis).to_world(Vec3::new(local.x, local.y, cosine))
}
