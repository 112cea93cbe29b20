//! From bytes to the JSON and the buffers of a glTF file: the chunks of a GLB, files beside it, and data within URIs.

use super::document::Document;
use crate::scene::error::{Place, SceneError, shortened, within};
use crate::scene::limits::Limits;
use crate::scene::loader::{LoadedFile, Loader};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;

/// How the file begins that holds JSON and binary data together.
const MAGIC: &[u8; 4] = b"glTF";
/// Bytes of its header, and of that of a chunk.
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;

/// The JSON and, where the file has it, the binary chunk (section 4.4 of the specification).
pub(super) struct Chunks<'a> {
    pub(super) json: &'a [u8],
    pub(super) binary: Option<&'a [u8]>,
    /// Whether lines of the JSON are lines of the file.
    has_lines: bool,
}

/// Parts the file, which is JSON itself or a GLB.
pub(super) fn chunks<'a>(bytes: &'a [u8], place: &Place) -> Result<Chunks<'a>, SceneError> {
    if !bytes.starts_with(MAGIC) {
        let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        return Ok(Chunks {
            json,
            binary: None,
            has_lines: true,
        });
    }
    let broken = |reason: String| SceneError::data(place, reason);
    let number = |at: usize| {
        let four = bytes.get(at..at + 4).and_then(|four| four.try_into().ok());
        four.map(u32::from_le_bytes)
            .ok_or_else(|| broken(format!("the GLB ends at byte {}, within a header", bytes.len())))
    };
    match number(4)? {
        2 => {}
        version => {
            return Err(broken(format!(
                "the GLB has version {version} of its container; version 2 is read"
            )));
        }
    }
    let chunk = |at: usize, kind: &[u8; 4]| {
        let length = number(at)? as usize;
        let found = number(at + 4)?.to_le_bytes();
        let begin = at + CHUNK_HEADER;
        let content = begin.checked_add(length).and_then(|end| bytes.get(begin..end));
        let content = content.ok_or_else(|| {
            let rest = bytes.len() - begin;
            broken(format!("a chunk of the GLB tells {length} bytes, and {rest} follow"))
        })?;
        Ok::<_, SceneError>((found == *kind).then_some(content))
    };
    let json = chunk(HEADER, b"JSON")?.ok_or_else(|| broken("the first chunk of the GLB is not JSON".into()))?;
    let next = HEADER + CHUNK_HEADER + json.len();
    let binary = if next + CHUNK_HEADER <= bytes.len() {
        chunk(next, b"BIN\0")?
    } else {
        None
    };
    Ok(Chunks {
        json,
        binary,
        has_lines: false,
    })
}

/// Reads the JSON.
pub(super) fn document(chunks: &Chunks, place: &Place, limits: &Limits) -> Result<Document, SceneError> {
    within(place, "bytes of JSON", chunks.json.len() as u64, limits.xml_bytes)?;
    // Every object takes a brace, so that none is made before the limit holds.
    let objects = chunks.json.iter().filter(|byte| **byte == b'{').count() as u64;
    within(place, "number of JSON objects", objects, u64::from(limits.xml_nodes))?;
    let mut json = serde_json::Deserializer::from_slice(chunks.json);
    let document: Document = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        let line = if chunks.has_lines {
            error.inner().line() as u32
        } else {
            0
        };
        let place = Place { line, ..place.clone() };
        match error.path().to_string().as_str() {
            "." => SceneError::data(&place, format!("not glTF: {}", error.inner())),
            path => SceneError::value(&place, shortened(path), error.inner().to_string()),
        }
    })?;
    if !document.asset.version.starts_with("2.") {
        let reason = format!(
            "version {} is not read; version 2 is",
            shortened(&document.asset.version)
        );
        return Err(SceneError::value(place, "asset.version", reason));
    }
    Ok(document)
}

/// The content of a URI: `data:` with base64, or a file beside the scene.
pub(super) fn resource(
    loader: &mut Loader,
    scene: &LoadedFile,
    place: &Place,
    field: &str,
    uri: &str,
) -> Result<LoadedFile, SceneError> {
    let Some(data) = uri.strip_prefix("data:") else {
        let name = percent_decoded(uri);
        return loader.open(place, &[scene.folder().to_owned()], &name);
    };
    let (_, content) = data
        .split_once(";base64,")
        .ok_or_else(|| SceneError::value(place, field, "a data URI must be `data:` with `;base64,`"))?;
    let bytes = STANDARD
        .decode(content)
        .map_err(|error| SceneError::value(place, field, format!("broken base64: {error}")))?;
    let name = format!("{}#{field}", scene.name);
    Ok(LoadedFile {
        name,
        bytes: bytes.to_vec().into(),
    })
}

/// A URI with its `%20` and the like decoded; what is no valid escape stays as it is.
fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let hex = (bytes[at] == b'%').then(|| uri.get(at + 1..at + 3)).flatten();
        match hex.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => {
                decoded.push(byte);
                at += 3;
            }
            None => {
                decoded.push(bytes[at]);
                at += 1;
            }
        }
    }
    String::from_utf8(decoded).unwrap_or_else(|_| uri.to_owned())
}

/// The buffers of the document, each of them read.
pub(super) fn buffers(
    document: &Document,
    binary: Option<&[u8]>,
    loader: &mut Loader,
    scene: &LoadedFile,
    place: &Place,
) -> Result<Vec<Option<Bytes>>, SceneError> {
    let mut buffers = Vec::with_capacity(document.buffers.len());
    for (index, buffer) in document.buffers.iter().enumerate() {
        let field = format!("buffers[{index}]");
        let bytes: Option<Bytes> = match (&buffer.uri, binary) {
            (Some(uri), _) => Some(resource(loader, scene, place, &format!("{field}.uri"), uri)?.bytes),
            (None, Some(binary)) if index == 0 => Some(scene.bytes.slice_ref(binary)),
            // A stand-in without content, for readers that do not decompress.
            (None, _) => None,
        };
        if let Some(bytes) = &bytes
            && (bytes.len() as u64) < buffer.byte_length
        {
            let reason = format!("it tells {} bytes, and there are {}", buffer.byte_length, bytes.len());
            return Err(SceneError::value(place, format!("{field}.byteLength"), reason));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_of_uris_are_decoded_and_broken_ones_kept() {
        for (uri, name) in [
            ("a%20b.bin", "a b.bin"),
            ("%C3%A9.png", "é.png"),
            ("100%.png", "100%.png"),
            ("%zz%4", "%zz%4"),
            ("%é", "%é"),
        ] {
            assert_eq!(percent_decoded(uri), name);
        }
    }

    #[test]
    fn lengths_of_chunks_are_not_believed() {
        let place = Place::whole("a.glb");
        let glb = |version: u32, length: u32, kind: &[u8; 4], content: &[u8]| {
            let mut bytes = MAGIC.to_vec();
            for number in [version, 0, length] {
                bytes.extend(number.to_le_bytes());
            }
            bytes.extend(kind);
            bytes.extend(content);
            bytes
        };
        let whole = glb(2, 2, b"JSON", b"{}");
        assert_eq!(chunks(&whole, &place).unwrap().json, b"{}");
        for (bytes, reason) in [
            (MAGIC.to_vec(), "within a header"),
            (glb(1, 2, b"JSON", b"{}"), "version 1"),
            (glb(2, u32::MAX, b"JSON", b"{}"), "4294967295 bytes, and 2 follow"),
            (glb(2, 2, b"BIN\0", b"{}"), "not JSON"),
        ] {
            let error = chunks(&bytes, &place).err().unwrap();
            assert!(error.to_string().contains(reason), "{error}");
        }
    }
}
