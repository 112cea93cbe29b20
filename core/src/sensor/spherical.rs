//! Cameras that look everywhere.

use super::{Sensor, SensorSample};
use crate::geometry::Ray;
use crate::math::{FRAC_1_PI, TAU, Vec2, Vec3, atan2};

impl Sensor {
    /// As [`Self::sample_we`], of the camera in the middle of all directions.
    pub(super) fn sample_spherical(&self, position: Vec3, local: Vec3) -> Option<SensorSample> {
        let offset = position - self.to_world.point(Vec3::ZERO);
        let distance = offset.length();
        let ray = Ray {
            origin: position,
            direction: offset.try_normalize()?,
            max_distance: distance,
        };
        let turn = atan2(local.x, -local.z) / TAU;
        let at = Vec2::new(
            if turn < 0.0 { turn + 1.0 } else { turn },
            atan2(Vec2::new(local.x, local.z).length(), local.y) * FRAC_1_PI,
        );
        (distance > self.clip[0] && distance < self.clip[1]).then(|| SensorSample {
            pixel: at * Vec2::from(self.resolution.map(|n| n as f32)),
            pdf: self.pdf_we(&ray),
            direction: -ray.direction,
            distance,
        })
    }
}
