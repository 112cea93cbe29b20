//! Files of NanoVDB (Museth 2021, "NanoVDB: A GPU-Friendly and Portable VDB Data Structure"; `io/IO.h` and `PNanoVDB.h` of its version 32): segments of grids, each a
//! block of memory in which nodes refer to each other by distances in bytes. A file may be such a block alone.

use super::Entry;
use super::blosc;
use super::bytes::Bytes;
use super::open_vdb::inflate;
use super::tree::{Lattice, Level, Tree, VOXELS, is_set};
use crate::scene::error::{Place, SceneError, within};
use crate::scene::limits::Limits;
use crate::scene::loader::LoadedFile;
use glam::{DMat3, DMat4, DVec3};
use std::borrow::Cow;

/// What files and blocks begin with, before the last digit: 0 is either, 1 a block, 2 a file.
const MAGIC: [u8; 7] = *b"NanoVDB";
const MAJOR: u32 = 32;
/// Bytes of a file's description of a grid.
const DESCRIPTION: usize = 176;
/// Of a block: its own header, then that of the tree.
const GRID: u64 = 672;
/// The most bytes that a chunk of Blosc holds.
const CHUNK: u64 = 1 << 30;

pub(super) fn is_one(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

/// A file with its table of grids.
pub(super) struct Archive<'a> {
    place: Place,
    data: &'a [u8],
    pub(super) grids: Vec<Entry<Descriptor>>,
}

/// Where a grid is.
pub(super) struct Descriptor {
    codec: u16,
    at: u64,
    /// Bytes of the block.
    size: u64,
}

impl<'a> Archive<'a> {
    pub(super) fn open(file: &'a LoadedFile) -> Result<Self, SceneError> {
        let place = Place::whole(&file.name);
        let data = &file.bytes[..];
        let mut bytes = Bytes::new(&place, "NanoVDB", data);
        let mut grids = Vec::new();
        while bytes.at() < data.len() as u64 {
            let start = bytes.at();
            let magic: [u8; 8] = bytes.array()?;
            let (version, count, codec) = (bytes.u32()?, bytes.u16()?, bytes.u16()?);
            if !is_one(&magic) {
                return Err(bytes.broken(format!("no segment begins at byte {start}")));
            }
            if magic[7] == b'1' {
                bytes.seek(start)?;
                grids.push(block(&mut bytes)?);
                continue;
            }
            check_version(&bytes, version)?;
            segment(&mut bytes, count, codec, &mut grids)?;
        }
        Ok(Self { grids, data, place })
    }

    pub(super) fn lattice(
        &self,
        entry: &Entry<Descriptor>,
        limits: &Limits,
        greatest: f64,
    ) -> Result<Lattice, SceneError> {
        let block = self.unpacked(&entry.rest, limits)?;
        let block = Block {
            bytes: Bytes::new(&self.place, "NanoVDB", &block),
        };
        block.lattice(limits, greatest)
    }

    /// The block of a grid.
    fn unpacked(&self, descriptor: &Descriptor, limits: &Limits) -> Result<Cow<'_, [u8]>, SceneError> {
        let Descriptor { codec, at, size } = *descriptor;
        let mut bytes = Bytes::new(&self.place, "NanoVDB", self.data);
        bytes.seek(at)?;
        within(&self.place, "bytes of the decompressed grid", size, limits.file_bytes)?;
        match codec {
            0 => bytes.take_long(size).map(Cow::Borrowed),
            1 => {
                let packed = bytes.u64()?;
                let packed = bytes.take_long(packed)?;
                let unpacked = inflate(packed, size as usize);
                unpacked.map(Cow::Owned).map_err(|reason| bytes.broken(reason))
            }
            2 => {
                let mut unpacked = Vec::new();
                while (unpacked.len() as u64) < size {
                    let packed = bytes.u64()?;
                    let packed = bytes.take_long(packed)?;
                    let length = CHUNK.min(size - unpacked.len() as u64) as usize;
                    let chunk = blosc::decompress(packed, length)
                        .map_err(|reason| bytes.broken(format!("a chunk of Blosc: {reason}")))?;
                    unpacked.extend_from_slice(&chunk);
                }
                Ok(Cow::Owned(unpacked))
            }
            other => Err(bytes.unknown("the codec", &other.to_string(), "0 (none), 1 (zip) and 2 (Blosc) are")),
        }
    }
}

fn check_version(bytes: &Bytes, version: u32) -> Result<(), SceneError> {
    let parts = [version >> 21, version >> 10 & 0x7ff, version & 0x3ff];
    if parts[0] == MAJOR {
        return Ok(());
    }
    let [major, minor, patch] = parts;
    Err(bytes.unknown(
        "version",
        &format!("{major}.{minor}.{patch}"),
        &format!("versions {MAJOR}.x are"),
    ))
}

/// Reads the descriptions of a segment, and goes on behind its grids.
fn segment(bytes: &mut Bytes, count: u16, codec: u16, grids: &mut Vec<Entry<Descriptor>>) -> Result<(), SceneError> {
    let mut described = Vec::new();
    for _ in 0..count {
        let mut description = bytes.clone();
        bytes.take(DESCRIPTION)?;
        let (size, packed) = (description.u64()?, description.u64()?);
        description.take(8 + 8 + 4 + 4 + 48 + 24 + 24)?;
        let name = bytes.take_long(description.u32()?.into())?;
        let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
        described.push((String::from_utf8_lossy(name).into_owned(), size, packed));
    }
    for (name, size, packed) in described {
        let at = bytes.at();
        bytes.take_long(packed)?;
        let rest = Descriptor { codec, at, size };
        grids.push(Entry { name, rest });
    }
    Ok(())
}

/// Reads the description of a block that stands for itself, and goes on behind it.
fn block(bytes: &mut Bytes) -> Result<Entry<Descriptor>, SceneError> {
    let at = bytes.at();
    let mut header = bytes.clone();
    header.take(16)?;
    check_version(bytes, header.u32()?)?;
    header.take(12)?;
    let size = header.u64()?;
    let name = header.take(256)?;
    let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
    bytes.take_long(size.max(GRID))?;
    Ok(Entry {
        name: String::from_utf8_lossy(name).into_owned(),
        rest: Descriptor { codec: 0, at, size },
    })
}

/// How the values of leaves are written.
#[derive(Clone, Copy)]
enum Encoding {
    Floats,
    /// Numbers of so many bits, in steps above a least value; of as many as each leaf says where this is `None`.
    Steps(Option<u32>),
}

/// The block of a grid.
struct Block<'a> {
    bytes: Bytes<'a>,
}

impl Block<'_> {
    fn at(&self, place: u64) -> Result<Bytes<'_>, SceneError> {
        let mut bytes = self.bytes.clone();
        bytes.seek(place)?;
        Ok(bytes)
    }

    /// The place that lies `distance` from another one.
    fn beyond(&self, place: u64, distance: i64) -> Result<u64, SceneError> {
        let there = place.checked_add_signed(distance);
        there.ok_or_else(|| self.bytes.broken("a node refers to another one before the file"))
    }

    fn lattice(&self, limits: &Limits, greatest: f64) -> Result<Lattice, SceneError> {
        let (class, kind) = {
            let mut header = self.at(632)?;
            (header.u32()?, header.u32()?)
        };
        let encoding = match kind {
            1 => Encoding::Floats,
            13 => Encoding::Steps(Some(4)),
            14 => Encoding::Steps(Some(8)),
            15 => Encoding::Steps(Some(16)),
            16 => Encoding::Steps(None),
            other => {
                let known = "1 (floats) and 13 to 16 (quantised floats) are";
                return Err(self.bytes.unknown("the grid type", &other.to_string(), known));
            }
        };
        if !matches!(class, 0 | 2) {
            let known = "0 (unknown) and 2 (fog volumes, whose values are densities) are";
            return Err(self.bytes.unknown("the grid class", &class.to_string(), known));
        }
        let to_world = self.map()?;
        let mut tree = Tree::new(self.bytes.place(), limits);
        let root = self.beyond(GRID, self.at(GRID + 24)?.i64()?)?;
        let tiles = self.at(root + 24)?.u32()?;
        // Tiles follow the root, whose 64 bytes hold its box, their number and a few values.
        let mut table = self.at(root + 64)?;
        for _ in 0..tiles {
            let (key, child, active, value) = (table.u64()?, table.i64()?, table.u32()?, table.f32()?);
            table.take(8)?;
            // 21 bits for each axis, of which those of z are lowest.
            let origin = [key >> 42, key >> 21, key].map(|part| ((part & 0x1f_ffff) as u32).wrapping_shl(12) as i32);
            if child != 0 {
                self.upper(self.beyond(root, child)?, origin, &mut tree)?;
            } else if active != 0 {
                tree.add_tile(origin, Level::UPPER.edge(), value)?;
            }
        }
        tree.lattice(to_world, greatest, |leaf, values| self.leaf(leaf, encoding, values))
    }

    /// The map from the coordinates of voxels to the world.
    fn map(&self) -> Result<DMat4, SceneError> {
        let mut bytes = self.at(296 + 88)?;
        let mut numbers = [0.0; 9];
        for number in &mut numbers {
            *number = bytes.f64()?;
        }
        bytes.take(72)?;
        let translation = DVec3::new(bytes.f64()?, bytes.f64()?, bytes.f64()?);
        let linear = DMat3::from_cols_array(&numbers).transpose();
        let map = DMat4::from_translation(translation) * DMat4::from_mat3(linear);
        match map.is_finite() {
            true => Ok(map),
            false => Err(self.bytes.broken("a number of its map is not finite")),
        }
    }

    fn upper(&self, node: u64, origin: [i32; 3], tree: &mut Tree<u64>) -> Result<(), SceneError> {
        for (child, origin) in self.node(node, Level::UPPER, origin, tree)? {
            for (leaf, origin) in self.node(child, Level::LOWER, origin, tree)? {
                tree.add_leaf(origin, leaf)?;
            }
        }
        Ok(())
    }

    /// The children of a node, with their first voxels.
    fn node(
        &self,
        node: u64,
        level: Level,
        origin: [i32; 3],
        tree: &mut Tree<u64>,
    ) -> Result<Vec<(u64, [i32; 3])>, SceneError> {
        tree.visit(level)?;
        let count = level.count();
        let mut bytes = self.at(node)?;
        // Its box and flags come first, and after the masks a few values, up to a multiple of 32 bytes.
        bytes.take(32)?;
        let (active, children) = (bytes.take(count / 8)?, bytes.take(count / 8)?);
        let mut table = self.at(node + (32 + count as u64 / 4 + 16).next_multiple_of(32))?;
        let mut found = Vec::new();
        for index in 0..count {
            let entry: [u8; 8] = table.array()?;
            let child = level.origin(origin, index);
            let child = child.ok_or_else(|| self.bytes.broken("a node of it lies beyond the range of coordinates"))?;
            if is_set(children, index) {
                found.push((self.beyond(node, i64::from_le_bytes(entry))?, child));
            } else if is_set(active, index) {
                let [a, b, c, d, ..] = entry;
                tree.add_tile(child, level.child, f32::from_le_bytes([a, b, c, d]))?;
            }
        }
        Ok(found)
    }

    fn leaf(&self, leaf: u64, encoding: Encoding, values: &mut [f32; VOXELS]) -> Result<(), SceneError> {
        let mut bytes = self.at(leaf)?;
        bytes.take(15)?;
        let flags = bytes.u8()?;
        bytes.take(VOXELS / 8)?;
        let (least, step) = (bytes.f32()?, bytes.f32()?);
        bytes.take(8)?;
        let bits = match encoding {
            Encoding::Floats => {
                for value in values {
                    *value = bytes.f32()?;
                }
                return Ok(());
            }
            Encoding::Steps(Some(bits)) => bits,
            // Its logarithm lies above five flags.
            Encoding::Steps(None) => 1 << (flags >> 5).min(4),
        };
        let codes = bytes.take(VOXELS * bits as usize / 8)?;
        for (index, value) in values.iter_mut().enumerate() {
            let bit = index * bits as usize;
            let code = match bits {
                16 => u32::from(codes[bit / 8]) | u32::from(codes[bit / 8 + 1]) << 8,
                _ => u32::from(codes[bit / 8]) >> (bit % 8) & ((1 << bits) - 1),
            };
            *value = code as f32 * step + least;
        }
        Ok(())
    }
}
