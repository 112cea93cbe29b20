//! Files of OpenVDB (`io/Archive.cc`, `io/Compression.h`, `tree/RootNode.h`, `tree/InternalNode.h` and `tree/LeafNode.h` of OpenVDB 10): a header, and grids at
//! places that it names; of each first its topology, node by node, and then the values of its leaves.

use super::Entry;
use super::blosc;
use super::bytes::Bytes;
use super::tree::{Lattice, Level, Tree, VOXELS, is_set};
use crate::scene::error::{Place, SceneError};
use crate::scene::limits::Limits;
use crate::scene::loader::LoadedFile;
use exr::prelude::f16;
use flate2::bufread::ZlibDecoder;
use glam::DMat4;
use std::io::Read;

const MAGIC: [u8; 8] = *b" BDV\0\0\0\0";
/// Of files since OpenVDB 1.2 of 2013.
const VERSIONS: std::ops::RangeInclusive<u32> = 222..=224;
/// Bytes of the identifier in the header.
const UUID: usize = 36;
const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;
const HALF: &str = "_HalfFloat";
/// What stands between the name of a grid and a number that tells it from others of the name.
const NUMBERED: char = '\u{1e}';

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
    kind: String,
    grid: u64,
    leaves: u64,
    /// Whether its values have 16 bits.
    half: bool,
}

impl<'a> Archive<'a> {
    pub(super) fn open(file: &'a LoadedFile) -> Result<Self, SceneError> {
        let place = Place::whole(&file.name);
        let data = &file.bytes[..];
        let mut bytes = Bytes::new(&place, "OpenVDB", data);
        bytes.take(MAGIC.len())?;
        let version = bytes.u32()?;
        if !VERSIONS.contains(&version) {
            let known = format!("versions {} to {} are", VERSIONS.start(), VERSIONS.end());
            return Err(bytes.unknown("version", &version.to_string(), &known));
        }
        let (_major, _minor, with_places) = (bytes.u32()?, bytes.u32()?, bytes.u8()?);
        if with_places == 0 {
            return Err(bytes.broken("it does not say where its grids are, as one that was written as a stream"));
        }
        bytes.take(UUID)?;
        metadata(&mut bytes, |_, _| {})?;
        let mut grids = Vec::new();
        for _ in 0..bytes.u32()? {
            let name = bytes.text()?;
            let name = name.split(NUMBERED).next().unwrap_or_default().to_owned();
            let (kind, _instance_of) = (bytes.text()?, bytes.text()?);
            let [grid, leaves, end] = [bytes.u64()?, bytes.u64()?, bytes.u64()?];
            let rest = Descriptor {
                half: kind.ends_with(HALF),
                kind: kind.trim_end_matches(HALF).to_owned(),
                grid,
                leaves,
            };
            grids.push(Entry { name, rest });
            if end < bytes.at() {
                return Err(bytes.broken("its grids lie within each other"));
            }
            bytes.seek(end)?;
        }
        Ok(Self { grids, data, place })
    }

    pub(super) fn lattice(
        &self,
        entry: &Entry<Descriptor>,
        limits: &Limits,
        greatest: f64,
    ) -> Result<Lattice, SceneError> {
        let mut bytes = Bytes::new(&self.place, "OpenVDB", self.data);
        let Descriptor {
            kind,
            grid,
            leaves,
            half,
        } = &entry.rest;
        if kind != "Tree_float_5_4_3" {
            return Err(bytes.unknown("the grid type", kind, "those of floats, `Tree_float_5_4_3`, are"));
        }
        bytes.seek(*grid)?;
        let compression = bytes.u32()?;
        let mut class = String::new();
        metadata(&mut bytes, |name, value| {
            if name == "class" {
                class = String::from_utf8_lossy(value).into_owned();
            }
        })?;
        if class == "level set" {
            return Err(bytes.unknown("the grid class", &class, "fog volumes, whose values are densities, are"));
        }
        let to_world = transform(&mut bytes)?;
        let mut reading = Reading {
            bytes,
            compression,
            half: *half,
            background: 0.0,
        };
        let tree = reading.topology(limits)?;
        reading.bytes.seek(*leaves)?;
        tree.lattice(to_world, greatest, |(), values| {
            let mask = reading.bytes.take(VOXELS / 8)?;
            reading.values(mask, values)
        })
    }
}

/// Reads a list of names and values, of which `each` learns.
fn metadata(bytes: &mut Bytes, mut each: impl FnMut(&str, &[u8])) -> Result<(), SceneError> {
    for _ in 0..bytes.u32()? {
        let (name, _kind) = (bytes.text()?, bytes.text()?);
        let length = bytes.u32()?;
        each(&name, bytes.take(length as usize)?);
    }
    Ok(())
}

/// The map from the coordinates of voxels to the world.
fn transform(bytes: &mut Bytes) -> Result<DMat4, SceneError> {
    let kind = bytes.text()?;
    let vector = |bytes: &mut Bytes| Ok::<_, SceneError>([bytes.f64()?, bytes.f64()?, bytes.f64()?].into());
    let map = match kind.as_str() {
        "TranslationMap" => DMat4::from_translation(vector(bytes)?),
        "ScaleMap" | "UniformScaleMap" => {
            let scale = vector(bytes)?;
            // The same again in other forms.
            bytes.take(4 * 24)?;
            DMat4::from_scale(scale)
        }
        "ScaleTranslateMap" | "UniformScaleTranslateMap" => {
            let (translation, scale) = (vector(bytes)?, vector(bytes)?);
            bytes.take(4 * 24)?;
            DMat4::from_translation(translation) * DMat4::from_scale(scale)
        }
        "AffineMap" | "UnitaryMap" => {
            let mut numbers = [0.0; 16];
            for number in &mut numbers {
                *number = bytes.f64()?;
            }
            // Its rows are our columns: there vectors stand to the left of matrices.
            DMat4::from_cols_array(&numbers)
        }
        _ => return Err(bytes.unknown("the map", &kind, "affine maps are")),
    };
    match map.is_finite() {
        true => Ok(map),
        false => Err(bytes.broken("a number of its map is not finite")),
    }
}

/// A grid as it is read.
struct Reading<'a> {
    bytes: Bytes<'a>,
    compression: u32,
    half: bool,
    /// The value where nothing is.
    background: f32,
}

impl<'a> Reading<'a> {
    fn topology<'l>(&mut self, limits: &'l Limits) -> Result<Tree<'l, ()>, SceneError>
    where
        'a: 'l,
    {
        let mut tree = Tree::new(self.bytes.place(), limits);
        let buffers = self.bytes.u32()?;
        if buffers != 1 {
            return Err(self
                .bytes
                .broken(format!("its tree has {buffers} values for each voxel, not 1")));
        }
        self.background = self.bytes.f32()?;
        let (tiles, children) = (self.bytes.u32()?, self.bytes.u32()?);
        for _ in 0..tiles {
            let (origin, value, active) = (self.bytes.coordinates()?, self.bytes.f32()?, self.bytes.u8()?);
            self.check(origin)?;
            if active != 0 {
                tree.add_tile(origin, Level::UPPER.edge(), value)?;
            }
        }
        for _ in 0..children {
            let origin = self.bytes.coordinates()?;
            self.check(origin)?;
            self.upper(origin, &mut tree)?;
        }
        Ok(tree)
    }

    /// Refuses what no node begins at.
    fn check(&self, origin: [i32; 3]) -> Result<(), SceneError> {
        match origin.iter().all(|c| c.rem_euclid(Level::UPPER.edge() as i32) == 0) {
            true => Ok(()),
            false => Err(self.bytes.broken(format!("no node begins at {origin:?}"))),
        }
    }

    fn upper(&mut self, origin: [i32; 3], tree: &mut Tree<()>) -> Result<(), SceneError> {
        for child in self.node(Level::UPPER, origin, tree)? {
            for leaf in self.node(Level::LOWER, child, tree)? {
                // Which of its voxels are active is said again with their values.
                self.bytes.take(VOXELS / 8)?;
                tree.add_leaf(leaf, ())?;
            }
        }
        Ok(())
    }

    /// Reads a node but for its children, whose first voxels it gives back.
    fn node(&mut self, level: Level, origin: [i32; 3], tree: &mut Tree<()>) -> Result<Vec<[i32; 3]>, SceneError> {
        tree.visit(level)?;
        let count = level.count();
        let (children, active) = (self.bytes.take(count / 8)?, self.bytes.take(count / 8)?);
        let mut values = vec![0.0; count];
        self.values(active, &mut values)?;
        let mut found = Vec::new();
        for (index, value) in values.iter().enumerate() {
            let child = level.origin(origin, index);
            let child = child.ok_or_else(|| self.bytes.broken("a node of it lies beyond the range of coordinates"))?;
            if is_set(children, index) {
                found.push(child);
            } else if is_set(active, index) {
                tree.add_tile(child, level.child, *value)?;
            }
        }
        Ok(found)
    }

    /// The values of a node or leaf, of which `active` says which are active (`io::readCompressedValues`).
    fn values(&mut self, active: &[u8], values: &mut [f32]) -> Result<(), SceneError> {
        let told = self.bytes.u8()?;
        if told > 6 {
            return Err(self
                .bytes
                .broken(format!("a node's values are written in way {told}; there are 0 to 6")));
        }
        let mut inactive = [
            if told == 0 { self.background } else { -self.background },
            self.background,
        ];
        if matches!(told, 2 | 4 | 5) {
            inactive[0] = self.bytes.f32()?;
        }
        if told == 5 {
            inactive[1] = self.bytes.f32()?;
        }
        let second = match told {
            3..=5 => Some(self.bytes.take(active.len())?),
            _ => None,
        };
        if self.compression & ACTIVE_MASK == 0 || told == 6 {
            return self.numbers(values);
        }
        let count = active.iter().map(|byte| byte.count_ones() as usize).sum();
        let mut read = vec![0.0; count];
        self.numbers(&mut read)?;
        let mut read = read.into_iter();
        for (index, value) in values.iter_mut().enumerate() {
            let of_second = second.is_some_and(|mask| is_set(mask, index));
            *value = match is_set(active, index) {
                true => read.next().unwrap_or_default(),
                false => inactive[usize::from(of_second)],
            };
        }
        Ok(())
    }

    /// Numbers one after the other, perhaps compressed (`io::readData`).
    fn numbers(&mut self, values: &mut [f32]) -> Result<(), SceneError> {
        if self.half && values.is_empty() {
            return Ok(());
        }
        let size = if self.half { 2 } else { 4 };
        let length = values.len() * size;
        let unpacked;
        let data = if self.compression & (ZIP | BLOSC) == 0 {
            self.bytes.take(length)?
        } else {
            let packed = self.bytes.i64()?;
            if packed <= 0 {
                // What does not become shorter stands as it is.
                if packed.unsigned_abs() != length as u64 {
                    return Err(self
                        .bytes
                        .broken(format!("{} bytes of values, not {length}", packed.unsigned_abs())));
                }
                self.bytes.take(length)?
            } else {
                let packed = self.bytes.take_long(packed.unsigned_abs())?;
                unpacked = match self.compression & BLOSC {
                    0 => inflate(packed, length).map_err(|reason| self.bytes.broken(reason))?,
                    _ => blosc::decompress(packed, length)
                        .map_err(|reason| self.bytes.broken(format!("a chunk of Blosc: {reason}")))?,
                };
                &unpacked
            }
        };
        for (value, bytes) in values.iter_mut().zip(data.chunks_exact(size)) {
            *value = match *bytes {
                [a, b] => f16::from_le_bytes([a, b]).to_f32(),
                [a, b, c, d] => f32::from_le_bytes([a, b, c, d]),
                _ => 0.0,
            };
        }
        Ok(())
    }
}

/// The `length` bytes that data of zlib hold.
pub(super) fn inflate(packed: &[u8], length: usize) -> Result<Vec<u8>, String> {
    let mut unpacked = Vec::new();
    unpacked
        .try_reserve_exact(length)
        .map_err(|_| "memory does not hold its content")?;
    let mut reader = ZlibDecoder::new(packed).take(length as u64 + 1);
    reader
        .read_to_end(&mut unpacked)
        .map_err(|error| format!("zlib data: {error}"))?;
    match unpacked.len() == length {
        true => Ok(unpacked),
        false => Err(format!("zlib data of {} bytes or more, not {length}", unpacked.len())),
    }
}
