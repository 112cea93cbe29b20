//! Lights.
use crate::math::Vec3;
use crate::spectrum::Spectrum;

/// Index of a light in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightId(pub u32);

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
    /// Solid-angle density [1/sr] times the probability of choosing the light; for a delta light that probability alone.
    pub pdf: f32,
    /// Whether no other technique can hit this light (point, spot, directional).
    pub delta: bool,
}

/// The start of a light path.
#[derive(Clone, Copy, Debug)]
pub struct EmissionSample {
    /// Ray away from the light, already off its surface.
    pub ray: crate::geometry::Ray,
    /// Flux of the path: emitted radiance times cosine over the density of origin, direction and light choice [W].
    pub flux: Spectrum,
}

/// A light, as validated data in world space.
#[derive(Clone, Debug)]
pub enum Light {
    /// A shape whose outer side emits `radiance` [W/(m^2 sr)] in every direction.
    Area {
        shape: crate::geometry::ShapeId,
        radiance: crate::texture::Texture,
    },
    /// `intensity` [W/sr] in every direction from `position`.
    Point { position: Vec3, intensity: Spectrum },
    /// Mitsuba's `spot`: full intensity within `beam_width`, falling linearly in angle to zero at `cutoff_angle` [radians].
    Spot {
        to_world: crate::math::Transform,
        intensity: Spectrum,
        cutoff_angle: f32,
        beam_width: f32,
    },
    /// `irradiance` [W/m^2] on a surface facing it, travelling along the unit vector `direction`.
    Directional { direction: Vec3, irradiance: Spectrum },
    /// The same `radiance` from everywhere outside.
    Constant { radiance: Spectrum },
    /// Mitsuba's `envmap`: latitude-longitude image, `to_world` maps its frame (up is +y) to the world.
    Environment {
        image: std::sync::Arc<crate::texture::Bitmap>,
        scale: f32,
        to_world: crate::math::Transform,
    },
}

/// The scene's lights, and the probability with which each is chosen: in proportion to its power.
#[derive(Debug)]
pub struct Lights {}

impl Lights {
    /// Builds the distributions. `geometry` gives area lights their shapes and distant lights the scene's bounds.
    #[must_use]
    pub fn build(_lights: Vec<Light>, _geometry: &crate::geometry::Geometry) -> Self {
        unimplemented!()
    }
    /// Whether there is no light.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        unimplemented!()
    }
    /// Connects `from` with a light. `choice` selects the light, `u` the point on it. `None` where nothing can arrive.
    #[must_use]
    pub fn sample_direct(
        &self,
        _geometry: &crate::geometry::Geometry,
        _from: Vec3,
        _choice: f32,
        _u: crate::math::Vec2,
    ) -> Option<LightSample> {
        unimplemented!()
    }
    /// Density [1/sr, choice of light included] with which [`Self::sample_direct`] at `from` returns the direction to `hit`, a point on the area light `light`.
    #[must_use]
    pub fn pdf_area(
        &self,
        _geometry: &crate::geometry::Geometry,
        _light: LightId,
        _from: Vec3,
        _hit: &crate::geometry::SurfacePoint,
    ) -> f32 {
        unimplemented!()
    }
    /// Radiance that the area light `light` emits at `hit` along the unit vector `wo`.
    #[must_use]
    pub fn emitted(&self, _light: LightId, _hit: &crate::geometry::SurfacePoint, _wo: Vec3) -> Spectrum {
        unimplemented!()
    }
    /// Radiance that arrives from outside the scene along a ray of unit `direction` that hits nothing; the sum over distant lights.
    #[must_use]
    pub fn background(&self, _direction: Vec3) -> Spectrum {
        unimplemented!()
    }
    /// Density [1/sr, choice of light included] with which [`Self::sample_direct`] returns `direction` from the background lights.
    #[must_use]
    pub fn pdf_background(&self, _direction: Vec3) -> f32 {
        unimplemented!()
    }
    /// Starts a light path.
    #[must_use]
    pub fn sample_emission(
        &self,
        _geometry: &crate::geometry::Geometry,
        _choice: f32,
        _u_position: crate::math::Vec2,
        _u_direction: crate::math::Vec2,
    ) -> Option<EmissionSample> {
        unimplemented!()
    }
}
