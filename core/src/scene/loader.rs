//! Reads the files of one scene within its limits, each once.

use super::error::{Place, SceneError, within};
use super::files::{SceneFiles, normalise};
use super::limits::Limits;
use std::collections::BTreeMap;
use std::sync::Arc;

pub(crate) struct Loader<'a> {
    files: &'a dyn SceneFiles,
    pub(crate) limits: &'a Limits,
    read: BTreeMap<String, Arc<[u8]>>,
    total: u64,
}

/// A file of the scene.
#[derive(Clone, Debug)]
pub(crate) struct LoadedFile {
    /// Plain name within the scene.
    pub(crate) name: String,
    pub(crate) bytes: Arc<[u8]>,
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
        let bytes: Arc<[u8]> = self.files.read(name).map_err(|error| error.at(place))?.into();
        within(
            place,
            &format!("bytes of file `{name}`"),
            bytes.len() as u64,
            self.limits.file_bytes,
        )?;
        self.total += bytes.len() as u64;
        within(place, "bytes of all files", self.total, self.limits.total_bytes)?;
        self.read.insert(name.into(), bytes.clone());
        Ok(LoadedFile {
            name: name.into(),
            bytes,
        })
    }
}
