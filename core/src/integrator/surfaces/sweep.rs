//! The surfaces that tails of light paths sweep out, and the light paths that end where a camera ray meets them.

use super::lamp::Line;
use super::shape::{Meeting, Shape};
use super::tail::{Sweep, Tail};
use super::technique::{Chain, OnLight, Technique};
use crate::geometry::Ray;
use crate::math::{Frame, Vec3, safe_sqrt};

impl Technique {
    /// The surface that a tail sweeps out; `None` where the tail has none.
    pub(super) fn shape(self, tail: &Tail) -> Option<Shape> {
        let first = tail.kind.first();
        if !self.sweeps(first) && !tail.is_whole() {
            return None;
        }
        let [on, before, _] = tail.directions;
        let length = |segment: usize| match segment == first {
            true => tail.lengths[segment].min(tail.end),
            false => tail.lengths[segment],
        };
        let cosine = on.dot(before).clamp(-1.0, 1.0);
        let sine = safe_sqrt(1.0 - cosine * cosine);
        Some(match self {
            Self::Plane(i, j) => {
                let swept = [i, j].map(usize::from);
                let still = (0..=first).filter(|segment| !swept.contains(segment));
                let origin = still.fold(tail.start, |place, segment| {
                    place + tail.directions[segment] * tail.lengths[segment]
                });
                Shape::Parallelogram {
                    origin,
                    edges: swept.map(|segment| tail.directions[segment]),
                    lengths: swept.map(length),
                }
            }
            Self::Sphere => Shape::Zone {
                center: tail.before(0),
                radius: length(0),
                axis: before,
                cosines: match first {
                    0 => [tail.spread.least_cosine(), 1.0],
                    _ => [-1.0, 1.0],
                },
            },
            Self::InnerSphere => Shape::Zone {
                center: tail.before(1) + tail.aside * length(0),
                radius: length(1),
                axis: before,
                cosines: [-1.0, 1.0],
            },
            Self::Cone => Shape::Cone {
                apex: tail.before(0),
                axis: before,
                cosine,
                length: length(0),
            },
            Self::Cylinder => Shape::Cylinder {
                base: tail.before(1) + before * (cosine * length(0)),
                axis: before,
                radius: sine * length(0),
                height: length(1),
            },
            Self::HalfDisc => Shape::HalfDisc {
                center: tail.before(0),
                axis: before,
                side: aside(on, before),
                radius: length(0),
            },
            // The end keeps its distance from the start of the segment before, about which all turns.
            Self::Toroid => {
                let center = tail.before(1);
                let axis = tail.directions[2];
                let to_end = tail.after(0) - center;
                let radius = to_end.length();
                let [a, b] = [before.dot(axis), before.dot(to_end) / radius].map(|cosine| cosine.clamp(-1.0, 1.0));
                let (middle, half) = (a * b, safe_sqrt(1.0 - a * a) * safe_sqrt(1.0 - b * b));
                Shape::Zone {
                    center,
                    radius,
                    axis,
                    cosines: [middle - half, middle + half],
                }
            }
            Self::Hyperboloid => Shape::Hyperboloid {
                center: tail.before(1),
                axis: tail.directions[2],
                origin: tail.before(0),
                direction: on,
                length: length(0),
            },
            Self::Connection => return None,
            Self::Light(on_light) => return on_light.shape(tail, tail.sweep()?),
        })
    }

    /// Calls `visit` with the light paths of a tail that end where a camera ray meets the surface which the tail sweeps out, and the distances of
    /// their ends along the ray.
    pub(super) fn each_chain(self, tail: &Tail, shape: &Shape, ray: &Ray, mut visit: impl FnMut(f32, &Chain)) {
        if let (Self::Light(OnLight::Copy), Some(sweep)) = (self, tail.sweep()) {
            // The ray that meets the light itself where the other meets its copy.
            let moved = Ray {
                origin: ray.origin - sweep.direction * tail.lengths[0],
                ..*ray
            };
            sweep.lamp.each_meeting(&moved, |distance, point| {
                if let Some(point) = sweep.lamp.facing(point, sweep.direction) {
                    let [_, before, first] = tail.directions;
                    let chain = Chain {
                        start: Some(point),
                        directions: [sweep.direction, before, first],
                        lengths: tail.lengths,
                    };
                    visit(distance, &chain);
                }
            });
            return;
        }
        for meeting in shape.meet(ray).iter().flatten() {
            let place = ray.origin + ray.direction * meeting.distance;
            for chain in self.chains(tail, place, meeting).iter().flatten() {
                visit(meeting.distance, chain);
            }
        }
    }

    /// The light paths of a tail that end at `place`, where the camera's ray meets the surface.
    fn chains(self, tail: &Tail, place: Vec3, meeting: &Meeting) -> [Option<Chain>; 2] {
        let chain = Chain::of(tail);
        let single = |chain: Option<Chain>| [chain, None];
        match self {
            Self::Plane(i, j) => {
                let mut chain = chain;
                chain.lengths[usize::from(i)] = meeting.along[0];
                chain.lengths[usize::from(j)] = meeting.along[1];
                single(Some(chain))
            }
            Self::Cylinder => {
                let mut chain = chain;
                chain.lengths[1] = meeting.along[0];
                let joint = tail.before(1) + tail.directions[1] * meeting.along[0];
                single(chain.lead_from(joint, place))
            }
            Self::InnerSphere => {
                let mut chain = chain;
                let to_joint = place - tail.aside * tail.lengths[0] - tail.before(1);
                chain.directions[0] = tail.aside;
                single(to_joint.try_normalize().map(|direction| {
                    chain.directions[1] = direction;
                    chain
                }))
            }
            Self::Toroid => {
                toroid_joints(tail, place).map(|joint| chain.clone().lead_by(tail.before(1), joint?, place))
            }
            Self::Hyperboloid => single(chain.turned(tail, place, meeting.along[0])),
            Self::Sphere | Self::Cone | Self::HalfDisc | Self::Connection => single(Chain::connecting(tail, place)),
            Self::Light(on_light) => match tail.sweep() {
                Some(sweep) => on_light.chains(tail, sweep, place, meeting),
                None => [None, None],
            },
        }
    }
}

impl OnLight {
    /// The surface that a tail sweeps out.
    fn shape(self, tail: &Tail, sweep: &Sweep) -> Option<Shape> {
        let (on, length, normal) = (tail.directions[0], tail.lengths[0], sweep.normal());
        let cosine = on.dot(normal);
        let swept_on = |line: Line| Shape::Parallelogram {
            origin: line.origin,
            edges: [line.along, on],
            lengths: [line.length, length],
        };
        Some(match self {
            Self::Copy => {
                let offset = sweep.direction * length;
                let (lower, upper) = sweep.lamp.bounds();
                Shape::Boxed {
                    lower: lower + offset,
                    upper: upper + offset,
                }
            }
            Self::Plane(edge) => swept_on(line_of(tail, sweep, edge)?),
            Self::TurnedPlane => swept_on(sweep.line?),
            Self::Circle(edge) => {
                let line = line_of(tail, sweep, edge)?;
                Shape::Stadium {
                    center: line.origin + normal * (cosine * length),
                    along: line.along * line.length,
                    normal,
                    radius: safe_sqrt(1.0 - cosine * cosine) * length,
                }
            }
            Self::Arc(edge) => {
                let line = line_of(tail, sweep, edge)?;
                Shape::Arc {
                    center: line.origin,
                    along: line.along,
                    length: line.length,
                    side: aside(on, normal),
                    normal,
                    radius: length,
                }
            }
        })
    }

    /// The light paths of a tail that end at `place`, but for those by copies, which start where the ray meets the light itself.
    fn chains(self, tail: &Tail, sweep: &Sweep, place: Vec3, meeting: &Meeting) -> [Option<Chain>; 2] {
        let normal = sweep.normal();
        let from = |line: Option<Line>, moved: f32, length: Option<f32>| {
            let start = line?;
            let start = start.origin + start.along * moved;
            let mut chain = Chain::of(tail);
            match length {
                Some(length) => chain.lengths[0] = length,
                None => chain = chain.lead_from(start, place)?,
            }
            let point = sweep.lamp.point_at(start, normal)?;
            chain.start = Some(sweep.lamp.facing(point, normal)?);
            Some(chain)
        };
        match self {
            Self::Plane(edge) => {
                let [moved, length] = meeting.along;
                [from(line_of(tail, sweep, edge), moved, Some(length)), None]
            }
            Self::TurnedPlane => {
                let [moved, length] = meeting.along;
                [from(sweep.line, moved, Some(length)), None]
            }
            Self::Arc(edge) => [from(line_of(tail, sweep, edge), meeting.along[0], None), None],
            // The circles on whose rims the place lies.
            Self::Circle(edge) => {
                let Some(line) = line_of(tail, sweep, edge) else {
                    return [None, None];
                };
                let offset = place - line.origin;
                let (along, across) = (offset.dot(line.along), offset.dot(normal.cross(line.along)));
                let cosine = tail.directions[0].dot(normal);
                let radius2 = (1.0 - cosine * cosine) * tail.lengths[0] * tail.lengths[0];
                let half_chord = safe_sqrt(radius2 - across * across);
                [along - half_chord, along + half_chord].map(|moved| {
                    let is_on_line = (0.0..=line.length).contains(&moved);
                    is_on_line.then(|| from(Some(line), moved, None)).flatten()
                })
            }
            Self::Copy => [None, None],
        }
    }
}

impl Chain {
    /// As the tail was drawn.
    fn of(tail: &Tail) -> Self {
        Self {
            start: None,
            directions: tail.directions,
            lengths: tail.lengths,
        }
    }

    /// The tail's segments but for the last, which leads to `place`.
    pub(super) fn connecting(tail: &Tail, place: Vec3) -> Option<Self> {
        Self::of(tail).lead_from(tail.before(0), place)
    }

    /// The axis about which directions of the first segment are drawn.
    pub(super) fn axis(&self, tail: &Tail) -> Vec3 {
        self.start.map_or(tail.directions[1], |point| point.geometric_normal)
    }

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

    /// With the last two segments from `start` by `joint` to `place`.
    fn lead_by(mut self, start: Vec3, joint: Vec3, place: Vec3) -> Option<Self> {
        self.directions[1] = (joint - start).try_normalize()?;
        self.lead_from(joint, place)
    }

    /// Turned about the direction of the first segment, so that the last one, of the length `length`, leads to `place`.
    fn turned(mut self, tail: &Tail, place: Vec3, length: f32) -> Option<Self> {
        let (center, axis) = (tail.before(1), tail.directions[2]);
        let across = |place: Vec3| {
            let offset = place - center;
            offset - axis * offset.dot(axis)
        };
        let (from, to) = (across(tail.before(0) + tail.directions[0] * length), across(place));
        let scale = 1.0 / (from.length() * to.length());
        if !scale.is_finite() {
            return None;
        }
        let (cosine, sine) = (from.dot(to) * scale, from.cross(to).dot(axis) * scale);
        let turn = |v: Vec3| {
            let along = axis * v.dot(axis);
            along + (v - along) * cosine + axis.cross(v) * sine
        };
        self.directions[0] = turn(self.directions[0]).normalize();
        self.directions[1] = turn(self.directions[1]).normalize();
        self.lengths[0] = length;
        Some(self)
    }
}

/// The line along an edge of a light's rectangle on which a tail starts.
fn line_of(tail: &Tail, sweep: &Sweep, edge: u8) -> Option<Line> {
    let rectangle = sweep.lamp.rectangle.as_ref()?;
    Some(rectangle.line_through(tail.start, usize::from(edge)))
}

/// The unit vector across `axis` to the side of `direction`.
fn aside(direction: Vec3, axis: Vec3) -> Vec3 {
    let across = direction - axis * direction.dot(axis);
    across.try_normalize().unwrap_or_else(|| Frame::from_normal(axis).s)
}

/// The ends of the segment before the last, when it is turned about the first and the last one about it so that the light path ends at `place`.
fn toroid_joints(tail: &Tail, place: Vec3) -> [Option<Vec3>; 2] {
    let center = tail.before(1);
    let [on, before, axis] = tail.directions.map(|v| v.as_dvec3());
    let [length, length_before, _] = tail.lengths.map(f64::from);
    let to_place = (place - center).as_dvec3();
    let distance = to_place.length();
    let towards = to_place / distance;
    // The direction sought has these cosines with the axis and with the direction to the place.
    let (with_axis, with_place) = (before.dot(axis), (length_before + length * on.dot(before)) / distance);
    let cosine = axis.dot(towards);
    let sine2 = 1.0 - cosine * cosine;
    let a = (with_axis - cosine * with_place) / sine2;
    let b = (with_place - cosine * with_axis) / sine2;
    let rest = (1.0 - a * with_axis - b * with_place) / sine2;
    if !(rest >= 0.0 && rest.is_finite()) {
        return [None, None];
    }
    let (in_plane, across) = (axis * a + towards * b, axis.cross(towards) * rest.sqrt());
    [in_plane + across, in_plane - across].map(|direction| Some(center + (direction * length_before).as_vec3()))
}
