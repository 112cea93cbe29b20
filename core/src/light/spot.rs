use super::Falloff;
use super::projector::axes;
use crate::geometry::Ray;
use crate::math::warp::{Cone, one_minus_cos};
use crate::math::{Frame, TAU, Transform, Vec2, Vec3, atan2, cos, tan};
use crate::spectrum::Spectrum;
use crate::texture::{Texture, TexturePoint};

/// A point light that shines into a cone.
#[derive(Clone, Debug)]
pub(super) struct Spot {
    position: Vec3,
    /// About the axis of the cone.
    frame: Frame,
    intensity: Spectrum,
    cutoff_angle: f32,
    beam_width: f32,
    falloff: Falloff,
    cone: Cone,
    slide: Option<Box<Slide>>,
}

/// What colours a spot's light: an image on the plane at distance 1, on the square about the cone.
#[derive(Clone, Debug)]
struct Slide {
    /// The light's axes; the image's u runs along +x and its v along +y.
    axes: Frame,
    /// Half the side of the square.
    half_size: f32,
    texture: Texture,
}

impl Slide {
    /// Factor on the light along the unit vector `direction`, which lies within the cone.
    fn factor(&self, direction: Vec3, position: Vec3) -> Spectrum {
        let local = self.axes.to_local(direction);
        let uv = 0.5 * (Vec2::ONE + local.truncate() / (local.z * self.half_size));
        self.texture.eval(&TexturePoint {
            position,
            ..TexturePoint::of_uv(uv)
        })
    }
}

impl Spot {
    /// The angles are those of the beam and of the cone; `texture` colours the light of a cone below a right angle.
    pub(super) fn new(
        to_world: &Transform,
        intensity: Spectrum,
        [beam_width, cutoff_angle]: [f32; 2],
        falloff: Falloff,
        texture: Option<Texture>,
    ) -> Self {
        Self {
            position: to_world.point(Vec3::ZERO),
            frame: Frame::from_normal(to_world.vector(Vec3::Z).normalize()),
            intensity,
            cutoff_angle,
            beam_width,
            falloff,
            cone: Cone::of_angle(cutoff_angle),
            slide: texture.map(|texture| {
                Box::new(Slide {
                    axes: axes(to_world),
                    half_size: tan(cutoff_angle),
                    texture,
                })
            }),
        }
    }

    /// The light where `to_world` puts it.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        let texture = self.slide.as_ref().map(|slide| slide.texture.clone());
        let angles = [self.beam_width, self.cutoff_angle];
        Self::new(to_world, self.intensity, angles, self.falloff, texture)
    }

    /// Solid-angle density of the directions of light paths [1/sr].
    pub(super) fn pdf(&self) -> f32 {
        self.cone.pdf()
    }

    pub(super) fn position(&self) -> Vec3 {
        self.position
    }

    /// The unit axis of the cone, and the cosine of its half angle.
    pub(super) fn cone(&self) -> (Vec3, f32) {
        (self.frame.n, cos(self.cutoff_angle))
    }

    /// Intensity [W/sr] along the unit vector `direction`.
    pub(super) fn intensity(&self, direction: Vec3) -> Spectrum {
        self.coloured(self.intensity * self.falloff(self.frame.to_local(direction)), direction)
    }

    /// What is left of the light along `direction`.
    fn coloured(&self, light: Spectrum, direction: Vec3) -> Spectrum {
        match &self.slide {
            Some(slide) if !light.is_black() => light * slide.factor(direction, self.position),
            _ => light,
        }
    }

    /// Share of the intensity in a direction in the light's frame. The angle comes from the sine, since the cosine of a narrow
    /// beam's angles does not tell them apart.
    fn falloff(&self, local: Vec3) -> f32 {
        let theta = atan2(local.truncate().length(), local.z);
        if theta <= self.beam_width {
            return 1.0;
        }
        let share = match self.falloff {
            Falloff::Linear => (self.cutoff_angle - theta) / (self.cutoff_angle - self.beam_width),
            Falloff::SmoothStep | Falloff::FourthPower => {
                let [edge, beam] = [self.cutoff_angle, self.beam_width].map(one_minus_cos);
                (edge - one_minus_cos(theta)) / (edge - beam)
            }
        };
        let share = share.clamp(0.0, 1.0);
        match self.falloff {
            Falloff::Linear => share,
            Falloff::SmoothStep => share * share * (3.0 - 2.0 * share),
            Falloff::FourthPower => (share * share) * (share * share),
        }
    }

    /// Luminance of `2 pi` times the integral of the falloff times the sine; of a texture the mean counts.
    pub(super) fn power(&self) -> f32 {
        let [cutoff, beam] = [self.cutoff_angle, self.beam_width].map(f64::from);
        // (sin c - sin b) / (c - b) = cos((c + b) / 2) sin(h) / h, where h is half the width.
        let half_width = 0.5 * (cutoff - beam);
        let sinc = if half_width > 0.0 {
            libm::sin(half_width) / half_width
        } else {
            1.0
        };
        // The mean of the falloff over the cosines beyond the beam is the integral of its polynomial.
        let by_cosine = |mean: f64| 1.0 - libm::cos(beam) + mean * (libm::cos(beam) - libm::cos(cutoff));
        let part = match self.falloff {
            Falloff::Linear => 1.0 - libm::cos(0.5 * (cutoff + beam)) * sinc,
            Falloff::SmoothStep => by_cosine(0.5),
            Falloff::FourthPower => by_cosine(0.2),
        };
        let texture = self.slide.as_ref().map_or(Spectrum::ONE, |slide| slide.texture.mean());
        (self.intensity * texture).luminance() * TAU * part as f32
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
            self.coloured(flux, direction),
        )
    }
}
