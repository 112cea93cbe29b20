//! Where a scene's files come from.

use super::error::{Place, SceneError, within};
use super::limits::Limits;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The files of a scene: a folder, or a bundle.
///
/// Names are relative to the root and '/'-separated, as [`normalise`] returns them.
pub trait SceneFiles {
    /// The bytes of a file.
    ///
    /// # Errors
    /// [`SceneError::NotFound`] where there is no such file (the loader then looks in the next folder),
    /// [`SceneError::FileName`] for a name that leaves the root, [`SceneError::Limit`] for a file that is too large.
    fn read(&self, name: &str) -> Result<Vec<u8>, SceneError>;
}

/// The plain form of a file name: relative, '/'-separated, without `.`, `..` and empty parts.
///
/// # Errors
/// [`SceneError::FileName`] where the name is empty, absolute, a URL, leaves the root, or holds characters that no
/// system allows in names.
pub fn normalise(name: &str) -> Result<String, SceneError> {
    let refuse = |reason: &str| {
        let place = Place::whole(name);
        Err(SceneError::FileName {
            place,
            name: name.into(),
            reason: reason.into(),
        })
    };
    if name.is_empty() {
        return refuse("it is empty");
    }
    if name.starts_with('/') {
        return refuse("absolute names are not allowed; names are relative to the scene file");
    }
    if name.contains(['\\', ':', '\0']) || name.chars().any(char::is_control) {
        return refuse("`\\`, `:` and control characters are not allowed; parts are separated by `/`");
    }
    let mut parts: Vec<&str> = Vec::new();
    for part in name.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                if parts.pop().is_none() {
                    return refuse("it leaves the scene's folder");
                }
            }
            _ => parts.push(part),
        }
    }
    if parts.is_empty() {
        return refuse("it names no file");
    }
    Ok(parts.join("/"))
}

/// A folder of files. Nothing outside it is opened, also not through symbolic links.
#[derive(Debug)]
pub struct SceneFolder {
    root: PathBuf,
    limits: Limits,
}

impl SceneFolder {
    /// The folder `root`, with the default limits.
    ///
    /// # Errors
    /// [`SceneError::NotFound`] or [`SceneError::Read`] where there is no such folder.
    pub fn new(root: &Path) -> Result<Self, SceneError> {
        Self::with_limits(root, &Limits::default())
    }

    /// The folder `root`, reading no file larger than `limits.file_bytes`.
    ///
    /// # Errors
    /// [`SceneError::NotFound`] or [`SceneError::Read`] where there is no such folder.
    pub fn with_limits(root: &Path, limits: &Limits) -> Result<Self, SceneError> {
        let name = root.to_string_lossy();
        let root = root.canonicalize().map_err(|error| unreadable(&name, &error))?;
        Ok(Self {
            root,
            limits: limits.clone(),
        })
    }

    fn open(&self, name: &str) -> Result<File, SceneError> {
        let unreadable = |error| unreadable(name, &error);
        let path = self.root.join(name).canonicalize().map_err(unreadable)?;
        if !path.starts_with(&self.root) {
            return Err(SceneError::FileName {
                place: Place::whole(name),
                name: name.into(),
                reason: "it leads out of the scene's folder through a symbolic link".into(),
            });
        }
        if !path.metadata().map_err(unreadable)?.is_file() {
            return Err(SceneError::Read {
                place: Place::whole(name),
                name: name.into(),
                reason: "it is not a regular file".into(),
            });
        }
        File::open(path).map_err(unreadable)
    }
}

fn unreadable(name: &str, error: &std::io::Error) -> SceneError {
    let (place, name) = (Place::whole(name), name.to_owned());
    match error.kind() {
        ErrorKind::NotFound | ErrorKind::NotADirectory => SceneError::NotFound {
            place,
            tried: format!("`{name}`"),
            name,
        },
        _ => SceneError::Read {
            place,
            name,
            reason: error.to_string(),
        },
    }
}

impl SceneFiles for SceneFolder {
    fn read(&self, name: &str) -> Result<Vec<u8>, SceneError> {
        let place = Place::whole(name);
        let file = self.open(&normalise(name)?)?;
        let unreadable = |error| unreadable(name, &error);
        let limit = self.limits.file_bytes;
        let what = format!("bytes of file `{name}`");
        within(&place, &what, file.metadata().map_err(unreadable)?.len(), limit)?;
        let mut bytes = Vec::new();
        let read = file
            .take(limit.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(unreadable)?;
        within(&place, &what, read as u64, limit)?;
        Ok(bytes)
    }
}

/// Passes reads on to other files and keeps what was read: the content of the scene's bundle.
pub struct RecordedFiles<'a> {
    inner: &'a dyn SceneFiles,
    read: Mutex<BTreeMap<String, Vec<u8>>>,
}

impl<'a> RecordedFiles<'a> {
    /// Records what is read from `inner`.
    #[must_use]
    pub fn new(inner: &'a dyn SceneFiles) -> Self {
        Self {
            inner,
            read: Mutex::default(),
        }
    }

    /// The files that were read, by name.
    ///
    /// # Panics
    /// If a read panicked on another thread.
    #[must_use]
    pub fn into_files(self) -> BTreeMap<String, Vec<u8>> {
        self.read.into_inner().expect("no read panicked")
    }
}

impl SceneFiles for RecordedFiles<'_> {
    fn read(&self, name: &str) -> Result<Vec<u8>, SceneError> {
        let name = normalise(name)?;
        let bytes = self.inner.read(&name)?;
        self.read.lock().expect("no read panicked").insert(name, bytes.clone());
        Ok(bytes)
    }
}

/// A bundle in memory.
impl SceneFiles for BTreeMap<String, Vec<u8>> {
    fn read(&self, name: &str) -> Result<Vec<u8>, SceneError> {
        let name = normalise(name)?;
        self.get(&name).cloned().ok_or_else(|| SceneError::NotFound {
            place: Place::whole(&name),
            tried: format!("`{name}`"),
            name,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_made_plain_and_stay_inside() {
        assert_eq!(normalise("a/./b//../c.obj").unwrap(), "a/c.obj");
        for name in [
            "",
            "/etc/passwd",
            "..",
            "a/../../b",
            "C:\\x",
            "http://x/y",
            "a\0b",
            "./",
            "a\nb",
        ] {
            assert!(matches!(normalise(name), Err(SceneError::FileName { .. })), "{name:?}");
        }
    }

    #[test]
    fn a_folder_refuses_what_lies_outside_and_what_is_too_large() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("scene");
        std::fs::create_dir(&inside).unwrap();
        std::fs::write(folder.path().join("secret"), b"x").unwrap();
        std::fs::write(inside.join("large"), [0; 101]).unwrap();
        std::os::unix::fs::symlink("../secret", inside.join("link")).unwrap();
        let files = SceneFolder::with_limits(
            &inside,
            &Limits {
                file_bytes: 100,
                ..Limits::default()
            },
        )
        .unwrap();
        assert!(matches!(files.read("link"), Err(SceneError::FileName { .. })));
        assert!(matches!(files.read("../secret"), Err(SceneError::FileName { .. })));
        assert!(matches!(files.read("."), Err(SceneError::FileName { .. })));
        assert!(matches!(files.read("nothing"), Err(SceneError::NotFound { .. })));
        assert!(matches!(
            files.read("large"),
            Err(SceneError::Limit {
                value: 101,
                limit: 100,
                ..
            })
        ));
    }

    #[test]
    fn reads_are_recorded_under_plain_names() {
        let bundle = BTreeMap::from([("a/b".to_owned(), vec![1, 2])]);
        let recorded = RecordedFiles::new(&bundle);
        assert_eq!(recorded.read("a/./b").unwrap(), [1, 2]);
        assert!(recorded.read("c").is_err());
        assert_eq!(recorded.into_files(), bundle);
    }
}
