//! Scenes: as written (untrusted) and as rendered (validated, built).
//!
//! Files come through [`SceneFiles`]; `xml` reads them into a `Description`, in which every value has its type and its
//! place; `build` turns that into a [`Scene`]. What was written and never asked for is an error, as in Mitsuba.

mod build;
mod description;
mod error;
mod files;
mod image;
mod limits;
mod loader;
mod mesh;
mod reader;
mod spectrum;
mod text;
mod xml;

pub use error::{Place, SceneError};
pub use files::{RecordedFiles, SceneFiles, SceneFolder, normalise};
pub use limits::Limits;

use crate::film::FilmSettings;
use crate::geometry::{Geometry, ShapeId, SurfacePoint};
use crate::light::{LightId, Lights};
use crate::material::Material;
use crate::sensor::Sensor;
use crate::settings::IntegratorSettings;
use std::collections::BTreeMap;

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
    /// Loads the scene file `main`. `defines` set its parameters in place of their `<default>`s.
    ///
    /// # Errors
    /// Anything wrong with the scene or its files, with its place; see [`SceneError`].
    pub fn load(
        files: &dyn SceneFiles,
        main: &str,
        defines: &BTreeMap<String, String>,
        limits: &Limits,
    ) -> Result<Self, SceneError> {
        let mut loader = loader::Loader::new(files, limits);
        let description = xml::read(&mut loader, main, defines)?;
        build::build(&description, &mut loader)
    }

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
