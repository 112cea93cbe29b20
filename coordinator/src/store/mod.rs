//! Where the farm's truth is kept: state in a [`StateStore`], bytes in a [`BlobStore`].
//!
//! Bytes are published before the row that names them is committed, and removed after the row that named them is gone.
//! A crash in between leaves bytes without a row, which the next start removes; never a row without bytes.

mod folder;
#[cfg(test)]
pub(crate) mod memory;
mod sqlite;
#[cfg(test)]
mod tests;

pub use folder::FolderStore;
pub use sqlite::SqliteStore;

use crate::access::TokenRecord;
use crate::scheduler::record::{Change, JobRecord, Snapshot};
use async_trait::async_trait;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::token::Usage;
use std::path::PathBuf;
use thiserror::Error;

/// Why a store failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// Another coordinator has the store open.
    #[error("{}: in use by another coordinator", .0.display())]
    InUse(PathBuf),
    /// Made by a newer version, or by another program.
    #[error("{}: {reason}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
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
    /// No such blob.
    #[error("there is no blob {0}")]
    NoBlob(BlobHash),
    /// The database failed.
    #[error("the database failed: {0}")]
    Database(#[from] rusqlite::Error),
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What failed.
        source: std::io::Error,
    },
    /// The store's task did not end.
    #[error("the store was stopped")]
    Stopped,
}

impl StoreError {
    /// Whether the same call may succeed later, as after a full disk.
    #[must_use]
    pub fn retryable(&self) -> bool {
        matches!(self, Self::Database(_) | Self::Io { .. } | Self::Stopped)
    }
}

/// State: jobs, leases, nodes, workers, bundles, tokens.
///
/// # Contract
/// * [`commit`](Self::commit) applies all changes or none, and what it applied survives a crash of the machine.
///   After an error the outcome is unknown until [`load`](Self::load) tells.
/// * Counters never fall, even when the rows that used them are gone.
/// * A store has one user at a time: opening it twice is an error.
#[async_trait]
pub trait StateStore: Send + Sync {
    /// The state to go on from.
    async fn load(&self) -> Result<Snapshot, StoreError>;
    /// Applies changes, all or none.
    async fn commit(&self, changes: Vec<Change>) -> Result<(), StoreError>;
    /// A job, whether it has ended or not.
    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError>;
    /// Up to `limit` jobs, newest first, below the job `before`.
    async fn jobs(&self, before: Option<JobId>, limit: u32) -> Result<Vec<JobRecord>, StoreError>;
    /// The job that was submitted with an idempotency key.
    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError>;
    /// Keeps a manifest under its hash, and counts its distinct blobs for the owner, once each. Where the owner would
    /// have more than `most` bytes then, nothing changes. Returns the bytes that the owner has then or would have.
    async fn put_bundle(
        &self,
        hash: BlobHash,
        manifest: BundleManifest,
        owner: String,
        most: u64,
    ) -> Result<u64, StoreError>;
    /// The manifest of a bundle.
    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError>;
    /// The largest size that a bundle gives for a blob; `None` if no bundle names it.
    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError>;
    /// What an owner has used.
    async fn usage(&self, owner: String) -> Result<Usage, StoreError>;
    /// Keeps a token; returns false, and changes nothing, if there is one of that name.
    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError>;
    /// All tokens, by name.
    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError>;
    /// Forgets a token. Returns whether there was one.
    async fn remove_token(&self, name: String) -> Result<bool, StoreError>;
    /// Lets go of the store, so that somebody else can open it; every later call fails.
    async fn close(&self);
    /// Digests of all nodes that count, of all jobs.
    async fn live_digests(&self) -> Result<Vec<BlobHash>, StoreError>;
}

/// Bytes, named by their hash.
///
/// # Contract
/// * A blob is there whole or not at all, and what was published survives a crash of the machine.
/// * Publishing what is there already succeeds and changes nothing.
/// * [`read`](Self::read) returns bytes of the hash asked for, or an error.
#[async_trait]
pub trait BlobStore: Send + Sync {
    /// Begins a blob. Dropping it leaves nothing behind that anyone could read.
    async fn stage(&self) -> Result<Box<dyn StagedBlob>, StoreError>;
    /// All bytes, verified.
    async fn read(&self, hash: BlobHash) -> Result<Vec<u8>, StoreError>;
    /// The bytes as a stream with its length, not verified: the receiver does that.
    async fn open(&self, hash: BlobHash) -> Result<(u64, BlobReader), StoreError>;
    /// Whether the blob is there.
    async fn contains(&self, hash: BlobHash) -> Result<bool, StoreError>;
    /// Removes the blob, if it is there.
    async fn remove(&self, hash: BlobHash) -> Result<(), StoreError>;
    /// Names of all blobs.
    async fn list(&self) -> Result<Vec<BlobHash>, StoreError>;
}

/// Bytes of a blob as they are read.
pub type BlobReader = Box<dyn tokio::io::AsyncRead + Send + Unpin>;

/// A blob that is being written.
#[async_trait]
pub trait StagedBlob: Send {
    /// Appends bytes.
    async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError>;
    /// Makes the bytes durable and visible, if they have the hash `expected`.
    async fn publish(self: Box<Self>, expected: BlobHash) -> Result<(), StoreError>;
}

/// Stages and publishes bytes at hand.
pub async fn put(store: &dyn BlobStore, bytes: &[u8]) -> Result<BlobHash, StoreError> {
    let hash = BlobHash::of(bytes);
    if !store.contains(hash).await? {
        let mut staged = store.stage().await?;
        staged.write(bytes).await?;
        staged.publish(hash).await?;
    }
    Ok(hash)
}
