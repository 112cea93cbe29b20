//! The images of nodes are added up as they are read, piece by piece: besides those that are at hand, memory holds one
//! image, however many are added.

use super::at_hand::AtHand;
use crate::scheduler::record::BlobName;
use crate::store::{BlobReader, BlobStore, StoreError};
use photonfarm_core::film::add_pixels;
use photonfarm_proto::node::{NodeHeader, NodeKey};
use photonfarm_proto::planes::{self, Pixels};
use std::io::ErrorKind;
use tokio::io::AsyncReadExt;

/// Bytes read of each image at a time: whole pixels.
const PIECE: usize = 1 << 18;

/// A node that is to be made, and what it is made of.
#[derive(Clone, Debug)]
pub(super) struct Merge {
    pub(super) node: NodeHeader,
    /// The nodes that make it up, from left to right.
    pub(super) parts: Vec<(NodeKey, BlobName)>,
}

impl Merge {
    /// Length of the node's image.
    pub(super) fn bytes(&self) -> u64 {
        NodeHeader::BYTES as u64 + self.node.plane_bytes()
    }
}

/// A node of which the image cannot be used.
#[derive(Debug)]
pub(super) struct Unusable {
    pub(super) node: NodeKey,
    pub(super) image: BlobName,
    pub(super) reason: String,
}

/// Why images could not be added up.
pub(super) enum AddError {
    Unusable(Unusable),
    Store(StoreError),
}

impl From<StoreError> for AddError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

/// Makes the image of a node: the sum of its parts in the order of the tree, left plus right, and the statistics of the last.
///
/// Every part is held against its header, and, unless it is at hand, against its hash and what pixels may be. `image` has the length of
/// [`Merge::bytes`].
pub(super) async fn add_up(
    store: &dyn BlobStore,
    at_hand: &AtHand,
    merge: &Merge,
    image: &mut [u8],
) -> Result<(), AddError> {
    let (head, rest) = image.split_at_mut(NodeHeader::BYTES);
    head.copy_from_slice(&merge.node.to_bytes());
    let mut parts = Vec::with_capacity(merge.parts.len());
    for &(key, image) in &merge.parts {
        parts.push(Part::open(store, at_hand, NodeHeader { key, ..merge.node }, image).await?);
    }
    let mut stack: Vec<(NodeKey, Vec<f32>)> = Vec::new();
    let (sums, statistics) = rest.split_at_mut(merge.node.image_bytes() as usize);
    for piece in sums.chunks_mut(PIECE) {
        for part in &mut parts {
            let mut sum = (part.header.key, part.read(piece.len()).await?);
            while let Some((_, mut left)) = stack.pop_if(|(left, _)| sum.0 == left.sibling()) {
                add_pixels(&mut left, &sum.1);
                sum = (sum.0.parent(), left);
            }
            stack.push(sum);
        }
        for (_, sum) in stack.drain(..) {
            planes::write(piece, &sum);
        }
    }
    for piece in statistics.chunks_mut(PIECE) {
        for part in &mut parts {
            part.fill_from_planes(piece.len()).await?;
            piece.copy_from_slice(&part.bytes);
        }
    }
    parts.into_iter().try_for_each(Part::end)
}

/// The image of a part as it is read.
struct Part {
    header: NodeHeader,
    image: BlobName,
    reader: BlobReader,
    /// None for an image that was looked at when it arrived.
    checks: Option<Checks>,
    bytes: Vec<u8>,
}

/// What an image is held against while it is read.
struct Checks {
    hasher: blake3::Hasher,
    pixels: Pixels,
}

impl Part {
    async fn open(
        store: &dyn BlobStore,
        at_hand: &AtHand,
        header: NodeHeader,
        image: BlobName,
    ) -> Result<Self, AddError> {
        let unusable = |reason| {
            AddError::Unusable(Unusable {
                node: header.key,
                image,
                reason,
            })
        };
        let held = at_hand.open(image.hash);
        let checks = held.is_none().then(|| Checks {
            hasher: blake3::Hasher::new(),
            pixels: Pixels::new([header.width, header.height], header.statistics),
        });
        let opened = match held {
            Some(held) => Ok(held),
            None => store.open(image).await,
        };
        let (length, reader) = match opened {
            Ok(opened) => opened,
            Err(error @ (StoreError::NoBlob(_) | StoreError::Damaged(_))) => return Err(unusable(error.to_string())),
            Err(error) => return Err(error.into()),
        };
        let expected = NodeHeader::BYTES as u64 + header.plane_bytes();
        if length != expected {
            return Err(unusable(format!("its image has {length} bytes, not {expected}")));
        }
        let mut part = Self {
            header,
            image,
            reader,
            checks,
            bytes: Vec::new(),
        };
        part.fill(NodeHeader::BYTES).await?;
        if part.bytes != header.to_bytes() {
            return Err(part.unusable("its image is that of another node".to_owned()));
        }
        Ok(part)
    }

    fn unusable(&self, reason: String) -> AddError {
        AddError::Unusable(Unusable {
            node: self.header.key,
            image: self.image,
            reason,
        })
    }

    /// Reads the next `length` bytes.
    async fn fill(&mut self, length: usize) -> Result<(), AddError> {
        self.bytes.resize(length, 0);
        match self.reader.read_exact(&mut self.bytes).await {
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                return Err(self.unusable("its image ends early".to_owned()));
            }
            Err(source) => {
                let path = self.image.to_string().into();
                return Err(StoreError::Io { path, source }.into());
            }
        }
        if let Some(checks) = &mut self.checks {
            checks.hasher.update(&self.bytes);
        }
        Ok(())
    }

    /// Reads the next `length` bytes of the planes.
    async fn fill_from_planes(&mut self, length: usize) -> Result<(), AddError> {
        self.fill(length).await?;
        if let Some(checks) = &mut self.checks {
            checks.pixels.look_at(&self.bytes);
        }
        Ok(())
    }

    /// The values of the next `length` bytes of the planes.
    async fn read(&mut self, length: usize) -> Result<Vec<f32>, AddError> {
        self.fill_from_planes(length).await?;
        Ok(planes::values(&self.bytes))
    }

    fn end(self) -> Result<(), AddError> {
        let Some(checks) = &self.checks else { return Ok(()) };
        let found = checks.hasher.finalize().into();
        if self.image.hash != found {
            return Err(self.unusable(format!("its image has hash {found}")));
        }
        match checks.pixels.bad() {
            Some(error) => Err(self.unusable(error.to_string())),
            None => Ok(()),
        }
    }
}
