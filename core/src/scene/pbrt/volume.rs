//! Media that vary in space: lattices in the scene file, clouds, and files of voxels.
//!
//! Where a lattice of pbrt is looked up at several places that are multiplied, as density and temperature are, or added, as absorption and
//! scattering are, the lattice here holds what comes out for each voxel, and is interpolated itself.

use super::Reading;
use super::heat::{Heat, LUMINANCE_OF_ONE, bounded};
use super::medium::Coefficients;
use super::parameter::Parameters;
use crate::math::Vec3;
use crate::medium::Grid;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{SceneError, within};
use crate::scene::spectrum::{BRIGHTEST, Use};
use crate::scene::volume::{self, Lattice, VolumeFile};
use crate::texture::perlin;
use glam::{DMat4, DVec3};
use rayon::prelude::*;
use std::sync::Arc;

/// A lattice, or one of colours, with a factor.
type Scaled = (Arc<Grid>, [f64; 3]);

/// Voxels along the longest edge of a cloud.
const CLOUD_VOXELS: u32 = 160;

impl Reading<'_, '_> {
    /// A lattice of densities, by which the coefficients are multiplied, between two corners.
    pub(super) fn uniform_grid(
        &mut self,
        parameters: &mut Parameters,
        old: bool,
    ) -> Result<Option<ObjectId>, SceneError> {
        let Some(size) = self.voxels(parameters)? else {
            return Ok(None);
        };
        let Some(densities) = list::<1>(parameters, "density", size)? else {
            return Ok(None);
        };
        let temperatures = optional::<1>(parameters, "temperature", size)?;
        let scales = optional::<1>(parameters, "Lescale", size)?;
        self.take_bytes(parameters, densities.len() as u64 * 4)?;
        let grid = filled(parameters, size, |voxel| [bounded(f64::from(densities[voxel][0]))])?;
        let medium = self.add(Kind::Medium, "heterogeneous", parameters);
        let coefficients = self.coefficients(parameters, old, medium)?;
        let radiance = self.colour(parameters, "Le", Use::Emission)?;
        let (offset, scale) = heat_of(parameters)?;
        let index = |voxel: [u32; 3]| ((voxel[2] * size[1] + voxel[1]) * size[0] + voxel[0]) as usize;
        let le_scale = |voxel: [u32; 3]| {
            scales
                .as_ref()
                .map_or(1.0, |scales| f64::from(scales[index(voxel)][0]).max(0.0))
        };
        let sigma_a = coefficients.sigma_a;
        let emission = match (temperatures, radiance) {
            (Some(temperatures), radiance) => {
                if radiance.is_some() {
                    parameters.warn_of("Le", "it does not count beside `temperature`");
                }
                let heat = Heat::new();
                let colour = |voxel: [u32; 3]| {
                    let kelvin = (f64::from(temperatures[index(voxel)][0]) - offset) * scale;
                    heat.at(kelvin).map(|channel| channel * le_scale(voxel))
                };
                Some((self.glow(parameters, &grid, colour)?, sigma_a))
            }
            (None, Some(radiance)) => {
                let factor = std::array::from_fn(|channel| radiance[channel] * sigma_a[channel]);
                match &scales {
                    None => Some((grid.clone(), factor)),
                    Some(_) => Some((self.glow(parameters, &grid, |voxel| [le_scale(voxel); 3])?, factor)),
                }
            }
            (None, None) => None,
        };
        let unit = bounds(parameters)?;
        self.varying(
            parameters,
            medium,
            (grid, coefficients.sigma_t()),
            Ok(coefficients.albedo()),
            emission,
            unit,
        )?;
        Ok(Some(medium))
    }

    /// Lattices of the coefficients themselves.
    pub(super) fn coloured_grid(&mut self, parameters: &mut Parameters) -> Result<Option<ObjectId>, SceneError> {
        let Some(size) = self.voxels(parameters)? else {
            return Ok(None);
        };
        let space = |name: &str| {
            parameters
                .find(name)
                .map(|parameter| parameter.space)
                .unwrap_or_default()
        };
        let spaces = ["sigma_a", "sigma_s", "Le"].map(space);
        let sigma_a = optional::<3>(parameters, "sigma_a", size)?;
        let sigma_s = optional::<3>(parameters, "sigma_s", size)?;
        let radiances = optional::<3>(parameters, "Le", size)?;
        if sigma_a.is_none() && sigma_s.is_none() {
            return parameters.fault("sigma_a", "a grid of colours needs `sigma_a` or `sigma_s`");
        }
        let voxels = size.iter().map(|size| u64::from(*size)).product::<u64>();
        self.take_bytes(parameters, voxels * 12 * if radiances.is_some() { 3 } else { 2 })?;
        // What is not written is 1 in pbrt-v4.
        let coefficient = |list: &Option<Vec<[f32; 3]>>, which: usize, voxel: usize| match list {
            Some(list) => {
                spaces[which].reflectance(list[voxel].map(|channel| f64::from(channel).clamp(0.0, BRIGHTEST)))
            }
            None => [1.0; 3],
        };
        let both = |voxel: usize| Coefficients {
            sigma_a: coefficient(&sigma_a, 0, voxel),
            sigma_s: coefficient(&sigma_s, 1, voxel),
        };
        let extinction = filled(parameters, size, |voxel| both(voxel).sigma_t().map(bounded))?;
        let albedo = filled(parameters, size, |voxel| {
            both(voxel).albedo().map(|share| share.clamp(0.0, 1.0) as f32)
        })?;
        let medium = self.add(Kind::Medium, "heterogeneous", parameters);
        let scale = self.scattering(parameters, medium)?;
        let le_scale = parameters.float_or("Lescale", 1.0)?.max(0.0);
        let emission = match radiances {
            None => None,
            Some(radiances) => {
                let glow = |voxel: usize| -> [f32; 3] {
                    let radiance = spaces[2].light(radiances[voxel].map(f64::from));
                    let sigma_a = both(voxel).sigma_a;
                    std::array::from_fn(|channel| bounded(radiance[channel] * sigma_a[channel] * LUMINANCE_OF_ONE))
                };
                Some((filled(parameters, size, glow)?, [scale * le_scale; 3]))
            }
        };
        let unit = bounds(parameters)?;
        self.varying(
            parameters,
            medium,
            (extinction, [scale; 3]),
            Err(albedo),
            emission,
            unit,
        )?;
        Ok(Some(medium))
    }

    /// Noise in the form of a cloud, looked up at the middles of voxels.
    pub(super) fn cloud(&mut self, parameters: &Parameters) -> Result<Option<ObjectId>, SceneError> {
        let density = parameters.float_or("density", 1.0)?;
        let wispiness = parameters.float_or("wispiness", 1.0)?;
        let frequency = parameters.float_or("frequency", 5.0)?;
        let medium = self.add(Kind::Medium, "heterogeneous", parameters);
        let coefficients = self.coefficients(parameters, false, medium)?;
        let unit = bounds(parameters)?;
        let [x, y, z, _] = [unit.x_axis, unit.y_axis, unit.z_axis, unit.w_axis];
        let edges = [x.x, y.y, z.z];
        let longest = edges.into_iter().fold(0.0, f64::max);
        let size = edges.map(|edge| match longest > 0.0 {
            true => ((edge / longest * f64::from(CLOUD_VOXELS)).ceil() as u32).clamp(1, CLOUD_VOXELS),
            false => 1,
        });
        let count = size.iter().map(|size| *size as usize).product::<usize>();
        self.take_bytes(parameters, count as u64 * 4)?;
        let extent = DVec3::from_array(size.map(f64::from));
        let at = |voxel: usize| {
            let voxel = voxel as u32;
            let voxel = [voxel % size[0], voxel / size[0] % size[1], voxel / size[0] / size[1]];
            let middle = (DVec3::from_array(voxel.map(f64::from)) + DVec3::splat(0.5)) / extent;
            cloud_density(
                unit.transform_point3(middle).as_vec3(),
                density as f32,
                wispiness as f32,
                frequency as f32,
            )
        };
        let values: Vec<f32> = (0..count).into_par_iter().map(at).collect();
        let grid = filled(parameters, size, |voxel| [bounded(f64::from(values[voxel]))])?;
        self.varying(
            parameters,
            medium,
            (grid, coefficients.sigma_t()),
            Ok(coefficients.albedo()),
            None,
            unit,
        )?;
        Ok(Some(medium))
    }

    /// Densities, and perhaps temperatures, of a file of NanoVDB or OpenVDB.
    pub(super) fn tree_of_voxels(&mut self, parameters: &Parameters) -> Result<Option<ObjectId>, SceneError> {
        let Some(name) = parameters.text("filename")? else {
            return parameters.fault("filename", "the medium names no file");
        };
        let file = match self.loader.open(&parameters.place, &self.search, name) {
            Ok(file) => file,
            Err(fault) => return self.faults.note(fault).map(|()| None),
        };
        let lattice =
            |name: &str, reading: &mut Self| match volume::read(&file, Some(name), reading.loader.limits, BRIGHTEST) {
                Ok(VolumeFile::Placed(lattice)) => Ok(Some(lattice)),
                Ok(VolumeFile::Box { .. }) => {
                    parameters.fault("filename", "it is a file of neither NanoVDB nor OpenVDB")
                }
                Err(fault) => reading.faults.note(fault).map(|()| None),
            };
        let density_name = parameters.text("gridname")?.unwrap_or("density");
        let Some(density) = lattice(density_name, self)? else {
            return Ok(None);
        };
        self.take_bytes(parameters, density.grid.bytes())?;
        let medium = self.add(Kind::Medium, "heterogeneous", parameters);
        let coefficients = self.coefficients(parameters, false, medium)?;
        let temperature_name = parameters.text("temperaturename")?.unwrap_or("temperature");
        let le_scale = parameters.float_or("Lescale", 1.0)?.max(0.0);
        let (offset, scale) = heat_of(parameters)?;
        let Lattice { grid, first, to_world } = density;
        let grid = Arc::new(grid);
        let emission = match le_scale > 0.0 && volume::holds(&file, temperature_name)? {
            false => None,
            true => lattice(temperature_name, self)?
                .map(|temperature| {
                    let heat = Heat::new();
                    let colour = |voxel: [u32; 3]| {
                        let kelvin = temperature_at(&temperature, first, voxel);
                        heat.at((kelvin - offset) * scale).map(|channel| channel * le_scale)
                    };
                    self.glow(parameters, &grid, colour)
                })
                .transpose()?
                .map(|grid| (grid, coefficients.sigma_a)),
        };
        self.varying(
            parameters,
            medium,
            (grid, coefficients.sigma_t()),
            Ok(coefficients.albedo()),
            emission,
            to_world,
        )?;
        Ok(Some(medium))
    }

    /// The number of voxels along each axis.
    fn voxels(&self, parameters: &Parameters) -> Result<Option<[u32; 3]>, SceneError> {
        let mut size = [1_u32; 3];
        for (size, name) in size.iter_mut().zip(["nx", "ny", "nz"]) {
            let written = parameters.integer(name)?.unwrap_or(1);
            let Ok(count @ 1..) = u32::try_from(written) else {
                return parameters.fault(name, format!("{written} is out of range; allowed: 1 and above"));
            };
            *size = count;
        }
        let voxels = size
            .iter()
            .fold(1, |voxels: u64, size| voxels.saturating_mul((*size).into()));
        let limit = self.loader.limits.image_texels;
        within(&parameters.place, "number of voxels", voxels, limit)?;
        Ok(Some(size))
    }

    /// Counts bytes of lattices against the limit.
    fn take_bytes(&mut self, parameters: &Parameters, bytes: u64) -> Result<(), SceneError> {
        self.volume_bytes = self.volume_bytes.saturating_add(bytes);
        let limit = self.loader.limits.texture_bytes;
        within(&parameters.place, "bytes of volumes", self.volume_bytes, limit).map(|_| ())
    }

    /// Densities times what `colour` says of a voxel.
    fn glow(
        &mut self,
        parameters: &Parameters,
        density: &Grid,
        colour: impl Fn([u32; 3]) -> [f64; 3],
    ) -> Result<Arc<Grid>, SceneError> {
        self.take_bytes(parameters, density.coloured_bytes())?;
        let product =
            |voxel: [u32; 3], density: f32| colour(voxel).map(|channel| bounded(channel * f64::from(density)));
        let grid = density.coloured(product).map_err(|_| no_memory(parameters))?;
        Ok(Arc::new(grid))
    }

    /// Describes the medium of an extinction that varies, within the image of the unit cube under a map. The albedo is a colour or a lattice.
    fn varying(
        &mut self,
        parameters: &Parameters,
        medium: ObjectId,
        extinction: Scaled,
        albedo: Result<[f64; 3], Arc<Grid>>,
        emission: Option<Scaled>,
        unit: DMat4,
    ) -> Result<(), SceneError> {
        let albedo_grid = match albedo {
            Ok(albedo) => {
                self.draft.set(medium, "albedo", Value::Rgb(albedo));
                None
            }
            Err(grid) => Some((grid, [1.0; 3])),
        };
        let volumes = [
            ("sigma_t", Some(extinction)),
            ("albedo", albedo_grid),
            ("emission", emission),
        ];
        for (name, volume) in volumes {
            let Some((grid, factor)) = volume else { continue };
            let volume = self.add(Kind::Volume, "gridvolume", parameters);
            self.draft.set(volume, "grid", Value::Grid(grid));
            self.draft.set(volume, "factor", Value::Rgb(factor));
            self.set_to_world(volume, self.state.placed(unit))?;
            self.draft.link(medium, Some(name), volume);
        }
        Ok(())
    }
}

/// What temperatures are less by, and then multiplied by.
fn heat_of(parameters: &Parameters) -> Result<(f64, f64), SceneError> {
    let cutoff = parameters.float_or("temperaturecutoff", 0.0)?;
    let offset = parameters.float_or("temperatureoffset", cutoff)?;
    Ok((offset, parameters.float_or("temperaturescale", 1.0)?))
}

/// The temperature at a voxel of another lattice, whose first voxel has the coordinates `first`. pbrt-v4 looks temperatures up by the coordinates of the
/// densities.
fn temperature_at(temperature: &Lattice, first: [i32; 3], voxel: [u32; 3]) -> f64 {
    let size = temperature.grid.size();
    let mut within = [0; 3];
    for axis in 0..3 {
        let place = i64::from(first[axis]) + i64::from(voxel[axis]) - i64::from(temperature.first[axis]);
        match u32::try_from(place).ok().filter(|place| *place < size[axis]) {
            Some(place) => within[axis] = place,
            None => return 0.0,
        }
    }
    temperature.grid.voxel(within)[0].into()
}

/// The map from the unit cube to the box between `p0` and `p1`.
fn bounds(parameters: &Parameters) -> Result<DMat4, SceneError> {
    let corner = |name: &str, default: DVec3| Ok::<_, SceneError>(parameters.vector(name)?.unwrap_or(default));
    let (lower, upper) = (corner("p0", DVec3::ZERO)?, corner("p1", DVec3::ONE)?);
    Ok(DMat4::from_translation(lower.min(upper)) * DMat4::from_scale((upper - lower).abs()))
}

fn no_memory(parameters: &Parameters) -> SceneError {
    SceneError::data(&parameters.place, "memory does not hold the volume")
}

/// A list of one number or colour for each voxel; `None` where it has another length, which is noted.
fn list<const N: usize>(
    parameters: &mut Parameters,
    name: &str,
    size: [u32; 3],
) -> Result<Option<Vec<[f32; N]>>, SceneError> {
    let values = parameters.take_groups::<N>(name)?.unwrap_or_default();
    let voxels = size.iter().map(|size| *size as usize).product::<usize>();
    if values.len() == voxels {
        return Ok(Some(values));
    }
    let [x, y, z] = size;
    let what = if N == 1 { "numbers" } else { "colours" };
    parameters.fault(
        name,
        format!("{} {what}, not the {voxels} of {x} x {y} x {z}", values.len()),
    )
}

/// As [`list`], of what may not be there.
fn optional<const N: usize>(
    parameters: &mut Parameters,
    name: &str,
    size: [u32; 3],
) -> Result<Option<Vec<[f32; N]>>, SceneError> {
    match parameters.has(name) {
        true => list(parameters, name, size),
        false => Ok(None),
    }
}

/// A lattice of the numbers or colours that `value` gives for each voxel, x fastest.
fn filled<const N: usize>(
    parameters: &Parameters,
    size: [u32; 3],
    value: impl Fn(usize) -> [f32; N],
) -> Result<Arc<Grid>, SceneError> {
    let memory = |_| no_memory(parameters);
    let mut grid = Grid::new(size, N > 1).map_err(memory)?;
    let mut index = 0;
    for z in 0..size[2] {
        for y in 0..size[1] {
            for x in 0..size[0] {
                grid.set([x, y, z], &value(index)).map_err(memory)?;
                index += 1;
            }
        }
    }
    Ok(Arc::new(grid))
}

/// The density of a cloud at a place in the space of the medium (pbrt-v4, `CloudMedium::Density`).
fn cloud_density(p: Vec3, density: f32, wispiness: f32, frequency: f32) -> f32 {
    let mut place = p * frequency;
    if wispiness > 0.0 {
        let (mut strength, mut finer) = (0.05 * wispiness, 10.0);
        for _ in 0..2 {
            place += slope(place * finer) * strength;
            strength *= 0.5;
            finer *= 1.99;
        }
    }
    let (mut sum, mut weight, mut finer) = (0.0, 0.5, 1.0);
    for _ in 0..5 {
        sum += weight * perlin(place * finer);
        weight *= 0.5;
        finer *= 1.99;
    }
    let high = ((1.0 - p.y) * 4.5 * density * sum).clamp(0.0, 1.0);
    (high + 2.0 * (0.5 - p.y).max(0.0)).clamp(0.0, 1.0)
}

/// How noise changes along each axis (pbrt-v4, `DNoise`).
fn slope(p: Vec3) -> Vec3 {
    const STEP: f32 = 0.01;
    let here = perlin(p);
    let along = |axis: Vec3| (perlin(p + axis * STEP) - here) / STEP;
    Vec3::new(along(Vec3::X), along(Vec3::Y), along(Vec3::Z))
}
