//! Shapes.
//!
//! Which side is the outer one matters for lights. pbrt turns normals over where `ReverseOrientation` says so, and those that do not come
//! with the mesh where the transform mirrors as well (`Shape::transformSwapsHandedness`).

use super::Reading;
use super::grid::add_bilinear;
use super::parameter::{Parameters, groups};
use super::subdivision::subdivide;
use super::texture::Tint;
use crate::math::{Vec2, Vec3};
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::mesh::RawMesh;
use glam::DMat4;

const SHAPES: [&str; 8] = [
    "trianglemesh",
    "plymesh",
    "sphere",
    "disk",
    "cylinder",
    "bilinearmesh",
    "loopsubdiv",
    "curve",
];

/// A shape that was made.
#[derive(Clone, Copy)]
pub(super) struct Made {
    pub(super) object: ObjectId,
    /// How many lights it is in pbrt, where each triangle of a mesh is one.
    pub(super) lights: usize,
}

impl Reading<'_, '_> {
    pub(super) fn shape(&mut self, kind: &str, parameters: &mut Parameters) -> Result<(), SceneError> {
        if kind == "curve" {
            return self.curve(parameters);
        }
        self.count_shape(&parameters.place)?;
        let made = match kind {
            "trianglemesh" => self.triangle_mesh(parameters)?,
            "plymesh" => self.ply_mesh(parameters)?,
            "sphere" => self.sphere(parameters)?,
            "disk" => self.disk(parameters)?,
            "cylinder" => self.cylinder(parameters)?,
            "cone" => self.cone(parameters)?,
            "paraboloid" => self.paraboloid(parameters)?,
            "hyperboloid" => self.hyperboloid(parameters)?,
            "bilinearmesh" => self.bilinear_mesh(parameters)?,
            "loopsubdiv" => self.loop_subdivision(parameters)?,
            "heightfield" => self.height_field(parameters)?,
            "nurbs" => {
                parameters.warn("this type does not exist here: the shape is left out of the picture");
                return Ok(());
            }
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                self.faults
                    .note(SceneError::unknown(place, context, "type", kind, SHAPES))?;
                return Ok(());
            }
        };
        let Some(made) = made else { return Ok(()) };
        let opacity = self.float_tint(parameters, "alpha")?;
        let cutout = self.float_tint(parameters, "shadowalpha")?;
        if cutout.is_some() {
            parameters.warn_of("shadowalpha", "shadows are as dense as the shape");
        }
        if parameters.has("displacement") {
            parameters.warn_of("displacement", "the mesh is not displaced");
            parameters.ignore(&["displacement", "edgelength", "uvscale"]);
        }
        parameters.finish();
        let mut material = match self.state.material {
            Some(material) => material,
            None => self.default_material(),
        };
        if opacity == Some(Tint::Number(0.0)) && self.state.area_light.is_some() {
            parameters.warn_of(
                "alpha",
                "the lamp is seen, and mirrored, where pbrt's shines without being seen",
            );
        }
        if let Some(opacity) = opacity.filter(|opacity| *opacity != Tint::Number(1.0)) {
            let opacity = match opacity {
                Tint::Number(value) => Tint::Number(value.clamp(0.0, 1.0)),
                other => other,
            };
            material = self.masked(material, opacity, &parameters.context, &parameters.place);
        }
        self.draft.link(made.object, None, material);
        self.bound(made.object);
        if let Some(light) = self.state.area_light.clone() {
            self.light_up(made, &light, self.group, &parameters.place)?;
        }
        let parent = self.group.unwrap_or(0);
        self.draft.link(parent, None, made.object);
        Ok(())
    }

    /// Gives a shape an area light, unless it is part of a group.
    pub(super) fn light_up(
        &mut self,
        made: Made,
        light: &Parameters,
        group: Option<ObjectId>,
        place: &Place,
    ) -> Result<(), SceneError> {
        if group.is_some() {
            light.warn("objects do not shine: shapes between ObjectBegin and ObjectEnd are without it");
            return Ok(());
        }
        self.shine(made, light, place)
    }

    /// Adds a shape that stands where the state has it.
    pub(super) fn add_shape(
        &mut self,
        plugin: &str,
        parameters: &Parameters,
        first: DMat4,
        flip: bool,
    ) -> Result<ObjectId, SceneError> {
        let shape = self.add(Kind::Shape, plugin, parameters);
        let placed = self.state.placed(first);
        if placed != [DMat4::IDENTITY; 2] {
            self.set_to_world(shape, placed)?;
        }
        if flip {
            self.draft.set(shape, "flip_normals", Value::Boolean(true));
        }
        Ok(shape)
    }

    /// Adds a mesh. Without normals its triangles are flat.
    pub(super) fn add_mesh(
        &mut self,
        parameters: &Parameters,
        mesh: RawMesh,
        flip: bool,
    ) -> Result<Option<Made>, SceneError> {
        let lights = mesh.triangles.len();
        let shape = self.add_shape("mesh", parameters, DMat4::IDENTITY, flip)?;
        if mesh.normals.is_empty() {
            self.draft.set(shape, "face_normals", Value::Boolean(true));
        }
        self.draft.set(shape, "mesh", Value::Mesh(mesh.into()));
        Ok(Some(Made { object: shape, lights }))
    }

    /// Warns where the triangles of a mesh that shines with a given power have different areas.
    fn compare_areas(&self, mesh: &RawMesh) {
        let Some(light) = self.state.area_light.as_ref().filter(|light| light.has("power")) else {
            return;
        };
        let matrix = self.state.to_world[0];
        let areas = mesh.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| matrix.transform_point3(mesh.positions[vertex as usize].as_dvec3()));
            (b - a).cross(c - a).length()
        });
        let (smallest, largest) = areas.fold((f64::MAX, 0.0_f64), |(s, l), area| (s.min(area), l.max(area)));
        if smallest < 0.999 * largest {
            light.warn_of("power", SHARED_POWER);
        }
    }

    /// Whether shapes without normals of their own are turned over.
    pub(super) fn turned(&self) -> bool {
        self.state.reverse_orientation != self.state.mirrors()
    }

    /// Whether the material or the opacity depends on the place on the surface.
    pub(super) fn is_textured(&self, parameters: &Parameters) -> Result<bool, SceneError> {
        Ok(parameters.texture("alpha")?.is_some() || self.has_texture())
    }

    fn has_texture(&self) -> bool {
        let mut pending: Vec<ObjectId> = self.state.material.into_iter().collect();
        let mut seen = 0;
        while let Some(object) = pending.pop() {
            if self.draft.objects[object].kind == Kind::Texture {
                return true;
            }
            seen += 1;
            if seen > MOST_PARTS {
                return true;
            }
            pending.extend(self.draft.objects[object].children.iter().map(|child| child.target));
        }
        false
    }

    fn triangle_mesh(&mut self, parameters: &mut Parameters) -> Result<Option<Made>, SceneError> {
        let Some(mut mesh) = self.indexed(parameters, 3)? else {
            return Ok(None);
        };
        mesh.mesh.triangles = groups(mesh.indices).expect("there are three for each triangle");
        parameters.ignore(&["S", "faceIndices"]);
        let flip = match mesh.mesh.normals.is_empty() {
            true => self.turned(),
            false => self.state.reverse_orientation,
        };
        self.compare_areas(&mesh.mesh);
        self.add_mesh(parameters, mesh.mesh, flip)
    }

    /// The vertices of a mesh and its indices, `corners` for each face. A single face needs no indices.
    fn indexed(&self, parameters: &mut Parameters, corners: usize) -> Result<Option<Indexed>, SceneError> {
        let positions = parameters.take_vectors("P")?;
        if positions.is_empty() {
            return parameters.fault("P", "it is missing");
        }
        let indices = match parameters.take_indices("indices")? {
            Some(indices) => indices,
            None if positions.len() == corners => (0..corners as u32).collect::<Vec<u32>>(),
            None => return parameters.fault("indices", "it is missing"),
        };
        if !indices.len().is_multiple_of(corners) {
            return parameters.fault(
                "indices",
                format!("{} indices are no multiple of {corners}", indices.len()),
            );
        }
        if let Some(index) = indices.iter().find(|index| **index as usize >= positions.len()) {
            let reason = format!(
                "index {} is out of range: there are {} points",
                *index as i32,
                positions.len()
            );
            return parameters.fault("indices", reason);
        }
        let mut mesh = RawMesh {
            positions,
            ..RawMesh::default()
        };
        mesh.normals = parameters.take_vectors("N")?;
        mesh.normals
            .iter_mut()
            .for_each(|normal| *normal = normal.normalize_or(Vec3::ZERO));
        let uv = if parameters.has("uv") { "uv" } else { "st" };
        let uvs = parameters.take_groups::<2>(uv)?.unwrap_or_default();
        mesh.uvs = uvs.into_iter().map(Vec2::from_array).collect();
        for (name, count) in [("N", mesh.normals.len()), (uv, mesh.uvs.len())] {
            if count != 0 && count != mesh.positions.len() {
                return parameters.fault(name, format!("there are {count} for {} points", mesh.positions.len()));
            }
        }
        Ok(Some(Indexed { mesh, indices }))
    }

    fn ply_mesh(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let Some(name) = parameters.text("filename")?.map(str::to_owned) else {
            return parameters.fault("filename", "it is missing");
        };
        let file = match self.loader.open(&parameters.place, &self.search, &name) {
            Ok(file) => file,
            Err(fault) => return self.faults.note(fault).map(|()| None),
        };
        let flat = !has_normals(&file.bytes);
        let flip = if flat {
            self.turned()
        } else {
            self.state.reverse_orientation
        };
        let shape = self.add_shape("ply", parameters, DMat4::IDENTITY, flip)?;
        self.draft.set(shape, "filename", Value::String(name));
        if flat {
            self.draft.set(shape, "face_normals", Value::Boolean(true));
        }
        let lights = faces(&file.bytes);
        if let Some(light) = self
            .state
            .area_light
            .as_ref()
            .filter(|light| light.has("power") && lights != 1)
        {
            light.warn_of("power", SHARED_POWER);
        }
        Ok(Some(Made { object: shape, lights }))
    }

    fn bilinear_mesh(&mut self, parameters: &mut Parameters) -> Result<Option<Made>, SceneError> {
        let Some(Indexed { mesh: given, indices }) = self.indexed(parameters, 4)? else {
            return Ok(None);
        };
        let few = indices.len() / 4 > MOST_FINE_PATCHES;
        let mut mesh = RawMesh::default();
        for corners in indices.chunks_exact(4) {
            let vertex = |corner: usize| corners[corner] as usize;
            let points = std::array::from_fn(|corner| given.positions[vertex(corner)].as_dvec3());
            let first = mesh.positions.len();
            add_bilinear(&mut mesh, points, few);
            let total = mesh.triangles.len() as u64;
            within(
                &parameters.place,
                "number of triangles of the scene",
                total,
                self.loader.limits.triangles,
            )?;
            for added in first..mesh.positions.len() {
                let uv = mesh.uvs[added];
                let [w00, w10] = [(1.0 - uv.x) * (1.0 - uv.y), uv.x * (1.0 - uv.y)];
                let weights = [w00, w10, (1.0 - uv.x) * uv.y, uv.x * uv.y];
                if !given.uvs.is_empty() {
                    mesh.uvs[added] = (0..4).map(|corner| given.uvs[vertex(corner)] * weights[corner]).sum();
                }
                if !given.normals.is_empty() {
                    let normal: Vec3 = (0..4)
                        .map(|corner| given.normals[vertex(corner)] * weights[corner])
                        .sum();
                    mesh.normals[added] = normal.normalize_or(mesh.normals[added]);
                }
            }
        }
        parameters.ignore(&["faceIndices", "emissionfilename"]);
        let patches = indices.len() / 4;
        let flip = if given.normals.is_empty() {
            self.turned()
        } else {
            self.state.reverse_orientation
        };
        let made = self.add_mesh(parameters, mesh, flip)?;
        // A patch is a light, and not each of its triangles.
        Ok(made.map(|made| Made {
            lights: patches,
            ..made
        }))
    }

    /// The unit square raised by heights, of which a row runs along x.
    fn height_field(&mut self, parameters: &mut Parameters) -> Result<Option<Made>, SceneError> {
        let heights = parameters.take_groups::<1>("Pz")?.unwrap_or_default();
        let [columns, rows] =
            [parameters.integer("nu")?, parameters.integer("nv")?].map(|side| side.unwrap_or(0).max(0));
        let (columns, rows) = (columns as usize, rows as usize);
        if columns < 2 || rows < 2 || columns.checked_mul(rows) != Some(heights.len()) {
            let reason = format!(
                "there are {} heights for {columns} times {rows}; a field has 2 by 2 or more",
                heights.len()
            );
            return parameters.fault("Pz", reason);
        }
        let mut mesh = RawMesh::default();
        for (index, [height]) in heights.into_iter().enumerate() {
            let at = [index % columns, index / columns];
            let uv = Vec2::new(at[0] as f32 / (columns - 1) as f32, at[1] as f32 / (rows - 1) as f32);
            mesh.positions.push(uv.extend(height));
            mesh.uvs.push(uv);
            if at[0] + 1 < columns && at[1] + 1 < rows {
                let [a, b, c, d] = [0, 1, columns, columns + 1].map(|step| (index + step) as u32);
                mesh.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        self.add_mesh(parameters, mesh, self.turned())
    }

    fn loop_subdivision(&mut self, parameters: &mut Parameters) -> Result<Option<Made>, SceneError> {
        let Some(Indexed { mesh: given, indices }) = self.indexed(parameters, 3)? else {
            return Ok(None);
        };
        let levels = if parameters.has("levels") { "levels" } else { "nlevels" };
        let levels = parameters.integer(levels)?.unwrap_or(3).clamp(0, 16) as u32;
        parameters.ignore(&["scheme"]);
        let triangles = groups(indices).expect("there are three for each triangle");
        let refined = (triangles.len() as u64).saturating_mul(1 << (2 * levels));
        let what = "number of triangles after subdivision";
        within(&parameters.place, what, refined, self.loader.limits.triangles)?;
        match subdivide(&given.positions, triangles, levels) {
            Ok(mesh) => self.add_mesh(parameters, mesh, self.state.reverse_orientation),
            Err(reason) => parameters.fault("indices", reason),
        }
    }
}

/// The most objects of a material that are looked at for textures.
const MOST_PARTS: usize = 1000;
/// The most patches of a bilinear mesh that are finely divided where they are curved.
const MOST_FINE_PATCHES: usize = 1000;

/// A mesh whose faces are not made yet.
struct Indexed {
    mesh: RawMesh,
    indices: Vec<u32>,
}

/// What becomes of the power of lights that share it.
const SHARED_POWER: &str = "each face of the mesh has this power in pbrt: here they share the sum, and shine alike";

/// The header of a PLY file.
fn header(bytes: &[u8]) -> String {
    let head = &bytes[..bytes.len().min(1 << 16)];
    let end = head
        .windows(10)
        .position(|window| window == b"end_header")
        .unwrap_or(head.len());
    String::from_utf8_lossy(&head[..end]).into_owned()
}

/// Whether the header of a PLY file declares normals.
fn has_normals(bytes: &[u8]) -> bool {
    header(bytes).split(['\n', '\r']).any(|line| {
        let mut words = line.split_ascii_whitespace();
        words.next() == Some("property") && words.last() == Some("nx")
    })
}

/// The faces that the header of a PLY file promises.
fn faces(bytes: &[u8]) -> usize {
    let header = header(bytes);
    let mut lines = header.split(['\n', '\r']).map(str::split_ascii_whitespace);
    let count = lines.find_map(|mut words| {
        let face = words.next() == Some("element") && words.next() == Some("face");
        words.next().filter(|_| face)?.parse().ok()
    });
    count.unwrap_or(1)
}
