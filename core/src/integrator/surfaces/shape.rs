//! Shapes of photon surfaces, and where rays meet them.

use crate::geometry::Ray;
use crate::math::{DVec3, Vec3};

/// A shape in space, without what light does on it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// The places `origin + a along + b across` with `a` and `b` up to the lengths of the edges.
    Parallelogram {
        origin: Vec3,
        edges: [Vec3; 2],
        lengths: [f32; 2],
    },
    Sphere {
        center: Vec3,
        radius: f32,
    },
    /// The places at most `length` from the apex, in directions of the cosine `cosine` with the axis.
    Cone {
        apex: Vec3,
        axis: Vec3,
        cosine: f32,
        length: f32,
    },
    /// The places at the distance `radius` from the axis, up to the height `height`.
    Cylinder {
        base: Vec3,
        axis: Vec3,
        radius: f32,
        height: f32,
    },
    /// Half a disc: on that side of the axis to which the unit vector `side` points, which is perpendicular to it.
    HalfDisc {
        center: Vec3,
        axis: Vec3,
        side: Vec3,
        radius: f32,
    },
}

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Meeting {
    /// Along the ray.
    pub(super) distance: f32,
    /// Along the edges of a parallelogram, or the first of them the height on a cylinder.
    pub(super) along: [f32; 2],
}

/// As many meetings as a ray has with a shape.
pub(super) type Meetings = [Option<Meeting>; 2];

impl Shape {
    /// A box that holds the shape: lower and upper corner.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Self::Parallelogram { origin, edges, lengths } => {
                let [a, b] = [edges[0] * lengths[0], edges[1] * lengths[1]];
                let corners = [a, b, a + b].map(|offset| origin + offset);
                corners.into_iter().fold((origin, origin), |(lower, upper), corner| {
                    (lower.min(corner), upper.max(corner))
                })
            }
            Self::Sphere { center, radius } => (center - radius, center + radius),
            Self::Cone {
                apex,
                axis,
                cosine,
                length,
            } => {
                let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
                let (lower, upper) = disc_bounds(apex + axis * (cosine * length), axis, sine * length);
                (lower.min(apex), upper.max(apex))
            }
            Self::Cylinder {
                base,
                axis,
                radius,
                height,
            } => {
                let [first, last] = [base, base + axis * height].map(|center| disc_bounds(center, axis, radius));
                (first.0.min(last.0), first.1.max(last.1))
            }
            Self::HalfDisc {
                center,
                axis,
                side,
                radius,
            } => disc_bounds(center, axis.cross(side), radius),
        }
    }

    /// Where the ray meets it.
    pub(super) fn meet(&self, ray: &Ray) -> Meetings {
        let (on, from) = (ray.direction.as_dvec3(), ray.origin.as_dvec3());
        let within = |distance: f64| distance > 0.0 && distance < f64::from(ray.max_distance);
        let plain = |distance: f64| Meeting {
            distance: distance as f32,
            along: [0.0; 2],
        };
        match *self {
            Self::Parallelogram { origin, edges, lengths } => {
                let [a, b] = edges.map(|edge| edge.as_dvec3());
                let normal = a.cross(b);
                let slant = normal.dot(on);
                let between = origin.as_dvec3() - from;
                let distance = between.dot(normal) / slant;
                // By Cramer's rule.
                let offset = on.cross(between);
                let along = [-offset.dot(b) / slant, offset.dot(a) / slant];
                let inside = (0..2).all(|edge| along[edge] >= 0.0 && along[edge] <= f64::from(lengths[edge]));
                let meeting = (slant != 0.0 && within(distance) && inside).then(|| Meeting {
                    distance: distance as f32,
                    along: along.map(|along| along as f32),
                });
                [meeting, None]
            }
            Self::Sphere { center, radius } => {
                let between = from - center.as_dvec3();
                let half = between.dot(on);
                let rest = between - on * half;
                let radius = f64::from(radius);
                roots(
                    1.0,
                    half,
                    between.length_squared() - radius * radius,
                    radius * radius - rest.length_squared(),
                )
                .map(|root| root.filter(|distance| within(*distance)).map(plain))
            }
            Self::Cone {
                apex,
                axis,
                cosine,
                length,
            } => {
                let (axis, between) = (axis.as_dvec3(), from - apex.as_dvec3());
                let cosine = f64::from(cosine);
                let (along, height) = (on.dot(axis), between.dot(axis));
                // (p . axis)^2 = cosine^2 p^2, on the side of the axis that the cosine says.
                let a = along * along - cosine * cosine;
                let half = along * height - cosine * cosine * between.dot(on);
                let c = height * height - cosine * cosine * between.length_squared();
                roots(a, half, c, half * half - a * c).map(|root| {
                    root.filter(|distance| {
                        let place = between + on * *distance;
                        let right_side = place.dot(axis) * cosine >= 0.0;
                        within(*distance) && right_side && place.length() <= f64::from(length)
                    })
                    .map(plain)
                })
            }
            Self::Cylinder {
                base,
                axis,
                radius,
                height,
            } => {
                let (axis, between) = (axis.as_dvec3(), from - base.as_dvec3());
                let across = |v: DVec3| v - axis * v.dot(axis);
                let (on_across, between_across) = (across(on), across(between));
                let a = on_across.length_squared();
                let half = on_across.dot(between_across);
                let radius = f64::from(radius);
                let c = between_across.length_squared() - radius * radius;
                roots(a, half, c, half * half - a * c).map(|root| {
                    root.filter(|distance| within(*distance)).and_then(|distance| {
                        let along = (between + on * distance).dot(axis);
                        (along >= 0.0 && along <= f64::from(height)).then_some(Meeting {
                            distance: distance as f32,
                            along: [along as f32, 0.0],
                        })
                    })
                })
            }
            Self::HalfDisc {
                center,
                axis,
                side,
                radius,
            } => {
                let side = side.as_dvec3();
                let normal = axis.as_dvec3().cross(side);
                let between = center.as_dvec3() - from;
                let distance = between.dot(normal) / on.dot(normal);
                let place = on * distance - between;
                let inside = place.dot(side) >= 0.0 && place.length() <= f64::from(radius);
                [(within(distance) && inside).then(|| plain(distance)), None]
            }
        }
    }
}

/// The roots of `a x^2 + 2 half x + c`, whose discriminant `half^2 - a c` is given: it is often known better than by these.
fn roots(a: f64, half: f64, c: f64, discriminant: f64) -> [Option<f64>; 2] {
    if discriminant < 0.0 {
        return [None, None];
    }
    // Without a difference of numbers that are nearly the same.
    let sum = -(half + discriminant.sqrt().copysign(half));
    [sum / a, c / sum].map(|root| root.is_finite().then_some(root))
}

/// A box that holds a disc.
fn disc_bounds(center: Vec3, normal: Vec3, radius: f32) -> (Vec3, Vec3) {
    let reach = (Vec3::ONE - normal * normal).max(Vec3::ZERO).map(f32::sqrt) * radius;
    (center - reach, center + reach)
}
