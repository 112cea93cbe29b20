//! Shapes.
//!
//! Which side is the outer one matters for lights. pbrt turns normals over where `ReverseOrientation` says so, and those that do not come
//! with the mesh where the transform mirrors as well (`Shape::transformSwapsHandedness`).

use super::Reading;
use super::grid::add_bilinear;
use super::parameter::Parameters;
use super::subdivision::subdivide;
use super::texture::Tint;
use crate::math::{Vec2, Vec3};
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{SceneError, within};
use crate::scene::loader::LoadedFile;
use crate::scene::mesh::RawMesh;
use glam::DMat4;
use std::sync::Arc;

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

/// A shape that was made, with what lights need to know.
pub(super) struct Made {
    pub(super) object: ObjectId,
    /// The area of what is one light in pbrt: a shape, or a triangle of a mesh.
    pub(super) area: Option<f64>,
}

impl Reading<'_, '_> {
    pub(super) fn shape(&mut self, kind: &str, parameters: &Parameters) -> Result<(), SceneError> {
        self.count_shape(&parameters.place)?;
        let made = match kind {
            "trianglemesh" => self.triangle_mesh(parameters)?,
            "plymesh" => self.ply_mesh(parameters)?,
            "sphere" => self.sphere(parameters)?,
            "disk" => self.disk(parameters)?,
            "cylinder" => self.cylinder(parameters)?,
            "cone" => self.cone(parameters)?,
            "paraboloid" => self.paraboloid(parameters)?,
            "bilinearmesh" => self.bilinear_mesh(parameters)?,
            "loopsubdiv" => self.loop_subdivision(parameters)?,
            "curve" | "hyperboloid" | "heightfield" | "heightfield2" | "nurbs" => {
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
        if let Some(opacity) = opacity.filter(|opacity| *opacity != Tint::Number(1.0)) {
            let opacity = match opacity {
                Tint::Number(value) => Tint::Number(value.clamp(0.0, 1.0)),
                other => other,
            };
            material = self.masked(material, opacity, &parameters.context, &parameters.place);
        }
        self.draft.link(made.object, None, material);
        if let Some(light) = self.state.area_light.clone() {
            match self.group {
                Some(_) => light.warn("objects do not shine: shapes between ObjectBegin and ObjectEnd are without it"),
                None => self.shine(made.object, &light, made.area, &parameters.place)?,
            }
        }
        let parent = self.group.unwrap_or(0);
        self.draft.link(parent, None, made.object);
        Ok(())
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
        let area = self.mean_area(&mesh);
        let shape = self.add_shape("mesh", parameters, DMat4::IDENTITY, flip)?;
        if mesh.normals.is_empty() {
            self.draft.set(shape, "face_normals", Value::Boolean(true));
        }
        self.draft.set(shape, "mesh", Value::Mesh(Arc::new(mesh)));
        Ok(Some(Made { object: shape, area }))
    }

    /// The mean area of a mesh's triangles in the world, of which each is a light of its own in pbrt; `None` where nothing asks for it.
    fn mean_area(&self, mesh: &RawMesh) -> Option<f64> {
        let light = self.state.area_light.as_ref()?;
        if !light.has("power") {
            return None;
        }
        let matrix = self.state.to_world[0];
        let areas = mesh.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| matrix.transform_point3(mesh.positions[vertex as usize].as_dvec3()));
            0.5 * (b - a).cross(c - a).length()
        });
        let (mut sum, mut smallest, mut largest) = (0.0, f64::MAX, 0.0_f64);
        for area in areas {
            sum += area;
            smallest = smallest.min(area);
            largest = largest.max(area);
        }
        if smallest < 0.999 * largest {
            let message =
                "each of the light's triangles has this power in pbrt: here they share the sum, and shine alike";
            light.warn_of("power", message);
        }
        Some(sum / mesh.triangles.len() as f64).filter(|area| *area > 0.0)
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

    fn triangle_mesh(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let Some(mut mesh) = self.indexed(parameters, 3)? else {
            return Ok(None);
        };
        mesh.mesh.triangles = mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        parameters.ignore(&["S", "faceIndices"]);
        let flip = match mesh.mesh.normals.is_empty() {
            true => self.turned(),
            false => self.state.reverse_orientation,
        };
        self.add_mesh(parameters, mesh.mesh, flip)
    }

    /// The vertices of a mesh and its indices, `corners` for each face. A single face needs no indices.
    fn indexed(&self, parameters: &Parameters, corners: usize) -> Result<Option<Indexed>, SceneError> {
        let positions = parameters.vectors("P")?;
        if positions.is_empty() {
            return parameters.fault("P", "it is missing");
        }
        let indices = match parameters.integers("indices")? {
            Some(indices) => indices.iter().map(|index| *index as u32).collect(),
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
        mesh.normals = parameters.vectors("N")?;
        mesh.normals
            .iter_mut()
            .for_each(|normal| *normal = normal.normalize_or(Vec3::ZERO));
        let uv = if parameters.has("uv") { "uv" } else { "st" };
        let uvs = parameters.groups::<2>(uv)?.unwrap_or_default();
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
        let packed = file.bytes.starts_with(&[0x1f, 0x8b]);
        let bytes = match super::unpacked(&file, self.loader.limits.file_bytes) {
            Ok(bytes) => bytes,
            Err(fault) => return self.faults.note(fault).map(|()| None),
        };
        let flat = !has_normals(&bytes);
        let flip = if flat {
            self.turned()
        } else {
            self.state.reverse_orientation
        };
        let shape = self.add_shape("ply", parameters, DMat4::IDENTITY, flip)?;
        let source = match packed {
            true => Value::File(LoadedFile { name: file.name, bytes }),
            false => Value::String(name),
        };
        self.draft.set(shape, "filename", source);
        if flat {
            self.draft.set(shape, "face_normals", Value::Boolean(true));
        }
        Ok(Some(Made {
            object: shape,
            area: None,
        }))
    }

    fn bilinear_mesh(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
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
        let triangles = mesh.triangles.len();
        let made = self.add_mesh(parameters, mesh, flip)?;
        // A patch is a light, and not each of its triangles.
        Ok(made.map(|made| Made {
            area: made.area.map(|area| area * triangles as f64 / patches as f64),
            ..made
        }))
    }

    fn loop_subdivision(&mut self, parameters: &Parameters) -> Result<Option<Made>, SceneError> {
        let Some(Indexed { mesh: given, indices }) = self.indexed(parameters, 3)? else {
            return Ok(None);
        };
        let levels = if parameters.has("levels") { "levels" } else { "nlevels" };
        let levels = parameters.integer(levels)?.unwrap_or(3).clamp(0, 16) as u32;
        parameters.ignore(&["scheme"]);
        let triangles: Vec<[u32; 3]> = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
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

/// Whether the header of a PLY file declares normals.
fn has_normals(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1 << 16)];
    let end = head
        .windows(10)
        .position(|window| window == b"end_header")
        .unwrap_or(head.len());
    let header = String::from_utf8_lossy(&head[..end]);
    header.split(['\n', '\r']).any(|line| {
        let mut words = line.split_ascii_whitespace();
        words.next() == Some("property") && words.last() == Some("nx")
    })
}
