//! Triangle meshes: readers of OBJ, PLY, Mitsuba's `.serialized` and files of curves, and what is common to them.
//!
//! The readers are our own. The `tobj` crate reports neither lines nor limits and keeps several meshes apart that one
//! `<shape>` holds together; `ply-rs-bw` stores each vertex as a map of its properties. Both read untrusted counts, and
//! Mitsuba's rules for shared vertices and polygons matter for the picture (smooth normals hang on them).

pub(crate) mod curves;
mod finish;
mod obj;
mod ply;
pub(crate) mod primitives;
mod serialized;

pub(crate) use curves::{CurveKind, Tubes, b_spline_segments};
pub(crate) use finish::{LARGEST_COORDINATE, finish};

use super::error::{Place, SceneError, within};
use super::faults::FileFaults;
use super::limits::Limits;
use super::loader::LoadedFile;
use crate::math::{Vec2, Vec3};
use crate::spectrum::Spectrum;

/// A mesh in its own space, as its file gives it. All numbers are finite and all indices in range.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RawMesh {
    pub(crate) positions: Vec<Vec3>,
    /// One for each position, zero where the file gives none; or empty.
    pub(crate) normals: Vec<Vec3>,
    /// One for each position, or empty.
    pub(crate) uvs: Vec<Vec2>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// What the file says of its vertices or triangles besides, so far as it is asked for.
    pub(crate) attributes: Vec<RawAttribute>,
}

/// A named value of each vertex or triangle, such as a colour.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RawAttribute {
    /// As Mitsuba has it: `vertex_` or `face_`, then the name, which is `color` for `r`, `g` and `b`.
    pub(crate) name: String,
    /// Whether there is a value for each triangle, and not for each position.
    pub(crate) of_faces: bool,
    /// Finite values, in linear colour.
    pub(crate) values: Vec<Spectrum>,
}

/// A mesh file with what it may hold.
pub(crate) struct MeshFile<'a> {
    pub(crate) place: Place,
    pub(crate) bytes: &'a [u8],
    limits: &'a Limits,
    /// What was read before for the scene.
    before: MeshTotals,
    /// Names of the attributes that are asked for.
    pub(crate) attributes: Vec<String>,
}

/// What the meshes of a scene hold together.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MeshTotals {
    pub(crate) triangles: u64,
    pub(crate) vertices: u64,
    pub(crate) bytes: u64,
}

impl<'a> MeshFile<'a> {
    pub(crate) fn new(file: &'a LoadedFile, limits: &'a Limits, before: MeshTotals) -> Self {
        Self {
            place: Place::whole(&file.name),
            bytes: &file.bytes,
            limits,
            before,
            attributes: Vec::new(),
        }
    }

    fn asks_for(&self, attribute: &str) -> bool {
        self.attributes.iter().any(|name| name == attribute)
    }

    /// An error at `line`; 0 where the format has no lines.
    fn broken(&self, line: u32, reason: impl Into<String>) -> SceneError {
        SceneError::data(
            &Place {
                line,
                ..self.place.clone()
            },
            reason,
        )
    }

    fn check_vertices(&self, count: u64) -> Result<u64, SceneError> {
        within(
            &self.place,
            "number of vertices of the scene",
            count.saturating_add(self.before.vertices),
            self.limits.vertices,
        )?;
        Ok(count)
    }

    fn check_triangles(&self, count: u64) -> Result<u64, SceneError> {
        let total = count.saturating_add(self.before.triangles);
        within(
            &self.place,
            "number of triangles of the scene",
            total,
            self.limits.triangles,
        )
    }

    /// Counts the reading of the whole file against the limit, so that repetition cannot multiply it.
    fn charge(&self) -> Result<(), SceneError> {
        let total = self.before.bytes.saturating_add(self.bytes.len() as u64);
        within(
            &self.place,
            "bytes of mesh files of the scene",
            total,
            self.limits.mesh_bytes,
        )
        .map(|_| ())
    }

    /// Reads a Wavefront OBJ file. `flip_v`: texture coordinates run downwards.
    pub(crate) fn obj(&self, flip_v: bool) -> Result<RawMesh, Vec<SceneError>> {
        self.read(|faults| {
            self.charge()?;
            obj::read(self, flip_v, faults)
        })
    }

    /// Reads a PLY file.
    pub(crate) fn ply(&self, flip_v: bool) -> Result<RawMesh, Vec<SceneError>> {
        self.read(|faults| {
            self.charge()?;
            ply::read(self, flip_v, faults)
        })
    }

    /// Reads mesh number `index` of a Mitsuba `.serialized` file, and whether it asks for face normals.
    pub(crate) fn serialized(&self, index: u32, flip_v: bool) -> Result<(RawMesh, bool), Vec<SceneError>> {
        self.read(|faults| serialized::read(self, index, flip_v, faults))
    }

    /// Reads a file of curves.
    pub(crate) fn curves(&self, kind: CurveKind) -> Result<Tubes, Vec<SceneError>> {
        self.read(|faults| {
            self.charge()?;
            curves::read(self, kind, faults)
        })
    }

    /// What `reader` reads. It notes the faults after which it can go on, and returns one that ends the reading.
    fn read<T>(&self, reader: impl FnOnce(&mut FileFaults) -> Result<T, SceneError>) -> Result<T, Vec<SceneError>> {
        let mut faults = FileFaults::default();
        let result = reader(&mut faults);
        faults.settle(result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, write::ZlibEncoder};
    use std::io::Write;

    pub(super) fn with_file<T>(bytes: &[u8], read: impl Fn(&MeshFile) -> T) -> T {
        let file = LoadedFile {
            name: "mesh".into(),
            bytes: bytes.to_vec().into(),
        };
        read(&MeshFile::new(&file, &Limits::default(), MeshTotals::default()))
    }

    /// Holds a reading to its only fault.
    pub(super) fn mesh_error(result: Result<RawMesh, Vec<SceneError>>, line: u32, reason: &str) {
        let errors = result.expect_err(reason);
        let [error] = &errors[..] else {
            panic!("{errors:?}");
        };
        assert!(matches!(error, SceneError::Data { .. }), "{error:?}");
        assert_eq!((error.file(), error.line().unwrap_or(0)), ("mesh", line), "{error}");
        assert!(error.to_string().contains(reason), "{error}");
    }

    /// A file of `meshes` triangles; the second corner of mesh `i` lies at x = `i + 1`. `vertices` is the number claimed.
    pub(super) fn serialized_file(
        version: u16,
        double: bool,
        vertices: u64,
        triangle: [u32; 3],
        meshes: u32,
    ) -> Vec<u8> {
        let (mut bytes, mut offsets) = (Vec::new(), Vec::new());
        for mesh in 0..meshes {
            offsets.push(bytes.len() as u64);
            bytes.extend(0x041c_u16.to_le_bytes());
            bytes.extend(version.to_le_bytes());
            let mut content: Vec<u8> = Vec::new();
            content.extend((if double { 0x2000_u32 } else { 0x1000 }).to_le_bytes());
            if version == 4 {
                content.extend(b"name\0");
            }
            content.extend(vertices.to_le_bytes());
            content.extend(1_u64.to_le_bytes());
            for value in [0.0, 0.0, 0.0, f64::from(mesh) + 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
                if double {
                    content.extend(value.to_le_bytes());
                } else {
                    content.extend((value as f32).to_le_bytes());
                }
            }
            content.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&content).unwrap();
            bytes.extend(encoder.finish().unwrap());
        }
        for offset in offsets {
            match version {
                3 => bytes.extend((offset as u32).to_le_bytes()),
                _ => bytes.extend(offset.to_le_bytes()),
            }
        }
        bytes.extend(meshes.to_le_bytes());
        bytes
    }
}
