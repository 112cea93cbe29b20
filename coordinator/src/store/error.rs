//! Why stores fail.

use photonfarm_proto::id::BlobHash;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a store failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another coordinator has the store open.
    #[error("{}: in use by another coordinator", .0.display())]
    InUse(PathBuf),
    /// Made by a newer version, or by another program.
    #[error("{place}: {reason}")]
    Foreign {
        /// The file or the database.
        place: String,
        /// What it is.
        reason: String,
    },
    /// Contents that cannot be.
    #[error("the store is damaged: {0}")]
    Damaged(String),
    /// The bytes do not have the hash announced; nothing was kept.
    #[error("the bytes have hash {found}, not {expected}")]
    WrongHash {
        /// Hash announced.
        expected: BlobHash,
        /// Hash found.
        found: BlobHash,
    },
    /// A change of a job that somebody else changed meanwhile; nothing was kept.
    #[error("the job was changed by somebody else meanwhile: try again")]
    TooLate,
    /// No such blob.
    #[error("there is no blob {0}")]
    NoBlob(BlobHash),
    /// The database file failed.
    #[error("the database failed: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// A file or folder of this user's that is somebody else's, or on a disk that is read only.
    #[error("{} cannot be written: {reason}; run the coordinator as the user who owns its data, on a disk that takes it", path.display())]
    NotWritable {
        /// The file or the folder.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What failed.
        source: std::io::Error,
    },
    /// The database server failed, or the connection to it.
    #[error("the database failed: {}", describe(.0))]
    Postgres(#[from] tokio_postgres::Error),
    /// No connection to the database server.
    #[error("no connection to the database: {0}")]
    Connection(String),
    /// The object store failed.
    #[error("the object store failed: {0}")]
    Object(#[from] object_store::Error),
    /// The system has no memory for an image.
    #[error("no memory for an image: {0}")]
    Memory(std::io::Error),
    /// The system gives no random numbers.
    #[error("no random numbers: {0}")]
    Random(#[from] getrandom::Error),
    /// The store's task did not end.
    #[error("the store was stopped")]
    Stopped,
}

impl StoreError {
    /// Whether there is no room left.
    #[must_use]
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io { source, .. } => matches!(source.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded),
            Self::Sqlite(error) => error.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull),
            _ => false,
        }
    }

    /// Whether the same call may succeed later, as after a full disk.
    #[must_use]
    pub fn retryable(&self) -> bool {
        matches!(
            self,
            Self::Sqlite(_)
                | Self::Postgres(_)
                | Self::Connection(_)
                | Self::Object(_)
                | Self::Io { .. }
                | Self::Memory(_)
                | Self::Random(_)
                | Self::TooLate
                | Self::Stopped
        )
    }
}

/// Refuses a folder in which no file can be made. One on a full disk passes: it may have room again soon.
pub(super) fn check_folder(path: &Path) -> Result<(), StoreError> {
    match tempfile::NamedTempFile::new_in(path) {
        Err(error) if error.kind() != ErrorKind::StorageFull => Err(not_writable(path, &error)),
        _ => Ok(()),
    }
}

/// Refuses a file that is there and cannot be written.
pub(super) fn check_file(path: &Path) -> Result<(), StoreError> {
    match std::fs::File::options().read(true).write(true).open(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(not_writable(path, &error)),
        _ => Ok(()),
    }
}

pub(super) fn not_writable(path: &Path, error: &std::io::Error) -> StoreError {
    StoreError::NotWritable {
        path: path.to_owned(),
        reason: error.kind().to_string(),
    }
}

/// What the server said, which the error itself does not show.
fn describe(error: &tokio_postgres::Error) -> String {
    match std::error::Error::source(error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}
