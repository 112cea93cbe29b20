//! Spheres, discs and cylinders: intersection in double precision.

use super::instance::Placed;
use super::{Line, Shape};
use crate::math::{DVec3, Vec3};
use glam::DAffine3;

/// A primitive that is not a triangle.
#[derive(Clone, Debug)]
pub(super) enum Curved {
    /// A sphere in world space.
    Sphere { center: DVec3, radius: f64 },
    /// The unit sphere about the local origin.
    Ellipsoid { to_local: DAffine3 },
    /// The unit disc about the local z axis.
    Disk { to_local: DAffine3 },
    /// The mantle of the cylinder of radius 1 about the local z axis from z = 0 to 1.
    Cylinder { to_local: DAffine3 },
    /// A group of shapes, which has a hierarchy of its own.
    Instance(Box<Placed>),
}

impl Curved {
    /// The primitive of a shape, or `None` for a mesh.
    pub(super) fn new(shape: &Shape) -> Option<Self> {
        match shape {
            Shape::Mesh(_) => None,
            Shape::Sphere { center, radius, .. } => Some(Self::Sphere {
                center: center.as_dvec3(),
                radius: f64::from(*radius),
            }),
            Shape::Ellipsoid { to_world, .. } => Some(Self::Ellipsoid {
                to_local: DAffine3::from_mat4(to_world.inverted().matrix()),
            }),
            Shape::Disk { to_world, .. } => Some(Self::Disk {
                to_local: DAffine3::from_mat4(to_world.inverted().matrix()),
            }),
            Shape::Cylinder { to_world, .. } => Some(Self::Cylinder {
                to_local: DAffine3::from_mat4(to_world.inverted().matrix()),
            }),
            Shape::Instance { group, to_world } => Some(Self::Instance(Box::new(Placed::new(group, to_world)))),
        }
    }

    /// The smallest positive distance at which the line meets the primitive; `None` for an instance.
    pub(super) fn intersect(&self, line: &Line) -> Option<f64> {
        let Line { origin, direction } = *line;
        match self {
            Self::Sphere { center, radius } => intersect_sphere(origin - *center, direction, *radius),
            Self::Ellipsoid { to_local } => {
                let origin = to_local.transform_point3(origin);
                intersect_sphere(origin, to_local.transform_vector3(direction), 1.0)
            }
            Self::Disk { to_local } => {
                let origin = to_local.transform_point3(origin);
                let direction = to_local.transform_vector3(direction);
                let t = -origin.z / direction.z;
                let at = origin + t * direction;
                (t > 0.0 && t.is_finite() && at.x * at.x + at.y * at.y <= 1.0).then_some(t)
            }
            Self::Cylinder { to_local } => {
                let origin = to_local.transform_point3(origin);
                let direction = to_local.transform_vector3(direction);
                let across = |v: DVec3| v.with_z(0.0);
                let hits = intersect_round(across(origin), across(direction), 1.0)?;
                let within = |t: &f64| (0.0..=1.0).contains(&(origin.z + t * direction.z));
                hits.into_iter().find(|t| *t > 0.0 && t.is_finite() && within(t))
            }
            Self::Instance(_) => None,
        }
    }
}

/// The smallest positive root for a sphere about the origin.
fn intersect_sphere(origin: DVec3, direction: DVec3, radius: f64) -> Option<f64> {
    intersect_round(origin, direction, radius)?
        .into_iter()
        .find(|t| *t > 0.0)
}

/// The roots, in order, of `|origin + t direction| = radius`. The discriminant comes from the distance between centre
/// and line, which does not cancel when the sphere is far away (Haines et al. 2019, Ray Tracing Gems, chapter 7).
fn intersect_round(origin: DVec3, direction: DVec3, radius: f64) -> Option<[f64; 2]> {
    let a = direction.length_squared();
    let b = -origin.dot(direction);
    let nearest = origin + (b / a) * direction;
    let discriminant = radius * radius - nearest.length_squared();
    if discriminant < 0.0 {
        return None;
    }
    let c = origin.length_squared() - radius * radius;
    let q = b + (discriminant * a).sqrt().copysign(b);
    let (t0, t1) = (c / q, q / a);
    Some(if t0 < t1 { [t0, t1] } else { [t1, t0] })
}

/// Bounds of the primitive of a shape that is not a mesh.
pub(super) fn bounds(shape: &Shape) -> Option<(Vec3, Vec3)> {
    let (lower, upper) = match shape {
        Shape::Mesh(_) => return None,
        Shape::Sphere { center, radius, .. } => {
            let (center, extent) = (center.as_dvec3(), DVec3::splat(f64::from(*radius)));
            (center - extent, center + extent)
        }
        Shape::Ellipsoid { to_world, .. } | Shape::Disk { to_world, .. } | Shape::Cylinder { to_world, .. } => {
            let matrix = to_world.matrix();
            let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.truncate());
            let (center, round) = (matrix.w_axis.truncate(), x * x + y * y);
            let (far, round) = match shape {
                Shape::Ellipsoid { .. } => (center, round + z * z),
                Shape::Cylinder { .. } => (center + z, round),
                _ => (center, round),
            };
            let extent = round.map(f64::sqrt);
            (center.min(far) - extent, center.max(far) + extent)
        }
        Shape::Instance { group, to_world } => {
            let (lower, upper) = group.bounds();
            let corners = (0..8).map(|corner| {
                let pick = |axis: usize| {
                    if corner >> axis & 1 == 0 {
                        lower[axis]
                    } else {
                        upper[axis]
                    }
                };
                let corner = Vec3::new(pick(0), pick(1), pick(2)).as_dvec3();
                to_world.matrix().transform_point3(corner)
            });
            corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lower, upper), corner| {
                (lower.min(corner), upper.max(corner))
            })
        }
    };
    let lower = lower.as_vec3().to_array().map(f32::next_down);
    let upper = upper.as_vec3().to_array().map(f32::next_up);
    Some((lower.into(), upper.into()))
}
