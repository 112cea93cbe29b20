//! Blobs as files: `<first two digits>/<other digits>` of the name, written aside, synced, then renamed.

use super::room::room_at;
use super::{BlobReader, BlobStore, Room, StagedBlob, StoreError, check_folder, not_writable};
use crate::background::in_background;
use crate::scheduler::record::BlobName;
use async_trait::async_trait;
use bytes::Bytes;
use photonfarm_proto::id::BlobHash;
use std::io::{ErrorKind, Read, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use tokio::fs::{self, File};
use tokio::io::AsyncSeekExt;

const STAGING: &str = "staging";

/// Age after which a half-written file is nobody's, where several coordinators share the folder.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// A folder of blobs.
#[derive(Clone, Debug)]
pub struct FolderStore {
    root: PathBuf,
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> StoreError {
    let path = path.to_owned();
    |source| StoreError::Io { path, source }
}

impl FolderStore {
    /// Opens or makes the folder, and removes what was left half written. If others may be writing, `shared`, that is
    /// only what is a day old.
    pub fn open(root: &Path, shared: bool) -> Result<Self, StoreError> {
        let staging = root.join(STAGING);
        std::fs::create_dir_all(&staging).map_err(|error| not_writable(&staging, &error))?;
        check_folder(root)?;
        check_folder(&staging)?;
        let now = shared.then(|| clock(&staging)).transpose()?;
        for file in std::fs::read_dir(&staging).map_err(io(&staging))? {
            let file = file.map_err(io(&staging))?;
            let modified = file.metadata().and_then(|metadata| metadata.modified());
            let old = |now| modified.is_ok_and(|modified| age(now, modified) > ABANDONED);
            if now.is_none_or(old) {
                let path = file.path();
                std::fs::remove_file(&path)
                    .or_else(|error| match error.kind() {
                        ErrorKind::NotFound => Ok(()),
                        _ => Err(error),
                    })
                    .map_err(io(&path))?;
            }
        }
        sync_folder(root)?;
        Ok(Self { root: root.to_owned() })
    }

    fn path(&self, name: BlobName) -> PathBuf {
        let digits = name.to_string();
        self.root.join(&digits[..2]).join(&digits[2..])
    }
}

/// The time by the clock that the files of a folder get theirs from, which may be that of another machine.
fn clock(folder: &Path) -> Result<SystemTime, StoreError> {
    let probe = tempfile::tempfile_in(folder).and_then(|probe| probe.metadata()?.modified());
    probe.map_err(io(folder))
}

/// How old a file is; one from the future is new.
fn age(now: SystemTime, modified: SystemTime) -> Duration {
    now.duration_since(modified).unwrap_or_default()
}

/// Makes renames within a folder durable.
#[cfg(unix)]
fn sync_folder(path: &Path) -> Result<(), StoreError> {
    std::fs::File::open(path)
        .and_then(|folder| folder.sync_all())
        .map_err(io(path))
}

/// Folders cannot be opened here, and nothing else makes a rename durable: what was renamed last may be lost where the
/// machine fails. A picture is rendered again then; a farm is not served on such a system.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> Result<(), StoreError> {
    Ok(())
}

/// Does what the file system may keep waiting.
async fn apart<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    in_background(work).await.map_err(|_| StoreError::Stopped)?
}

#[async_trait]
impl BlobStore for FolderStore {
    async fn stage(&self, name: BlobName) -> Result<Box<dyn StagedBlob>, StoreError> {
        let staging = self.root.join(STAGING);
        let (file, path) = apart(move || {
            let file = tempfile::NamedTempFile::new_in(&staging).map_err(io(&staging))?;
            file.keep().map_err(|error| io(&staging)(error.error))
        })
        .await?;
        let hasher = Some(blake3::Hasher::new());
        Ok(Box::new(StagedFile {
            store: self.clone(),
            guard: StagedPath(path),
            name,
            content: Some(Content { file, hasher }),
        }))
    }

    async fn read(&self, name: BlobName, most: u64) -> Result<Vec<u8>, StoreError> {
        let (path, hash) = (self.path(name), name.hash);
        apart(move || {
            let file = std::fs::File::open(&path).map_err(|error| missing_or(hash, &path, error))?;
            let length = file.metadata().map_err(io(&path))?.len();
            if length > most {
                let detail = format!("{} has {length} bytes, more than {most}", path.display());
                return Err(StoreError::Damaged(detail));
            }
            let mut bytes = Vec::with_capacity(length as usize);
            file.take(most).read_to_end(&mut bytes).map_err(io(&path))?;
            let found = BlobHash::of(&bytes);
            if found != hash {
                return Err(StoreError::Damaged(format!("{} has hash {found}", path.display())));
            }
            Ok(bytes)
        })
        .await
    }

    async fn open_at(&self, name: BlobName, start: u64) -> Result<(u64, BlobReader), StoreError> {
        let path = self.path(name);
        let mut file = File::open(&path)
            .await
            .map_err(|error| missing_or(name.hash, &path, error))?;
        let bytes = file.metadata().await.map_err(io(&path))?.len();
        file.seek(SeekFrom::Start(start)).await.map_err(io(&path))?;
        Ok((bytes, Box::new(file)))
    }

    async fn room(&self) -> Result<Option<Room>, StoreError> {
        room_at(self.root.clone()).await
    }

    async fn size(&self, name: BlobName) -> Result<Option<u64>, StoreError> {
        let path = self.path(name);
        match fs::metadata(&path).await {
            Ok(metadata) => Ok(Some(metadata.len())),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(io(&path)(error)),
        }
    }

    async fn remove(&self, name: BlobName) -> Result<(), StoreError> {
        let path = self.path(name);
        match fs::remove_file(&path).await {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(io(&path)(error)),
            _ => Ok(()),
        }
    }

    async fn list(&self) -> Result<Vec<(BlobName, Duration)>, StoreError> {
        let root = self.root.clone();
        apart(move || {
            let now = clock(&root.join(STAGING))?;
            let mut names = Vec::new();
            for folder in std::fs::read_dir(&root).map_err(io(&root))? {
                let folder = folder.map_err(io(&root))?;
                let start = folder.file_name();
                if start == STAGING || !folder.path().is_dir() {
                    continue;
                }
                for file in std::fs::read_dir(folder.path()).map_err(io(&folder.path()))? {
                    let file = file.map_err(io(&folder.path()))?;
                    let digits = format!("{}{}", start.to_string_lossy(), file.file_name().to_string_lossy());
                    if let (Ok(name), Ok(modified)) = (digits.parse(), file.metadata().and_then(|file| file.modified()))
                    {
                        names.push((name, age(now, modified)));
                    }
                }
            }
            Ok(names)
        })
        .await
    }
}

fn missing_or(hash: BlobHash, path: &Path, error: std::io::Error) -> StoreError {
    match error.kind() {
        ErrorKind::NotFound => StoreError::NoBlob(hash),
        _ => io(path)(error),
    }
}

/// Removes the file unless it was renamed.
struct StagedPath(PathBuf);

impl Drop for StagedPath {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

struct StagedFile {
    store: FolderStore,
    guard: StagedPath,
    name: BlobName,
    /// None once it could not be written.
    content: Option<Content>,
}

/// A file as it is written.
struct Content {
    file: std::fs::File,
    /// None where the caller is trusted.
    hasher: Option<blake3::Hasher>,
}

impl Content {
    fn append(&mut self, pieces: &[Bytes]) -> std::io::Result<()> {
        for piece in pieces {
            if let Some(hasher) = &mut self.hasher {
                hasher.update(piece);
            }
            self.file.write_all(piece)?;
        }
        Ok(())
    }
}

#[async_trait]
impl StagedBlob for StagedFile {
    async fn write_pieces(&mut self, pieces: Vec<Bytes>) -> Result<(), StoreError> {
        let mut content = self.content.take().ok_or(StoreError::Stopped)?;
        let path = self.guard.0.clone();
        let append = move || {
            content.append(&pieces).map_err(io(&path))?;
            Ok(content)
        };
        self.content = Some(apart(append).await?);
        Ok(())
    }

    fn trust(&mut self) {
        if let Some(content) = &mut self.content {
            content.hasher = None;
        }
    }

    fn hash(&self) -> BlobHash {
        let hasher = self.content.as_ref().and_then(|content| content.hasher.as_ref());
        hasher.map_or(self.name.hash, |hasher| hasher.finalize().into())
    }

    async fn publish(self: Box<Self>) -> Result<(), StoreError> {
        let found = self.hash();
        let Self {
            store,
            guard,
            name,
            content,
        } = *self;
        if found != name.hash {
            let expected = name.hash;
            return Err(StoreError::WrongHash { expected, found });
        }
        let Content { file, .. } = content.ok_or(StoreError::Stopped)?;
        let path = store.path(name);
        apart(move || {
            file.sync_all().map_err(io(&guard.0))?;
            let folder = path.parent().unwrap_or(&store.root);
            if !folder.is_dir() {
                std::fs::create_dir_all(folder).map_err(io(folder))?;
                sync_folder(&store.root)?;
            }
            std::fs::rename(&guard.0, &path).map_err(io(&path))?;
            sync_folder(folder)
        })
        .await
    }
}
