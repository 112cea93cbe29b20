//! Files of volumes: Mitsuba's, those of OpenVDB and those of NanoVDB, told apart by their content.

mod blocks;
mod blosc;
mod bytes;
mod nano_vdb;
mod open_vdb;
#[cfg(test)]
pub(crate) mod tests;
mod tree;
mod vol;

pub(crate) use blocks::{Blocks, blocks};
pub(crate) use tree::Lattice;

use super::error::{Place, SceneError, list, shortened};
use super::limits::Limits;
use super::loader::LoadedFile;
use crate::medium::Grid;
use glam::DVec3;

/// A lattice, and where its file says that it lies.
pub(crate) enum VolumeFile {
    /// Between the lower and the upper corner of a box.
    Box { grid: Grid, bounds: [DVec3; 2] },
    /// By a map of its own.
    Placed(Lattice),
}

/// A tree of voxels in a file.
struct Entry<T> {
    name: String,
    rest: T,
}

/// Reads a file. Of several grids that it may hold, the one `name` is taken, or else `density`, or else the first. Values below zero, which mean
/// nothing, count as 0, and those above `greatest` as this.
pub(crate) fn read(
    file: &LoadedFile,
    name: Option<&str>,
    limits: &Limits,
    greatest: f64,
) -> Result<VolumeFile, SceneError> {
    if open_vdb::is_one(&file.bytes) {
        let archive = open_vdb::Archive::open(file)?;
        let entry = chosen(file, &archive.grids, name)?;
        return archive.lattice(entry, limits, greatest).map(VolumeFile::Placed);
    }
    if nano_vdb::is_one(&file.bytes) {
        let archive = nano_vdb::Archive::open(file)?;
        let entry = chosen(file, &archive.grids, name)?;
        return archive.lattice(entry, limits, greatest).map(VolumeFile::Placed);
    }
    let (grid, bounds) = vol::read(file, limits, greatest)?;
    Ok(VolumeFile::Box { grid, bounds })
}

/// Whether a file of trees holds a grid of the name.
pub(crate) fn holds(file: &LoadedFile, name: &str) -> Result<bool, SceneError> {
    let has = |known: &str| known == name;
    if open_vdb::is_one(&file.bytes) {
        return Ok(open_vdb::Archive::open(file)?
            .grids
            .iter()
            .any(|entry| has(&entry.name)));
    }
    if nano_vdb::is_one(&file.bytes) {
        return Ok(nano_vdb::Archive::open(file)?
            .grids
            .iter()
            .any(|entry| has(&entry.name)));
    }
    Ok(false)
}

/// The grid that is taken.
fn chosen<'a, T>(file: &LoadedFile, grids: &'a [Entry<T>], name: Option<&str>) -> Result<&'a Entry<T>, SceneError> {
    let find = |name: &str| grids.iter().find(|entry| entry.name == name);
    let found = match name {
        Some(name) => find(name),
        None => find("density").or(grids.first()),
    };
    found.ok_or_else(|| {
        let names: Vec<String> = grids.iter().take(20).map(|entry| shortened(&entry.name)).collect();
        let wanted = name.map_or(String::new(), |name| format!(" `{}`", shortened(name)));
        let names = list(names.iter().map(String::as_str));
        SceneError::data(
            &Place::whole(&file.name),
            format!("the file has no grid{wanted}; it has: {names}"),
        )
    })
}
