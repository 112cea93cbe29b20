use crate::geometry::Ray;
use crate::math::warp::one_minus_cos;
use crate::math::{Frame, TAU, Transform, Vec2, Vec3, acos, cos, safe_sqrt, sin, sin_cos};
use crate::spectrum::Spectrum;

/// A point light that shines into a cone.
#[derive(Debug)]
pub(super) struct Spot {
    position: Vec3,
    /// About the axis of the cone.
    frame: Frame,
    intensity: Spectrum,
    cutoff_angle: f32,
    beam_width: f32,
    cos_beam: f32,
    one_minus_cos_cutoff: f32,
}

impl Spot {
    pub(super) fn new(to_world: &Transform, intensity: Spectrum, cutoff_angle: f32, beam_width: f32) -> Self {
        Self {
            position: to_world.point(Vec3::ZERO),
            frame: Frame::from_normal(to_world.vector(Vec3::Z).normalize()),
            intensity,
            cutoff_angle,
            beam_width,
            cos_beam: cos(beam_width),
            one_minus_cos_cutoff: one_minus_cos(cutoff_angle),
        }
    }

    pub(super) fn position(&self) -> Vec3 {
        self.position
    }

    /// Intensity [W/sr] along the unit vector `direction`.
    pub(super) fn intensity(&self, direction: Vec3) -> Spectrum {
        self.intensity * self.falloff(self.frame.n.dot(direction))
    }

    fn falloff(&self, cos_theta: f32) -> f32 {
        if cos_theta >= self.cos_beam {
            1.0
        } else {
            ((self.cutoff_angle - acos(cos_theta)) / (self.cutoff_angle - self.beam_width)).max(0.0)
        }
    }

    /// Luminance of `2 pi` times the integral of the falloff times the sine.
    pub(super) fn power(&self) -> f32 {
        let width = self.cutoff_angle - self.beam_width;
        let part = if width > 1e-3 {
            1.0 - (sin(self.cutoff_angle) - sin(self.beam_width)) / width
        } else {
            self.one_minus_cos_cutoff
        };
        self.intensity.luminance() * TAU * part
    }

    /// A ray uniform within the cone, and intensity over its density.
    pub(super) fn emit(&self, u: Vec2) -> (Ray, Spectrum) {
        let below_axis = u.x * self.one_minus_cos_cutoff;
        let sine = safe_sqrt(below_axis * (2.0 - below_axis));
        let (sin_phi, cos_phi) = sin_cos(TAU * u.y);
        let cos_theta = 1.0 - below_axis;
        let direction = self
            .frame
            .to_world(Vec3::new(sine * cos_phi, sine * sin_phi, cos_theta))
            .normalize();
        let flux = self.intensity * (self.falloff(cos_theta) * TAU * self.one_minus_cos_cutoff);
        (
            Ray {
                origin: self.position,
                direction,
                max_distance: f32::INFINITY,
            },
            flux,
        )
    }
}
