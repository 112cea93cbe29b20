//! Mitsuba's `.serialized` meshes, versions 3 and 4.
//!
//! Meshes lie one after the other: two 16-bit words (0x041c, version), then a zlib stream of flags, a name (version 4),
//! counts and arrays. A table at the end gives their offsets (64-bit, in version 3 32-bit) and their number (32-bit).
//! All is little-endian. Arrays are decompressed piece by piece, so that memory grows only with data that is there.

use super::{MeshFile, RawAttribute, RawMesh};
use crate::math::{Vec2, Vec3};
use crate::scene::error::SceneError;
use crate::scene::faults::FileFaults;
use crate::spectrum::Spectrum;
use flate2::bufread::ZlibDecoder;
use std::io::Read;

const MAGIC: u16 = 0x041c;
const HAS_NORMALS: u32 = 0x0001;
const HAS_UVS: u32 = 0x0002;
const HAS_COLOURS: u32 = 0x0008;
const FACE_NORMALS: u32 = 0x0010;
const DOUBLE: u32 = 0x2000;
/// The longest name of a mesh [bytes].
const NAME_BYTES: usize = 4096;

pub(super) fn read(
    file: &MeshFile,
    index: u32,
    flip_v: bool,
    faults: &mut FileFaults,
) -> Result<(RawMesh, bool), SceneError> {
    let (version, start) = locate(file, index)?;
    let mut stream = Stream {
        file,
        decoder: ZlibDecoder::new(&file.bytes[start + 4..]),
        faults,
    };
    let flags = stream.u32()?;
    if version == 4 {
        stream.skip_name()?;
    }
    let (vertices, triangles) = (stream.u64()?, stream.u64()?);
    file.check_vertices(vertices)?;
    file.check_triangles(triangles)?;
    let (count, double) = (vertices as usize, flags & DOUBLE != 0);
    let mut mesh = RawMesh {
        positions: stream.vectors(count, double, "position")?,
        ..RawMesh::default()
    };
    if flags & HAS_NORMALS != 0 {
        let normals = stream.vectors(count, double, "normal")?;
        mesh.normals = normals
            .into_iter()
            .map(|normal| normal.normalize_or(Vec3::ZERO))
            .collect();
    }
    if flags & HAS_UVS != 0 {
        let pairs = stream.floats(count * 2, double, "texture coordinate")?;
        mesh.uvs = pairs
            .chunks_exact(2)
            .map(|p| Vec2::new(p[0], if flip_v { 1.0 - p[1] } else { p[1] }))
            .collect();
    }
    if flags & HAS_COLOURS != 0 {
        let colours = stream.floats(count * 3, double, "colour")?;
        if file.asks_for("vertex_color") {
            let colours = colours.chunks_exact(3);
            mesh.attributes.push(RawAttribute {
                name: "vertex_color".to_owned(),
                of_faces: false,
                values: colours.map(|c| Spectrum::from_rgb([c[0], c[1], c[2]])).collect(),
            });
        }
    }
    mesh.triangles = stream.triangles(triangles as usize, vertices)?;
    Ok((mesh, flags & FACE_NORMALS != 0))
}

/// The version of the file and the offset of mesh `index`.
fn locate(file: &MeshFile, index: u32) -> Result<(u16, usize), SceneError> {
    let bytes = file.bytes;
    let version = header_at(file, 0)?;
    if index == 0 {
        return Ok((version, 0));
    }
    let short = || file.broken(0, "the file ends too early for its table of meshes");
    let table_end = bytes.len().checked_sub(4).ok_or_else(short)?;
    let count = u32::from_le_bytes(array(&bytes[table_end..]));
    if index >= count {
        return Err(file.broken(
            0,
            format!("there is no mesh {index}: the file has {count}, counted from 0"),
        ));
    }
    let width = if version == 4 { 8 } else { 4 };
    let from_end = (count - index) as usize * width;
    let entry = table_end.checked_sub(from_end).ok_or_else(short)?;
    let offset = match width {
        8 => u64::from_le_bytes(array(&bytes[entry..])),
        _ => u64::from(u32::from_le_bytes(array(&bytes[entry..]))),
    };
    let offset = usize::try_from(offset)
        .ok()
        .filter(|offset| *offset < table_end)
        .ok_or_else(|| {
            file.broken(
                0,
                format!("the table puts mesh {index} at byte {offset}, behind the meshes"),
            )
        })?;
    let version = header_at(file, offset)?;
    Ok((version, offset))
}

fn header_at(file: &MeshFile, offset: usize) -> Result<u16, SceneError> {
    let header = file.bytes.get(offset..).and_then(|bytes| bytes.get(..4));
    let header = header.ok_or_else(|| file.broken(0, "the file ends too early"))?;
    let (magic, version) = (
        u16::from_le_bytes([header[0], header[1]]),
        u16::from_le_bytes([header[2], header[3]]),
    );
    if magic != MAGIC {
        return Err(file.broken(
            0,
            format!("no mesh starts at byte {offset}: found {magic:#06x}, not {MAGIC:#06x}"),
        ));
    }
    match version {
        3 | 4 => Ok(version),
        _ => Err(file.broken(0, format!("version {version} of the format; allowed: 3 and 4"))),
    }
}

/// The first bytes of a slice that is long enough.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[..N]);
    array
}

struct Stream<'a, 'f> {
    file: &'a MeshFile<'f>,
    decoder: ZlibDecoder<&'a [u8]>,
    faults: &'a mut FileFaults,
}

impl Stream<'_, '_> {
    fn fill(&mut self, buffer: &mut [u8]) -> Result<(), SceneError> {
        let ended = |error| {
            self.file
                .broken(0, format!("the compressed data end too early or are broken: {error}"))
        };
        self.decoder.read_exact(buffer).map_err(ended)
    }

    fn u32(&mut self) -> Result<u32, SceneError> {
        let mut bytes = [0; 4];
        self.fill(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn u64(&mut self) -> Result<u64, SceneError> {
        let mut bytes = [0; 8];
        self.fill(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn skip_name(&mut self) -> Result<(), SceneError> {
        let mut byte = [0];
        for _ in 0..=NAME_BYTES {
            self.fill(&mut byte)?;
            if byte == [0] {
                return Ok(());
            }
        }
        Err(self
            .file
            .broken(0, format!("the mesh's name is longer than {NAME_BYTES} bytes")))
    }

    /// Calls `take` with `count` items of `size` bytes, and notes what is wrong with each.
    fn items(
        &mut self,
        count: usize,
        size: usize,
        mut take: impl FnMut(&[u8]) -> Result<(), String>,
    ) -> Result<(), SceneError> {
        let mut buffer = vec![0; 4096 * size];
        let mut left = count;
        while left > 0 {
            let part = &mut buffer[..left.min(4096) * size];
            self.fill(part)?;
            for item in part.chunks_exact(size) {
                if let Err(reason) = take(item) {
                    self.faults.note(self.file.broken(0, reason))?;
                }
            }
            left -= part.len() / size;
        }
        Ok(())
    }

    fn floats(&mut self, count: usize, double: bool, what: &str) -> Result<Vec<f32>, SceneError> {
        let mut floats = Vec::new();
        self.items(count, if double { 8 } else { 4 }, |bytes| {
            let value = if double {
                f64::from_le_bytes(array(bytes)) as f32
            } else {
                f32::from_le_bytes(array(bytes))
            };
            floats.push(value);
            if value.is_finite() {
                Ok(())
            } else {
                Err(format!("{what}: number {} is not finite", floats.len() - 1))
            }
        })?;
        Ok(floats)
    }

    fn vectors(&mut self, count: usize, double: bool, what: &str) -> Result<Vec<Vec3>, SceneError> {
        Ok(self
            .floats(count * 3, double, what)?
            .chunks_exact(3)
            .map(Vec3::from_slice)
            .collect())
    }

    fn triangles(&mut self, count: usize, vertices: u64) -> Result<Vec<[u32; 3]>, SceneError> {
        let mut triangles = Vec::new();
        self.items(count, 12, |bytes| {
            let triangle = [0, 4, 8].map(|at| u32::from_le_bytes(array(&bytes[at..])));
            triangles.push(triangle);
            match triangle.iter().find(|index| u64::from(**index) >= vertices) {
                None => Ok(()),
                Some(bad) => Err(format!(
                    "triangle {}: vertex index {bad} is out of range: the mesh has {vertices} vertices",
                    triangles.len() - 1
                )),
            }
        })?;
        Ok(triangles)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh_error, serialized_file, with_file};
    use super::*;

    #[test]
    fn both_versions_and_precisions_are_read() {
        for version in [3, 4] {
            for double in [false, true] {
                let bytes = serialized_file(version, double, 3, [0, 1, 2], 2);
                for index in 0..2 {
                    let (mesh, face_normals) = with_file(&bytes, |file| file.serialized(index, false)).unwrap();
                    assert!(!face_normals);
                    assert_eq!(
                        mesh.positions,
                        [Vec3::ZERO, Vec3::new(index as f32 + 1.0, 0.0, 0.0), Vec3::Y]
                    );
                    assert_eq!(mesh.triangles, [[0, 1, 2]]);
                    assert!(mesh.normals.is_empty());
                }
            }
        }
    }

    #[test]
    fn broken_files_are_refused() {
        let good = serialized_file(4, false, 3, [0, 1, 2], 2);
        let read = |bytes: &[u8], index| with_file(bytes, |file| file.serialized(index, false).map(|(mesh, _)| mesh));
        mesh_error(read(&good, 2), 0, "there is no mesh 2");
        mesh_error(read(&good[..3], 0), 0, "too early");
        mesh_error(read(&good[..20], 0), 0, "broken");
        mesh_error(read(&serialized_file(5, false, 3, [0, 1, 2], 1), 0), 0, "version 5");
        mesh_error(read(&serialized_file(4, false, 3, [0, 1, 3], 1), 0), 0, "out of range");
        mesh_error(
            read(&serialized_file(4, false, 1 << 20, [0, 1, 2], 1), 0),
            0,
            "too early",
        );
        let over = read(&serialized_file(4, false, 1 << 60, [0, 1, 2], 1), 0);
        assert!(matches!(
            over.unwrap_err()[..],
            [SceneError::Limit {
                value: 0x1000_0000_0000_0000,
                ..
            }]
        ));
        let mut table = good.clone();
        let end = table.len();
        table[end - 12..end - 4].copy_from_slice(&u64::MAX.to_le_bytes());
        mesh_error(read(&table, 1), 0, "behind the meshes");
        table[end - 4..].copy_from_slice(&u32::MAX.to_le_bytes());
        mesh_error(read(&table, 1), 0, "too early");
    }
}
