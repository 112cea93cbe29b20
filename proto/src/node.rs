//! Nodes of the reduction tree: their names, and their images as bytes.
//!
//! A node's image is a header of [`NodeHeader::BYTES`] bytes and planes of little-endian `f32`: the pixels, each with its sum of
//! radiance and its squared error ([`Node::pixels`]), then what a sequential integrator goes on from after the node, if it is one;
//! rows from the top. The same bytes are stored and hashed, so that equal digests mean equal bits.

use crate::id::JobId;
use crate::limits::{LimitError, Limits};
use crate::planes::values;
use photonfarm_core::film::{FilmError, Node, VALUES_PER_PIXEL};
use photonfarm_core::settings::STATISTICS_PER_PIXEL;
use photonfarm_core::spectrum::{CHANNELS, Spectrum};
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;
use utoipa::ToSchema;

/// Version of stored nodes.
pub const NODE_VERSION: u16 = 2;

/// Place of a node in the tree: it covers leaves `[index 2^level, (index + 1) 2^level)`. Leaf `k` is iteration `k + 1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
pub struct NodeKey {
    /// Height in the tree; 0 is one iteration.
    pub level: u32,
    /// Place within the level.
    pub index: u32,
}

impl NodeKey {
    /// Highest level: the node covers every leaf that there can be.
    pub const MAX_LEVEL: u32 = 31;

    /// One leaf.
    #[must_use]
    pub fn leaf(index: u32) -> Self {
        Self { level: 0, index }
    }

    /// Whether the node lies in a tree of `leaves` leaves.
    #[must_use]
    pub fn fits(self, leaves: u32) -> bool {
        self.level <= Self::MAX_LEVEL && (u64::from(self.index) + 1) << self.level <= u64::from(leaves)
    }

    /// First leaf covered.
    #[must_use]
    pub fn first(self) -> u64 {
        u64::from(self.index) << self.level
    }

    /// The leaf after the last one covered.
    #[must_use]
    pub fn end(self) -> u64 {
        (u64::from(self.index) + 1) << self.level
    }

    /// Number of leaves covered.
    #[must_use]
    pub fn leaves(self) -> u64 {
        1 << self.level
    }

    /// Whether `other` covers no leaf that this node does not; a node contains itself.
    #[must_use]
    pub fn contains(self, other: Self) -> bool {
        self.first() <= other.first() && other.end() <= self.end()
    }

    /// The node that has this one as a child.
    #[must_use]
    pub fn parent(self) -> Self {
        Self {
            level: self.level + 1,
            index: self.index / 2,
        }
    }

    /// The other child of the parent.
    #[must_use]
    pub fn sibling(self) -> Self {
        Self {
            level: self.level,
            index: self.index ^ 1,
        }
    }

    /// Left and right child; `None` for a leaf.
    #[must_use]
    pub fn children(self) -> Option<[Self; 2]> {
        let level = self.level.checked_sub(1)?;
        let index = self.index * 2;
        Some([
            Self { level, index },
            Self {
                level,
                index: index + 1,
            },
        ])
    }
}

impl fmt::Display for NodeKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {})", self.level, self.index)
    }
}

/// What precedes the planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeHeader {
    /// The job, so that no two jobs share an image.
    pub job: JobId,
    /// The node.
    pub key: NodeKey,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Statistics of each pixel: those of a sequential integrator, or none.
    pub statistics: u16,
}

/// Why bytes are not a node.
#[derive(Debug, Error)]
pub enum NodeError {
    /// No magic number.
    #[error("not an image of a node: the magic number is missing")]
    Magic,
    /// Another version of the format.
    #[error("the image of a node has version {found}, this program has {NODE_VERSION}")]
    Version {
        /// The version found.
        found: u16,
    },
    /// Fewer or more bytes than the image size needs.
    #[error("the image of a node has {found} bytes, its size needs {expected}")]
    Length {
        /// Bytes found.
        found: u64,
        /// Bytes needed.
        expected: u64,
    },
    /// A node that cannot be.
    #[error("there is no node {0}")]
    Key(NodeKey),
    /// Statistics that no integrator has.
    #[error(
        "the image of a node has {0} statistics of each pixel; there are integrators with 0 and with {STATISTICS_PER_PIXEL}"
    )]
    Statistics(u16),
    /// An image beyond the limits.
    #[error(transparent)]
    Limit(#[from] LimitError),
    /// A bad pixel.
    #[error(transparent)]
    Film(#[from] FilmError),
}

const MAGIC: [u8; 4] = *b"PHFN";

impl NodeHeader {
    /// Size of the header.
    pub const BYTES: usize = 32;

    /// The header of a node's image.
    #[must_use]
    pub fn of(job: JobId, node: &Node) -> Self {
        let key = NodeKey {
            level: node.level,
            index: node.index,
        };
        Self {
            job,
            key,
            width: node.width,
            height: node.height,
            statistics: match node.statistics.is_empty() {
                true => 0,
                false => STATISTICS_PER_PIXEL as u16,
            },
        }
    }

    /// Size of the planes.
    #[must_use]
    pub fn plane_bytes(&self) -> u64 {
        self.image_bytes() + self.statistics_bytes()
    }

    /// Size of the pixels.
    #[must_use]
    pub fn image_bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * VALUES_PER_PIXEL as u64 * 4
    }

    /// Size of the statistics, which come last.
    #[must_use]
    pub fn statistics_bytes(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * u64::from(self.statistics) * 4
    }

    /// As bytes: magic, version, statistics of each pixel, job, level, index, width, height.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4..6].copy_from_slice(&NODE_VERSION.to_le_bytes());
        bytes[6..8].copy_from_slice(&self.statistics.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.job.0.to_le_bytes());
        let words = [self.key.level, self.key.index, self.width, self.height];
        for (to, word) in bytes[16..].chunks_exact_mut(4).zip(words) {
            to.copy_from_slice(&word.to_le_bytes());
        }
        bytes
    }

    /// Reads a header and checks it against the limits.
    pub fn from_bytes(bytes: &[u8], limits: &Limits) -> Result<Self, NodeError> {
        match Self::of_any_version(bytes, limits)? {
            (NODE_VERSION, header) => Ok(header),
            (found, _) => Err(NodeError::Version { found }),
        }
    }

    fn of_any_version(bytes: &[u8], limits: &Limits) -> Result<(u16, Self), NodeError> {
        let found = bytes.len() as u64;
        let short = NodeError::Length {
            found,
            expected: Self::BYTES as u64,
        };
        let bytes: &[u8; Self::BYTES] = bytes.get(..Self::BYTES).and_then(|b| b.try_into().ok()).ok_or(short)?;
        if bytes[..4] != MAGIC {
            return Err(NodeError::Magic);
        }
        let version = u16::from_le_bytes([bytes[4], bytes[5]]);
        if !(1..=NODE_VERSION).contains(&version) {
            return Err(NodeError::Version { found: version });
        }
        let statistics = u16::from_le_bytes([bytes[6], bytes[7]]);
        if statistics != 0 && usize::from(statistics) != STATISTICS_PER_PIXEL {
            return Err(NodeError::Statistics(statistics));
        }
        let mut words = [0u32; 6];
        for (word, from) in words.iter_mut().zip(bytes[8..].chunks_exact(4)) {
            *word = u32::from_le_bytes([from[0], from[1], from[2], from[3]]);
        }
        let [job_low, job_high, level, index, width, height] = words;
        let key = NodeKey { level, index };
        if !key.fits(u32::MAX) {
            return Err(NodeError::Key(key));
        }
        limits.check_resolution(width, height)?;
        let job = JobId(u64::from(job_low) | u64::from(job_high) << 32);
        let header = Self {
            job,
            key,
            width,
            height,
            statistics,
        };
        Ok((version, header))
    }

    /// Reads the planes and checks every value.
    pub fn read_planes(&self, planes: &[u8]) -> Result<Node, NodeError> {
        if planes.len() as u64 != self.plane_bytes() {
            return Err(NodeError::Length {
                found: planes.len() as u64,
                expected: self.plane_bytes(),
            });
        }
        let (image, statistics) = planes.split_at(self.image_bytes() as usize);
        let node = Node {
            width: self.width,
            height: self.height,
            level: self.key.level,
            index: self.key.index,
            pixels: values(image),
            statistics: values(statistics),
        };
        node.check()?;
        Ok(node)
    }
}

/// A node's image as bytes: what is stored and hashed.
#[must_use]
pub fn encode_node(job: JobId, node: &Node) -> Vec<u8> {
    let header = NodeHeader::of(job, node);
    let mut bytes = Vec::with_capacity(NodeHeader::BYTES + header.plane_bytes() as usize);
    bytes.extend_from_slice(&header.to_bytes());
    for value in node.pixels.iter().chain(&node.statistics) {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes
}

/// Reads a node's image and checks it; one of version 1 as well, so that pictures of ended jobs stay.
pub fn decode_node(bytes: &[u8], limits: &Limits) -> Result<(JobId, Node), NodeError> {
    let (version, header) = NodeHeader::of_any_version(bytes, limits)?;
    let mut node = header.read_planes(&bytes[NodeHeader::BYTES..])?;
    if version == 1 {
        node.pixels = pixels_of_version_1(&node);
    }
    Ok((header.job, node))
}

/// The pixels of version 1: all sums of radiance came first, then all sums of squared luminance, of which the squared error of the sum is
/// made as of independent iterations.
fn pixels_of_version_1(node: &Node) -> Vec<f32> {
    let (sums, squares) = node.pixels.split_at(node.pixels.len() / VALUES_PER_PIXEL * CHANNELS);
    let (sums, _) = sums.as_chunks::<CHANNELS>();
    let n = node.iterations() as f32;
    let pixel = |(sum, squares): (&[f32; CHANNELS], &f32)| {
        let luminance = Spectrum::from_channels(*sum).luminance();
        let error = match node.level {
            0 => 0.0,
            _ => ((squares - luminance * (luminance / n)) * (n / (n - 1.0))).clamp(0.0, f32::MAX),
        };
        (*sum).into_iter().chain([error])
    };
    sums.iter().zip(squares).flat_map(pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node() -> Node {
        let pixels: Vec<Spectrum> = (0..6).map(|i| Spectrum::from_rgb([i as f32, 0.5, 1e-3])).collect();
        Node::leaf(5, 3, 2, &pixels).unwrap()
    }

    #[test]
    fn a_node_survives_its_bytes() {
        let bytes = encode_node(JobId(1 << 40), &node());
        assert_eq!(
            decode_node(&bytes, &Limits::default()).unwrap(),
            (JobId(1 << 40), node())
        );
    }

    #[test]
    fn statistics_survive_and_no_others_than_an_integrator_has_are_read() {
        let node = node().with_statistics((0..12).map(|i| i as f32).collect()).unwrap();
        let mut bytes = encode_node(JobId(1), &node);
        let limits = Limits::default();
        assert_eq!(decode_node(&bytes, &limits).unwrap(), (JobId(1), node));
        for other in [0, 1, 3] {
            bytes[6] = other;
            assert!(decode_node(&bytes, &limits).is_err(), "{other}");
        }
    }

    #[test]
    fn a_node_of_version_1_is_read() {
        let leaf = |index, value| Node::leaf(index, 2, 1, &[Spectrum::splat(value), Spectrum::ONE]).unwrap();
        let node = leaf(0, 1.0).merge(&leaf(1, 3.0)).unwrap();
        let mut bytes = encode_node(JobId(3), &node);
        bytes[4] = 1;
        // Sums of both pixels, then sums of squares: 1 + 9 and 1 + 1.
        let planes = [4.0_f32, 4.0, 4.0, 2.0, 2.0, 2.0, 10.0, 2.0].map(f32::to_le_bytes);
        bytes[NodeHeader::BYTES..].copy_from_slice(planes.as_flattened());
        let limits = Limits::default();
        assert_eq!(decode_node(&bytes, &limits).unwrap(), (JobId(3), node));
        assert!(matches!(
            NodeHeader::from_bytes(&bytes, &limits),
            Err(NodeError::Version { found: 1 })
        ));
        for version in [0, 3] {
            bytes[4] = version;
            assert!(matches!(decode_node(&bytes, &limits), Err(NodeError::Version { .. })));
        }
    }

    #[test]
    fn every_truncation_is_an_error() {
        let bytes = encode_node(JobId(1), &node());
        for length in 0..bytes.len() {
            assert!(decode_node(&bytes[..length], &Limits::default()).is_err(), "{length}");
        }
        let longer = [bytes.as_slice(), &[0]].concat();
        assert!(matches!(
            decode_node(&longer, &Limits::default()),
            Err(NodeError::Length { .. })
        ));
    }

    #[test]
    fn no_flipped_bit_makes_a_panic() {
        let bytes = encode_node(JobId(1), &node());
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            if let Ok((_, node)) = decode_node(&damaged, &Limits::default()) {
                assert!(node.check().is_ok());
            }
        }
    }

    #[test]
    fn sizes_and_places_beyond_the_limits_are_refused_before_the_planes() {
        let header = NodeHeader {
            job: JobId(1),
            key: NodeKey::leaf(0),
            width: u32::MAX,
            height: u32::MAX,
            statistics: 0,
        };
        let limits = Limits::default();
        assert!(matches!(
            NodeHeader::from_bytes(&header.to_bytes(), &limits),
            Err(NodeError::Limit(_))
        ));
        let header = NodeHeader {
            key: NodeKey { level: 32, index: 0 },
            width: 1,
            height: 1,
            ..header
        };
        assert!(matches!(
            NodeHeader::from_bytes(&header.to_bytes(), &limits),
            Err(NodeError::Key(_))
        ));
        let header = NodeHeader {
            key: NodeKey { level: 31, index: 1 },
            ..header
        };
        assert!(matches!(
            NodeHeader::from_bytes(&header.to_bytes(), &limits),
            Err(NodeError::Key(_))
        ));
    }

    #[test]
    fn bad_pixels_are_refused() {
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            let mut node = node();
            node.pixels[4] = bad;
            let bytes = encode_node(JobId(1), &node);
            assert!(
                matches!(decode_node(&bytes, &Limits::default()), Err(NodeError::Film(_))),
                "{bad}"
            );
        }
    }

    #[test]
    fn the_tree_is_a_tree() {
        let key = NodeKey { level: 2, index: 3 };
        assert_eq!((key.first(), key.end(), key.leaves()), (12, 16, 4));
        let [left, right] = key.children().unwrap();
        assert_eq!((left.parent(), right.parent(), left.sibling()), (key, key, right));
        assert!(key.contains(left) && key.contains(key) && !left.contains(key));
        assert!(key.fits(16) && !key.fits(15));
        assert!(!NodeKey { level: 64, index: 0 }.fits(u32::MAX));
    }
}
