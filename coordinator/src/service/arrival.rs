//! The image of a node as it arrives: it goes to the store piece by piece, while its hash is taken and its pixels are
//! looked at. So no image is held in memory, and however slow or large one is, it keeps no other waiting.

use super::ServiceError;
use crate::store::{BlobStore, StagedBlob};
use photonfarm_core::film::FilmError;
use photonfarm_core::spectrum::CHANNELS;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::node::{NodeError, NodeHeader};
use photonfarm_proto::problem::{ErrorCode, Problem};

/// An image of which a part has arrived.
pub(super) struct Arrival {
    staged: Box<dyn StagedBlob>,
    hasher: blake3::Hasher,
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
        let head = header.to_bytes();
        staged.write(&head).await?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(&head);
        Ok(Self {
            staged,
            hasher,
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
        self.hasher.update(piece);
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
        let (found, announced) = (BlobHash::from(self.hasher.finalize()), self.announced);
        if found != announced {
            let detail = format!("the node's image has hash {found}, announced was {announced}");
            return Err(Problem::new(ErrorCode::ContentMismatch, detail).into());
        }
        Ok(match self.pixels.bad {
            Some(error) => Err(error.into()),
            None => Ok(self.staged),
        })
    }
}

/// A body ended before what it announced.
pub(super) fn too_short() -> ServiceError {
    Problem::new(ErrorCode::Malformed, "the body is shorter than its announcement says").into()
}

/// Looks at planes of values: none may be negative or not finite.
struct Pixels {
    width: u64,
    /// Values of the plane of sums.
    sums: u64,
    /// Values seen.
    seen: u64,
    /// The first bytes of a value of which the others have not come.
    part: Vec<u8>,
    bad: Option<FilmError>,
}

impl Pixels {
    fn of(header: &NodeHeader) -> Self {
        let width = u64::from(header.width);
        Self {
            width,
            sums: width * u64::from(header.height) * CHANNELS as u64,
            seen: 0,
            part: Vec::with_capacity(4),
            bad: None,
        }
    }

    fn look_at(&mut self, mut piece: &[u8]) {
        if !self.part.is_empty() {
            let (end, rest) = piece.split_at(piece.len().min(4 - self.part.len()));
            self.part.extend_from_slice(end);
            piece = rest;
            if let Ok(value) = <[u8; 4]>::try_from(self.part.as_slice()) {
                self.part.clear();
                self.look_at_values(&value);
            }
        }
        let (whole, rest) = piece.split_at(piece.len() / 4 * 4);
        self.look_at_values(whole);
        self.part.extend_from_slice(rest);
    }

    fn look_at_values(&mut self, bytes: &[u8]) {
        let mut values = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let bad = values.clone().position(|value| !value.is_finite() || value < 0.0);
        if let (None, Some(index)) = (&self.bad, bad) {
            let at = self.seen + index as u64;
            let pixel = at.checked_sub(self.sums).unwrap_or(at / CHANNELS as u64);
            self.bad = Some(FilmError::Pixel {
                x: (pixel % self.width) as u32,
                y: (pixel / self.width) as u32,
                value: values.nth(index).unwrap_or_default(),
            });
        }
        self.seen += bytes.len() as u64 / 4;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::id::JobId;
    use photonfarm_proto::node::{NodeKey, decode_node};

    /// What is found in planes that come in pieces of `length` bytes.
    fn found(header: &NodeHeader, planes: &[u8], length: usize) -> Option<String> {
        let mut pixels = Pixels::of(header);
        planes.chunks(length).for_each(|piece| pixels.look_at(piece));
        assert_eq!(pixels.seen, planes.len() as u64 / 4);
        pixels.bad.map(|error| error.to_string())
    }

    #[test]
    fn a_bad_value_is_found_where_it_is_whatever_the_pieces() {
        let header = NodeHeader {
            job: JobId(1),
            key: NodeKey::leaf(0),
            width: 3,
            height: 2,
        };
        let values = (header.plane_bytes() / 4) as usize;
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            for index in 0..=values {
                let value = |at| if at == index { bad } else { 0.5_f32 };
                let planes: Vec<u8> = (0..values).flat_map(|at| value(at).to_le_bytes()).collect();
                let whole = [&header.to_bytes()[..], &planes].concat();
                let expected = decode_node(&whole, &Default::default())
                    .err()
                    .map(|error| error.to_string());
                assert_eq!(expected.is_none(), index == values);
                for length in [1, 2, 3, 4, 5, 7, 64, 1000] {
                    assert_eq!(
                        found(&header, &planes, length),
                        expected,
                        "{bad} at {index}, pieces of {length}"
                    );
                }
            }
        }
    }
}
