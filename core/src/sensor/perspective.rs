//! Perspective cameras: pinholes and thin lenses.

use super::{Projection, Sensor, SensorSample};
use crate::geometry::Ray;
use crate::math::warp::square_to_disk;
use crate::math::{FRAC_1_PI, Vec2, Vec3, sqr, tan};

/// A thin lens.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Aperture radius [scene units].
    pub radius: f32,
    /// Distance of the plane in focus [scene units].
    pub focus_distance: f32,
}

impl Lens {
    /// Density of its points [1/unit^2].
    pub(super) fn pdf(self) -> f32 {
        FRAC_1_PI / sqr(self.radius)
    }
}

impl Sensor {
    /// The ray through the point `through` of the plane at distance one, in focus or not.
    pub(super) fn perspective_ray(&self, through: Vec3, lens: Option<Lens>, u: Vec2) -> Ray {
        let (start, direction) = match lens {
            None => (Vec3::ZERO, through.normalize()),
            Some(Lens { radius, focus_distance }) => {
                let start = (radius * square_to_disk(u)).extend(0.0);
                (start, (focus_distance * through - start).normalize())
            }
        };
        let [near, far] = self.clip.map(|distance| distance / direction.z);
        let world_direction = self.to_world.vector(direction).normalize();
        Ray {
            origin: self.to_world.point(start) + near * world_direction,
            direction: world_direction,
            max_distance: far - near,
        }
    }

    /// Where a ray that comes from the scene, or `from_infinity`, and is free up to the distance `free` meets the lens; `None` where it
    /// does not, or there is no lens. What lies before the near plane hides nothing.
    #[must_use]
    pub fn hit_lens(&self, ray: &Ray, free: f32, from_infinity: bool) -> Option<SensorSample> {
        let Projection::Perspective { lens: Some(lens), .. } = self.projection else {
            return None;
        };
        let to_local = self.to_world.inverted();
        let (origin, direction) = (to_local.point(ray.origin), to_local.vector(ray.direction).normalize());
        let farthest = if from_infinity { f32::INFINITY } else { self.clip[1] };
        if direction.z >= 0.0 || origin.z <= self.clip[0] || origin.z >= farthest {
            return None;
        }
        let distance = origin.z / -direction.z;
        let on_lens = (origin + distance * direction).truncate().extend(0.0);
        let near = (origin.z - self.clip[0]) / -direction.z;
        if on_lens.length_squared() >= sqr(lens.radius) || near > free {
            return None;
        }
        let back = Ray {
            direction: -ray.direction,
            ..*ray
        };
        Some(SensorSample {
            pixel: self.pixel_of(self.through(on_lens, -direction)),
            pdf: self.pdf_we(&back),
            direction: ray.direction,
            distance,
        })
    }

    /// The point of the plane at distance one through which the camera's ray goes that leaves the lens at `on_lens` along `offset`,
    /// over half the width of the image; in camera coordinates.
    pub(super) fn through(&self, on_lens: Vec3, offset: Vec3) -> Vec2 {
        let Projection::Perspective { fov_x, lens, .. } = self.projection else {
            return offset.truncate();
        };
        let slope = offset.truncate() / offset.z;
        let through = lens.map_or(slope, |lens| slope + on_lens.truncate() / lens.focus_distance);
        through / tan(0.5 * fov_x)
    }
}
