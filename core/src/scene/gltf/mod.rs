//! glTF 2.0: from files to a [`Description`].
//!
//! Section numbers are those of the Khronos specification of glTF 2.0.
//!
//! `container` finds the JSON and the buffers, `document` is that JSON, `packed` unpacks what is compressed, `accessor` reads numbers out of the buffers; `tree` places nodes, moved by
//! `animation`; `geometry`, `material` with `texture`, and `camera` make what stands at a node.

mod accessor;
mod animation;
mod camera;
mod container;
mod document;
mod geometry;
mod material;
mod packed;
mod sheet;
mod solid;
#[cfg(test)]
mod tests;
mod texture;
mod tree;
mod warnings;

use super::description::{Description, Draft, Kind, ObjectId, Value};
use super::error::{Place, SceneError, shortened};
use super::faults::Faults;
use super::loader::{LoadedFile, Loader};
use super::warning::Warnings;
use accessor::Accessors;
use animation::{Animations, Property};
use document::Document;
use geometry::{Deformation, Geometry, Triangles, primitive_name};
use glam::DMat4;
use material::{Look, Materials};
use std::collections::BTreeMap;
use std::rc::Rc;
use texture::Textures;
use tree::{Timing, Tree, node_name};
use warnings::Told;

/// Extensions that are rendered, approximated or warned about where they are used.
const KNOWN: [&str; 25] = [
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_materials_volume_scatter",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
];

/// What a user may define, in place of what glTF does not say.
const DEFINITIONS: [&str; 4] = ["fps", "frame", "shutter", "width"];

/// Frames per second where nobody says them: Blender's default.
const FRAMES_PER_SECOND: f64 = 24.0;

/// Reads a scene file and what it includes. `defines` say when it is seen and how large.
pub(crate) fn read(
    loader: &mut Loader,
    file: &LoadedFile,
    defines: &BTreeMap<String, String>,
    faults: &Rc<Faults>,
    warnings: &Rc<Warnings>,
) -> Result<Description, SceneError> {
    let place = Place::whole(&file.name);
    let (timing, width) = definitions(defines, &place)?;
    let chunks = container::chunks(&file.bytes, &place)?;
    let mut document = container::document(&chunks, &place, loader.limits)?;
    let told = Told::new(&place, warnings);
    check_required(&document, &told);
    let limits = loader.limits;
    let mut buffers = container::buffers(&document, chunks.binary, loader, file, &place)?;
    packed::unpack(&mut document, &mut buffers, &place, limits)?;
    let accessors = Accessors::new(&document, buffers, &place, limits);
    let animations = Animations::read(&document, &accessors, limits, &told)?;
    let tree = Tree::new(&document, &animations, &timing, &place)?;
    let mut scene = SceneWriter {
        document: &document,
        accessors: &accessors,
        animations: &animations,
        tree: &tree,
        timing,
        told: &told,
        draft: Draft::new(place.clone(), [file.folder().to_owned()].into(), faults, warnings),
        geometry: Geometry::new(&document, &accessors, limits, &told),
        materials: Materials::new(&document, &told),
        textures: Textures {
            document: &document,
            accessors: &accessors,
            told: &told,
            scene: file,
            images: BTreeMap::new(),
        },
        loader,
        groups: BTreeMap::new(),
        uses: uses(&document, &tree),
    };
    for node in &tree.shown {
        let written = scene.node(*node, width);
        if let Err(fault) = written {
            faults.note(fault)?;
        }
    }
    Ok(scene.draft.finish())
}

/// The time and the picture's width that the user defines.
fn definitions(defines: &BTreeMap<String, String>, place: &Place) -> Result<(Timing, Option<i64>), SceneError> {
    let context = "definitions";
    if let Some(name) = defines.keys().find(|name| !DEFINITIONS.contains(&name.as_str())) {
        return Err(SceneError::unknown(place, context, "parameter", name, DEFINITIONS));
    }
    let number = |name: &str, range: std::ops::RangeInclusive<f64>, default: f64| {
        let Some(text) = defines.get(name) else {
            return Ok(default);
        };
        let value = text.trim().parse::<f64>().ok().filter(|value| range.contains(value));
        value.ok_or_else(|| {
            let reason = format!(
                "`{}` is not a number from {:e} to {:e}",
                shortened(text),
                range.start(),
                range.end()
            );
            SceneError::value(place, format!("{context} `{name}`"), reason)
        })
    };
    let fps = number("fps", 1e-3..=1e6, FRAMES_PER_SECOND)?;
    let timing = Timing {
        time: number("frame", -1e9..=1e9, 0.0)? / fps,
        shutter: number("shutter", 0.0..=1e6, 0.0)? / fps,
    };
    let width = number("width", 1.0..=65536.0, 0.0)?;
    Ok((timing, (width > 0.0).then_some(width as i64)))
}

/// Warns about extensions that the file requires and that are not known here.
fn check_required(document: &Document, told: &Told) {
    for extension in &document.extensions_required {
        let name = extension.as_str();
        if !KNOWN.contains(&name) {
            let name = shortened(name);
            told.warn(format!(
                "extensionsRequired: {name} is not known here: the picture lacks what it says"
            ));
        }
    }
}

/// Writes what stands at nodes into a draft.
struct SceneWriter<'a, 'l, 'f> {
    document: &'a Document,
    accessors: &'a Accessors<'a>,
    animations: &'a Animations,
    tree: &'a Tree,
    timing: Timing,
    told: &'a Told,
    draft: Draft,
    geometry: Geometry<'a>,
    materials: Materials<'a>,
    textures: Textures<'a>,
    loader: &'l mut Loader<'f>,
    /// Meshes of which there is more than one and which do not change their form: the group of shapes that each is.
    groups: BTreeMap<usize, ObjectId>,
    /// How many nodes show each mesh.
    uses: Vec<usize>,
}

impl SceneWriter<'_, '_, '_> {
    fn node(&mut self, index: usize, width: Option<i64>) -> Result<(), SceneError> {
        let document = self.document;
        let node = &document.nodes[index];
        if node.camera.is_some() {
            let seen = (&self.timing, width);
            camera::camera(&mut self.draft, document, self.tree, index, seen, self.told)?;
        }
        if let Some(light) = &node.extensions.light {
            camera::light(&mut self.draft, document, self.tree, (index, light.light), self.told)?;
        }
        let Some(mesh) = node.mesh else { return Ok(()) };
        let meshes = &document.meshes;
        if mesh >= meshes.len() {
            let reason = format!("there is no mesh {mesh}; the file has {}", meshes.len());
            return Err(SceneError::value(
                self.told.place(),
                format!("nodes[{index}].mesh"),
                reason,
            ));
        }
        let places = self.places(index)?;
        let rigid = node.skin.is_none() && meshes[mesh].primitives.iter().all(|part| part.targets.is_empty());
        if rigid && self.uses[mesh].max(places.len()) > 1 {
            let group = self.group(index, mesh)?;
            for place in &places {
                let name = node_name(document, index);
                let instance = self.draft.add(Kind::Shape, "instance", Some(&name), self.told.place());
                self.draft.call(instance, &node.name);
                self.draft.set(instance, "to_world", copied(place));
                self.draft.link(instance, None, group);
                self.draft.link(0, None, instance);
            }
            return Ok(());
        }
        for place in &places {
            self.primitives(0, index, mesh, place)?;
        }
        Ok(())
    }

    /// The group of shapes that a mesh is, which is written where a node first shows it.
    fn group(&mut self, node: usize, mesh: usize) -> Result<ObjectId, SceneError> {
        if let Some(group) = self.groups.get(&mesh) {
            return Ok(*group);
        }
        let name = format!("meshes[{mesh}] \"{}\"", shortened(&self.document.meshes[mesh].name));
        let group = self
            .draft
            .add(Kind::Shape, "shapegroup", Some(&name), self.told.place());
        self.draft.link(0, None, group);
        self.groups.insert(mesh, group);
        self.primitives(group, node, mesh, &Value::Transform(Box::default()))?;
        Ok(group)
    }

    /// Adds the primitives of a mesh to `parent`: the scene, or a group.
    fn primitives(&mut self, parent: ObjectId, node: usize, mesh: usize, place: &Value) -> Result<(), SceneError> {
        for number in 0..self.document.meshes[mesh].primitives.len() {
            if let Err(fault) = self.primitive(parent, node, (mesh, number), place) {
                self.draft.faults.note(fault)?;
            }
        }
        Ok(())
    }

    /// The maps of a node's mesh to the world: one, or those of EXT_mesh_gpu_instancing.
    fn places(&self, index: usize) -> Result<Vec<Value>, SceneError> {
        let node = &self.document.nodes[index];
        if node.skin.is_some() {
            // A skin places the mesh in the world by itself.
            return Ok(vec![Value::Transform(Box::default())]);
        }
        let Some(instancing) = &node.extensions.instancing else {
            let place = self.tree.placement(index, Some);
            if place.is_none() {
                let name = node_name(self.document, index);
                self.told
                    .warn(format!("{name}: it is scaled to nothing, and its mesh is left out"));
            }
            return Ok(place.into_iter().collect());
        };
        let field = format!("nodes[{index}].extensions.EXT_mesh_gpu_instancing");
        let attribute = |name: &str| instancing.attributes.get(name).copied();
        let read = |name: &str, width: usize| match attribute(name) {
            Some(accessor) => self.accessors.numbers(accessor, &[width], &field).map(Some),
            None => Ok(None),
        };
        let (moves, turns, scales) = (read("TRANSLATION", 3)?, read("ROTATION", 4)?, read("SCALE", 3)?);
        let lengths = [
            moves.as_ref().map(|all| all.len() / 3),
            turns.as_ref().map(|all| all.len() / 4),
            scales.as_ref().map(|all| all.len() / 3),
        ];
        let count = lengths.iter().flatten().copied().max().unwrap_or(0);
        if lengths.iter().flatten().any(|length| *length != count) {
            return Err(self
                .accessors
                .wrong(field, "its attributes have different numbers of elements"));
        }
        super::error::within(
            self.told.place(),
            "number of instances of a node",
            count as u64,
            self.loader.limits.shapes,
        )?;
        let three = |all: &Option<Vec<f32>>, i: usize, default: f64| {
            let numbers = all.as_ref().map(|all| [0, 1, 2].map(|k| f64::from(all[3 * i + k])));
            glam::DVec3::from_array(numbers.unwrap_or([default; 3]))
        };
        let place = |i: usize| {
            let turn = turns
                .as_ref()
                .map(|all| [0, 1, 2, 3].map(|k| f64::from(all[4 * i + k])));
            let turn = turn.map_or(glam::DQuat::IDENTITY, |xyzw| animation::quaternion(&xyzw));
            let own = DMat4::from_scale_rotation_translation(three(&scales, i, 1.0), turn, three(&moves, i, 0.0));
            self.tree.placement(index, |world| Some(world * own))
        };
        Ok((0..count).filter_map(place).collect())
    }

    /// Adds one primitive of a mesh at a place.
    fn primitive(
        &mut self,
        parent: ObjectId,
        node: usize,
        (mesh, number): (usize, usize),
        place: &Value,
    ) -> Result<(), SceneError> {
        let primitive = &self.document.meshes[mesh].primitives[number];
        let used = format!("meshes[{mesh}].primitives[{number}].material");
        let coloured = primitive.attributes.contains_key("COLOR_0");
        let look = self.materials.look(
            (primitive.material, coloured),
            &mut self.draft,
            &mut self.textures,
            self.loader,
            &used,
        )?;
        if look.bsdf.is_none() && look.emitter.is_none() {
            return Ok(());
        }
        let deformation = self.deformation(node, mesh)?;
        let triangles = self.geometry.read((mesh, number), look.uv_set, &deformation)?;
        let Some(triangles) = triangles else { return Ok(()) };
        let written = &self.document.nodes[node].name;
        if let Some(emitter) = look.emitter.filter(|_| !written.is_empty()) {
            self.draft.ids.entry(written.clone()).or_insert(emitter);
        }
        let name = format!(
            "{} {}",
            node_name(self.document, node),
            primitive_name(self.document, mesh, number)
        );
        let names = (name.as_str(), written.as_str());
        self.shape(parent, &triangles, look, place, names);
        if look.emitter.is_some()
            && let Some(back) = sheet::back(&triangles.mesh)
        {
            let back = Triangles {
                mesh: back.into(),
                ..triangles
            };
            self.shape(parent, &back, look, place, names);
        }
        Ok(())
    }

    /// Adds triangles with their look at a place. `names`: what messages call them, and what their node is called.
    fn shape(
        &mut self,
        parent: ObjectId,
        triangles: &Triangles,
        look: Look,
        to_world: &Value,
        (name, node): (&str, &str),
    ) {
        let shape = self.draft.add(Kind::Shape, "mesh", Some(name), self.told.place());
        self.draft.call(shape, node);
        self.draft
            .set(shape, "mesh", Value::Mesh(triangles.mesh.clone().into()));
        if !triangles.has_normals {
            self.draft.set(shape, "face_normals", Value::Boolean(true));
            // Sides are told by the winding in the mesh's own space (section 3.7.4), and there in the world.
            if mirrors(to_world) {
                self.draft.set(shape, "flip_normals", Value::Boolean(true));
            }
        }
        self.draft.set(shape, "to_world", copied(to_world));
        for object in look.bsdf.into_iter().chain(look.emitter) {
            self.draft.link(shape, None, object);
        }
        if let Some(medium) = look.interior {
            self.draft.link(shape, Some("interior"), medium);
        }
        // Of solids that lie within each other, and of equal priority, the inner one holds.
        if look.is_solid && look.emitter.is_none() {
            self.draft.set(shape, "priority", Value::Integer(0));
        }
        self.draft.link(parent, None, shape);
    }

    /// How a node's mesh is deformed at the time.
    fn deformation(&self, node: usize, mesh: usize) -> Result<Deformation, SceneError> {
        let (document, time) = (self.document, self.timing.time);
        let written = &document.nodes[node];
        let deforms = written.skin.is_some()
            || document.meshes[mesh]
                .primitives
                .iter()
                .any(|part| !part.targets.is_empty());
        if self.timing.shutter > 0.0 && deforms {
            let name = node_name(document, node);
            self.told
                .warn(format!("{name}: its form is that of one moment; only places blur"));
        }
        let animated = self.animations.at(node, Property::Weights, time);
        let at_rest = written.weights.clone().or(document.meshes[mesh].weights.clone());
        let weights = animated.or(at_rest).unwrap_or_default();
        let Some(skin) = written.skin else {
            return Ok(Deformation { weights, joints: None });
        };
        let field = format!("skins[{skin}]");
        let skin = document.skins.get(skin).ok_or_else(|| {
            let reason = format!("there is no skin {skin}; the file has {}", document.skins.len());
            self.accessors.wrong(format!("nodes[{node}].skin"), reason)
        })?;
        let bindings = match skin.inverse_bind_matrices {
            Some(accessor) => self.accessors.vectors::<16>(accessor, &field)?,
            None => Vec::new(),
        };
        let joint = |(number, joint): (usize, &usize)| {
            let world = self.tree.world(*joint).ok_or_else(|| {
                let reason = format!("joint {number} is node {joint}, which hangs in no tree");
                self.accessors.wrong(field.clone(), reason)
            })?;
            let binding = bindings
                .get(number)
                .map(|matrix| DMat4::from_cols_array(&matrix.map(f64::from)));
            Ok(world * binding.unwrap_or(DMat4::IDENTITY))
        };
        let joints: Result<Vec<DMat4>, SceneError> = skin.joints.iter().enumerate().map(joint).collect();
        Ok(Deformation {
            weights,
            joints: Some(joints?),
        })
    }
}

/// How many of the nodes that are shown have each mesh.
fn uses(document: &Document, tree: &Tree) -> Vec<usize> {
    let mut uses = vec![0; document.meshes.len()];
    for node in &tree.shown {
        if let Some(uses) = document.nodes[*node].mesh.and_then(|mesh| uses.get_mut(mesh)) {
            *uses += 1;
        }
    }
    uses
}

/// A place once more.
fn copied(to_world: &Value) -> Value {
    match to_world {
        Value::Animation(moving) => Value::Animation(moving.clone()),
        Value::Transform(still) => Value::Transform(still.clone()),
        _ => Value::Transform(Box::default()),
    }
}

/// Whether a place turns left into right.
fn mirrors(to_world: &Value) -> bool {
    match to_world {
        Value::Transform(still) => still.flips_handedness(),
        Value::Animation(moving) => moving.keyframes().any(crate::math::Transform::flips_handedness),
        _ => false,
    }
}
