//! Room on disks.

use super::StoreError;
use crate::background::in_background;
use std::path::PathBuf;

/// The room on the disk that a store lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Bytes that may still be written.
    pub free: u64,
    /// Bytes in all.
    pub total: u64,
}

/// The room on the disk that a folder or a file lies on.
#[cfg(unix)]
pub(super) async fn room_at(path: PathBuf) -> Result<Option<Room>, StoreError> {
    let looked = in_background(move || {
        let disk = rustix::fs::statvfs(&path).map_err(|error| StoreError::Io {
            path,
            source: error.into(),
        })?;
        let bytes = |blocks: u64| blocks.saturating_mul(disk.f_frsize);
        Ok(Some(Room {
            free: bytes(disk.f_bavail),
            total: bytes(disk.f_blocks),
        }))
    });
    looked.await.map_err(|_| StoreError::Stopped)?
}

/// It cannot be told on this system.
#[cfg(not(unix))]
pub(super) async fn room_at(_: PathBuf) -> Result<Option<Room>, StoreError> {
    Ok(None)
}
