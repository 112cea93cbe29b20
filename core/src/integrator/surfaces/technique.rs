//! The ways to find the end of a light path on a camera ray: what is swept over, the surface that it makes, and its density.

use super::rates::Rates;
use super::shape::{Meeting, Shape};
use super::tail::{Kind, Tail, pdf_of_cosine};
use crate::math::{Frame, TAU, Vec3, safe_sqrt};
use crate::settings::SurfaceKind;

/// What is swept over analytically, besides the distance along the camera's ray (Deng et al. 2019, table 1). Segments of the light
/// path are numbered from its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Technique {
    /// The lengths of two segments.
    Plane(u8, u8),
    /// The last direction.
    Sphere,
    /// The last length, and the angle about the direction before.
    Cone,
    /// The length before the last, and the angle about its direction.
    Cylinder,
    /// The last length, and the cosine with the direction before.
    HalfDisc,
    /// The last direction and length, while the place on the camera's ray is drawn (footnote 2): a connection.
    Connection,
}

/// Segments of a light path that ends on a camera ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chain {
    pub(super) directions: [Vec3; 3],
    pub(super) lengths: [f32; 3],
}

/// What densities of techniques are made of, for one chain and one camera ray.
pub(super) struct Densities {
    kind: Kind,
    chain: Chain,
    /// Of each length, and the probability of a greater one.
    lengths: [f32; 3],
    exceeded: [f32; 3],
    /// Solid-angle density of each direction that is drawn from a phase function; of the first segment 1.
    directions: [f32; 3],
    /// Unit direction of the camera's ray.
    ray: Vec3,
    /// Density with which a connection chooses the place on the camera's ray.
    place: f32,
}

const OF_ONE: [Technique; 3] = [Technique::Sphere, Technique::Cone, Technique::Connection];
const OF_TWO: [Technique; 6] = [
    Technique::Plane(1, 0),
    Technique::Sphere,
    Technique::Cone,
    Technique::Cylinder,
    Technique::HalfDisc,
    Technique::Connection,
];
const OF_THREE: [Technique; 8] = [
    Technique::Plane(1, 0),
    Technique::Plane(2, 0),
    Technique::Plane(2, 1),
    Technique::Sphere,
    Technique::Cone,
    Technique::Cylinder,
    Technique::HalfDisc,
    Technique::Connection,
];

impl Technique {
    /// Those that find the light of tails of a kind.
    pub(super) fn of(kind: Kind) -> &'static [Self] {
        match kind {
            Kind::One => &OF_ONE,
            Kind::Two => &OF_TWO,
            Kind::Three => &OF_THREE,
        }
    }

    /// How it is called in settings.
    pub(super) fn kind(self) -> SurfaceKind {
        match self {
            Self::Plane(..) => SurfaceKind::Planes,
            Self::Sphere => SurfaceKind::Spheres,
            Self::Cone => SurfaceKind::Cones,
            Self::Cylinder => SurfaceKind::Cylinders,
            Self::HalfDisc => SurfaceKind::Discs,
            Self::Connection => SurfaceKind::Connections,
        }
    }

    /// Whether it sweeps over the length of a segment.
    fn sweeps(self, segment: usize) -> bool {
        match self {
            Self::Plane(i, j) => segment == usize::from(i) || segment == usize::from(j),
            Self::Cone | Self::HalfDisc | Self::Connection => segment == 0,
            Self::Cylinder => segment == 1,
            Self::Sphere => false,
        }
    }

    /// The surface that a tail sweeps out; `None` where the tail has none.
    pub(super) fn shape(self, tail: &Tail) -> Option<Shape> {
        let first = tail.kind.first();
        if !self.sweeps(first) && !tail.is_whole() {
            return None;
        }
        let [on, before] = [tail.directions[0], tail.directions[1]];
        let length = |segment: usize| match segment == first {
            true => tail.lengths[segment].min(tail.end),
            false => tail.lengths[segment],
        };
        let cosine = on.dot(before).clamp(-1.0, 1.0);
        match self {
            Self::Plane(i, j) => {
                let swept = [i, j].map(usize::from);
                let still = (0..=first).filter(|segment| !swept.contains(segment));
                let origin = still.fold(tail.start, |place, segment| {
                    place + tail.directions[segment] * tail.lengths[segment]
                });
                Some(Shape::Parallelogram {
                    origin,
                    edges: swept.map(|segment| tail.directions[segment]),
                    lengths: swept.map(length),
                })
            }
            Self::Sphere => Some(Shape::Sphere {
                center: tail.before(0),
                radius: length(0),
            }),
            Self::Cone => Some(Shape::Cone {
                apex: tail.before(0),
                axis: before,
                cosine,
                length: length(0),
            }),
            Self::Cylinder => Some(Shape::Cylinder {
                base: tail.before(1) + before * (cosine * length(0)),
                axis: before,
                radius: safe_sqrt(1.0 - cosine * cosine) * length(0),
                height: length(1),
            }),
            Self::HalfDisc => {
                let across = on - before * cosine;
                let side = across.try_normalize().unwrap_or_else(|| Frame::from_normal(before).s);
                Some(Shape::HalfDisc {
                    center: tail.before(0),
                    axis: before,
                    side,
                    radius: length(0),
                })
            }
            Self::Connection => None,
        }
    }

    /// The light path of a tail that ends at `place`, which the camera's ray meets; `None` where there is none.
    pub(super) fn chain(self, tail: &Tail, place: Vec3, meeting: &Meeting) -> Option<Chain> {
        let mut chain = Chain {
            directions: tail.directions,
            lengths: tail.lengths,
        };
        match self {
            Self::Plane(i, j) => {
                chain.lengths[usize::from(i)] = meeting.along[0];
                chain.lengths[usize::from(j)] = meeting.along[1];
                Some(chain)
            }
            Self::Cylinder => {
                chain.lengths[1] = meeting.along[0];
                let joint = tail.before(1) + tail.directions[1] * meeting.along[0];
                chain.lead_from(joint, place)
            }
            Self::Sphere | Self::Cone | Self::HalfDisc | Self::Connection => chain.lead_from(tail.before(0), place),
        }
    }
}

impl Chain {
    /// With the last segment from `joint` to `place`.
    fn lead_from(mut self, joint: Vec3, place: Vec3) -> Option<Self> {
        let offset = place - joint;
        let length = offset.length();
        (length > 0.0).then(|| {
            self.lengths[0] = length;
            self.directions[0] = offset / length;
            self
        })
    }
}

impl Densities {
    /// `directions` are the densities by which those of the chain are drawn.
    pub(super) fn new(kind: Kind, chain: Chain, rates: &Rates, directions: [f32; 3], ray: Vec3, place: f32) -> Self {
        Self {
            kind,
            chain,
            lengths: chain.lengths.map(|length| rates.density(length)),
            exceeded: chain.lengths.map(|length| rates.exceeds(length)),
            directions,
            ray,
            place,
        }
    }

    /// The density with which a technique finds the chain on the camera's ray, per length of the ray and with the measures of the chain's lengths and
    /// directions: that of what is drawn, times the Jacobian `|n . psi|` (equation 22; normals n of table 1).
    pub(super) fn of(&self, technique: Technique) -> f32 {
        let first = self.kind.first();
        let of_length = |segment: usize| match technique.sweeps(segment) {
            // The length of a connection is not drawn, and no surface ends before it.
            true if technique == Technique::Connection => 1.0,
            true => self.exceeded[segment],
            false => self.lengths[segment],
        };
        let lengths: f32 = (0..=first).map(of_length).product();
        let before: f32 = (1..first).map(|segment| self.directions[segment]).product();
        let drawn = lengths * before;
        let Chain {
            directions,
            lengths: [length, ..],
        } = self.chain;
        let [on, axis] = [directions[0], directions[1]];
        let cosine = on.dot(axis);
        // The density of the cosine with the direction before.
        let of_cosine = match self.kind {
            Kind::One => pdf_of_cosine(cosine),
            _ => TAU * self.directions[0],
        };
        let of_direction = if first == 0 { 1.0 } else { self.directions[0] };
        let normal = on.cross(axis);
        match technique {
            Technique::Plane(i, j) => {
                let [a, b] = [i, j].map(|segment| directions[usize::from(segment)]);
                drawn * of_direction * a.cross(b).dot(self.ray).abs()
            }
            Technique::Sphere => drawn * length * length * on.dot(self.ray).abs(),
            Technique::Cone => drawn * of_cosine * length * on.cross(normal).dot(self.ray).abs(),
            Technique::Cylinder => drawn * of_cosine * length * axis.cross(normal).dot(self.ray).abs(),
            Technique::HalfDisc => {
                let sine2 = normal.length_squared();
                match sine2 > 0.0 {
                    true => drawn * length * normal.dot(self.ray).abs() / (sine2 * TAU),
                    false => 0.0,
                }
            }
            Technique::Connection => drawn * length * length * self.place,
        }
    }
}
