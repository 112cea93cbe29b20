//! The image of a node as it arrives: it goes to the store piece by piece, while its hash is taken and its pixels are
//! looked at. However slow or large one is, it keeps no other waiting, and it is held in memory, to be added up with
//! others later, only as far as there is memory to spare.

use super::ServiceError;
use super::at_hand::{AtHand, Held, Room, buffer};
use crate::scheduler::record::BlobName;
use crate::store::{BlobStore, StagedBlob};
use axum::body::Bytes;
use memmap2::MmapMut;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::node::{NodeError, NodeHeader};
use photonfarm_proto::planes::Pixels;
use photonfarm_proto::problem::{ErrorCode, Problem};

/// Bytes that are hashed and written at a time, so that few of them cost a change of threads.
const BATCH: usize = 1 << 20;

/// An image of which a part has arrived.
pub(super) struct Arrival {
    staged: Box<dyn StagedBlob>,
    /// What is to be written next, and how many bytes that are.
    batch: (Vec<Bytes>, usize),
    announced: BlobHash,
    /// Bytes to come.
    left: u64,
    pixels: Pixels,
    held: Option<InMemory>,
}

/// The same image in memory, as far as it has arrived. A buffer of its own: the pieces lie in larger ones.
struct InMemory {
    image: MmapMut,
    arrived: usize,
    room: Room,
}

impl InMemory {
    fn begin(image: MmapMut, room: Room) -> Self {
        Self {
            image,
            arrived: 0,
            room,
        }
    }

    fn take(&mut self, piece: &[u8]) {
        let end = self.arrived + piece.len();
        self.image[self.arrived..end].copy_from_slice(piece);
        self.arrived = end;
    }
}

/// An image that arrived whole, with the hash announced and pixels that can be.
pub(super) struct Arrived {
    /// To be published.
    pub(super) staged: Box<dyn StagedBlob>,
    /// The same bytes in memory, if there was room.
    pub(super) held: Option<Held>,
}

impl Arrival {
    /// Begins an image with its header, which was checked against the limits.
    pub(super) async fn begin(
        store: &dyn BlobStore,
        at_hand: &AtHand,
        header: &NodeHeader,
        name: BlobName,
    ) -> Result<Self, ServiceError> {
        let staged = store.stage(name).await?;
        let head = Bytes::copy_from_slice(&header.to_bytes());
        let length = head.len() as u64 + header.plane_bytes();
        let room = at_hand.room(name.hash, length);
        let mut held = room.and_then(|room| Some(InMemory::begin(buffer(length).ok()?, room)));
        if let Some(image) = &mut held {
            image.take(&head);
        }
        Ok(Self {
            staged,
            batch: (vec![head], NodeHeader::BYTES),
            announced: name.hash,
            left: header.plane_bytes(),
            pixels: Pixels::new([header.width, header.height], header.statistics),
            held,
        })
    }

    /// Takes the next bytes of the planes.
    pub(super) async fn take(&mut self, piece: Bytes) -> Result<(), ServiceError> {
        let left = self.left.checked_sub(piece.len() as u64);
        self.left = left.ok_or_else(|| Problem::new(ErrorCode::Malformed, "bytes follow the node's image"))?;
        self.pixels.look_at(&piece);
        if let Some(image) = &mut self.held {
            image.take(&piece);
        }
        self.batch.1 += piece.len();
        self.batch.0.push(piece);
        if self.batch.1 >= BATCH {
            self.write().await?;
        }
        Ok(())
    }

    async fn write(&mut self) -> Result<(), ServiceError> {
        let (pieces, _) = std::mem::take(&mut self.batch);
        Ok(self.staged.write_pieces(pieces).await?)
    }

    /// The whole image, ready to be published; or what is wrong with an image that has the hash announced.
    ///
    /// # Errors
    /// The image is not whole, or has another hash.
    pub(super) async fn end(mut self) -> Result<Result<Arrived, NodeError>, ServiceError> {
        if self.left > 0 {
            return Err(too_short());
        }
        self.write().await?;
        let (found, announced) = (self.staged.hash(), self.announced);
        if found != announced {
            let detail = format!("the node's image has hash {found}, announced was {announced}");
            return Err(Problem::new(ErrorCode::ContentMismatch, detail).into());
        }
        Ok(match self.pixels.bad() {
            Some(error) => Err(error.clone().into()),
            None => Ok(Arrived {
                staged: self.staged,
                held: self.held.map(|held| held.room.hold(Bytes::from_owner(held.image))),
            }),
        })
    }
}

/// A body ended before what it announced.
pub(super) fn too_short() -> ServiceError {
    Problem::new(ErrorCode::Malformed, "the body is shorter than its announcement says").into()
}
