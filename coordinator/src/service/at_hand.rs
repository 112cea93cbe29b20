//! Images of nodes that this coordinator has held against their hash and has still in memory, so that adding them up
//! takes no second reading, hashing and looking. They lie in the store as well: forgetting one costs time only.

use crate::store::BlobReader;
use axum::body::Bytes;
use memmap2::MmapMut;
use photonfarm_proto::id::BlobHash;
use std::collections::BTreeMap;
use std::io::{self, Cursor};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Unit in which memory is counted [bytes].
const UNIT: u64 = 1024;
/// Memory for images in all [units of `UNIT`]: eight nodes of 1920 x 1080 pixels, which is as many as are added up at a time.
const MOST: usize = 256 << 10;

/// Images in memory, those that are on their way included.
#[derive(Debug)]
pub(super) struct AtHand {
    /// Units in all.
    most: usize,
    /// Units that are free.
    memory: Arc<Semaphore>,
    images: Mutex<BTreeMap<BlobHash, Held>>,
}

impl Default for AtHand {
    fn default() -> Self {
        Self::with_units(MOST)
    }
}

/// Memory for an image.
#[derive(Debug)]
pub(super) struct Room {
    _units: OwnedSemaphorePermit,
}

/// A buffer of an image's size, filled with zeros. It is mapped by itself, so that the system has it back as soon as it is
/// dropped: an allocator keeps freed buffers of this size, several times what is in use.
///
/// # Errors
/// There is no memory for it.
pub(super) fn buffer(bytes: u64) -> io::Result<MmapMut> {
    let bytes = usize::try_from(bytes).map_err(io::Error::other)?;
    MmapMut::map_anon(bytes)
}

/// An image in memory.
#[derive(Debug)]
pub(super) struct Held {
    bytes: Bytes,
    _room: Room,
}

impl Room {
    /// An image in this memory. The bytes are to be all that their buffer holds, since that is what is counted.
    pub(super) fn hold(self, bytes: Bytes) -> Held {
        Held { bytes, _room: self }
    }
}

impl AtHand {
    fn with_units(units: usize) -> Self {
        Self {
            most: units,
            memory: Arc::new(Semaphore::new(units)),
            images: Mutex::default(),
        }
    }

    /// Memory for an image of `bytes` bytes, for which others are forgotten where they must. Nothing if there is none.
    pub(super) fn room(&self, digest: BlobHash, bytes: u64) -> Option<Room> {
        let units = u32::try_from(bytes.div_ceil(UNIT)).ok()?;
        if units as usize > self.most {
            return None;
        }
        loop {
            if let Ok(memory) = self.memory.clone().try_acquire_many_owned(units) {
                return Some(Room { _units: memory });
            }
            self.forget_another(digest)?;
        }
    }

    /// Forgets the image whose digest follows `digest`. Digests are as good as random, so that neither the oldest nor
    /// the newest image is favoured: either could be the next that is asked for.
    fn forget_another(&self, digest: BlobHash) -> Option<()> {
        let mut images = self.images();
        let next = images.range((Excluded(digest), Unbounded)).next();
        let next = *next.or_else(|| images.first_key_value())?.0;
        images.remove(&next).map(drop)
    }

    /// Keeps an image that was held against its hash and looked at.
    pub(super) fn keep(&self, digest: BlobHash, image: Held) {
        self.images().insert(digest, image);
    }

    /// Forgets an image that is no longer needed.
    pub(super) fn forget(&self, digest: BlobHash) {
        self.images().remove(&digest);
    }

    /// Length and bytes of an image.
    pub(super) fn open(&self, digest: BlobHash) -> Option<(u64, BlobReader)> {
        let bytes = self.images().get(&digest)?.bytes.clone();
        Some((bytes.len() as u64, Box::new(Cursor::new(bytes))))
    }

    fn images(&self) -> MutexGuard<'_, BTreeMap<BlobHash, Held>> {
        self.images.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::AsyncReadExt;

    fn keep(at_hand: &AtHand, bytes: &'static [u8]) -> BlobHash {
        let digest = BlobHash::of(bytes);
        let room = at_hand.room(digest, UNIT).unwrap();
        at_hand.keep(digest, room.hold(Bytes::from_static(bytes)));
        digest
    }

    #[tokio::test]
    async fn an_image_is_there_until_it_is_forgotten() {
        let at_hand = AtHand::with_units(2);
        let digest = keep(&at_hand, b"image");
        for _ in 0..2 {
            let (length, mut reader) = at_hand.open(digest).unwrap();
            let mut found = Vec::new();
            reader.read_to_end(&mut found).await.unwrap();
            assert_eq!((length, &found[..]), (5, &b"image"[..]));
        }
        at_hand.forget(digest);
        assert!(at_hand.open(digest).is_none());
        assert_eq!(at_hand.memory.available_permits(), 2);
    }

    #[test]
    fn memory_is_bounded_whatever_arrives() {
        let at_hand = AtHand::with_units(2);
        for image in [&b"one"[..], b"two", b"three", b"four"] {
            keep(&at_hand, image);
        }
        assert_eq!(at_hand.images().len(), 2);
        // Images on their way are not forgotten for others, and neither is anything for one that would never fit.
        let on_their_way: Vec<_> = (0..2).map(|_| at_hand.room(BlobHash::of(b""), UNIT).unwrap()).collect();
        assert!(at_hand.room(BlobHash::of(b""), UNIT).is_none());
        drop(on_their_way);
        let digest = keep(&at_hand, b"one");
        assert!(at_hand.room(BlobHash::of(b""), 3 * UNIT).is_none());
        assert!(at_hand.open(digest).is_some());
    }
}
