//! Files of scenes on this machine, by hash: written aside and renamed, verified when read, bounded in size.

use crate::client::{Client, ClientError, retry};
use crate::transfer::{self, SILENCE};
use futures_util::StreamExt;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::BlobHash;
use reqwest::StatusCode;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;
use tempfile::NamedTempFile;
use thiserror::Error;
use tokio_util::sync::CancellationToken;

/// How the names of files begin that are being written.
const PART: &str = ".part-";

/// Why a bundle is not at hand.
#[derive(Debug, Error)]
pub(crate) enum CacheError {
    /// It cannot be fetched.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// It cannot be kept.
    #[error("the cache failed: {0}")]
    Io(#[from] io::Error),
    /// The coordinator sent other bytes.
    #[error("the file {expected} arrived with hash {found}")]
    WrongBytes {
        /// Hash asked for.
        expected: BlobHash,
        /// Hash received.
        found: BlobHash,
    },
}

impl CacheError {
    /// Whether the file may be damaged or missing where it comes from.
    fn is_suspicious(&self) -> bool {
        match self {
            Self::WrongBytes { .. } => true,
            Self::Client(ClientError::Store(status)) => *status == StatusCode::NOT_FOUND,
            Self::Client(_) | Self::Io(_) => false,
        }
    }
}

/// A folder of files by hash. Several workers may share it.
#[derive(Clone, Debug)]
pub struct Cache {
    root: PathBuf,
    limit: u64,
}

impl Cache {
    /// Opens or makes a folder that holds at most about `limit` bytes besides the scene in use. What workers were
    /// writing when they were killed is removed.
    ///
    /// # Errors
    /// A folder in which no file can be made. One on a full disk passes: what is in it may be all that is needed.
    pub fn open(root: &Path, limit: u64) -> io::Result<Self> {
        std::fs::create_dir_all(root)?;
        remove_abandoned(root)?;
        let cache = Self {
            root: root.to_owned(),
            limit,
        };
        match cache.part() {
            Err(error) if error.kind() != io::ErrorKind::StorageFull => Err(error),
            _ => Ok(cache),
        }
    }

    /// The folder.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    fn path(&self, hash: BlobHash) -> PathBuf {
        self.root.join(hash.to_string())
    }

    /// A file to be renamed once it is whole; whoever writes to it holds its lock.
    pub(crate) fn part(&self) -> io::Result<NamedTempFile> {
        let file = tempfile::Builder::new().prefix(PART).tempfile_in(&self.root)?;
        if let Err(error) = file.as_file().lock() {
            tracing::debug!(%error, "a file of the cache cannot be locked");
        }
        Ok(file)
    }

    /// Keeps bytes; returns their hash.
    pub fn insert(&self, bytes: &[u8]) -> io::Result<BlobHash> {
        let hash = BlobHash::of(bytes);
        let mut file = self.part()?;
        file.write_all(bytes)?;
        file.persist(self.path(hash)).map_err(|error| error.error)?;
        Ok(hash)
    }

    /// Fetches what is missing of a bundle, then makes room. Waits where the coordinator asks for patience, until `stop`.
    pub(crate) async fn fetch(
        &self,
        client: &Client,
        manifest: BundleManifest,
        stop: &CancellationToken,
    ) -> Result<BundleFiles, CacheError> {
        let mut wanted = BTreeSet::new();
        for (hash, bytes) in manifest.blobs() {
            wanted.insert(hash);
            match File::open(self.path(hash)) {
                Ok(file) => _ = file.set_modified(SystemTime::now()),
                Err(_) => self.fetch_blob(client, (hash, bytes), stop).await?,
            }
        }
        self.make_room(&wanted)?;
        Ok(BundleFiles {
            cache: self.clone(),
            manifest: Arc::new(manifest),
            damaged: Arc::default(),
        })
    }

    /// Fetches a file; where it is missing or has another hash, once more after the coordinator has looked at its own.
    async fn fetch_blob(
        &self,
        client: &Client,
        file: (BlobHash, u64),
        stop: &CancellationToken,
    ) -> Result<(), CacheError> {
        match self.fetch_once(client, file, false, stop).await {
            Err(error) if error.is_suspicious() => {
                tracing::warn!(hash = %file.0, "{error}; the coordinator is asked to check it");
                self.fetch_once(client, file, true, stop).await
            }
            other => other,
        }
    }

    async fn fetch_once(
        &self,
        client: &Client,
        (hash, bytes): (BlobHash, u64),
        suspect: bool,
        stop: &CancellationToken,
    ) -> Result<(), CacheError> {
        tracing::debug!(%hash, bytes, "fetching a file");
        // What the coordinator refuses for now it gives later; where something else fails, the lease may go to others.
        let ask = || async {
            match client.blob(hash, suspect).await {
                Err(error) if error.code().is_some() => Err(error),
                answer => Ok(answer),
            }
        };
        let answer = retry(stop, "the request for a file", ask).await??;
        let mut stream = std::pin::pin!(transfer::pieces(answer, SILENCE));
        let mut file = self.part()?;
        let mut hasher = blake3::Hasher::new();
        let mut received = 0;
        while let Some(piece) = stream.next().await {
            let piece = piece.map_err(ClientError::from)?;
            received += piece.len() as u64;
            if received > bytes {
                break;
            }
            hasher.update(&piece);
            file.write_all(&piece)?;
        }
        let found = BlobHash::from(hasher.finalize());
        if found != hash || received != bytes {
            return Err(CacheError::WrongBytes { expected: hash, found });
        }
        file.persist(self.path(hash)).map_err(|error| error.error)?;
        Ok(())
    }

    /// Removes the files that were not used for longest.
    fn make_room(&self, keep: &BTreeSet<BlobHash>) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&self.root)? {
            let entry = entry?;
            let hash = entry.file_name().to_string_lossy().parse::<BlobHash>();
            if let (Ok(hash), Ok(metadata)) = (hash, entry.metadata()) {
                files.push((metadata.modified()?, hash, metadata.len()));
            }
        }
        files.sort_unstable();
        let mut total: u64 = files.iter().map(|(_, _, bytes)| bytes).sum();
        for (_, hash, bytes) in files {
            if total <= self.limit {
                break;
            }
            if !keep.contains(&hash) {
                std::fs::remove_file(self.path(hash)).or_else(ignore_missing)?;
                total -= bytes;
            }
        }
        Ok(())
    }
}

/// Removes the parts that nobody writes to any more.
fn remove_abandoned(root: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(root)? {
        let entry = entry?;
        let is_part = entry.file_name().to_string_lossy().starts_with(PART);
        if is_part && File::open(entry.path()).is_ok_and(|file| file.try_lock().is_ok()) {
            std::fs::remove_file(entry.path()).or_else(ignore_missing)?;
        }
    }
    Ok(())
}

fn ignore_missing(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::NotFound {
        Ok(())
    } else {
        Err(error)
    }
}

/// Why a file of a scene cannot be read.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FileError {
    /// The bundle has no such file.
    #[error("the bundle has no such file")]
    Missing,
    /// The file was damaged or removed in the cache.
    #[error("the file is damaged in the worker's cache")]
    Damaged,
}

/// The files of one scene, all at hand.
#[derive(Clone, Debug)]
pub struct BundleFiles {
    cache: Cache,
    manifest: Arc<BundleManifest>,
    damaged: Arc<AtomicBool>,
}

impl BundleFiles {
    /// Files that were inserted into the cache.
    #[must_use]
    pub fn new(cache: Cache, manifest: BundleManifest) -> Self {
        Self {
            cache,
            manifest: Arc::new(manifest),
            damaged: Arc::default(),
        }
    }

    /// The bytes of a file, verified.
    pub fn bytes(&self, name: &str) -> Result<Vec<u8>, FileError> {
        let entry = self.manifest.files.get(name).ok_or(FileError::Missing)?;
        let path = self.cache.path(entry.hash);
        let bytes = std::fs::read(&path).unwrap_or_default();
        if BlobHash::of(&bytes) == entry.hash {
            return Ok(bytes);
        }
        self.damaged.store(true, Ordering::Relaxed);
        let _ = std::fs::remove_file(&path);
        Err(FileError::Damaged)
    }

    /// Whether a file was found damaged or missing: it was removed, and the bundle is to be fetched again.
    pub(crate) fn is_damaged(&self) -> bool {
        self.damaged.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::bundle::FileEntry;

    fn bundle(cache: &Cache, content: &[u8]) -> BundleFiles {
        cache.insert(content).unwrap();
        let files = [("a".to_owned(), FileEntry::of(content))].into();
        BundleFiles::new(cache.clone(), BundleManifest { files })
    }

    #[test]
    fn damage_is_noticed_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 100).unwrap();
        let files = bundle(&cache, b"scene");
        assert_eq!(files.bytes("a").unwrap(), b"scene");
        assert_eq!(files.bytes("b"), Err(FileError::Missing));
        assert!(!files.is_damaged());
        let path = cache.path(BlobHash::of(b"scene"));
        std::fs::write(&path, b"scenf").unwrap();
        assert_eq!(files.bytes("a"), Err(FileError::Damaged));
        assert!(files.is_damaged() && !path.exists());
    }

    #[test]
    fn what_killed_workers_were_writing_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 100).unwrap();
        let hash = cache.insert(b"scene").unwrap();
        let live = cache.part().unwrap();
        let dead = folder.path().join(format!("{PART}dead"));
        std::fs::write(&dead, b"sce").unwrap();
        Cache::open(folder.path(), 100).unwrap();
        assert!(!dead.exists() && live.path().exists() && cache.path(hash).exists());
    }

    #[test]
    fn the_cache_keeps_its_bound_and_what_is_in_use() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path(), 25).unwrap();
        let hashes: Vec<BlobHash> = (0..4u8).map(|i| cache.insert(&[i; 10]).unwrap()).collect();
        for (age, hash) in hashes.iter().enumerate() {
            let file = File::options().write(true).open(cache.path(*hash)).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(age as u64))
                .unwrap();
        }
        cache.make_room(&BTreeSet::from([hashes[0]])).unwrap();
        let left: Vec<bool> = hashes.iter().map(|hash| cache.path(*hash).exists()).collect();
        assert_eq!(left, [true, false, false, true]);
    }
}
