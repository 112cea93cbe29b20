//! Scenes: as written (untrusted) and as rendered (validated, built).
//!
//! Files come through [`SceneFiles`]; `format` finds the front end that reads them into a `Description`, in which every value has its type and its
//! place; `build` turns that into a [`Scene`]. What was written and never asked for is a warning.

mod black;
mod build;
mod contents;
mod description;
mod error;
mod faults;
mod files;
mod format;
mod gltf;
mod ies;
mod image;
mod lamps;
mod limits;
mod linear_image;
mod loader;
mod mesh;
mod names;
mod number;
mod pbrt;
mod pfm;
mod reader;
mod spectrum;
mod substance;
#[cfg(test)]
mod tests;
mod text;
mod volume;
mod warning;
mod xml;

pub use contents::SceneContents;
pub(crate) use error::shortened;
pub use error::{Place, SceneError};
pub use faults::SceneFaults;
pub use files::{RecordedFiles, SceneFiles, SceneFolder, normalise};
pub use limits::Limits;
pub use names::Names;
#[cfg(test)]
pub(crate) use volume::tests::files as volume_files;
pub use warning::SceneWarning;

use crate::film::{FilmSettings, Window, WindowError};
use crate::geometry::{Geometry, ShapeId, ShapeSampler, SurfacePoint};
use crate::light::{LightId, Lights};
use crate::material::Material;
use crate::medium::{BodyId, Boundary, Media};
use crate::motion::Motion;
use crate::path::{ANY, PathExpression, States};
use crate::sensor::Sensor;
use crate::settings::IntegratorSettings;
use crate::texture::TileFile;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

/// A renderable scene: validated and built. Nothing in it can make rendering fail.
///
/// What moves stands here as it does in the middle of the shutter interval: the scene at rest. [`Scene::frame`] makes the scene that an
/// iteration renders.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Shapes and their hierarchy.
    pub geometry: Arc<Geometry>,
    /// What each shape is made of, by [`ShapeId`].
    pub bindings: Arc<[ShapeBinding]>,
    /// Materials, by [`ShapeBinding::material`].
    pub materials: Arc<[Material]>,
    /// What fills space; `None` where it is empty everywhere.
    pub media: Option<Arc<Media>>,
    /// Lights and the distribution they are chosen by.
    pub lights: Lights,
    /// What the scene calls each light, by [`LightId`]: its id or that of its shape, or else `lamp-` and its number from 1. Several may
    /// have one name.
    pub lamps: Arc<[String]>,
    /// What the scene calls its objects and materials.
    pub names: Arc<Names>,
    /// The paths that count, where not all do.
    pub(crate) paths: Option<PathExpression>,
    /// Whether the camera sees neither lights nor their shapes, nor what surrounds the scene (`hide_emitters`): its rays go on behind
    /// them. Mirrors show them all the same.
    pub hide_emitters: bool,
    /// The camera.
    pub sensor: Sensor,
    /// The camera of the whole film, where the picture is a window of it.
    pub(crate) whole: Option<Box<Sensor>>,
    /// The shape that the sensor measures the irradiance of, where that is no grid on a rectangle.
    pub(crate) meter: Option<ShapeSampler>,
    /// Image size and filter.
    pub film: FilmSettings,
    /// What the scene holds.
    pub contents: SceneContents,
    /// What the scene file asks for.
    pub wishes: Wishes,
    /// What is probably not meant, in the order in which it was found.
    pub warnings: Arc<[SceneWarning]>,
    /// What the scene file says and changes nothing in the picture.
    pub notes: Arc<[SceneWarning]>,
    /// What moves while the shutter is open; `None` where nothing does.
    pub(crate) motion: Option<Motion>,
    /// Where textures lie that memory does not hold.
    pub(crate) tiles: Option<Arc<TileFile>>,
    /// The place of the first light that a random direction hardly ever finds.
    pub(crate) small_lamp: Option<Place>,
}

/// What a shape is made of.
#[derive(Clone, Copy, Debug)]
pub struct ShapeBinding {
    /// Index into [`Scene::materials`].
    pub material: u32,
    /// The area light on the shape.
    pub light: Option<LightId>,
    /// What lies on its two sides, where it bounds a medium.
    pub boundary: Option<Boundary>,
    /// The body that it bounds; it says no boundary then.
    pub body: Option<BodyId>,
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
    /// Loads the scene file `main`, seen through its first sensor. `defines` set its parameters in place of their `<default>`s.
    ///
    /// # Errors
    /// All that is wrong with the scene and its files, with its places; see [`SceneError`].
    pub fn load(
        files: &dyn SceneFiles,
        main: &str,
        defines: &BTreeMap<String, String>,
        limits: &Limits,
    ) -> Result<Self, SceneFaults> {
        Self::load_sensor(files, main, defines, None, limits)
    }

    /// As [`Scene::load`], seen through the sensor that `sensor` names: by its id, or by its number from 1 in the order of the
    /// file.
    ///
    /// # Errors
    /// As [`Scene::load`]; also where there is no such sensor.
    pub fn load_sensor(
        files: &dyn SceneFiles,
        main: &str,
        defines: &BTreeMap<String, String>,
        sensor: Option<&str>,
        limits: &Limits,
    ) -> Result<Self, SceneFaults> {
        let mut loader = loader::Loader::new(files, limits);
        let (faults, warnings) = (
            Rc::new(faults::Faults::default()),
            Rc::new(warning::Warnings::default()),
        );
        let scene = format::read(&mut loader, main, defines, &faults, &warnings)
            .and_then(|(format, description)| build::build(format, &description, &mut loader, sensor));
        faults.settle(scene, &warnings)
    }

    /// The scene of which a window of the picture is rendered, where one is given: the picture that it has without, its own crop included.
    ///
    /// # Errors
    /// A window that is not within the picture.
    pub fn cropped(mut self, window: Option<Window>) -> Result<Self, WindowError> {
        self.film.window = match window {
            Some(window) => window.of(self.film.resolution)?,
            None => None,
        };
        Ok(self)
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

    /// Where a camera path that has met nothing yet is among the words of the path expression.
    #[inline]
    pub(crate) fn states_at_camera(&self) -> States {
        self.paths.as_ref().map_or(ANY, PathExpression::at_camera)
    }

    pub(crate) fn binding(&self, shape: ShapeId) -> &ShapeBinding {
        &self.bindings[shape.0 as usize]
    }
}
