//! The ends of light paths in media: what photon surfaces are made of.

use super::lamp::{Lamp, Line};
use super::rates::Rates;
use super::technique::Chain;
use crate::density::count_edges;
use crate::geometry::{Ray, SurfacePoint};
use crate::light::{EmissionSample, LightId, Lights, Origin};
use crate::math::warp::square_to_sphere;
use crate::math::{Frame, TAU, Vec2, Vec3, safe_sqrt, sin_cos};
use crate::medium::{Medium, MediumId, Space};
use crate::path::{ANY, AT_LIGHT, Event, Piece, States, Tracer, Vertex, Walk, Way};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;
use std::sync::Arc;

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
    /// At an area light which photon surfaces sweep over, too.
    Lamp(Box<Sweep>),
    /// At a surface, which scatters light into all directions that it does.
    Surface(Box<Vertex<'s>>),
}

/// A start on an area light, and what has been drawn for sweeping over it.
pub(super) struct Sweep {
    light: LightId,
    point: SurfacePoint,
    start: EmissionSample,
    pub(super) lamp: Arc<Lamp>,
    /// In which copies of the light are moved: for a plane that of the tail.
    pub(super) direction: Vec3,
    /// A random line on a rectangle.
    pub(super) line: Option<Line>,
}

/// The directions into which light leaves a light or a surface, about an axis. The azimuth is uniform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Spread {
    /// Those on the side of the axis, in proportion to the cosine.
    OneSide,
    /// All, in proportion to the cosine without its sign.
    BothSides,
    /// Those of a cosine of at least this with the axis, evenly.
    Cone(f32),
}

impl Spread {
    /// The least cosine with the axis.
    pub(super) fn least_cosine(self) -> f32 {
        match self {
            Self::OneSide => 0.0,
            Self::BothSides => -1.0,
            Self::Cone(least) => least,
        }
    }

    /// The density of a direction of this cosine with the axis \[1/sr\].
    pub(super) fn pdf(self, cosine: f32) -> f32 {
        let of_cosine = match self {
            Self::OneSide => 2.0 * cosine.max(0.0),
            Self::BothSides => cosine.abs(),
            Self::Cone(least) if cosine >= least => 1.0 / (1.0 - least),
            Self::Cone(_) => 0.0,
        };
        of_cosine / TAU
    }

    fn sample_cosine(self, u: f32) -> f32 {
        match self {
            Self::OneSide => safe_sqrt(u),
            Self::BothSides => {
                let signed = 2.0 * u - 1.0;
                safe_sqrt(signed.abs()).copysign(signed)
            }
            Self::Cone(least) => 1.0 - u * (1.0 - least),
        }
    }
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
    /// Unit vectors. Those of segments before the first repeat the axis about which the first was drawn.
    pub(super) directions: [Vec3; 3],
    /// How the direction of a single segment is drawn.
    pub(super) spread: Spread,
    /// A direction for the last of three segments that is drawn about that of the first.
    pub(super) aside: Vec3,
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

impl<'s> Tail<'s> {
    /// The tail of a light, with directions about its normal, or about the axis of its cone. `lamps` are the scene's, each at the number of its
    /// light, where surfaces sweep over them.
    pub(super) fn of_light(
        scene: &Scene,
        start: &EmissionSample,
        lamps: &[Option<Arc<Lamp>>],
        random: &mut PathRandom,
    ) -> Option<Self> {
        let states = scene.paths.as_ref().map_or(ANY, |_| AT_LIGHT);
        let (at, axis, spread) = match &start.origin {
            Origin::Area(_, point) => (point.position, point.geometric_normal, Spread::OneSide),
            Origin::Point(light) => {
                let (axis, least) = scene.lights.cone(*light).unwrap_or((Vec3::Z, -1.0));
                (start.ray.origin, axis, Spread::Cone(least))
            }
            _ => return None,
        };
        let rates = Rates::of_first([scene.space_of_light(start)], scene);
        let counted = (1, states);
        let mut tail = Self::free(
            Stem::Light(Box::new(*start)),
            rates,
            (at, axis, spread),
            Spectrum::ONE,
            counted,
            random,
        );
        if let Origin::Area(light, point) = start.origin
            && let Some(Some(lamp)) = lamps.get(light.0 as usize)
        {
            let direction = match lamp.is_plane {
                true => tail.directions[0],
                false => square_to_sphere(random.next_2d()),
            };
            tail.stem = Stem::Lamp(Box::new(Sweep {
                light,
                point,
                start: *start,
                lamp: lamp.clone(),
                direction,
                line: lamp.rectangle.and_then(|rectangle| rectangle.random_line(random)),
            }));
        }
        Some(tail)
    }

    /// The tail of a surface that scatters light, with directions about its normal.
    pub(super) fn of_surface(
        scene: &Scene,
        vertex: &Vertex<'s>,
        point: &SurfacePoint,
        random: &mut PathRandom,
    ) -> Self {
        let towards_wo = point.geometric_normal * vertex.wo.dot(point.geometric_normal).signum();
        let spread = match scene.material(point).transmits() {
            true => Spread::BothSides,
            false => Spread::OneSide,
        };
        let sides = [towards_wo, -towards_wo].map(|direction| vertex.space_towards(direction));
        let rates = Rates::of_first(sides, scene);
        let counted = (vertex.counted_edges + 1, vertex.states.smooth);
        let stem = Stem::Surface(Box::new(vertex.clone()));
        let start = (point.position, towards_wo, spread);
        Self::free(stem, rates, start, vertex.beta, counted, random)
    }

    /// A tail of one segment in a direction of a spread.
    fn free(
        stem: Stem<'s>,
        rates: Rates,
        (start, axis, spread): (Vec3, Vec3, Spread),
        flux: Spectrum,
        (edges, states): (u32, States),
        random: &mut PathRandom,
    ) -> Self {
        let cosine = spread.sample_cosine(random.next_1d());
        let direction = about(axis, cosine, random.next_1d());
        Self {
            stem,
            kind: Kind::One,
            start,
            flux,
            space: Space::EMPTY,
            rates,
            directions: [direction, axis, axis],
            spread,
            aside: axis,
            lengths: [rates.sample(random), 0.0, 0.0],
            end: f32::INFINITY,
            edges: count_edges(edges),
            states,
        }
    }

    /// The area light of the tail, where surfaces sweep over it.
    pub(super) fn sweep(&self) -> Option<&Sweep> {
        match &self.stem {
            Stem::Lamp(sweep) => Some(sweep),
            _ => None,
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

    /// What of the light goes along the first segment of a chain, per solid angle and by the density of its start \[W/sr\].
    pub(super) fn sent(&self, lights: &Lights, chain: &Chain) -> Spectrum {
        let direction = chain.directions[self.kind.first()];
        let from_area = |light, point: &SurfacePoint, pdf_position: f32| {
            let cosine = direction.dot(point.geometric_normal).max(0.0);
            lights.emitted(light, point, direction) * (cosine / pdf_position)
        };
        match &self.stem {
            Stem::Edge => self.flux,
            Stem::Lamp(sweep) => from_area(sweep.light, sweep.point_of(chain), sweep.start.pdf_position),
            Stem::Light(start) => match &start.origin {
                Origin::Area(light, point) => from_area(*light, point, start.pdf_position),
                Origin::Point(light) => lights.intensity(*light, direction) * (1.0 / start.pdf_position),
                _ => Spectrum::ZERO,
            },
            Stem::Surface(vertex) => self.flux * vertex.eval(direction) * vertex.cos_geometric(direction),
        }
    }

    /// What comes through along the first segment of a chain, and what its end lies in; `None` where something is in the way.
    pub(super) fn through_first(
        &self,
        chain: &Chain,
        tracer: &mut Tracer,
        random: &mut PathRandom,
    ) -> Option<(Spectrum, Space)> {
        let scene = tracer.scene;
        let first = self.kind.first();
        let (direction, length) = (chain.directions[first], chain.lengths[first]);
        let mut follow = |start: EmissionSample| {
            let space = scene.space_of_light(&start);
            let way = Way {
                ray: start.ray,
                length,
                space,
            };
            tracer.follow(&way.up_to(length), random)
        };
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
            Stem::Light(start) => follow(EmissionSample {
                ray: match &start.origin {
                    Origin::Area(_, point) => point.ray_towards(direction),
                    _ => Ray { direction, ..start.ray },
                },
                ..**start
            }),
            Stem::Lamp(sweep) => {
                let point = sweep.point_of(chain);
                follow(EmissionSample {
                    ray: point.ray_towards(direction),
                    origin: Origin::Area(sweep.light, *point),
                    ..sweep.start
                })
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
        let phase = &self.inside.medium.phase;
        let mut scatter = |from: Vec3| {
            let choice = random.next_1d();
            phase.sample(-from, choice, random.next_2d())
        };
        let mut directions = [self.ray.direction; 3];
        for segment in (0..first).rev() {
            directions[segment] = scatter(directions[segment + 1]);
        }
        let aside = scatter(self.ray.direction);
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
            spread: Spread::OneSide,
            aside,
            lengths,
            end: self.ray.max_distance,
            edges: count_edges(edges + first as u32),
            states,
        }
    }
}

impl Sweep {
    /// Where on the light a chain starts.
    fn point_of<'c>(&'c self, chain: &'c Chain) -> &'c SurfacePoint {
        chain.start.as_ref().unwrap_or(&self.point)
    }

    /// The unit normal on the side that emits.
    pub(super) fn normal(&self) -> Vec3 {
        self.point.geometric_normal
    }
}

/// The direction of this cosine with an axis, at the part `u` of the way about it.
fn about(axis: Vec3, cosine: f32, u: f32) -> Vec3 {
    let sine = safe_sqrt(1.0 - cosine * cosine);
    let (sin_phi, cos_phi) = sin_cos(TAU * u);
    let local: Vec2 = Vec2::new(cos_phi, sin_phi) * sine;
    Frame::from_normal(axis).to_world(Vec3::new(local.x, local.y, cosine))
}
