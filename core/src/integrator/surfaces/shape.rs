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
    /// The places of a sphere whose directions from its centre have a cosine with the axis between two.
    Zone {
        center: Vec3,
        radius: f32,
        axis: Vec3,
        cosines: [f32; 2],
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
    /// What a straight line sweeps over that turns about an axis through `center`.
    Hyperboloid {
        center: Vec3,
        axis: Vec3,
        origin: Vec3,
        direction: Vec3,
        length: f32,
    },
    /// What a circle sweeps over that moves from `center` by the vector `along`, which lies in its plane.
    Stadium {
        center: Vec3,
        along: Vec3,
        normal: Vec3,
        radius: f32,
    },
    /// What a quarter of a circle sweeps over that moves from `center` by `length` along the unit vector `along`: that between the
    /// unit vectors `side` and `normal`, which are perpendicular to each other.
    Arc {
        center: Vec3,
        along: Vec3,
        length: f32,
        side: Vec3,
        normal: Vec3,
        radius: f32,
    },
    /// A box about a shape that rays meet elsewhere.
    Boxed { lower: Vec3, upper: Vec3 },
}

/// Where a ray meets a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Meeting {
    /// Along the ray.
    pub(super) distance: f32,
    /// Along the edges of a parallelogram; or the first of them is the height on a cylinder, the length on the line of a hyperboloid, or how far an arc
    /// has moved.
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
            Self::Zone {
                center,
                radius,
                axis,
                cosines,
            } => {
                let reach = zone_reach(axis, cosines);
                (center - reach[1] * radius, center + reach[0] * radius)
            }
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
            Self::Hyperboloid {
                center,
                axis,
                origin,
                direction,
                length,
            } => {
                // The circles of the line's ends bound it, since the distance from the axis is greatest at one of them.
                let [first, last] = [origin, origin + direction * length].map(|end| {
                    let offset = end - center;
                    let along = axis * offset.dot(axis);
                    disc_bounds(center + along, axis, (offset - along).length())
                });
                (first.0.min(last.0), first.1.max(last.1))
            }
            Self::Stadium {
                center,
                along,
                normal,
                radius,
            } => {
                let (lower, upper) = disc_bounds(center, normal, radius);
                (lower.min(lower + along), upper.max(upper + along))
            }
            Self::Arc {
                center,
                along,
                length,
                side,
                normal,
                radius,
            } => {
                let [side, normal, along] = [side * radius, normal * radius, along * length];
                let (lower, upper) = (side.min(normal).min(Vec3::ZERO), (side + normal).max(side).max(normal));
                (
                    center + lower + along.min(Vec3::ZERO),
                    center + upper + along.max(Vec3::ZERO),
                )
            }
            Self::Boxed { lower, upper } => (lower, upper),
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
            Self::Zone {
                center,
                radius,
                axis,
                cosines,
            } => {
                let (between, axis) = (from - center.as_dvec3(), axis.as_dvec3());
                let half = between.dot(on);
                let rest = between - on * half;
                let radius = f64::from(radius);
                let [least, greatest] = cosines.map(|cosine| f64::from(cosine) * radius);
                let c = between.length_squared() - radius * radius;
                roots(1.0, half, c, radius * radius - rest.length_squared()).map(|root| {
                    root.filter(|distance| {
                        let height = (between + on * *distance).dot(axis);
                        within(*distance) && least <= height && height <= greatest
                    })
                    .map(plain)
                })
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
            Self::Hyperboloid {
                center,
                axis,
                origin,
                direction,
                length,
            } => {
                let [axis, line] = [axis, direction].map(|v| v.as_dvec3());
                let start = (origin - center).as_dvec3();
                let between = from - center.as_dvec3();
                // At the height of the ray above the centre the line is that far along.
                let slope = line.dot(axis);
                let (first, per_distance) = ((between - start).dot(axis) / slope, on.dot(axis) / slope);
                // There, ray and line are at the same distance from the centre.
                let (on_line, moved) = (start + line * first, line * per_distance);
                let a = 1.0 - moved.length_squared();
                let half = between.dot(on) - on_line.dot(moved);
                let c = between.length_squared() - on_line.length_squared();
                roots(a, half, c, half * half - a * c).map(|root| {
                    let distance = root.filter(|distance| within(*distance))?;
                    let along = first + per_distance * distance;
                    (0.0..=f64::from(length)).contains(&along).then_some(Meeting {
                        distance: distance as f32,
                        along: [along as f32, 0.0],
                    })
                })
            }
            Self::Stadium {
                center,
                along,
                normal,
                radius,
            } => {
                let [along, normal] = [along, normal].map(|v| v.as_dvec3());
                let between = center.as_dvec3() - from;
                let distance = between.dot(normal) / on.dot(normal);
                let place = on * distance - between;
                let moved = (place.dot(along) / along.length_squared()).clamp(0.0, 1.0);
                let inside = (place - along * moved).length() <= f64::from(radius);
                [(within(distance) && inside).then(|| plain(distance)), None]
            }
            Self::Arc {
                center,
                along,
                length,
                side,
                normal,
                radius,
            } => {
                let [along, side, normal] = [along, side, normal].map(|v| v.as_dvec3());
                let between = from - center.as_dvec3();
                // Without what lies along the motion, it is an ellipse.
                let across = normal.cross(along);
                let narrow = side.dot(across);
                let flat = |v: DVec3| [v.dot(across) / narrow, v.dot(normal)];
                let ([x, y], [to_x, to_y]) = (flat(between), flat(on));
                let radius = f64::from(radius);
                let a = to_x * to_x + to_y * to_y;
                let half = x * to_x + y * to_y;
                let c = x * x + y * y - radius * radius;
                roots(a, half, c, half * half - a * c).map(|root| {
                    let distance = root.filter(|distance| within(*distance))?;
                    let [x, y] = [x + to_x * distance, y + to_y * distance];
                    let moved = (between + on * distance).dot(along) - side.dot(along) * x;
                    let inside = x >= 0.0 && y >= 0.0 && (0.0..=f64::from(length)).contains(&moved);
                    inside.then_some(Meeting {
                        distance: distance as f32,
                        along: [moved as f32, 0.0],
                    })
                })
            }
            Self::Boxed { .. } => [None, None],
        }
    }
}

/// How far directions whose cosine with the axis lies between two reach along the axes of space, and against them.
fn zone_reach(axis: Vec3, [least, greatest]: [f32; 2]) -> [Vec3; 2] {
    let reach = |cosine: f32| {
        let nearest = cosine.clamp(least, greatest);
        let sine = |cosine: f32| (1.0 - cosine * cosine).max(0.0).sqrt();
        match nearest == cosine {
            true => 1.0,
            false => cosine * nearest + sine(cosine) * sine(nearest),
        }
    };
    [axis, -axis].map(|axis| axis.map(reach))
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
