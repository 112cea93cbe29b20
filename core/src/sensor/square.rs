//! Squares that measure irradiance.

use super::{Projection, Sensor, SensorSample};
use crate::geometry::Ray;
use crate::math::{Vec2, Vec3};

impl Sensor {
    /// The normal of a meter's square.
    pub(crate) fn meter_normal(&self) -> Option<Vec3> {
        match self.projection {
            Projection::Irradiance { flipped } => Some(self.plane_normal(flipped)),
            Projection::Perspective { .. } | Projection::Orthographic | Projection::Spherical => None,
        }
    }

    /// The normal of the square of an irradiance meter.
    pub(super) fn plane_normal(&self, flipped: bool) -> Vec3 {
        let normal = self.to_world.normal(Vec3::Z);
        if flipped { -normal } else { normal }
    }

    /// Distance of the corners of that square from its middle, at most [scene units].
    pub(super) fn plane_radius(&self) -> f32 {
        self.to_world.vector(Vec3::X).length() + self.to_world.vector(Vec3::Y).length()
    }

    /// As [`Self::sample_we`], of the point `u` of the square that measures irradiance.
    pub(super) fn sample_plane(&self, position: Vec3, u: Vec2) -> Option<SensorSample> {
        let offset = position - self.to_world.point((2.0 * u - Vec2::ONE).extend(0.0));
        let distance = offset.length();
        let ray = Ray {
            origin: position,
            direction: offset.try_normalize()?,
            max_distance: distance,
        };
        let pdf = self.pdf_we(&ray);
        (pdf.cos > 0.0).then(|| SensorSample {
            pixel: u * Vec2::from(self.resolution.map(|n| n as f32)),
            pdf,
            direction: -ray.direction,
            distance,
        })
    }
}
