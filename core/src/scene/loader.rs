//! Reads the files of one scene within its limits, each once.

use super::error::{Place, SceneError, within};
use super::files::{SceneFiles, normalise};
use super::limits::Limits;
use bytes::Bytes;
use flate2::bufread::MultiGzDecoder;
use std::collections::BTreeMap;
use std::io::Read;

pub(crate) struct Loader<'a> {
    files: &'a dyn SceneFiles,
    pub(crate) limits: &'a Limits,
    read: BTreeMap<String, Bytes>,
    total: u64,
}

/// A file of the scene.
#[derive(Clone, Debug)]
pub(crate) struct LoadedFile {
    /// Plain name within the scene.
    pub(crate) name: String,
    /// The content, decompressed where the file is one of `gzip`.
    pub(crate) bytes: Bytes,
}

impl LoadedFile {
    /// The folder of the file, empty for the root.
    pub(crate) fn folder(&self) -> &str {
        self.name.rsplit_once('/').map_or("", |(folder, _)| folder)
    }
}

impl<'a> Loader<'a> {
    pub(crate) fn new(files: &'a dyn SceneFiles, limits: &'a Limits) -> Self {
        Self {
            files,
            limits,
            read: BTreeMap::new(),
            total: 0,
        }
    }

    /// The file `name`, looked for in the folders of `search` in order; errors are reported at `place`.
    pub(crate) fn open(&mut self, place: &Place, search: &[String], name: &str) -> Result<LoadedFile, SceneError> {
        let mut tried = Vec::new();
        let mut outside = None;
        for folder in search {
            // An absolute name is looked for in no folder, and an empty one must be refused as such.
            let joined = if folder.is_empty() || name.starts_with(['/', '\\']) || name.is_empty() {
                name.to_owned()
            } else {
                format!("{folder}/{name}")
            };
            let plain = match normalise(&joined) {
                Ok(plain) => plain,
                Err(error) => {
                    outside = Some(error);
                    continue;
                }
            };
            match self.read(place, &plain) {
                Err(SceneError::NotFound { .. }) => {
                    let plain = format!("`{plain}`");
                    if !tried.contains(&plain) {
                        tried.push(plain);
                    }
                }
                result => return result,
            }
        }
        match outside {
            Some(error) if tried.is_empty() => Err(error.at(place)),
            _ => Err(SceneError::NotFound {
                place: place.clone(),
                name: name.into(),
                tried: tried.join(", "),
            }),
        }
    }

    fn read(&mut self, place: &Place, name: &str) -> Result<LoadedFile, SceneError> {
        if let Some(bytes) = self.read.get(name) {
            return Ok(LoadedFile {
                name: name.into(),
                bytes: bytes.clone(),
            });
        }
        within(place, "number of files", self.read.len() as u64 + 1, self.limits.files)?;
        let bytes = self.files.read(name).map_err(|error| error.at(place))?;
        within(
            place,
            &format!("bytes of file `{name}`"),
            bytes.len() as u64,
            self.limits.file_bytes,
        )?;
        let bytes = unpacked(name, bytes, self.limits.file_bytes)?;
        self.total += bytes.len() as u64;
        within(place, "bytes of all files", self.total, self.limits.total_bytes)?;
        self.read.insert(name.into(), bytes.clone());
        Ok(LoadedFile {
            name: name.into(),
            bytes,
        })
    }
}

/// The content of the file `name`, decompressed where it is one of `gzip`, whose content may have `limit` bytes.
fn unpacked(name: &str, bytes: Bytes, limit: u64) -> Result<Bytes, SceneError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    let place = Place::whole(name);
    let mut content = Vec::new();
    MultiGzDecoder::new(&bytes[..])
        .take(limit.saturating_add(1))
        .read_to_end(&mut content)
        .map_err(|error| SceneError::data(&place, format!("broken gzip data: {error}")))?;
    within(&place, "bytes of the decompressed file", content.len() as u64, limit)?;
    Ok(content.into())
}
