//! Where bytes are kept.

use super::{Room, StoreError};
use crate::background::in_background;
use crate::scheduler::record::BlobName;
use async_trait::async_trait;
use bytes::Bytes;
use photonfarm_proto::id::BlobHash;
use std::time::Duration;
use tokio::io::AsyncReadExt;

/// Bytes, named by their hash and the number of a copy.
///
/// # Contract
/// * A blob is there whole or not at all, and what was published survives a crash of the machine.
/// * Publishing what is there already succeeds, and changes nothing but its age.
/// * [`read`](Self::read) returns bytes of the hash asked for, or an error: [`StoreError::NoBlob`] or
///   [`StoreError::Damaged`] where the same call will not succeed later.
#[async_trait]
pub trait BlobStore: Send + Sync {
    /// Begins the blob of this name. Dropping it leaves nothing behind that anyone could read.
    async fn stage(&self, name: BlobName) -> Result<Box<dyn StagedBlob>, StoreError>;
    /// All bytes, verified. A blob of more than `most` bytes is damaged.
    async fn read(&self, name: BlobName, most: u64) -> Result<Vec<u8>, StoreError>;
    /// The bytes from `start` on as a stream, with the length of all of them, not verified: the receiver does that.
    /// `start` is no greater than the length.
    async fn open_at(&self, name: BlobName, start: u64) -> Result<(u64, BlobReader), StoreError>;
    /// The size of the blob, if it is there.
    async fn size(&self, name: BlobName) -> Result<Option<u64>, StoreError>;
    /// Removes the blob, if it is there.
    async fn remove(&self, name: BlobName) -> Result<(), StoreError>;
    /// Names of all blobs, and how long ago each was last published. Both ends of that time are read from the clock of
    /// the store itself, so that it is right whatever the time is on this machine.
    async fn list(&self) -> Result<Vec<(BlobName, Duration)>, StoreError>;

    /// The room on its disk, where it lies on one that can be looked at.
    async fn room(&self) -> Result<Option<Room>, StoreError> {
        Ok(None)
    }

    /// All bytes as a stream with its length, not verified.
    async fn open(&self, name: BlobName) -> Result<(u64, BlobReader), StoreError> {
        self.open_at(name, 0).await
    }

    /// Whether there are URLs by which others may read and write for a short time.
    fn signs(&self) -> bool {
        false
    }

    /// A URL for an HTTP GET of the blob, where the store [`signs`](Self::signs).
    async fn read_url(&self, _name: BlobName) -> Result<Option<String>, StoreError> {
        Ok(None)
    }

    /// A URL for an HTTP PUT of bytes that are no blob until they are [`adopt`](Self::adopt)ed from this place, where
    /// the store [`signs`](Self::signs).
    async fn write_url(&self, _place: &str) -> Result<Option<String>, StoreError> {
        Ok(None)
    }

    /// Makes a blob of what was put to [`write_url`](Self::write_url). Its size is checked, its hash is not: readers
    /// do that. [`StoreError::NoBlob`] if nothing was put, [`StoreError::Damaged`] if it has another size.
    async fn adopt(&self, _place: &str, name: BlobName, _bytes: u64) -> Result<(), StoreError> {
        Err(StoreError::NoBlob(name.hash))
    }

    /// Removes what was put to [`write_url`](Self::write_url) and is not to be adopted, if anything was.
    async fn discard(&self, _place: &str) -> Result<(), StoreError> {
        Ok(())
    }

    /// Removes what was put so long ago and never adopted.
    async fn tidy(&self, _age: Duration) -> Result<(), StoreError> {
        Ok(())
    }
}

/// Bytes of a blob as they are read.
pub type BlobReader = Box<dyn tokio::io::AsyncRead + Send + Unpin>;

/// A blob that is being written.
#[async_trait]
pub trait StagedBlob: Send {
    /// Appends bytes, piece by piece. After an error there is nothing more to do with it.
    async fn write_pieces(&mut self, pieces: Vec<Bytes>) -> Result<(), StoreError>;

    /// Appends a copy of bytes.
    async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.write_pieces(vec![Bytes::copy_from_slice(bytes)]).await
    }

    /// The caller has found that the bytes to be written have the hash announced: it is not computed again.
    fn trust(&mut self);
    /// The hash of the bytes written so far; the one announced where the caller is trusted.
    fn hash(&self) -> BlobHash;
    /// Makes the bytes durable and visible, if they have the hash announced.
    async fn publish(self: Box<Self>) -> Result<(), StoreError>;
}

/// The number of a copy that nobody else has: 64 random bits.
pub fn new_copy() -> Result<u64, StoreError> {
    Ok(getrandom::u64()?)
}

/// Bytes that are hashed at a time.
const PIECE: usize = 1 << 18;

/// The hash of the bytes that lie in the store under a name.
pub(crate) async fn hash_of(store: &dyn BlobStore, name: BlobName) -> Result<BlobHash, StoreError> {
    let (_, mut reader) = store.open(name).await?;
    let (mut hasher, mut piece) = (blake3::Hasher::new(), vec![0; PIECE]);
    loop {
        let read = reader.read(&mut piece).await.map_err(|source| StoreError::Io {
            path: name.to_string().into(),
            source,
        })?;
        if read == 0 {
            return Ok(hasher.finalize().into());
        }
        hasher.update(&piece[..read]);
    }
}

/// Stages and publishes bytes at hand, as the given copy of them.
pub async fn put(store: &dyn BlobStore, bytes: Bytes, copy: u64) -> Result<BlobName, StoreError> {
    let hashed = bytes.clone();
    let hash = in_background(move || BlobHash::of(&hashed));
    let hash = hash.await.map_err(|_| StoreError::Stopped)?;
    let name = BlobName { hash, copy };
    let mut staged = store.stage(name).await?;
    staged.trust();
    staged.write_pieces(vec![bytes]).await?;
    staged.publish().await?;
    Ok(name)
}
