//! The ways to find the end of a light path on a camera ray: what is swept over, and the density of what is found.

use super::lamp::Rectangle;
use super::tail::{Kind, Sweep, Tail};
use crate::geometry::SurfacePoint;
use crate::math::{FRAC_1_PI, TAU, Vec3};
use crate::settings::SurfaceKind;

/// What is swept over analytically, besides the distance along the camera's ray (Deng et al. 2019, table 1 and section 5.2). Segments of
/// the light path are numbered from its end: the directions omega_1, omega_2, omega_3 of the paper are those of the segments 0, 1, 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Technique {
    /// The lengths of two segments.
    Plane(u8, u8),
    /// The last direction.
    Sphere,
    /// The direction before the last, while the last stays as it is.
    InnerSphere,
    /// The last length, and the angle about the direction before.
    Cone,
    /// The length before the last, and the angle about its direction.
    Cylinder,
    /// The last length, and the cosine with the direction before.
    HalfDisc,
    /// The angles about the two directions before the last.
    Toroid,
    /// The last length, and the angle about the direction before the last but one.
    Hyperboloid,
    /// The last direction and length, while the place on the camera's ray is drawn (footnote 2): a connection.
    Connection,
    /// The place on the light.
    Light(OnLight),
}

/// What is swept over where one of the two is the place on the light. Edges of a rectangle have numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OnLight {
    /// Both coordinates.
    Copy,
    /// The coordinate along an edge, and the length.
    Plane(u8),
    /// The same along a line in a random direction (section 6.2).
    TurnedPlane,
    /// The coordinate along an edge, and the angle about the normal.
    Circle(u8),
    /// The coordinate along an edge, and the cosine with the normal.
    Arc(u8),
}

/// A light path that ends on a camera ray, from the start of its tail.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    /// Where it starts on a light that was swept over; `None`: where the tail does.
    pub(super) start: Option<SurfacePoint>,
    pub(super) directions: [Vec3; 3],
    pub(super) lengths: [f32; 3],
}

/// What densities of techniques are made of, for one chain and one camera ray.
pub(super) struct Densities<'c> {
    pub(super) kind: Kind,
    pub(super) chain: &'c Chain,
    /// Of each length, and the probability of a greater one.
    pub(super) lengths: [f32; 3],
    pub(super) exceeded: [f32; 3],
    /// Solid-angle density of each direction. That of the first segment is 1, unless it is the only one.
    pub(super) directions: [f32; 3],
    /// Density of the last of three directions where it is drawn about the first.
    pub(super) aside: f32,
    /// Unit direction of the camera's ray.
    pub(super) ray: Vec3,
    /// Density with which a connection chooses the place on the camera's ray.
    pub(super) place: f32,
}

const OF_ONE: [Technique; 3] = [Technique::Sphere, Technique::Cone, Technique::Connection];
const OF_LAMP: [Technique; 4] = [
    Technique::Sphere,
    Technique::Cone,
    Technique::Connection,
    Technique::Light(OnLight::Copy),
];
const OF_RECTANGLE: [Technique; 11] = [
    Technique::Sphere,
    Technique::Cone,
    Technique::Connection,
    Technique::Light(OnLight::Copy),
    Technique::Light(OnLight::Plane(0)),
    Technique::Light(OnLight::Plane(1)),
    Technique::Light(OnLight::TurnedPlane),
    Technique::Light(OnLight::Circle(0)),
    Technique::Light(OnLight::Circle(1)),
    Technique::Light(OnLight::Arc(0)),
    Technique::Light(OnLight::Arc(1)),
];
const OF_TWO: [Technique; 6] = [
    Technique::Plane(1, 0),
    Technique::Sphere,
    Technique::Cone,
    Technique::Cylinder,
    Technique::HalfDisc,
    Technique::Connection,
];
const OF_THREE: [Technique; 11] = [
    Technique::Plane(1, 0),
    Technique::Plane(2, 0),
    Technique::Plane(2, 1),
    Technique::Sphere,
    Technique::InnerSphere,
    Technique::Cone,
    Technique::Cylinder,
    Technique::HalfDisc,
    Technique::Toroid,
    Technique::Hyperboloid,
    Technique::Connection,
];

impl Technique {
    /// Those that find the light of a tail.
    pub(super) fn of(tail: &Tail) -> &'static [Self] {
        match (tail.kind, tail.sweep()) {
            (Kind::One, None) => &OF_ONE,
            (Kind::One, Some(sweep)) if sweep.lamp.rectangle.is_some() => &OF_RECTANGLE,
            (Kind::One, Some(_)) => &OF_LAMP,
            (Kind::Two, _) => &OF_TWO,
            (Kind::Three, _) => &OF_THREE,
        }
    }

    /// How it is called in settings.
    pub(super) fn kind(self) -> SurfaceKind {
        match self {
            Self::Plane(..) => SurfaceKind::Planes,
            Self::Sphere => SurfaceKind::Spheres,
            Self::InnerSphere => SurfaceKind::InnerSpheres,
            Self::Cone => SurfaceKind::Cones,
            Self::Cylinder => SurfaceKind::Cylinders,
            Self::HalfDisc => SurfaceKind::Discs,
            Self::Toroid => SurfaceKind::Toroids,
            Self::Hyperboloid => SurfaceKind::Hyperboloids,
            Self::Connection => SurfaceKind::Connections,
            Self::Light(OnLight::Copy) => SurfaceKind::LightCopies,
            Self::Light(OnLight::Plane(_)) => SurfaceKind::LightPlanes,
            Self::Light(OnLight::TurnedPlane) => SurfaceKind::TurnedPlanes,
            Self::Light(OnLight::Circle(_)) => SurfaceKind::LightCircles,
            Self::Light(OnLight::Arc(_)) => SurfaceKind::LightArcs,
        }
    }

    /// Whether it sweeps over the length of a segment.
    pub(super) fn sweeps(self, segment: usize) -> bool {
        match self {
            Self::Plane(i, j) => segment == usize::from(i) || segment == usize::from(j),
            Self::Cone
            | Self::HalfDisc
            | Self::Hyperboloid
            | Self::Connection
            | Self::Light(OnLight::Plane(_) | OnLight::TurnedPlane) => segment == 0,
            Self::Cylinder => segment == 1,
            Self::Sphere
            | Self::InnerSphere
            | Self::Toroid
            | Self::Light(OnLight::Copy | OnLight::Circle(_) | OnLight::Arc(_)) => false,
        }
    }
}

impl Densities<'_> {
    /// The density with which a technique finds the chain on the camera's ray, per length of the ray and with the measures of the chain's lengths and
    /// directions: that of what is drawn, times the Jacobian `|n . psi|` (equation 22; normals n of table 1). Where a chain starts on a light that
    /// surfaces sweep over, the density is that by area, divided by the density of starts on the light.
    pub(super) fn of(&self, technique: Technique, sweep: Option<&Sweep>) -> f32 {
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
            directions: [on, axis, first_axis],
            lengths: [length, length_before, _],
            ..
        } = *self.chain;
        // Of the cosine with the direction before, and with that before.
        let [of_cosine, of_cosine_before] = [self.directions[0], self.directions[1]].map(|density| TAU * density);
        let normal = on.cross(axis);
        let from_second = on * length + axis * length_before;
        match technique {
            Technique::Plane(i, j) => {
                let [a, b] = [i, j].map(|segment| self.chain.directions[usize::from(segment)]);
                drawn * self.directions[0] * a.cross(b).dot(self.ray).abs()
            }
            Technique::Sphere => drawn * length * length * on.dot(self.ray).abs(),
            Technique::InnerSphere => lengths * self.aside * length_before * length_before * axis.dot(self.ray).abs(),
            Technique::Cone => drawn * of_cosine * length * on.cross(normal).dot(self.ray).abs(),
            Technique::Cylinder => drawn * of_cosine * length * axis.cross(normal).dot(self.ray).abs(),
            Technique::HalfDisc => {
                let sine2 = normal.length_squared();
                match sine2 > 0.0 {
                    true => drawn * length * normal.dot(self.ray).abs() / (sine2 * TAU),
                    false => 0.0,
                }
            }
            Technique::Toroid => {
                let turned = first_axis.cross(from_second).cross(axis.cross(on * length));
                lengths * of_cosine_before * of_cosine * turned.dot(self.ray).abs()
            }
            Technique::Hyperboloid => {
                let turned = first_axis.cross(from_second).cross(on);
                lengths * of_cosine_before * self.directions[0] * turned.dot(self.ray).abs()
            }
            Technique::Connection => drawn * length * length * self.place,
            Technique::Light(on_light) => sweep.map_or(0.0, |sweep| lengths * self.of_light(on_light, sweep)),
        }
    }

    /// The same of techniques that sweep over a light, but for the density of the length.
    fn of_light(&self, on_light: OnLight, sweep: &Sweep) -> f32 {
        let Chain {
            directions: [on, ..],
            lengths: [length, ..],
            ..
        } = *self.chain;
        let lamp = &sweep.lamp;
        let point = self.chain.start.as_ref();
        let normal = point.map_or(sweep.normal(), |point| point.geometric_normal);
        let of_direction = self.directions[0];
        let along = |vector: Vec3| vector.dot(self.ray);
        let of_rectangle = |density: &dyn Fn(&Rectangle) -> f32| lamp.rectangle.as_ref().map_or(0.0, density);
        match on_light {
            OnLight::Copy => {
                let of_direction = match lamp.is_plane {
                    true => lamp.area * of_direction,
                    false => lamp.emitting() * 0.25 * FRAC_1_PI,
                };
                of_direction * along(normal).abs()
            }
            OnLight::Plane(edge) => of_rectangle(&|Rectangle { edges, lengths, .. }| {
                let edge = usize::from(edge);
                lengths[edge] * of_direction * along(edges[edge].cross(on)).abs()
            }),
            // Equation 27, the mean over all directions of the line.
            OnLight::TurnedPlane => of_rectangle(&|rectangle| {
                let [u, v] = rectangle.edges.map(|edge| along(edge.cross(on)));
                let of_line = lamp.area / (2.0 * rectangle.radius());
                of_line * of_direction * 2.0 * FRAC_1_PI * u.hypot(v)
            }),
            OnLight::Circle(edge) => of_rectangle(&|Rectangle { edges, lengths, .. }| {
                let edge = usize::from(edge);
                let of_cosine = TAU * of_direction;
                lengths[edge] * of_cosine * (length * edges[edge].dot(on) * along(normal)).abs()
            }),
            OnLight::Arc(edge) => of_rectangle(&|Rectangle { edges, lengths, .. }| {
                let edge = usize::from(edge);
                let cosine = on.dot(normal);
                let aside = on - normal * cosine;
                let sine2 = aside.length_squared();
                match sine2 > 0.0 {
                    true => {
                        // How the direction changes with its cosine.
                        let turned = normal - aside * (cosine / sine2);
                        lengths[edge] / TAU * (length * along(edges[edge].cross(turned))).abs()
                    }
                    false => 0.0,
                }
            }),
        }
    }
}
