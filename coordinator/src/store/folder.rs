//! Blobs as files: `<first two digits>/<other digits>` of the hash, written aside, synced, then renamed.

use super::{BlobReader, BlobStore, StagedBlob, StoreError, check_folder, not_writable};
use crate::scheduler::record::Millis;
use async_trait::async_trait;
use photonfarm_proto::id::BlobHash;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::fs::{self, File};
use tokio::io::AsyncWriteExt;

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
        for file in std::fs::read_dir(&staging).map_err(io(&staging))? {
            let file = file.map_err(io(&staging))?;
            let age = file.metadata().and_then(|metadata| metadata.modified());
            let age = age.ok().and_then(|time| SystemTime::now().duration_since(time).ok());
            if !shared || age.is_some_and(|age| age > ABANDONED) {
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

    fn path(&self, hash: BlobHash) -> PathBuf {
        let digits = hash.to_string();
        self.root.join(&digits[..2]).join(&digits[2..])
    }
}

fn modified_ms(metadata: &std::fs::Metadata) -> Millis {
    let since_1970 = metadata
        .modified()
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    since_1970.unwrap_or_default().as_millis() as Millis
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
    async fn stage(&self, hash: BlobHash) -> Result<Box<dyn StagedBlob>, StoreError> {
        let staging = self.root.join(STAGING);
        let (file, path) = in_background(move || {
            let file = tempfile::NamedTempFile::new_in(&staging).map_err(io(&staging))?;
            file.keep().map_err(|error| io(&staging)(error.error))
        })
        .await?;
        let (file, guard) = (File::from_std(file), StagedPath(path));
        Ok(Box::new(StagedFile {
            store: self.clone(),
            file,
            guard,
            expected: hash,
            hasher: blake3::Hasher::new(),
        }))
    }

    async fn read(&self, hash: BlobHash, most: u64) -> Result<Vec<u8>, StoreError> {
        let path = self.path(hash);
        in_background(move || {
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

    async fn open(&self, hash: BlobHash) -> Result<(u64, BlobReader), StoreError> {
        let path = self.path(hash);
        let file = File::open(&path)
            .await
            .map_err(|error| missing_or(hash, &path, error))?;
        let bytes = file.metadata().await.map_err(io(&path))?.len();
        Ok((bytes, Box::new(file)))
    }

    async fn size(&self, hash: BlobHash) -> Result<Option<u64>, StoreError> {
        let path = self.path(hash);
        match fs::metadata(&path).await {
            Ok(metadata) => Ok(Some(metadata.len())),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(io(&path)(error)),
        }
    }

    async fn remove(&self, hash: BlobHash) -> Result<(), StoreError> {
        let path = self.path(hash);
        match fs::remove_file(&path).await {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(io(&path)(error)),
            _ => Ok(()),
        }
    }

    async fn list(&self) -> Result<Vec<(BlobHash, Millis)>, StoreError> {
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
                    let file = file.map_err(io(&folder.path()))?;
                    let digits = format!("{}{}", start.to_string_lossy(), file.file_name().to_string_lossy());
                    if let (Ok(hash), Ok(metadata)) = (digits.parse::<BlobHash>(), file.metadata()) {
                        hashes.push((hash, modified_ms(&metadata)));
                    }
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
    expected: BlobHash,
    hasher: blake3::Hasher,
}

#[async_trait]
impl StagedBlob for StagedFile {
    async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.hasher.update(bytes);
        self.file.write_all(bytes).await.map_err(io(&self.guard.0))
    }

    fn hash(&self) -> BlobHash {
        self.hasher.finalize().into()
    }

    async fn publish(self: Box<Self>) -> Result<(), StoreError> {
        let found = self.hash();
        let Self {
            store,
            mut file,
            guard,
            expected,
            ..
        } = *self;
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
