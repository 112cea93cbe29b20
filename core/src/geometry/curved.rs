//! Spheres and discs: intersection in double precision.

use super::{Ray, Shape};
use crate::math::{DVec3, Vec3};
use glam::DAffine3;

/// A curved or bounded primitive that is not a triangle.
#[derive(Clone, Debug)]
pub(super) enum Curved {
    /// A sphere in world space.
    Sphere { center: DVec3, radius: f64 },
    /// The unit disc about the local z axis.
    Disk { to_local: DAffine3 },
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
            Shape::Disk { to_world, .. } => Some(Self::Disk {
                to_local: DAffine3::from_mat4(to_world.inverted().matrix()),
            }),
        }
    }

    /// The smallest positive distance at which the ray meets the primitive.
    pub(super) fn intersect(&self, ray: &Ray) -> Option<f64> {
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        match self {
            Self::Sphere { center, radius } => intersect_sphere(origin - *center, direction, *radius),
            Self::Disk { to_local } => {
                let origin = to_local.transform_point3(origin);
                let direction = to_local.transform_vector3(direction);
                let t = -origin.z / direction.z;
                let at = origin + t * direction;
                (t > 0.0 && t.is_finite() && at.x * at.x + at.y * at.y <= 1.0).then_some(t)
            }
        }
    }
}

/// The smallest positive root for a sphere about the origin. The discriminant comes from the distance between centre
/// and line, which does not cancel when the sphere is far away (Haines et al. 2019, Ray Tracing Gems, chapter 7).
fn intersect_sphere(origin: DVec3, direction: DVec3, radius: f64) -> Option<f64> {
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
    let (near, far) = if t0 < t1 { (t0, t1) } else { (t1, t0) };
    [near, far].into_iter().find(|t| *t > 0.0)
}

/// Bounds of the primitive of a shape that is not a mesh.
pub(super) fn bounds(shape: &Shape) -> Option<(Vec3, Vec3)> {
    let (center, extent) = match shape {
        Shape::Mesh(_) => return None,
        Shape::Sphere { center, radius, .. } => (center.as_dvec3(), DVec3::splat(f64::from(*radius))),
        Shape::Disk { to_world, .. } => {
            let matrix = to_world.matrix();
            let (x, y) = (matrix.x_axis.truncate(), matrix.y_axis.truncate());
            (matrix.w_axis.truncate(), (x * x + y * y).map(f64::sqrt))
        }
    };
    let lower = (center - extent).as_vec3().to_array().map(f32::next_down);
    let upper = (center + extent).as_vec3().to_array().map(f32::next_up);
    Some((lower.into(), upper.into()))
}
