use crate::geometry::Ray;
use crate::math::warp::Cone;
use crate::math::{Frame, TAU, Transform, Vec2, Vec3, atan2};
use crate::spectrum::Spectrum;

/// A point light that shines into a cone.
#[derive(Clone, Debug)]
pub(super) struct Spot {
    position: Vec3,
    /// About the axis of the cone.
    frame: Frame,
    intensity: Spectrum,
    cutoff_angle: f32,
    beam_width: f32,
    cone: Cone,
}

impl Spot {
    pub(super) fn new(to_world: &Transform, intensity: Spectrum, cutoff_angle: f32, beam_width: f32) -> Self {
        Self {
            position: to_world.point(Vec3::ZERO),
            frame: Frame::from_normal(to_world.vector(Vec3::Z).normalize()),
            intensity,
            cutoff_angle,
            beam_width,
            cone: Cone::of_angle(cutoff_angle),
        }
    }

    /// The light where `to_world` puts it.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        Self::new(to_world, self.intensity, self.cutoff_angle, self.beam_width)
    }

    /// Solid-angle density of the directions of light paths [1/sr].
    pub(super) fn pdf(&self) -> f32 {
        self.cone.pdf()
    }

    pub(super) fn position(&self) -> Vec3 {
        self.position
    }

    /// Intensity [W/sr] along the unit vector `direction`.
    pub(super) fn intensity(&self, direction: Vec3) -> Spectrum {
        self.intensity * self.falloff(self.frame.to_local(direction))
    }

    /// Share of the intensity in a direction in the light's frame. The angle comes from the sine, since the cosine of a narrow
    /// beam's angles does not tell them apart.
    fn falloff(&self, local: Vec3) -> f32 {
        let theta = atan2(local.truncate().length(), local.z);
        if theta <= self.beam_width {
            1.0
        } else {
            ((self.cutoff_angle - theta) / (self.cutoff_angle - self.beam_width)).max(0.0)
        }
    }

    /// Luminance of `2 pi` times the integral of the falloff times the sine.
    pub(super) fn power(&self) -> f32 {
        let [cutoff, beam] = [self.cutoff_angle, self.beam_width].map(f64::from);
        // (sin c - sin b) / (c - b) = cos((c + b) / 2) sin(h) / h, where h is half the width.
        let half_width = 0.5 * (cutoff - beam);
        let sinc = if half_width > 0.0 {
            libm::sin(half_width) / half_width
        } else {
            1.0
        };
        let part = 1.0 - libm::cos(0.5 * (cutoff + beam)) * sinc;
        self.intensity.luminance() * TAU * part as f32
    }

    /// A ray uniform within the cone, and intensity over its density.
    pub(super) fn emit(&self, u: Vec2) -> (Ray, Spectrum) {
        let local = self.cone.sample(u);
        let direction = self.frame.to_world(local).normalize();
        let flux = self.intensity * (self.falloff(local) / self.cone.pdf());
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
