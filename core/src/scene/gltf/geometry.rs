//! Primitives of meshes as triangles, with morph targets and skins at a time.

use super::accessor::Accessors;
use super::document::{Document, Primitive};
use super::warnings::Told;
use crate::math::{Vec2, Vec3};
use crate::scene::error::{SceneError, shortened, within};
use crate::scene::limits::Limits;
use crate::scene::mesh::{RawAttribute, RawMesh};
use crate::spectrum::Spectrum;
use glam::{DMat3, DMat4, DVec3};
use std::sync::Arc;

/// How the vertices of a mesh move in its own space.
#[derive(Default)]
pub(super) struct Deformation {
    /// By morph target.
    pub(super) weights: Vec<f64>,
    /// From the space of the mesh to the world, by joint.
    pub(super) joints: Option<Vec<DMat4>>,
}

/// The triangles of one primitive.
#[derive(Clone)]
pub(super) struct Triangles {
    pub(super) mesh: Arc<RawMesh>,
    /// Whether the file gives normals; without them faces are flat.
    pub(super) has_normals: bool,
}

/// Reads primitives, and counts what they take.
pub(super) struct Geometry<'a> {
    pub(super) document: &'a Document,
    pub(super) accessors: &'a Accessors<'a>,
    pub(super) limits: &'a Limits,
    pub(super) told: &'a Told,
    vertices: u64,
    triangles: u64,
}

impl<'a> Geometry<'a> {
    pub(super) fn new(
        document: &'a Document,
        accessors: &'a Accessors<'a>,
        limits: &'a Limits,
        told: &'a Told,
    ) -> Self {
        Self {
            document,
            accessors,
            limits,
            told,
            vertices: 0,
            triangles: 0,
        }
    }

    /// Reads a primitive with the texture coordinates of set `uv_set`. `None` where it shows nothing, which is told.
    pub(super) fn read(
        &mut self,
        (mesh, number): (usize, usize),
        uv_set: u32,
        deformation: &Deformation,
    ) -> Result<Option<Triangles>, SceneError> {
        let primitive = &self.document.meshes[mesh].primitives[number];
        let field = format!("meshes[{mesh}].primitives[{number}]");
        let name = primitive_name(self.document, mesh, number);
        if primitive.mode < 4 {
            self.told
                .warn(format!("{name}: points and lines are left out; there are triangles"));
            return Ok(None);
        }
        let attribute = |name: &str| primitive.attributes.get(name).copied();
        let Some(positions) = attribute("POSITION") else {
            self.told.warn(format!("{name}: it has no `POSITION` and is left out"));
            return Ok(None);
        };
        let count = self.accessors.count(positions, &field)?;
        self.vertices = self.vertices.saturating_add(count);
        let place = self.told.place();
        within(
            place,
            "number of vertices of the scene",
            self.vertices,
            self.limits.vertices,
        )?;
        let mut points = self.vectors::<3>(positions, count, &field, "POSITION")?;
        let triangles = self.triangles(primitive, count, &field)?;
        let mut normals = match attribute("NORMAL") {
            Some(normals) => self.vectors::<3>(normals, count, &field, "NORMAL")?,
            None => Vec::new(),
        };
        self.morph(primitive, deformation, &mut points, &mut normals, &field)?;
        if let Some(joints) = &deformation.joints {
            self.skin(primitive, joints, &mut points, &mut normals, &field)?;
        }
        let uvs = match attribute(&format!("TEXCOORD_{uv_set}")) {
            Some(uvs) => self.vectors::<2>(uvs, count, &field, "TEXCOORD")?,
            None => Vec::new(),
        };
        let raw = RawMesh {
            positions: points.into_iter().map(Vec3::from_array).collect(),
            normals: normals.into_iter().map(Vec3::from_array).collect(),
            uvs: uvs.into_iter().map(Vec2::from_array).collect(),
            triangles,
            attributes: self.colours(primitive, count, &field)?,
        };
        if !has_area(&raw) {
            self.told
                .warn(format!("{name}: no triangle of it has an area, and it is left out"));
            return Ok(None);
        }
        Ok(Some(Triangles {
            has_normals: !raw.normals.is_empty(),
            mesh: Arc::new(raw),
        }))
    }

    /// The colours of vertices, which are linear and at most 1.
    fn colours(&self, primitive: &Primitive, count: u64, field: &str) -> Result<Vec<RawAttribute>, SceneError> {
        let Some(accessor) = primitive.attributes.get("COLOR_0").copied() else {
            return Ok(Vec::new());
        };
        let field = format!("{field}.COLOR_0");
        let numbers = self.accessors.numbers(accessor, &[3, 4], &field)?;
        let width = numbers.len() / (self.accessors.count(accessor, &field)?.max(1) as usize);
        if numbers.len() as u64 != count * width as u64 {
            let reason = format!("it has not the {count} elements of `POSITION`");
            return Err(self.accessors.wrong(field, reason));
        }
        let colour =
            |numbers: &[f32]| Spectrum::from_rgb([numbers[0], numbers[1], numbers[2]].map(|c| c.clamp(0.0, 1.0)));
        Ok(vec![RawAttribute {
            name: "vertex_color".into(),
            of_faces: false,
            values: numbers.chunks_exact(width).map(colour).collect(),
        }])
    }

    /// `count` vectors of an attribute.
    fn vectors<const N: usize>(
        &self,
        accessor: usize,
        count: u64,
        field: &str,
        name: &str,
    ) -> Result<Vec<[f32; N]>, SceneError> {
        let field = format!("{field}.{name}");
        let found = self.accessors.count(accessor, &field)?;
        if found != count {
            let reason = format!("it has {found} elements, and `POSITION` has {count}");
            return Err(self.accessors.wrong(field, reason));
        }
        self.accessors.vectors(accessor, &field)
    }

    /// Corners of triangles; lists, strips and fans (section 3.7.2.1 of the specification).
    fn triangles(&mut self, primitive: &Primitive, count: u64, field: &str) -> Result<Vec<[u32; 3]>, SceneError> {
        let corners = match primitive.indices {
            Some(indices) => self.accessors.indices(indices, &format!("{field}.indices"))?,
            None => (0..count as u32).collect(),
        };
        let number = match primitive.mode {
            4 => corners.len() / 3,
            5 | 6 => corners.len().saturating_sub(2),
            other => {
                let reason = format!("there is no mode {other}; allowed: 0 to 6");
                return Err(self.accessors.wrong(format!("{field}.mode"), reason));
            }
        };
        self.triangles = self.triangles.saturating_add(number as u64);
        let place = self.told.place();
        within(
            place,
            "number of triangles of the scene",
            self.triangles,
            self.limits.triangles,
        )?;
        if let Some(at) = corners.iter().position(|corner| u64::from(*corner) >= count) {
            let reason = format!("index {at} is {}; there are {count} vertices", corners[at]);
            return Err(self.accessors.wrong(format!("{field}.indices"), reason));
        }
        let triangle = |i: usize| match primitive.mode {
            4 => [corners[3 * i], corners[3 * i + 1], corners[3 * i + 2]],
            // Every second triangle of a strip turns the other way round.
            5 => [corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]],
            _ => [corners[i + 1], corners[i + 2], corners[0]],
        };
        Ok((0..number).map(triangle).collect())
    }

    /// Adds the displacements of morph targets.
    fn morph(
        &self,
        primitive: &Primitive,
        deformation: &Deformation,
        points: &mut [[f32; 3]],
        normals: &mut [[f32; 3]],
        field: &str,
    ) -> Result<(), SceneError> {
        let count = points.len() as u64;
        for (number, (target, weight)) in primitive.targets.iter().zip(&deformation.weights).enumerate() {
            if *weight == 0.0 {
                continue;
            }
            let field = format!("{field}.targets[{number}]");
            let add = |to: &mut [[f32; 3]], name: &str| {
                let Some(accessor) = target.get(name).filter(|_| !to.is_empty()) else {
                    return Ok::<_, SceneError>(());
                };
                let moves = self.vectors::<3>(*accessor, count, &field, name)?;
                for (to, by) in to.iter_mut().zip(moves) {
                    *to = [0, 1, 2].map(|i| (f64::from(to[i]) + weight * f64::from(by[i])) as f32);
                }
                Ok(())
            };
            add(points, "POSITION")?;
            add(normals, "NORMAL")?;
        }
        Ok(())
    }

    /// Moves vertices by the weighted mean of their joints (section 3.7.3 of the specification).
    fn skin(
        &self,
        primitive: &Primitive,
        joints: &[DMat4],
        points: &mut [[f32; 3]],
        normals: &mut [[f32; 3]],
        field: &str,
    ) -> Result<(), SceneError> {
        let count = points.len();
        let mut sums = vec![DMat4::ZERO; count];
        let mut totals = vec![0.0_f64; count];
        for set in 0.. {
            let attributes = [format!("JOINTS_{set}"), format!("WEIGHTS_{set}")];
            let [Some(of_joints), Some(of_weights)] = attributes.each_ref().map(|name| primitive.attributes.get(name))
            else {
                break;
            };
            let numbers = self.vectors::<4>(*of_joints, count as u64, field, &attributes[0])?;
            let weights = self.vectors::<4>(*of_weights, count as u64, field, &attributes[1])?;
            for (vertex, (numbers, weights)) in numbers.iter().zip(&weights).enumerate() {
                for (number, weight) in numbers.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
                    let joint = joints.get(*number as usize).ok_or_else(|| {
                        let reason = format!("vertex {vertex} hangs on joint {number}; the skin has {}", joints.len());
                        self.accessors.wrong(format!("{field}.{}", attributes[0]), reason)
                    })?;
                    sums[vertex] += *joint * f64::from(*weight);
                    totals[vertex] += f64::from(*weight);
                }
            }
        }
        for vertex in (0..count).filter(|vertex| totals[*vertex] > 0.0) {
            let map = sums[vertex] * (1.0 / totals[vertex]);
            let point = DVec3::from_array(points[vertex].map(f64::from));
            points[vertex] = map.transform_point3(point).as_vec3().to_array();
            if let Some(normal) = normals.get_mut(vertex) {
                let turned = DMat3::from_mat4(map).inverse().transpose() * DVec3::from_array(normal.map(f64::from));
                *normal = turned.normalize_or(DVec3::ZERO).as_vec3().to_array();
            }
        }
        if let Some(vertex) = points.iter().flatten().position(|coordinate| !coordinate.is_finite()) {
            let reason = format!(
                "the skin moves vertex {} out of the range of single precision",
                vertex / 3
            );
            return Err(self.accessors.wrong(field, reason));
        }
        Ok(())
    }
}

/// Whether a triangle has an area, as far as single precision tells.
fn has_area(mesh: &RawMesh) -> bool {
    mesh.triangles.iter().any(|corners| {
        let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize].as_dvec3());
        (b - a).cross(c - a).length_squared() > 0.0
    })
}

/// What messages call a primitive.
pub(super) fn primitive_name(document: &Document, mesh: usize, number: usize) -> String {
    let name = shortened(&document.meshes[mesh].name);
    format!("meshes[{mesh}] \"{name}\" primitive {number}")
}
