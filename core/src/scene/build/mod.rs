//! From the scene as written to the scene that renders.

mod integrator;
mod light;
mod material;
mod sensor;
mod shape;
mod texture;

use super::description::{Description, Kind, ObjectId};
use super::error::{Place, SceneError, within};
use super::loader::{LoadedFile, Loader};
use super::mesh::MeshTotals;
use super::reader::Reader;
use super::{Scene, ShapeBinding, Wishes};
use crate::geometry::{Geometry, Shape, ShapeId};
use crate::light::{Light, LightId, Lights};
use crate::material::Material;
use crate::math::Transform;
use crate::texture::Bitmap;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Builds the scene that `description` describes.
pub(crate) fn build(description: &Description, loader: &mut Loader) -> Result<Scene, SceneError> {
    let mut builder = Builder::new(description, loader);
    let scene = Reader::new(description, 0);
    let integrator = scene.only_child(Kind::Integrator)?;
    let sensor = scene.only_child(Kind::Sensor)?;
    let sensor = sensor.ok_or_else(|| missing(scene.place(), "a <sensor>"))?;
    let (sensor, film, sample_count) = sensor::build(description, sensor.target, loader_limits(builder.loader))?;
    let mut wishes = Wishes {
        sample_count,
        ..Wishes::default()
    };
    if let Some(integrator) = integrator {
        (wishes.integrator, wishes.max_depth) = integrator::build(description, integrator.target)?;
    }
    for bsdf in scene.children(Kind::Bsdf) {
        builder.material(bsdf.target)?;
    }
    for texture in scene.children(Kind::Texture) {
        builder.texture(texture.target, texture::Role::REFLECTANCE)?;
    }
    let shapes = scene.children(Kind::Shape);
    within(
        scene.place(),
        "number of shapes",
        shapes.len() as u64,
        builder.loader.limits.shapes,
    )?;
    for shape in shapes {
        builder.shape(shape.target)?;
    }
    for emitter in scene.children(Kind::Emitter) {
        builder.emitter(emitter.target)?;
    }
    scene.finish()?;
    builder.finish(scene.place(), sensor, film, wishes)
}

fn loader_limits<'a>(loader: &Loader<'a>) -> &'a super::Limits {
    loader.limits
}

fn missing(place: &Place, what: &str) -> SceneError {
    SceneError::Missing {
        place: place.clone(),
        context: "<scene>".into(),
        what: what.into(),
    }
}

/// What has been built so far.
struct Builder<'b, 'f> {
    description: &'b Description,
    loader: &'b mut Loader<'f>,
    shapes: Vec<Shape>,
    bindings: Vec<ShapeBinding>,
    materials: Vec<Material>,
    lights: Vec<Light>,
    /// Materials that were built, by the object that describes them.
    material_of: BTreeMap<ObjectId, u32>,
    /// The material of shapes that name none.
    default_material: Option<u32>,
    /// Materials that are being built: a reference to one of them is a cycle.
    building: Vec<ObjectId>,
    bitmaps: BTreeMap<texture::BitmapKey, Arc<Bitmap>>,
    meshes: MeshTotals,
    texels: u64,
    /// Area lights that a shape uses.
    used_area_lights: BTreeSet<ObjectId>,
    /// The place of the environment light, of which there may be one.
    environment: Option<Place>,
}

impl<'b, 'f> Builder<'b, 'f> {
    fn new(description: &'b Description, loader: &'b mut Loader<'f>) -> Self {
        Self {
            description,
            loader,
            shapes: Vec::new(),
            bindings: Vec::new(),
            materials: Vec::new(),
            lights: Vec::new(),
            material_of: BTreeMap::new(),
            default_material: None,
            building: Vec::new(),
            bitmaps: BTreeMap::new(),
            meshes: MeshTotals::default(),
            texels: 0,
            used_area_lights: BTreeSet::new(),
            environment: None,
        }
    }

    fn reader(&self, object: ObjectId) -> Reader<'b> {
        Reader::new(self.description, object)
    }

    /// The file that an object's `filename` names.
    fn file(&mut self, reader: &Reader) -> Result<LoadedFile, SceneError> {
        let name = reader
            .string("filename")?
            .ok_or_else(|| reader.missing("property `filename`"))?;
        let place = &reader.object.properties["filename"].place;
        self.loader.open(place, &reader.object.search, name)
    }

    fn add_shape(&mut self, shape: Shape, material: u32) -> ShapeId {
        self.shapes.push(shape);
        self.bindings.push(ShapeBinding { material, light: None });
        ShapeId(self.shapes.len() as u32 - 1)
    }

    fn add_light(&mut self, light: Light) -> LightId {
        self.lights.push(light);
        LightId(self.lights.len() as u32 - 1)
    }

    fn finish(
        self,
        place: &Place,
        sensor: crate::sensor::Sensor,
        film: crate::film::FilmSettings,
        wishes: Wishes,
    ) -> Result<Scene, SceneError> {
        if self.shapes.is_empty() {
            return Err(missing(place, "a <shape>: the scene is empty"));
        }
        if self.lights.is_empty() {
            return Err(missing(place, "an <emitter>: the scene is dark"));
        }
        let geometry = Geometry::build(self.shapes);
        let lights = Lights::build(self.lights, &geometry);
        Ok(Scene {
            geometry,
            bindings: self.bindings,
            materials: self.materials,
            lights,
            sensor,
            film,
            wishes,
        })
    }
}

/// The length by which a map scales, where it is a rotation, a mirroring, a translation and a uniform scale.
fn uniform_scale(transform: &Transform) -> Option<f64> {
    let m = transform.matrix();
    let axes = [m.x_axis.truncate(), m.y_axis.truncate(), m.z_axis.truncate()];
    let scale = libm::cbrt(m.determinant().abs());
    let tolerance = 1e-3 * scale * scale;
    let even = axes
        .iter()
        .all(|axis| (axis.length_squared() - scale * scale).abs() <= 2.0 * tolerance);
    let square = (0..3).all(|i| axes[i].dot(axes[(i + 1) % 3]).abs() <= tolerance);
    (even && square && scale > 0.0).then_some(scale)
}
