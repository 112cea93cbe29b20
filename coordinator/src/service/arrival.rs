//! The image of a node as it arrives: it goes to the store piece by piece, while its hash is taken and its pixels are
//! looked at. So no image is held in memory, and however slow or large one is, it keeps no other waiting.

use super::ServiceError;
use crate::store::{BlobStore, StagedBlob};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::node::{NodeError, NodeHeader};
use photonfarm_proto::planes::Pixels;
use photonfarm_proto::problem::{ErrorCode, Problem};

/// An image of which a part has arrived.
pub(super) struct Arrival {
    staged: Box<dyn StagedBlob>,
    announced: BlobHash,
    /// Bytes to come.
    left: u64,
    pixels: Pixels,
}

impl Arrival {
    /// Begins an image with its header, which was checked against the limits.
    pub(super) async fn begin(
        store: &dyn BlobStore,
        header: &NodeHeader,
        announced: BlobHash,
    ) -> Result<Self, ServiceError> {
        let mut staged = store.stage(announced).await?;
        staged.write(&header.to_bytes()).await?;
        Ok(Self {
            staged,
            announced,
            left: header.plane_bytes(),
            pixels: Pixels::of(header),
        })
    }

    /// Takes the next bytes of the planes.
    pub(super) async fn take(&mut self, piece: &[u8]) -> Result<(), ServiceError> {
        let left = self.left.checked_sub(piece.len() as u64);
        self.left = left.ok_or_else(|| Problem::new(ErrorCode::Malformed, "bytes follow the node's image"))?;
        self.pixels.look_at(piece);
        Ok(self.staged.write(piece).await?)
    }

    /// The whole image, ready to be published; or what is wrong with an image that has the hash announced.
    ///
    /// # Errors
    /// The image is not whole, or has another hash.
    pub(super) fn end(self) -> Result<Result<Box<dyn StagedBlob>, NodeError>, ServiceError> {
        if self.left > 0 {
            return Err(too_short());
        }
        let (found, announced) = (self.staged.hash(), self.announced);
        if found != announced {
            let detail = format!("the node's image has hash {found}, announced was {announced}");
            return Err(Problem::new(ErrorCode::ContentMismatch, detail).into());
        }
        Ok(match self.pixels.bad() {
            Some(error) => Err(error.clone().into()),
            None => Ok(self.staged),
        })
    }
}

/// A body ended before what it announced.
pub(super) fn too_short() -> ServiceError {
    Problem::new(ErrorCode::Malformed, "the body is shorter than its announcement says").into()
}
