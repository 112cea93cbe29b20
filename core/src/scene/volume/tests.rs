//! Files of OpenVDB and NanoVDB against what other programs wrote, and broken ones.
//!
//! `fog.vdb` was written by Python's `pyopenvdb` of OpenVDB 10.0.1, and the other files by `vdb_tool -read fog.vdb -write codec=zip fog-zip.vdb`, with `none`, or
//! to `fog-zip.nvdb`, and with `bits=8` or `bits=N` for values in steps. All of them were compressed by gzip. With
//! `f(x, y, z) = 1 + 0.25 (x + 4) + 0.5 y + 0.125 z`, its grids are, in a class of fog volumes and with the linear transform of voxel size 0.5 and translation (1, 2, 3):
//!
//! * `density`: `f` for x from -3 to 5, y from 0 to 8 and z from 4 to 11, and 0.75 from (128, 0, 0) to (255, 127, 127), which `fill` makes a tile of;
//! * `temperature`, saved as half: 1000 + 8 x for x from -3 to 5, y from 0 to 1 and z from 4 to 5.

use super::tree::{Lattice, Level, VOXELS};
use super::{VolumeFile, read};
use crate::random::{PathRandom, Stream};
use crate::scene::error::SceneError;
use crate::scene::limits::Limits;
use crate::scene::loader::LoadedFile;
use flate2::bufread::GzDecoder;
use glam::DVec3;
use std::io::Read;

const FILES: [(&str, &[u8]); 7] = [
    ("fog.vdb", include_bytes!("tests/fog.vdb.gz")),
    ("fog-zip.vdb", include_bytes!("tests/fog-zip.vdb.gz")),
    ("fog-none.vdb", include_bytes!("tests/fog-none.vdb.gz")),
    ("fog-zip.nvdb", include_bytes!("tests/fog-zip.nvdb.gz")),
    ("fog-blosc.nvdb", include_bytes!("tests/fog-blosc.nvdb.gz")),
    ("fog-8.nvdb", include_bytes!("tests/fog-8.nvdb.gz")),
    ("fog-N.nvdb", include_bytes!("tests/fog-N.nvdb.gz")),
];

fn loaded(name: &str, bytes: Vec<u8>) -> LoadedFile {
    LoadedFile {
        name: name.to_owned(),
        bytes: bytes.into(),
    }
}

/// The files as other programs wrote them.
pub(crate) fn files() -> Vec<(&'static str, Vec<u8>)> {
    let unpacked = |packed: &[u8]| {
        let mut bytes = Vec::new();
        GzDecoder::new(packed).read_to_end(&mut bytes).unwrap();
        bytes
    };
    FILES.map(|(name, packed)| (name, unpacked(packed))).into()
}

fn lattice(file: &LoadedFile, name: Option<&str>, limits: &Limits) -> Result<Lattice, SceneError> {
    match read(file, name, limits, 1e12)? {
        VolumeFile::Placed(lattice) => Ok(lattice),
        VolumeFile::Box { .. } => panic!("{} is no tree", file.name),
    }
}

/// The value at the coordinates of a voxel in the file.
fn value(lattice: &Lattice, voxel: [i32; 3]) -> f32 {
    let size = lattice.grid.size();
    let within: [u32; 3] = std::array::from_fn(|axis| (voxel[axis] - lattice.first[axis]) as u32);
    match within.iter().zip(size).all(|(voxel, size)| *voxel < size) {
        true => lattice.grid.voxel(within)[0],
        false => 0.0,
    }
}

fn written([x, y, z]: [i32; 3]) -> f32 {
    let inside = (-3..6).contains(&x) && (0..9).contains(&y) && (4..12).contains(&z);
    let tile = (128..256).contains(&x) && (0..128).contains(&y) && (0..128).contains(&z);
    match (inside, tile) {
        (true, _) => 1.0 + 0.25 * (x + 4) as f32 + 0.5 * y as f32 + 0.125 * z as f32,
        (_, true) => 0.75,
        _ => 0.0,
    }
}

#[test]
fn files_of_other_programs_are_read_as_they_are_written() {
    for (name, bytes) in files() {
        let file = loaded(name, bytes);
        let density = lattice(&file, None, &Limits::default()).unwrap_or_else(|error| panic!("{error}"));
        // Values in steps are near to those that were written.
        let tolerance = if name.contains("-8") || name.contains("-N") {
            0.02
        } else {
            0.0
        };
        for index in 0..16 * 16 * 16 {
            let voxel = [index % 16 - 8, index / 16 % 16 - 2, index / 256 + 1];
            let (found, expected) = (value(&density, voxel), written(voxel));
            assert!(
                (found - expected).abs() <= tolerance,
                "{name} {voxel:?}: {found}, not {expected}"
            );
        }
        for voxel in [[128, 0, 0], [255, 127, 127], [200, 3, 100], [127, 5, 5], [130, 5, 128]] {
            assert_eq!(value(&density, voxel), written(voxel), "{name} {voxel:?}");
        }
        let size = density.grid.size().map(f64::from);
        let at = |voxel: [i32; 3]| {
            let unit = DVec3::from_array(std::array::from_fn(|axis| {
                (f64::from(voxel[axis] - density.first[axis]) + 0.5) / size[axis]
            }));
            density.to_world.transform_point3(unit)
        };
        for (voxel, world) in [
            ([0, 0, 0], DVec3::new(1.0, 2.0, 3.0)),
            ([5, 8, -2], DVec3::new(3.5, 6.0, 2.0)),
        ] {
            assert!(at(voxel).distance(world) < 1e-9, "{name}: {}", at(voxel));
        }
        let temperature = lattice(&file, Some("temperature"), &Limits::default()).unwrap();
        for x in -3..6 {
            let (found, expected) = (value(&temperature, [x, 1, 5]), 1000.0 + 8.0 * x as f32);
            assert!(
                (found - expected).abs() <= tolerance * 400.0,
                "{name} {x}: {found}, not {expected}"
            );
        }
        assert_eq!(value(&temperature, [6, 1, 5]), 0.0, "{name}");
        // One brick for all of the tile's.
        assert!(density.grid.bytes() < 200_000, "{name}: {} bytes", density.grid.bytes());
    }
}

#[test]
fn what_is_not_there_or_not_read_is_told() {
    for (name, bytes) in files() {
        let file = loaded(name, bytes);
        let message = |result: Result<Lattice, SceneError>| result.err().unwrap().to_string();
        let missing = message(lattice(&file, Some("heat"), &Limits::default()));
        assert_eq!(
            missing,
            // OpenVDB's program writes them the other way around.
            match name {
                "fog.vdb" => format!("{name}: the file has no grid `heat`; it has: density, temperature"),
                _ => format!("{name}: the file has no grid `heat`; it has: temperature, density"),
            }
        );
        let limits = Limits {
            texture_bytes: 10_000,
            ..Limits::default()
        };
        let large = lattice(&file, None, &limits).err().unwrap();
        assert!(
            matches!(large, SceneError::Limit { limit: 10_000, .. }),
            "{name}: {large}"
        );
    }
    let levels = nano_vdb("a", 1, &[([0; 3], [1.0; VOXELS])]);
    let refused = lattice(&loaded("a.nvdb", levels), None, &Limits::default())
        .err()
        .unwrap();
    let expected = "a.nvdb: the grid class `1` of NanoVDB files is not read here; 0 (unknown) and 2 (fog volumes, whose values are densities) are";
    assert_eq!(refused.to_string(), expected);
    let broken = nano_vdb("a", 2, &[([0; 3], [f32::NAN; VOXELS])]);
    let refused = lattice(&loaded("a.nvdb", broken), None, &Limits::default())
        .err()
        .unwrap();
    assert_eq!(
        refused.to_string(),
        "a.nvdb: a value of the leaf at [0, 0, 0] is not finite"
    );
}

/// Files that are cut off, and files of which bytes were changed: an error or a lattice, and neither a panic nor much memory.
#[test]
fn broken_files_are_errors() {
    let limits = Limits {
        texture_bytes: 1 << 22,
        file_bytes: 1 << 22,
        ..Limits::default()
    };
    let mut random = PathRandom::new(5, 1, Stream::Probe, 1);
    let mut refused = 0;
    for (name, bytes) in files() {
        for part in 0..40 {
            let cut = bytes[..bytes.len() * part / 40].to_vec();
            let found = read(&loaded(name, cut), Some("temperature"), &limits, 1e12);
            refused += u32::from(found.is_err());
        }
        // What the nodes refer to lies near the beginning of the file, of its grids and of its tables.
        for _ in 0..60 {
            let mut changed = bytes.clone();
            for _ in 0..4 {
                let within = [400, 2000, changed.len()][(random.next_1d() * 3.0) as usize % 3].min(changed.len());
                let at = (random.next_1d() * within as f32) as usize % changed.len();
                changed[at] = (random.next_1d() * 256.0) as u8;
            }
            if super::open_vdb::is_one(&changed) || super::nano_vdb::is_one(&changed) {
                refused += u32::from(lattice(&loaded(name, changed), None, &limits).is_err());
            }
        }
    }
    assert!(refused > 300, "{refused}");
}

/// A block of NanoVDB 32.3 in a file, not compressed: leaves by their number along each axis, of which there are up to 512, and the values of
/// each, z fastest.
pub(crate) fn nano_vdb(name: &str, class: u32, leaves: &[([u32; 3], [f32; VOXELS])]) -> Vec<u8> {
    const ROOT: usize = 672 + 64;
    const UPPER: usize = ROOT + 64 + 32;
    const LOWER: usize = UPPER + 8256 + 8 * Level::UPPER.count();
    const LOWER_BYTES: usize = 1088 + 8 * Level::LOWER.count();
    const LEAF_BYTES: usize = 96 + 4 * VOXELS;
    let number = |place: [u32; 3], log2: u32| ((place[0] << (2 * log2)) | (place[1] << log2) | place[2]) as usize;
    let mut lower: Vec<usize> = leaves
        .iter()
        .map(|(place, _)| number(place.map(|c| c / 16), 5))
        .collect();
    lower.sort_unstable();
    lower.dedup();
    let first_leaf = LOWER + lower.len() * LOWER_BYTES;
    let mut block = vec![0; first_leaf + leaves.len() * LEAF_BYTES];
    let mut put = |at: usize, bytes: &[u8]| block[at..at + bytes.len()].copy_from_slice(bytes);
    let version = (32_u32 << 21) | (3 << 10);
    put(0, b"NanoVDB0");
    put(16, &version.to_le_bytes());
    put(40, name.as_bytes());
    for axis in 0..3 {
        put(296 + 88 + 32 * axis, &1.0_f64.to_le_bytes());
    }
    put(632, &class.to_le_bytes());
    put(636, &1_u32.to_le_bytes());
    put(672 + 24, &64_u64.to_le_bytes());
    put(ROOT + 24, &1_u32.to_le_bytes());
    put(ROOT + 64 + 8, &((UPPER - ROOT) as u64).to_le_bytes());
    let refer = |block: &mut Vec<u8>, from: usize, count: usize, index: usize, to: usize| {
        block[from + 32 + count / 8 + index / 8] |= 1 << (index % 8);
        let entry = from + (48 + count / 4).next_multiple_of(32) + 8 * index;
        block[entry..entry + 8].copy_from_slice(&((to - from) as u64).to_le_bytes());
    };
    for (index, place) in lower.iter().enumerate() {
        refer(
            &mut block,
            UPPER,
            Level::UPPER.count(),
            *place,
            LOWER + index * LOWER_BYTES,
        );
    }
    for (index, (place, values)) in leaves.iter().enumerate() {
        let node = lower.binary_search(&number(place.map(|c| c / 16), 5)).unwrap();
        let leaf = first_leaf + index * LEAF_BYTES;
        let within = number(place.map(|c| c % 16), 4);
        refer(
            &mut block,
            LOWER + node * LOWER_BYTES,
            Level::LOWER.count(),
            within,
            leaf,
        );
        for (value, bytes) in values.iter().zip(block[leaf + 96..].chunks_exact_mut(4)) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
    }
    let mut file = b"NanoVDB0".to_vec();
    file.extend(version.to_le_bytes());
    file.extend([1, 0, 0, 0]);
    let mut description = [0; 176];
    description[..8].copy_from_slice(&(block.len() as u64).to_le_bytes());
    description[8..16].copy_from_slice(&(block.len() as u64).to_le_bytes());
    description[136..140].copy_from_slice(&(name.len() as u32 + 1).to_le_bytes());
    file.extend(description);
    file.extend(name.as_bytes());
    file.push(0);
    file.extend(block);
    file
}

/// 512^3 voxels, about 5 % of them in leaves, take at most twice their file, the bounds of bricks included.
#[test]
fn sparse_files_take_little_memory() {
    let leaf = |index: u32| [index % 64, index / 64 % 64, index / 4096];
    let leaves: Vec<_> = (0..64 * 64 * 64)
        .step_by(19)
        .map(|index| (leaf(index), [0.5 + index as f32; VOXELS]))
        .collect();
    let file = nano_vdb("density", 2, &leaves);
    let bytes = file.len() as u64;
    let lattice = lattice(&loaded("a.nvdb", file), None, &Limits::default()).unwrap();
    assert_eq!(lattice.grid.size(), [512; 3]);
    for index in [0, 19, 5700, 262_143] {
        let first = leaf(index).map(|c| c as i32 * 8);
        assert_eq!(value(&lattice, first), 0.5 + index as f32);
        assert_eq!(value(&lattice, first.map(|c| c + 7)), 0.5 + index as f32);
    }
    let bounds = 4 * 64 * 64 * 64;
    assert!(
        lattice.grid.bytes() + bounds <= 2 * bytes,
        "{} bytes",
        lattice.grid.bytes()
    );
}
