//! Mitsuba's grid volumes: `VOL`, a version, the type of the values, their number along x, y and z, their channels and the box that they fill; then
//! the values, x fastest. All is little-endian (W. Jakob, Mitsuba documentation, section on `gridvolume`).

use crate::medium::Grid;
use crate::scene::error::{Place, SceneError, within};
use crate::scene::limits::Limits;
use crate::scene::loader::LoadedFile;
use crate::spectrum::CHANNELS;
use glam::DVec3;

const HEADER: usize = 48;
const FLOAT32: i32 = 1;
const FLOAT16: i32 = 2;
const BYTES: i32 = 3;

/// Reads a file: its lattice, and the lower and upper corner of the box that it says. Values below zero, which mean nothing, count as 0, and
/// those above `greatest` as this.
pub(super) fn read(file: &LoadedFile, limits: &Limits, greatest: f64) -> Result<(Grid, [DVec3; 2]), SceneError> {
    let place = Place::whole(&file.name);
    let broken = |reason: String| SceneError::data(&place, format!("broken grid volume: {reason}"));
    let bytes = &file.bytes[..];
    if bytes.len() < HEADER {
        return Err(broken(format!(
            "{} bytes, fewer than the {HEADER} of its header",
            bytes.len()
        )));
    }
    if &bytes[..3] != b"VOL" || bytes[3] != 3 {
        return Err(broken("it does not begin with `VOL` and version 3".into()));
    }
    let word = |index: usize| std::array::from_fn::<u8, 4, _>(|byte| bytes[4 * index + byte]);
    let integer = |index: usize| i32::from_le_bytes(word(index));
    let encoding = integer(1);
    let width = match encoding {
        FLOAT32 => 4,
        FLOAT16 => 2,
        BYTES => 1,
        other => {
            let reason = format!(
                "values of type {other}; those of types 1, 2 and 3 are read: floats of 32 and 16 bits, and bytes"
            );
            return Err(broken(reason));
        }
    };
    let written: [i32; 3] = std::array::from_fn(|axis| integer(2 + axis));
    let size = written.map(|size| u32::try_from(size).ok().filter(|size| *size > 0));
    let [Some(x), Some(y), Some(z)] = size else {
        return Err(broken(format!("{written:?} values along x, y and z")));
    };
    let channels = match integer(5) {
        1 => 1,
        3 => CHANNELS,
        other => return Err(broken(format!("{other} channels; 1 or 3 are read"))),
    };
    let voxels = u64::from(x) * u64::from(y) * u64::from(z);
    within(&place, "number of voxels", voxels, limits.image_texels)?;
    let expected = voxels * channels as u64 * width;
    let data = &bytes[HEADER..];
    if (data.len() as u64) < expected {
        return Err(broken(format!(
            "{} bytes of values, not the {expected} of {x} x {y} x {z}",
            data.len()
        )));
    }
    let corner = |first: usize| {
        DVec3::from_array(std::array::from_fn(|axis| {
            f64::from(f32::from_le_bytes(word(first + axis)))
        }))
    };
    let bounds = [corner(6), corner(9)];
    let memory = |_| SceneError::data(&place, "memory does not hold the volume");
    let mut grid = Grid::new([x, y, z], channels > 1).map_err(memory)?;
    let value = |index: usize| match encoding {
        FLOAT32 => f32::from_le_bytes(std::array::from_fn(|byte| data[4 * index + byte])),
        FLOAT16 => exr::prelude::f16::from_le_bytes([data[2 * index], data[2 * index + 1]]).to_f32(),
        _ => f32::from(data[index]) / 255.0,
    };
    let mut index = 0;
    for z in 0..z {
        for y in 0..y {
            for x in 0..x {
                let mut voxel = [0.0; CHANNELS];
                for channel in &mut voxel[..channels] {
                    let value = value(index);
                    if !value.is_finite() {
                        return Err(broken(format!("the value of voxel ({x}, {y}, {z}) is not finite")));
                    }
                    *channel = value.clamp(0.0, greatest as f32);
                    index += 1;
                }
                grid.set([x, y, z], &voxel).map_err(memory)?;
            }
        }
    }
    Ok((grid, bounds))
}
