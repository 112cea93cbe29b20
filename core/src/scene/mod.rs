//! Scenes: as written (untrusted) and as rendered (validated, built).

use crate::film::FilmSettings;
use crate::geometry::{Geometry, ShapeId, SurfacePoint};
use crate::light::{LightId, Lights};
use crate::material::Material;
use crate::sensor::Sensor;
use crate::settings::IntegratorSettings;

/// A renderable scene: validated and built. Nothing in it can make rendering fail.
#[derive(Debug)]
pub struct Scene {
    /// Shapes and their hierarchy.
    pub geometry: Geometry,
    /// What each shape is made of, by [`ShapeId`].
    pub bindings: Vec<ShapeBinding>,
    /// Materials, by [`ShapeBinding::material`].
    pub materials: Vec<Material>,
    /// Lights and the distribution they are chosen by.
    pub lights: Lights,
    /// The camera.
    pub sensor: Sensor,
    /// Image size and filter.
    pub film: FilmSettings,
    /// What the scene file asks for.
    pub wishes: Wishes,
}

/// What a shape is made of.
#[derive(Clone, Copy, Debug)]
pub struct ShapeBinding {
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// The area light on the shape.
    pub light: Option<LightId>,
}

/// Rendering settings that the scene file carries; a job may override them.
#[derive(Clone, Debug, Default)]
pub struct Wishes {
    /// The scene's own `<integrator>`, where it is one of ours.
    pub integrator: Option<IntegratorSettings>,
    /// `max_depth` of the scene's `<integrator>`, whichever it is.
    pub max_depth: Option<u32>,
    /// `sample_count` of the scene's `<sampler>`.
    pub sample_count: Option<u32>,
}

impl Scene {
    /// The material at a point.
    #[must_use]
    pub fn material(&self, point: &SurfacePoint) -> &Material {
        &self.materials[self.binding(point.shape).material as usize]
    }

    /// The area light at a point.
    #[must_use]
    pub fn light_at(&self, point: &SurfacePoint) -> Option<LightId> {
        self.binding(point.shape).light
    }

    fn binding(&self, shape: ShapeId) -> &ShapeBinding {
        &self.bindings[shape.0 as usize]
    }
}
