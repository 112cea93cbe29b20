//! Volumes of lattices, and where they lie.

use super::Builder;
use super::texture::colour;
use crate::math::Transform;
use crate::medium::{Grid, GridVolume, Interpolation};
use crate::scene::error::{SceneError, within};
use crate::scene::reader::Reader;
use crate::scene::spectrum::{Use, greatest};
use crate::scene::volume::{self, Blocks, VolumeFile};
use crate::spectrum::Spectrum;
use glam::{DMat4, DVec3};
use std::sync::Arc;

/// A lattice, the map from the unit cube that it fills, and how far from its faces it begins \[voxels\].
struct Placed {
    grid: Arc<Grid>,
    unit: DMat4,
    margin: f64,
}

impl Placed {
    /// A lattice whose outer voxels have their middles on the faces of the box between two corners, outside of which is nothing, as in Mitsuba
    /// 0.6.
    fn around_middles(grid: Grid, [lower, upper]: [DVec3; 2]) -> Self {
        let cells = DVec3::from_array(grid.size().map(|size| f64::from((size - 1).max(1))));
        let half = 0.5 * (upper - lower) / cells;
        Self {
            grid: Arc::new(grid),
            unit: unit_to(lower - half, upper + half),
            margin: 0.5,
        }
    }
}

impl Builder<'_, '_> {
    pub(super) fn grid_volume(&mut self, reader: &Reader, used: Use) -> Result<GridVolume, SceneError> {
        let to_world = reader.transform("to_world")?.unwrap_or_default();
        let interpolation = reader.choice(
            "filter_type",
            &[
                ("trilinear", Interpolation::Linear),
                ("nearest", Interpolation::Nearest),
            ],
            Interpolation::Linear,
        )?;
        reader.accept(&["raw", "accel", "send_data"]);
        if !reader.choice(
            "wrap_mode",
            &[("clamp", true), ("repeat", false), ("mirror", false)],
            true,
        )? {
            reader.warn_of("wrap_mode", "what lies around the grid has the value of its edge");
        }
        let (placed, factor) = match reader.grid("grid") {
            // Whoever made it has counted its bytes.
            Some(grid) => {
                let factor = colour(reader, "factor", Use::Coefficient)?.unwrap_or(Spectrum::ONE);
                reader.finish();
                let unit = DMat4::IDENTITY;
                let placed = Placed {
                    grid,
                    unit,
                    margin: 0.0,
                };
                (placed, factor)
            }
            None => {
                let placed = match reader.object.plugin.as_str() {
                    "hgridvolume" => self.blocks(reader, used)?,
                    _ => self.volume_file(reader, used)?,
                };
                self.voxels += placed.grid.bytes();
                let limit = self.loader.limits.texture_bytes;
                within(reader.place(), "bytes of volumes", self.voxels, limit)?;
                (placed, Spectrum::ONE)
            }
        };
        let unit = Transform::from_matrix(placed.unit)
            .ok_or_else(|| reader.wrong("filename", "what the file says of its place is no box, or an empty one"))?;
        Ok(GridVolume {
            grid: placed.grid,
            to_local: to_world.after(&unit).inverted(),
            interpolation,
            factor,
            margin: placed.margin,
        })
    }

    /// The lattice of the file that a volume names.
    fn volume_file(&mut self, reader: &Reader, used: Use) -> Result<Placed, SceneError> {
        let of_file = reader.boolean("use_grid_bbox", false)?;
        let old = reader.object.old_dialect;
        let corners = match old {
            true => [reader.vector("min")?, reader.vector("max")?],
            false => [None; 2],
        };
        let name = reader.string("grid_name")?;
        reader.property("filename");
        reader.finish();
        let file = self.file(reader)?;
        Ok(match volume::read(&file, name, self.loader.limits, greatest(used))? {
            VolumeFile::Placed(lattice) => Placed {
                grid: Arc::new(lattice.grid),
                unit: lattice.to_world,
                margin: 0.0,
            },
            VolumeFile::Box { grid, bounds } if old => {
                let bounds = [0, 1].map(|end| corners[end].unwrap_or(bounds[end]));
                Placed::around_middles(grid, bounds)
            }
            VolumeFile::Box { grid, bounds } => Placed {
                grid: Arc::new(grid),
                unit: match of_file {
                    true => unit_to(bounds[0], bounds[1]),
                    false => DMat4::IDENTITY,
                },
                margin: 0.0,
            },
        })
    }

    /// The lattice that Mitsuba 0.6 keeps in blocks, each a file of its own. Blocks next to each other have the voxels of the face between them
    /// both.
    fn blocks(&mut self, reader: &Reader, used: Use) -> Result<Placed, SceneError> {
        let name = |name: &str| Ok::<_, SceneError>(reader.string(name)?.unwrap_or_default());
        let (prefix, postfix) = (name("prefix")?, name("postfix")?);
        reader.property("filename");
        reader.finish();
        let file = self.file(reader)?;
        let Blocks { bounds, along, blocks } = volume::blocks(&file)?;
        let place = &reader.object.properties["filename"].place;
        let limits = self.loader.limits;
        let mut whole: Option<(Grid, [u32; 3])> = None;
        for block in blocks {
            let [x, y, z] = block;
            let name = format!("{prefix}{x:03}_{y:03}_{z:03}{postfix}");
            let file = self.loader.open(place, &reader.object.search, &name)?;
            let VolumeFile::Box { grid: part, .. } = volume::read(&file, None, limits, greatest(used))? else {
                return Err(reader.wrong("filename", format!("`{name}` is no volume of Mitsuba")));
            };
            let cells = part.size().map(|size| size - 1);
            let (grid, first) = match &mut whole {
                Some(whole) => whole,
                none => {
                    let size = [0, 1, 2].map(|axis| u64::from(cells[axis]) * u64::from(along[axis]) + 1);
                    let voxels = size.iter().fold(1, |voxels: u64, size| voxels.saturating_mul(*size));
                    within(place, "number of voxels", voxels, limits.image_texels)?;
                    let grid = Grid::new(size.map(|size| size as u32), part.is_coloured())
                        .map_err(|_| SceneError::data(place, "memory does not hold the volume"))?;
                    none.insert((grid, cells))
                }
            };
            if *first != cells || grid.is_coloured() != part.is_coloured() {
                let reason = format!("`{name}` has another size or number of channels than the blocks before it");
                return Err(reader.wrong("filename", reason));
            }
            let origin = [0, 1, 2].map(|axis| block[axis] * cells[axis]);
            grid.copy(&part, origin)
                .map_err(|_| SceneError::data(place, "memory does not hold the volume"))?;
        }
        let (grid, _) = whole.ok_or_else(|| reader.wrong("filename", "the file names no block"))?;
        Ok(Placed::around_middles(grid, bounds))
    }
}

/// The map from the unit cube to the box between two corners.
fn unit_to(lower: DVec3, upper: DVec3) -> DMat4 {
    DMat4::from_translation(lower) * DMat4::from_scale(upper - lower)
}
