//! Compressed meshes: EXT_meshopt_compression and KHR_meshopt_compression of buffer views, and KHR_draco_mesh_compression of primitives.
//!
//! They are unpacked before anything else reads the file: a buffer view, or an accessor, gets a buffer of its own with the plain bytes, and all that
//! follows sees a file without compression. What has its data without compression beside it is left as it is.

use super::accessor::{Component, part, width};
use super::document::{BufferView, Document};
use crate::scene::error::{Place, SceneError, shortened, within};
use crate::scene::limits::Limits;
use bytes::Bytes;
use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute, PointIndex};
use meshoptimizer_rs::{Error, Workspace, codec};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;

const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
const DRACO: &str = "KHR_draco_mesh_compression";

/// Unpacks what is compressed. `buffers` has the content of the document's buffers, as far as there is any.
pub(super) fn unpack(
    document: &mut Document,
    buffers: &mut Vec<Option<Bytes>>,
    place: &Place,
    limits: &Limits,
) -> Result<(), SceneError> {
    let mut unpacking = Unpacking {
        document,
        buffers,
        place,
        limits,
        bytes: 0,
    };
    for view in 0..unpacking.document.buffer_views.len() {
        unpacking.view(view)?;
    }
    for mesh in 0..unpacking.document.meshes.len() {
        for number in 0..unpacking.document.meshes[mesh].primitives.len() {
            unpacking.primitive(mesh, number)?;
        }
    }
    Ok(())
}

struct Unpacking<'a> {
    document: &'a mut Document,
    buffers: &'a mut Vec<Option<Bytes>>,
    place: &'a Place,
    limits: &'a Limits,
    /// What has been unpacked so far [bytes].
    bytes: u64,
}

/// What a buffer view says of its compressed bytes.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct PackedView {
    buffer: usize,
    #[serde(default)]
    byte_offset: u64,
    byte_length: u64,
    byte_stride: u64,
    count: u64,
    mode: String,
    #[serde(default)]
    filter: Option<String>,
}

/// What a primitive says of its compressed bytes.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct PackedPrimitive {
    buffer_view: usize,
    /// Names of attributes with their numbers in the compressed bytes.
    attributes: BTreeMap<String, u32>,
}

/// Numbers of an accessor.
struct Plain {
    component: Component,
    width: usize,
    bytes: Vec<u8>,
}

impl Unpacking<'_> {
    fn wrong(&self, field: &str, reason: impl Into<String>) -> SceneError {
        SceneError::value(self.place, field, reason)
    }

    fn parse<T: DeserializeOwned>(&self, field: &str, extension: &Value) -> Result<T, SceneError> {
        T::deserialize(extension).map_err(|error| self.wrong(field, error.to_string()))
    }

    /// Counts bytes before they are taken.
    fn take(&mut self, field: &str, bytes: u64) -> Result<(), SceneError> {
        self.bytes = self.bytes.saturating_add(bytes);
        let what = format!("number of bytes that is unpacked up to {field}");
        within(self.place, &what, self.bytes, self.limits.file_bytes).map(|_| ())
    }

    fn has_content(&self, buffer: usize) -> bool {
        self.buffers.get(buffer).is_some_and(Option::is_some)
    }

    /// Part of a buffer.
    fn part(&self, buffer: usize, offset: u64, length: u64, field: &str) -> Result<Bytes, SceneError> {
        part(self.buffers, buffer, offset, length).map_err(|reason| self.wrong(field, reason))
    }

    /// A new buffer.
    fn add_buffer(&mut self, bytes: Vec<u8>) -> usize {
        self.buffers.push(Some(bytes.into()));
        self.buffers.len() - 1
    }

    fn view(&mut self, index: usize) -> Result<(), SceneError> {
        let view = &self.document.buffer_views[index];
        let found = MESHOPT
            .iter()
            .find_map(|name| Some((*name, view.extensions.get(*name)?)));
        let Some((name, extension)) = found.filter(|_| !self.has_content(view.buffer)) else {
            return Ok(());
        };
        let field = format!("bufferViews[{index}].{name}");
        let packed: PackedView = self.parse(&field, extension)?;
        let content = self.part(packed.buffer, packed.byte_offset, packed.byte_length, &field)?;
        self.take(&field, packed.count.saturating_mul(packed.byte_stride))?;
        let bytes = unpacked(&packed, &content).map_err(|reason| self.wrong(&field, reason))?;
        let (byte_length, buffer) = (bytes.len() as u64, self.add_buffer(bytes));
        self.document.buffer_views[index] = BufferView {
            buffer,
            byte_offset: 0,
            byte_length,
            byte_stride: Some(packed.byte_stride),
            extensions: BTreeMap::new(),
        };
        Ok(())
    }

    fn primitive(&mut self, mesh: usize, number: usize) -> Result<(), SceneError> {
        let primitive = &self.document.meshes[mesh].primitives[number];
        let Some(extension) = primitive.extensions.get(DRACO) else {
            return Ok(());
        };
        let accessors = &self.document.accessors;
        let positions = primitive
            .attributes
            .get("POSITION")
            .and_then(|index| accessors.get(*index));
        let Some(positions) = positions.filter(|accessor| accessor.buffer_view.is_none()) else {
            return Ok(());
        };
        let field = format!("meshes[{mesh}].primitives[{number}].{DRACO}");
        let packed: PackedPrimitive = self.parse(&field, extension)?;
        let corners = primitive
            .indices
            .and_then(|index| accessors.get(index))
            .map_or(0, |indices| indices.count);
        let (points, faces) = (positions.count, corners / 3);
        within(
            self.place,
            &format!("number of vertices of {field}"),
            points,
            self.limits.vertices,
        )?;
        within(
            self.place,
            &format!("number of triangles of {field}"),
            faces,
            self.limits.triangles,
        )?;
        let attributes: Vec<(String, usize, u32)> = packed
            .attributes
            .into_iter()
            .filter_map(|(name, id)| Some((name.clone(), *primitive.attributes.get(&name)?, id)))
            .collect();
        let indices = primitive.indices;
        let Some(view) = self.document.buffer_views.get(packed.buffer_view) else {
            return Err(self.wrong(&field, format!("there is no buffer view {}", packed.buffer_view)));
        };
        let content = self.part(view.buffer, view.byte_offset, view.byte_length, &field)?;
        let left = self.limits.file_bytes.saturating_sub(self.bytes);
        let limits = DecodeLimits::default()
            .with_max_points(points)
            .with_max_faces(faces)
            .with_max_decoded_bytes(left);
        let decoded = decode(&content, limits).map_err(|reason| self.wrong(&field, reason))?;
        if decoded.num_points() as u64 != points {
            let reason = format!("it has {} vertices, and `POSITION` has {points}", decoded.num_points());
            return Err(self.wrong(&field, reason));
        }
        for (name, accessor, id) in attributes {
            let field = format!("{field}.attributes.{name}");
            let plain = decoded
                .attribute_by_unique_id(id)
                .ok_or_else(|| format!("there is no attribute {id} in the compressed data"))
                .and_then(|attribute| plain(attribute, decoded.num_points()));
            let plain = plain.map_err(|reason| self.wrong(&field, reason))?;
            self.set(accessor, points, plain, &field)?;
        }
        if let Some(indices) = indices {
            let corners = decoded.faces().iter().flatten();
            let bytes = corners.flat_map(|corner| corner.0.to_le_bytes()).collect();
            let plain = Plain {
                component: Component::U32,
                width: 1,
                bytes,
            };
            self.set(indices, 3 * decoded.faces().len() as u64, plain, &field)?;
            // Strips are unpacked to triangles.
            self.document.meshes[mesh].primitives[number].mode = 4;
        }
        Ok(())
    }

    /// Gives an accessor plain numbers.
    fn set(&mut self, accessor: usize, count: u64, plain: Plain, field: &str) -> Result<(), SceneError> {
        self.take(field, plain.bytes.len() as u64)?;
        let Some(kind) = self
            .document
            .accessors
            .get(accessor)
            .map(|accessor| accessor.kind.clone())
        else {
            return Err(self.wrong(field, format!("there is no accessor {accessor}")));
        };
        if width(&kind) != Some(plain.width) {
            let reason = format!(
                "accessor {accessor} is of type `{}`, the compressed data of {} numbers",
                shortened(&kind),
                plain.width
            );
            return Err(self.wrong(field, reason));
        }
        let (byte_length, buffer) = (plain.bytes.len() as u64, self.add_buffer(plain.bytes));
        self.document.buffer_views.push(BufferView {
            buffer,
            byte_offset: 0,
            byte_length,
            byte_stride: None,
            extensions: BTreeMap::new(),
        });
        let view = self.document.buffer_views.len() - 1;
        let accessor = &mut self.document.accessors[accessor];
        accessor.buffer_view = Some(view);
        accessor.byte_offset = 0;
        accessor.count = count;
        accessor.component_type = plain.component.number();
        Ok(())
    }
}

/// The plain bytes of a buffer view.
fn unpacked(packed: &PackedView, bytes: &[u8]) -> Result<Vec<u8>, String> {
    let (count, stride) = (packed.count as usize, packed.byte_stride as usize);
    let mut workspace = Workspace::default();
    let plain = match packed.mode.as_str() {
        "ATTRIBUTES" => codec::decode_vertex_buffer(count, stride, bytes, &mut workspace),
        "TRIANGLES" => codec::decode_index_buffer(count, stride, bytes, &mut workspace),
        "INDICES" => codec::decode_index_sequence(count, stride, bytes, &mut workspace),
        other => {
            return Err(format!(
                "there is no mode `{}`; allowed: ATTRIBUTES, TRIANGLES, INDICES",
                shortened(other)
            ));
        }
    };
    let broken = |error: Error| format!("its data cannot be unpacked: {error}");
    let mut plain = plain.map_err(broken)?;
    let filter = match packed.filter.as_deref().unwrap_or("NONE") {
        "NONE" => return Ok(plain),
        "OCTAHEDRAL" => codec::decode_filter_oct,
        "QUATERNION" => codec::decode_filter_quat,
        "EXPONENTIAL" => codec::decode_filter_exp,
        "COLOR" => codec::decode_filter_color,
        other => {
            return Err(format!(
                "there is no filter `{}`; allowed: NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL, COLOR",
                shortened(other)
            ));
        }
    };
    filter(&mut plain, count, stride, &mut workspace).map_err(broken)?;
    Ok(plain)
}

fn decode(bytes: &[u8], limits: DecodeLimits) -> Result<Mesh, String> {
    let mut mesh = Mesh::new();
    let mut decoder = MeshDecoder::new();
    let decoded = decoder.decode(&mut DecoderBuffer::new(bytes).with_limits(limits), &mut mesh);
    decoded.map_err(|error| format!("its data cannot be unpacked: {error}"))?;
    Ok(mesh)
}

/// The values of an attribute, point by point.
fn plain(attribute: &PointAttribute, points: usize) -> Result<Plain, String> {
    let component = match attribute.data_type() {
        DataType::Int8 => Component::I8,
        DataType::Uint8 => Component::U8,
        DataType::Int16 => Component::I16,
        DataType::Uint16 => Component::U16,
        DataType::Uint32 => Component::U32,
        DataType::Float32 => Component::F32,
        other => return Err(format!("glTF has no attributes of {other:?}")),
    };
    let width = usize::from(attribute.num_components());
    let mut bytes = vec![0; points * width * component.bytes()];
    for (point, value) in bytes.chunks_exact_mut(width * component.bytes()).enumerate() {
        let index = u64::from(attribute.mapped_index(PointIndex(point as u32)).0);
        let begin = index * u64::try_from(attribute.byte_stride()).unwrap_or(0);
        if !attribute.buffer().try_read(begin as usize, value) {
            return Err(format!("vertex {point} has no value"));
        }
    }
    Ok(Plain {
        component,
        width,
        bytes,
    })
}
