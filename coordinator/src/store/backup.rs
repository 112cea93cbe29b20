//! Backups of a farm that keeps its state in a SQLite file, while it runs or while it does not.
//!
//! First the database is copied as it stands at one instant; then the bytes that this copy names. They never change,
//! and those of jobs that have ended stay, so that it does not matter that they are copied later. What a job that goes on has merged or given up
//! meanwhile is gone, though: then the database is copied once more, and what the newer copy names is added, until
//! nothing is missing. So a backup is the farm as it stood at an instant while the backup was made.

use super::{BlobName, BlobPlace, BlobStore, SqliteStore, StatePlace, StoreError};
use std::collections::BTreeSet;
use std::path::Path;
use thiserror::Error;
use tokio::io::AsyncReadExt;

/// How often the database is copied, where bytes that it names are gone each time.
const ATTEMPTS: usize = 10;
/// Bytes copied at a time.
const PIECE: usize = 1 << 20;
/// The database in the folder of a backup, as in the data folder of a farm.
const DATABASE: &str = "farm.sqlite";

/// Why there is no backup.
#[derive(Debug, Error)]
pub enum BackupError {
    /// A store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A state that is saved by its own means.
    #[error(
        "{0} is saved with PostgreSQL's own means (pg_dump, or continuous archiving); the bytes are copied after that, \
         with those of their store"
    )]
    NotAFile(String),
    /// A folder that holds something already.
    #[error("{0} is not empty: give a backup a folder of its own")]
    NotEmpty(String),
}

/// What was saved.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Backup {
    /// Files of scenes.
    pub files: usize,
    /// Images of nodes.
    pub images: usize,
    /// Images that the database names and that were gone or damaged: their iterations will be rendered again.
    pub missing: Vec<BlobName>,
}

/// Saves a farm to a folder, from which it can be served as from its own.
pub async fn back_up(state: &StatePlace, blobs: &BlobPlace, to: &Path) -> Result<Backup, BackupError> {
    let StatePlace::Sqlite(database) = state else {
        return Err(BackupError::NotAFile(state.to_string()));
    };
    let io = |source| StoreError::Io {
        path: to.to_owned(),
        source,
    };
    std::fs::create_dir_all(to).map_err(io)?;
    if std::fs::read_dir(to).map_err(io)?.next().is_some() {
        return Err(BackupError::NotEmpty(to.display().to_string()));
    }
    // Whoever serves the farm may be writing there: nothing of theirs is to be removed.
    let [scenes, nodes] = blobs.open(true).await?;
    let [scenes_to, nodes_to] = BlobPlace::Folder(to.to_owned()).open(true).await?;
    let mut backup = Backup::default();
    let mut saved = BTreeSet::new();
    for _ in 0..ATTEMPTS {
        let named = SqliteStore::copy(database, &to.join(DATABASE))?;
        for file in &named.files {
            let name = BlobName::from(*file);
            // A file that was announced and never sent is not there.
            if !saved.contains(&name) && copy(&*scenes, &*scenes_to, name).await? {
                saved.insert(name);
                backup.files += 1;
            }
        }
        backup.missing.clear();
        for image in &named.images {
            match saved.contains(image) || copy(&*nodes, &*nodes_to, *image).await? {
                true => _ = saved.insert(*image),
                false => backup.missing.push(*image),
            }
        }
        backup.images = named.images.len() - backup.missing.len();
        if backup.missing.is_empty() {
            break;
        }
    }
    Ok(backup)
}

/// Copies a blob, which is held against its hash. Returns false where it is not there, or damaged.
async fn copy(from: &dyn BlobStore, to: &dyn BlobStore, name: BlobName) -> Result<bool, StoreError> {
    let (_, mut reader) = match from.open(name).await {
        Ok(opened) => opened,
        Err(StoreError::NoBlob(_)) => return Ok(false),
        Err(error) => return Err(error),
    };
    let mut staged = to.stage(name).await?;
    let mut piece = vec![0; PIECE];
    loop {
        let read = reader.read(&mut piece).await.map_err(|source| StoreError::Io {
            path: name.to_string().into(),
            source,
        })?;
        if read == 0 {
            break;
        }
        staged.write(&piece[..read]).await?;
    }
    match staged.publish().await {
        Err(StoreError::WrongHash { .. }) => Ok(false),
        published => published.map(|()| true),
    }
}
