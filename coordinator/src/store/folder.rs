//! Blobs as files: `<first two digits>/<other digits>` of the hash, written aside, synced, then renamed.

use super::{BlobReader, BlobStore, StagedBlob, StoreError};
use async_trait::async_trait;
use photonfarm_proto::id::BlobHash;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::fs::{self, File};
use tokio::io::AsyncWriteExt;

const STAGING: &str = "staging";

/// A folder of blobs. It has one user at a time; whoever opens the state store next to it sees to that.
#[derive(Clone, Debug)]
pub struct FolderStore {
    root: PathBuf,
    next_stage: Arc<AtomicU64>,
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> StoreError {
    let path = path.to_owned();
    |source| StoreError::Io { path, source }
}

impl FolderStore {
    /// Opens or makes the folder, and removes what was left half written.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        let staging = root.join(STAGING);
        match std::fs::remove_dir_all(&staging) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(io(&staging)(error)),
            _ => {}
        }
        std::fs::create_dir_all(&staging).map_err(io(&staging))?;
        sync_folder(root)?;
        Ok(Self {
            root: root.to_owned(),
            next_stage: Arc::default(),
        })
    }

    fn path(&self, hash: BlobHash) -> PathBuf {
        let digits = hash.to_string();
        self.root.join(&digits[..2]).join(&digits[2..])
    }
}

/// Makes renames within a folder durable.
fn sync_folder(path: &Path) -> Result<(), StoreError> {
    std::fs::File::open(path)
        .and_then(|folder| folder.sync_all())
        .map_err(io(path))
}

async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|_| StoreError::Stopped)?
}

#[async_trait]
impl BlobStore for FolderStore {
    async fn stage(&self) -> Result<Box<dyn StagedBlob>, StoreError> {
        let number = self.next_stage.fetch_add(1, Ordering::Relaxed);
        let path = self.root.join(STAGING).join(number.to_string());
        let file = File::create_new(&path).await.map_err(io(&path))?;
        let guard = StagedPath(path);
        Ok(Box::new(StagedFile {
            store: self.clone(),
            file,
            guard,
            hasher: blake3::Hasher::new(),
        }))
    }

    async fn read(&self, hash: BlobHash) -> Result<Vec<u8>, StoreError> {
        let path = self.path(hash);
        in_background(move || {
            let bytes = std::fs::read(&path).map_err(|error| missing_or(hash, &path, error))?;
            let found = BlobHash::of(&bytes);
            if found != hash {
                return Err(StoreError::Damaged(format!("{} has hash {found}", path.display())));
            }
            Ok(bytes)
        })
        .await
    }

    async fn open(&self, hash: BlobHash) -> Result<(u64, BlobReader), StoreError> {
        let path = self.path(hash);
        let file = File::open(&path)
            .await
            .map_err(|error| missing_or(hash, &path, error))?;
        let bytes = file.metadata().await.map_err(io(&path))?.len();
        Ok((bytes, Box::new(file)))
    }

    async fn contains(&self, hash: BlobHash) -> Result<bool, StoreError> {
        let path = self.path(hash);
        fs::try_exists(&path).await.map_err(io(&path))
    }

    async fn remove(&self, hash: BlobHash) -> Result<(), StoreError> {
        let path = self.path(hash);
        match fs::remove_file(&path).await {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(io(&path)(error)),
            _ => Ok(()),
        }
    }

    async fn list(&self) -> Result<Vec<BlobHash>, StoreError> {
        let root = self.root.clone();
        in_background(move || {
            let mut hashes = Vec::new();
            for folder in std::fs::read_dir(&root).map_err(io(&root))? {
                let folder = folder.map_err(io(&root))?;
                let start = folder.file_name();
                if start == STAGING || !folder.path().is_dir() {
                    continue;
                }
                for file in std::fs::read_dir(folder.path()).map_err(io(&folder.path()))? {
                    let end = file.map_err(io(&folder.path()))?.file_name();
                    let digits = format!("{}{}", start.to_string_lossy(), end.to_string_lossy());
                    hashes.extend(digits.parse::<BlobHash>());
                }
            }
            Ok(hashes)
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
    file: File,
    guard: StagedPath,
    hasher: blake3::Hasher,
}

#[async_trait]
impl StagedBlob for StagedFile {
    async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.hasher.update(bytes);
        self.file.write_all(bytes).await.map_err(io(&self.guard.0))
    }

    async fn publish(self: Box<Self>, expected: BlobHash) -> Result<(), StoreError> {
        let Self {
            store,
            mut file,
            guard,
            hasher,
        } = *self;
        let found = hasher.finalize().into();
        if found != expected {
            return Err(StoreError::WrongHash { expected, found });
        }
        file.flush().await.map_err(io(&guard.0))?;
        file.sync_all().await.map_err(io(&guard.0))?;
        let path = store.path(expected);
        in_background(move || {
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
