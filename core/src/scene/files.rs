//! Where a scene's files come from.

use super::error::{Place, SceneError, within};
use super::limits::Limits;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::Mutex;

/// The files of a scene: a folder, or a bundle.
///
/// Names are those of [`normalise`]. Only a [`SceneFolder`] takes them for paths; in a bundle they are keys.
pub trait SceneFiles {
    /// The bytes of a file.
    ///
    /// # Errors
    /// [`SceneError::NotFound`] where there is no such file (the loader then looks in the next folder),
    /// [`SceneError::FileName`] for a name that is none, [`SceneError::Limit`] for a file that is too large.
    fn read(&self, name: &str) -> Result<Bytes, SceneError>;
}

/// The plain form of a file name: '/'-separated, without `.` and empty parts, and with `..` at its start only. It is relative to the
/// folder of the scene file, or absolute. Backslashes of other systems become slashes.
///
/// # Errors
/// [`SceneError::FileName`] where the name is empty, a URL, on a drive of another system, or holds characters that no system allows
/// in names.
pub fn normalise(name: &str) -> Result<String, SceneError> {
    let plain = normalise_folder(name)?;
    let reason = match plain.rsplit('/').next() {
        Some("" | "..") if name.is_empty() => "it is empty",
        Some("" | "..") => "it names no file",
        _ => return Ok(plain),
    };
    Err(file_name(name, reason))
}

/// As [`normalise`], for the name of a folder: the scene file's own is empty.
pub(super) fn normalise_folder(name: &str) -> Result<String, SceneError> {
    if name.contains(':') || name.chars().any(char::is_control) {
        let reason =
            "`:` and control characters are not allowed: files are named by paths, and there are no drives and URLs";
        return Err(file_name(name, reason));
    }
    let name = name.replace('\\', "/");
    let root = if name.starts_with('/') { "/" } else { "" };
    let mut parts: Vec<&str> = Vec::new();
    for part in name.split('/') {
        match (part, parts.last()) {
            ("" | ".", _) => {}
            ("..", Some(last)) if *last != ".." => _ = parts.pop(),
            ("..", None) if !root.is_empty() => {}
            _ => parts.push(part),
        }
    }
    Ok(format!("{root}{}", parts.join("/")))
}

fn file_name(name: &str, reason: &str) -> SceneError {
    SceneError::FileName {
        place: Place::whole(name),
        name: name.into(),
        reason: reason.into(),
    }
}

/// The files about a folder, for scenes of whoever runs the program: names may lead anywhere on this machine, also through symbolic links,
/// and may be written in another case, as systems allow on which files are found by `A.obj` and `a.obj` alike.
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
        let written = self.root.join(name);
        let path = match written.metadata() {
            Err(error) if error.kind() == ErrorKind::NotFound => in_any_case(&written).unwrap_or(written),
            _ => written,
        };
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

/// The most entries of a folder that are looked through for a name in another case.
const MOST_ENTRIES: usize = 100_000;

/// The path to what `path` names if upper and lower case are one; of several the first in the order of names.
fn in_any_case(path: &Path) -> Option<PathBuf> {
    let mut found = PathBuf::new();
    for part in path.components() {
        let exact = found.join(part);
        if !matches!(part, Component::Normal(_)) || exact.exists() {
            found = exact;
            continue;
        }
        let wanted = part.as_os_str().to_str()?.to_lowercase();
        let entries = found.read_dir().ok()?.take(MOST_ENTRIES);
        let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        found.push(names.filter(|name| name.to_lowercase() == wanted).min()?);
    }
    Some(found)
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
    fn read(&self, name: &str) -> Result<Bytes, SceneError> {
        let place = Place::whole(name);
        let file = self.open(&normalise(name)?)?;
        let unreadable = |error| unreadable(name, &error);
        let limit = self.limits.file_bytes;
        let what = format!("bytes of file `{name}`");
        let length = within(&place, &what, file.metadata().map_err(unreadable)?.len(), limit)?;
        let mut bytes = Vec::with_capacity(length as usize);
        let read = file
            .take(limit.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(unreadable)?;
        within(&place, &what, read as u64, limit)?;
        Ok(bytes.into())
    }
}

/// Passes reads on to other files and keeps what was read: the content of the scene's bundle.
pub struct RecordedFiles<'a> {
    inner: &'a dyn SceneFiles,
    read: Mutex<BTreeMap<String, Bytes>>,
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
    pub fn into_files(self) -> BTreeMap<String, Bytes> {
        self.read.into_inner().expect("no read panicked")
    }
}

impl SceneFiles for RecordedFiles<'_> {
    fn read(&self, name: &str) -> Result<Bytes, SceneError> {
        let name = normalise(name)?;
        let bytes = self.inner.read(&name)?;
        self.read.lock().expect("no read panicked").insert(name, bytes.clone());
        Ok(bytes)
    }
}

/// A bundle in memory.
impl<B: Clone + Into<Bytes>> SceneFiles for BTreeMap<String, B> {
    fn read(&self, name: &str) -> Result<Bytes, SceneError> {
        let name = normalise(name)?;
        match self.get(&name) {
            Some(bytes) => Ok(bytes.clone().into()),
            None => Err(SceneError::NotFound {
                place: Place::whole(&name),
                tried: format!("`{name}`"),
                name,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_made_plain() {
        for (name, plain) in [
            ("a/./b//../c.obj", "a/c.obj"),
            ("../a", "../a"),
            ("a/../../../b", "../../b"),
            ("..\\meshes\\A.obj", "../meshes/A.obj"),
            ("/usr/../share/./x", "/share/x"),
            ("/../x", "/x"),
        ] {
            assert_eq!(normalise(name).unwrap(), plain, "{name}");
        }
        for name in ["", "..", "a/..", "C:\\x", "http://x/y", "a\0b", "./", "/", "a\nb"] {
            assert!(matches!(normalise(name), Err(SceneError::FileName { .. })), "{name:?}");
        }
        assert_eq!(normalise_folder("sub/..").unwrap(), "");
        assert_eq!(normalise_folder("sub/../..").unwrap(), "..");
    }

    #[test]
    fn files_are_found_wherever_they_lie() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("scene");
        std::fs::create_dir_all(inside.join("Meshes")).unwrap();
        std::fs::write(folder.path().join("common"), b"x").unwrap();
        std::fs::write(inside.join("Meshes/Ball.obj"), b"ball").unwrap();
        std::fs::write(inside.join("Meshes/BALL.obj"), b"other").unwrap();
        std::fs::write(inside.join("large"), [0; 101]).unwrap();
        std::os::unix::fs::symlink("../common", inside.join("link")).unwrap();
        let limits = Limits {
            file_bytes: 100,
            ..Limits::default()
        };
        let files = SceneFolder::with_limits(&inside, &limits).unwrap();
        let absolute = folder.path().join("common").to_str().unwrap().to_owned();
        for name in ["link", "../common", "../COMMON", &absolute] {
            assert_eq!(files.read(name).unwrap()[..], *b"x", "{name}");
        }
        for (name, content) in [
            ("Meshes\\Ball.obj", &b"ball"[..]),
            ("Meshes/BALL.obj", b"other"),
            ("meshes/ball.OBJ", b"other"),
        ] {
            assert_eq!(files.read(name).unwrap(), content, "{name}");
        }
        assert!(matches!(files.read("meshes"), Err(SceneError::Read { .. })));
        assert!(matches!(files.read("/dev/zero"), Err(SceneError::Read { .. })));
        assert!(matches!(files.read("nothing"), Err(SceneError::NotFound { .. })));
        assert!(matches!(files.read("large/x"), Err(SceneError::NotFound { .. })));
        assert!(matches!(
            files.read("large"),
            Err(SceneError::Limit {
                value: 101,
                limit: 100,
                ..
            })
        ));
    }

    /// A bundle is a table: a name that leads out of a folder is a key like any other, and opens nothing.
    #[test]
    fn a_bundle_has_its_files_alone() {
        let bundle = BTreeMap::from([("../a".to_owned(), vec![1])]);
        assert_eq!(SceneFiles::read(&bundle, "b/../../a").unwrap()[..], [1]);
        for name in ["/etc/passwd", "../../etc/passwd", "/a"] {
            assert!(matches!(
                SceneFiles::read(&bundle, name),
                Err(SceneError::NotFound { .. })
            ));
        }
    }

    #[test]
    fn reads_are_recorded_under_plain_names() {
        let bundle = BTreeMap::from([("a/b".to_owned(), Bytes::from_static(&[1, 2]))]);
        let recorded = RecordedFiles::new(&bundle);
        assert_eq!(recorded.read("a/./b").unwrap()[..], [1, 2]);
        assert!(recorded.read("c").is_err());
        assert_eq!(recorded.into_files(), bundle);
    }
}
