//! Cones that point to the camera.

use crate::math::warp::{about_z, one_minus_cos, square_to_sphere};
use crate::math::{Frame, PI, TAU, Vec2, Vec3, exp, exp_m1, ln_1p, sin};
use crate::sensor::{Sensor, Towards};

/// A normalised lobe `(n + 1) / (2 pi) cos^n` about the direction to the camera; what falls below the surface is mirrored
/// at it, so that the density stays exact (thesis, section 4.2.2).
pub(super) struct CameraLobe<'a> {
    camera: &'a Sensor,
    theta: f32,
    /// Radius about a place in which camera paths want its cones, each in its own direction to the camera \[scene units\].
    radius: f32,
    defensive: f32,
}

impl<'a> CameraLobe<'a> {
    /// Lobes as wide as the angular bandwidth `theta` \[radians\] and the angle under which the lens is seen, and in which directions to the camera
    /// differ within `radius` \[scene units\]. The share `defensive` of the samples goes to all directions.
    pub(super) fn new(camera: &'a Sensor, theta: f32, radius: f32, defensive: f32) -> Self {
        Self {
            camera,
            theta,
            radius,
            defensive,
        }
    }

    /// How much the direction to the camera turns within the radius, about \[radians\].
    fn turn(&self, position: Vec3, direction: Vec3) -> f32 {
        if self.radius == 0.0 {
            return 0.0;
        }
        let beside = position + direction.any_orthonormal_vector() * self.radius;
        let other = self.camera.direction_from(beside);
        other.map_or(PI, |other| (other.direction - direction).length())
    }

    /// The lobe at a point of a surface of this normal, or without one in a medium; `None` at the camera itself.
    ///
    /// The mean of `1 - cos` over the lobe, `1 / (n + 2)`, is that over the cone around all that counts, `(1 - cos theta) / 2`.
    /// Where a lens reaches through the tangent plane both sides count, and nothing is mirrored.
    pub(super) fn at(&self, position: Vec3, normal: Option<Vec3>) -> Option<LobeAt> {
        let Towards { direction, lens_angle } = self.camera.direction_from(position)?;
        let plane = normal.and_then(|normal| {
            let height = direction.dot(normal);
            let on_one_side = lens_angle < 0.5 * PI && height.abs() >= sin(lens_angle);
            on_one_side.then_some(if height < 0.0 { -normal } else { normal })
        });
        let width = self.theta + lens_angle + self.turn(position, direction);
        Some(LobeAt {
            axis: direction,
            normal: plane,
            exponent: (2.0 / one_minus_cos(width.min(PI)) - 2.0).max(0.0),
            defensive: self.defensive,
        })
    }
}

/// A camera lobe at a surface point.
pub(super) struct LobeAt {
    axis: Vec3,
    /// Geometric normal on the camera's side, at whose plane the lobe is mirrored.
    normal: Option<Vec3>,
    exponent: f32,
    /// Share of the samples that goes to all directions.
    defensive: f32,
}

impl LobeAt {
    pub(super) fn sample(&self, choice: f64, u: Vec2) -> Vec3 {
        if choice < f64::from(self.defensive) {
            return square_to_sphere(u);
        }
        // 1 - (1 - u)^(1 / (n + 1))
        let one_minus_cos = -exp_m1(ln_1p(-u.x) / (self.exponent + 1.0));
        let direction = Frame::from_normal(self.axis)
            .to_world(about_z(one_minus_cos, u.y))
            .normalize();
        match self.normal {
            Some(normal) if direction.dot(normal) < 0.0 => mirrored(direction, normal),
            _ => direction,
        }
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        let lobe = match self.normal {
            None => self.lobe(direction),
            Some(normal) if direction.dot(normal) < 0.0 => 0.0,
            Some(normal) => self.lobe(direction) + self.lobe(mirrored(direction, normal)),
        };
        self.defensive / (4.0 * PI) + (1.0 - self.defensive) * lobe
    }

    fn lobe(&self, direction: Vec3) -> f32 {
        let one_minus_cos = 0.5 * (direction - self.axis).length_squared();
        if one_minus_cos >= 1.0 {
            return 0.0;
        }
        (self.exponent + 1.0) / TAU * exp(self.exponent * ln_1p(-one_minus_cos))
    }
}

fn mirrored(direction: Vec3, normal: Vec3) -> Vec3 {
    direction - 2.0 * direction.dot(normal) * normal
}
