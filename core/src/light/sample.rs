//! Samples of lights: connections to them, and the starts of light paths.

use super::LightId;
use crate::geometry::{Ray, SurfacePoint};
use crate::math::Vec3;
use crate::spectrum::Spectrum;

/// A connection from a point to a light (next-event estimation).
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction from the point to the light.
    pub wi: Vec3,
    /// Distance to the light; infinite for distant ones.
    pub distance: f32,
    /// Radiance arriving along `wi` if nothing is in the way; for a delta light divided by nothing: the factor such that
    /// `f * |cos| * radiance / pdf` estimates the reflected radiance.
    pub radiance: Spectrum,
    /// Solid-angle density \[1/sr\] times the probability of choosing the light; for a delta light that probability alone.
    pub pdf: f32,
    /// Whether no other technique can hit this light (point, spot, directional).
    pub delta: bool,
    /// Density with which a light path from the same point of the light arrives at the place connected [1/unit^2, by area that
    /// faces the light], times that of starting there ([`Lights::sample_emission`](super::Lights::sample_emission)) over that of being connected with.
    pub arrival: f32,
}

/// The start of a light path.
#[derive(Clone, Copy, Debug)]
pub struct EmissionSample {
    /// Ray away from the light, already off its surface.
    pub ray: Ray,
    /// Flux of the path: emitted radiance times cosine over the density of origin, direction and light choice \[W\].
    pub flux: Spectrum,
    /// Where it starts.
    pub origin: Origin,
    /// Density of the origin, the choice of light included, where it lies at a finite distance: [1/unit^2] on an area light, 1 of a
    /// point. Of the ray through the disc that faces it [1/unit^2] where it does not.
    pub pdf_position: f32,
    /// Solid-angle density of the direction \[1/sr\], the choice of light included where it lies at infinity; of a directional light
    /// that choice alone, and 1 where the origin says the direction.
    pub pdf_direction: f32,
}

/// Where a light path starts.
#[derive(Clone, Copy, Debug)]
pub enum Origin {
    /// On an area light.
    Area(LightId, SurfacePoint),
    /// On a shape that emits along its normals: nothing but light paths finds it.
    Normals(LightId),
    /// At a point: a point light, a spot, a projector or a goniometric light.
    Point(LightId),
    /// At infinity, in one direction.
    Directional,
    /// At infinity, in any direction.
    Background,
    /// At infinity, behind the portal of this light.
    Portal(LightId),
}

impl Origin {
    /// Whether paths that are scattered can find it.
    #[must_use]
    pub fn is_hit_by_chance(&self) -> bool {
        matches!(self, Self::Area(..) | Self::Background | Self::Portal(_))
    }

    /// Whether it lies at infinity.
    #[must_use]
    pub fn is_infinite(&self) -> bool {
        matches!(self, Self::Directional | Self::Background | Self::Portal(_))
    }
}
