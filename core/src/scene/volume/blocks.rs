//! The table of a lattice in blocks (`hgridvolume.cpp` of Mitsuba 0.6): its box, the number of blocks along each axis, and which of them there are.

use super::bytes::Bytes;
use crate::scene::error::{Place, SceneError};
use crate::scene::loader::LoadedFile;
use glam::DVec3;

/// What the file says.
pub(crate) struct Blocks {
    /// Lower and upper corner.
    pub(crate) bounds: [DVec3; 2],
    /// Blocks along each axis.
    pub(crate) along: [u32; 3],
    /// The numbers of each block along the axes.
    pub(crate) blocks: Vec<[u32; 3]>,
}

/// Reads a table.
pub(crate) fn blocks(file: &LoadedFile) -> Result<Blocks, SceneError> {
    let place = Place::whole(&file.name);
    let mut bytes = Bytes::new(&place, "hgridvolume", &file.bytes);
    let mut corner = [0.0; 6];
    for number in &mut corner {
        *number = f64::from(bytes.f32()?);
    }
    let [a, b, c, d, e, f] = corner;
    let along = bytes.coordinates()?;
    let mut blocks = Vec::new();
    while bytes.at() < file.bytes.len() as u64 {
        let block = bytes.coordinates()?;
        if (0..3).any(|axis| block[axis] < 0 || block[axis] >= along[axis]) {
            return Err(bytes.broken(format!(
                "it names a block {block:?}, and there are {along:?} along the axes"
            )));
        }
        blocks.push(block.map(i32::unsigned_abs));
    }
    Ok(Blocks {
        bounds: [DVec3::new(a, b, c), DVec3::new(d, e, f)],
        along: along.map(i32::unsigned_abs),
        blocks,
    })
}
