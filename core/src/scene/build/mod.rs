//! From the scene as written to the scene that renders.

mod attributes;
mod bodies;
mod curves;
mod daylight;
mod instance;
mod integrator;
mod lattice;
mod layered;
mod light;
mod light_image;
mod lobes;
mod material;
mod medium;
mod sensor;
mod shape;
mod texture;

use super::description::{Child, Description, Kind, ObjectId};
use super::error::{Place, SceneError};
use super::format::Format;
use super::loader::{LoadedFile, Loader};
use super::mesh::MeshTotals;
use super::reader::Reader;
use super::{Names, Scene, SceneContents, ShapeBinding, Wishes, lamps};
use crate::geometry::{Geometry, Shape, ShapeGroup, ShapeId, ShapeSampler};
use crate::light::{Light, LightId, Lights};
use crate::material::Material;
use crate::math::{AnimatedTransform, Transform};
use crate::medium::{Medium, MediumId};
use crate::motion::Motion;
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, TileFile};
use attributes::MeshAttributes;
use instance::BuiltGroup;
use sensor::View;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

/// Builds the scene that `description` describes.
///
/// It is seen through the sensor that is named, or through the first one.
/// Nothing comes back where faults of the scene were noted.
pub(crate) fn build(
    format: Format,
    description: &Description,
    loader: &mut Loader,
    sensor: Option<&str>,
) -> Result<Option<Scene>, SceneError> {
    let mut builder = Builder::new(description, loader);
    let scene = Reader::new(description, 0);
    let integrator = scene.only_child(Kind::Integrator)?;
    let view = builder.view(&scene, sensor)?;
    let mut wishes = Wishes {
        sample_count: view.as_ref().and_then(|view| view.sample_count),
        ..Wishes::default()
    };
    if let Some(integrator) = integrator {
        let wanted = integrator::build(description, integrator.target);
        if let Some(wanted) = description.attempt(integrator.target, wanted)? {
            (wishes.integrator, wishes.max_depth) = (wanted.settings, wanted.max_depth);
            builder.hide_emitters = wanted.hide_emitters;
        }
    }
    // What shows attributes of a mesh is built with the mesh.
    let of_no_mesh = |child: &&Child| MeshAttributes::asked_by(description, [child.target].into_iter()).is_empty();
    for bsdf in scene.children(Kind::Bsdf).into_iter().filter(of_no_mesh) {
        builder.material(bsdf.target)?;
    }
    for shape in scene.children(Kind::Shape) {
        let built = builder.placed_shape(shape.target, None);
        description.attempt(shape.target, built)?;
    }
    builder.check_groups();
    for medium in scene.children(Kind::Medium) {
        builder.medium(medium.target)?;
    }
    // The volumes and phase functions of media, where these refer to them.
    for kind in [Kind::Volume, Kind::Phase] {
        scene.children(kind);
    }
    for emitter in scene.children(Kind::Emitter) {
        let built = builder.emitter(emitter.target);
        description.attempt(emitter.target, built)?;
    }
    for texture in scene.children(Kind::Texture).into_iter().filter(of_no_mesh) {
        builder.unused_texture(texture.target)?;
    }
    // They stand here for sensors to refer to them.
    for kind in [Kind::Film, Kind::Sampler, Kind::Filter] {
        scene.children(kind);
    }
    scene.finish();
    if description.faults.any() {
        return Ok(None);
    }
    let contents = SceneContents::of(format, description);
    builder.finish(scene.place(), view, wishes, contents).map(Some)
}

fn missing(place: &Place, what: &str) -> SceneError {
    SceneError::Missing {
        place: place.clone(),
        context: "<scene>".into(),
        what: what.into(),
    }
}

/// Numbers that a scene's limit of shapes bounds, each for itself.
#[derive(Clone, Copy, Debug, Default)]
struct ShapeCounts {
    shapes: u64,
    instances: u64,
}

/// Materials of shapes that name none.
#[derive(Clone, Copy, Debug)]
enum Plain {
    Grey,
    /// Of lights.
    Black,
    /// Of what bounds a medium, in files for Mitsuba 0.x.
    Invisible,
}

/// What has been built so far.
struct Builder<'b, 'f> {
    description: &'b Description,
    loader: &'b mut Loader<'f>,
    shapes: Vec<Shape>,
    bindings: Vec<ShapeBinding>,
    /// Shapes and instances so far, those within groups counted once.
    counts: ShapeCounts,
    /// Groups of shapes, by the object that describes them; `None` before an instance places one.
    groups: BTreeMap<ObjectId, Option<Rc<BuiltGroup>>>,
    /// The bindings of all shapes within groups, in their order.
    group_bindings: Vec<ShapeBinding>,
    /// The group that was built last, behind which the next one is numbered.
    last_group: Option<Arc<ShapeGroup>>,
    /// Whether the shapes that are built belong to a group.
    within_group: bool,
    materials: Vec<Material>,
    /// Lights with their places.
    lights: Vec<(Light, Place)>,
    /// What the description calls objects.
    names: BTreeMap<ObjectId, &'b str>,
    /// The name of each light.
    lamps: Vec<String>,
    /// The names of shapes and materials that were built.
    called: Names,
    /// The instance that places the shapes which are built, and its group.
    placing: Option<[ObjectId; 2]>,
    motion: Motion,
    /// The attributes of the mesh whose material is built.
    attributes: MeshAttributes,
    media: Vec<Medium>,
    bodies: bodies::Bodies,
    /// Media that were built, by the object that describes them; `None` where it has a fault.
    media_of: BTreeMap<ObjectId, Option<MediumId>>,
    /// Bytes of volumes.
    voxels: u64,
    /// Materials that were built, by the object that describes them.
    material_of: BTreeMap<ObjectId, u32>,
    /// Materials of shapes that name none, each at the number of its [`Plain`].
    plain_materials: [Option<u32>; 3],
    /// Materials that are being built: a reference to one of them is a cycle.
    building: Vec<ObjectId>,
    /// BSDFs that the material which is being built consists of so far.
    bsdfs_within: u64,
    textures: texture::Textures,
    bitmaps: BTreeMap<texture::BitmapKey, Arc<Bitmap>>,
    meshes: MeshTotals,
    texels: u64,
    /// Bytes of textures in memory.
    texture_bytes: u64,
    /// Where the other textures lie.
    tiles: Option<Arc<TileFile>>,
    /// Whether the camera does not see lights.
    hide_emitters: bool,
    /// Area lights that a shape uses.
    used_area_lights: BTreeSet<ObjectId>,
    /// The shape that the sensor measures the irradiance of, by the object that describes it and, when it is built, in the scene.
    metered: Option<(ObjectId, Option<ShapeId>)>,
}

impl<'b, 'f> Builder<'b, 'f> {
    fn new(description: &'b Description, loader: &'b mut Loader<'f>) -> Self {
        Self {
            description,
            loader,
            shapes: Vec::new(),
            bindings: Vec::new(),
            counts: ShapeCounts::default(),
            groups: BTreeMap::new(),
            group_bindings: Vec::new(),
            last_group: None,
            within_group: false,
            materials: Vec::new(),
            lights: Vec::new(),
            names: description
                .ids
                .iter()
                .map(|(name, object)| (*object, name.as_str()))
                .collect(),
            lamps: Vec::new(),
            called: Names::default(),
            placing: None,
            motion: Motion::default(),
            attributes: MeshAttributes::default(),
            media: Vec::new(),
            bodies: bodies::Bodies::default(),
            media_of: BTreeMap::new(),
            voxels: 0,
            material_of: BTreeMap::new(),
            plain_materials: [None; 3],
            building: Vec::new(),
            bsdfs_within: 0,
            textures: texture::Textures::default(),
            bitmaps: BTreeMap::new(),
            meshes: MeshTotals::default(),
            texels: 0,
            texture_bytes: 0,
            tiles: None,
            hide_emitters: false,
            used_area_lights: BTreeSet::new(),
            metered: None,
        }
    }

    /// The sensor that `name` chooses, or the first; `None` where the scene has none.
    fn view(&mut self, scene: &Reader, name: Option<&str>) -> Result<Option<View>, SceneError> {
        let all = sensor::all(self.description, scene);
        let sensors: Vec<ObjectId> = all.iter().map(|(sensor, _)| *sensor).collect();
        let chosen = match name {
            Some(name) => Some(sensor::named(self.description, &sensors, name)?),
            None => sensors.first().copied(),
        };
        let Some(chosen) = chosen else { return Ok(None) };
        if name.is_none() && sensors.len() > 1 {
            let message = format!(
                "the first of the scene's {} sensors is taken; --sensor chooses another, by number or id: {}",
                sensors.len(),
                sensor::names(self.description, &sensors)
            );
            self.warn(&self.description.objects[chosen].place, message);
        }
        let shape = all
            .iter()
            .find(|(sensor, _)| *sensor == chosen)
            .and_then(|(_, shape)| *shape);
        let built = sensor::build(self.description, chosen, shape, self.loader.limits);
        let view = self.description.attempt(chosen, built)?.map(|(view, motion)| {
            self.motion = motion;
            self.metered = view.meter.map(|shape| (shape, None));
            view
        });
        if view.as_ref().is_some_and(View::is_upside_down) {
            let message =
                "the camera stands on its head: up in the picture is down in the world (see `up` of its <lookat>)";
            self.warn(&self.description.objects[chosen].place, message);
        }
        Ok(view)
    }

    fn warn(&self, place: &Place, message: impl Into<String>) {
        self.description.warnings.note(place, message);
    }

    fn reader(&self, object: ObjectId) -> Reader<'b> {
        Reader::new(self.description, object)
    }

    /// The file that an object's `filename` names, or holds.
    fn file(&mut self, reader: &Reader) -> Result<LoadedFile, SceneError> {
        if let Some(file) = reader.embedded_file("filename") {
            return Ok(file.clone());
        }
        let name = reader
            .string("filename")?
            .ok_or_else(|| reader.missing("property `filename`"))?;
        let place = &reader.object.properties["filename"].place;
        self.loader.open(place, &reader.object.search, name)
    }

    /// What the first of some objects is called that is called anything.
    fn name_of(&self, objects: impl IntoIterator<Item = ObjectId>) -> Option<Arc<str>> {
        let name = |object: &ObjectId| match (self.names.get(object), self.description.called.get(object)) {
            (Some(id), _) => Some(Arc::from(*id)),
            (None, called) => called.cloned(),
        };
        objects.into_iter().find_map(|object| name(&object))
    }

    /// Adds a shape that `object` describes. It is called as that, or as what that lies in or is placed by.
    fn add_shape(&mut self, object: ObjectId, shape: Shape, material: u32) -> ShapeId {
        let around = self.building.iter().rev().copied();
        let name = self.name_of(
            [object]
                .into_iter()
                .chain(around)
                .chain(self.placing.into_iter().flatten()),
        );
        self.called.objects.push(name);
        self.shapes.push(shape);
        self.bindings.push(ShapeBinding {
            material,
            light: None,
            boundary: None,
            body: None,
        });
        ShapeId(self.shapes.len() as u32 - 1)
    }

    /// Adds a light that moves by `to_world`, where that is given. It is called what the first of `objects` is called that has a name.
    fn add_light(
        &mut self,
        light: Light,
        to_world: Option<AnimatedTransform>,
        objects: &[ObjectId],
        place: &Place,
    ) -> LightId {
        self.lights.push((light, place.clone()));
        let named = objects.iter().find_map(|object| self.names.get(object));
        self.lamps.push(match named {
            Some(name) => (*name).to_owned(),
            None => format!("lamp-{}", self.lights.len()),
        });
        let id = LightId(self.lights.len() as u32 - 1);
        self.motion.lights.extend(to_world.map(|to_world| (id, to_world)));
        id
    }

    fn finish(
        mut self,
        place: &Place,
        view: Option<View>,
        wishes: Wishes,
        contents: SceneContents,
    ) -> Result<Scene, SceneError> {
        let is_sky = |light: &Light| {
            use Light::{Constant, Environment, Portal, Sun};
            matches!(light, Constant { .. } | Environment { .. } | Portal { .. } | Sun { .. })
        };
        let sky_alone = view.is_some() && self.lights.iter().any(|(light, _)| is_sky(light));
        if self.shapes.is_empty() && !sky_alone {
            return Err(missing(place, "a <shape> (the scene is empty)"));
        }
        if self.lights.is_empty() {
            let message = "the scene has no <emitter>: it is lit from all sides by radiance 1, as by <emitter type=\"constant\"/>";
            self.warn(place, message);
            let radiance = Spectrum::ONE;
            self.add_light(Light::Constant { radiance }, None, &[], place);
        }
        let geometry = Geometry::build(std::mem::take(&mut self.shapes));
        let view = match view {
            Some(view) => view,
            None => {
                self.warn(
                    place,
                    "the scene has no <sensor>: it is seen from outside along +z, all of it in the picture",
                );
                sensor::default_view(&geometry)
            }
        };
        let View {
            mut sensor,
            film,
            whole,
            medium,
            ..
        } = view;
        let meter = match self.metered {
            None => None,
            Some((_, Some(shape))) => {
                sensor.to_world = sensor::about(&geometry, shape);
                Some(ShapeSampler::new(&geometry, shape))
            }
            Some((shape, None)) => {
                let reason = "the shape that the sensor lies on is not in the picture";
                let place = &self.description.objects[shape].place;
                return Err(SceneError::value(place, "<sensor type=\"irradiancemeter\">", reason));
            }
        };
        let (warnings, small_lamp) = lamps::examine(&self.lights, &geometry);
        for warning in warnings {
            self.warn(&warning.place, warning.message);
        }
        let camera_medium = match medium {
            Some(medium) => self.medium(medium)?,
            None => None,
        };
        let mut bindings: Vec<ShapeBinding> = self.bindings.into_iter().chain(self.group_bindings).collect();
        let alone = camera_medium.is_none() && bindings.iter().all(|binding| binding.boundary.is_none());
        let warn = |place: &Place, message: &str| self.description.warnings.note(place, message);
        let bodies = self.bodies.settle(bindings.iter_mut(), alone, warn);
        let lights = Lights::build(self.lights.into_iter().map(|(light, _)| light).collect(), &geometry);
        let mut scene = Scene {
            geometry: Arc::new(geometry),
            bindings: bindings.into(),
            materials: self.materials.into(),
            media: None,
            lights,
            lamps: self.lamps.into(),
            names: Arc::new(self.called),
            paths: None,
            hide_emitters: self.hide_emitters,
            sensor,
            whole,
            meter,
            film,
            contents: SceneContents {
                triangles: self.meshes.triangles,
                vertices: self.meshes.vertices,
                texels: self.texels,
                ..contents
            },
            wishes,
            warnings: self.description.warnings.take().into(),
            notes: self.description.warnings.take_remarks().into(),
            motion: (!self.motion.is_empty()).then_some(self.motion),
            small_lamp,
            tiles: self.tiles,
        };
        scene.settle_media(self.media, bodies, camera_medium);
        Ok(scene)
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
