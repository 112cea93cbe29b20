//! Values on a lattice: bricks of 8 by 8 by 8 voxels, of which only those are kept that are not zero.

use crate::math::{DVec3, Vec3};
use crate::spectrum::{CHANNELS, Spectrum};
use std::collections::TryReserveError;

/// Voxels along each edge of a brick.
pub(super) const BRICK: u32 = 8;
const VOXELS: usize = (BRICK * BRICK * BRICK) as usize;
/// The brick whose voxels are all zero.
const NONE: u32 = u32::MAX;

/// Numbers or colours on a lattice of `size` voxels along x, y and z. A voxel's value is that of its middle; what lies around the lattice has
/// the value of the nearest voxel.
#[derive(Clone, Debug)]
pub struct Grid {
    size: [u32; 3],
    /// 1, or those of a [`Spectrum`].
    channels: usize,
    /// For each brick, x fastest, its place among those that are kept.
    bricks: Vec<u32>,
    /// Of the bricks that are kept, voxel by voxel, x fastest, channel by channel.
    values: Vec<f32>,
}

/// How values between the middles of voxels are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The value of the voxel.
    Nearest,
    /// Linear along each axis.
    Linear,
}

impl Grid {
    /// A lattice of zeros, of numbers or (`coloured`) of colours. No size is zero.
    ///
    /// # Errors
    /// Memory does not hold the table of its bricks.
    pub fn new(size: [u32; 3], coloured: bool) -> Result<Self, TryReserveError> {
        let count = size.iter().map(|size| size.div_ceil(BRICK) as usize).product();
        let mut bricks = Vec::new();
        bricks.try_reserve_exact(count)?;
        bricks.resize(count, NONE);
        Ok(Self {
            size,
            channels: if coloured { CHANNELS } else { 1 },
            bricks,
            values: Vec::new(),
        })
    }

    /// Voxels along each axis.
    #[must_use]
    pub fn size(&self) -> [u32; 3] {
        self.size
    }

    /// Whether its values are colours.
    pub(crate) fn is_coloured(&self) -> bool {
        self.channels > 1
    }

    /// Bytes that it takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.bricks[..]) + size_of_val(&self.values[..])) as u64
    }

    /// Sets the value of a voxel of the lattice, one number for each channel: finite, and not negative.
    ///
    /// # Errors
    /// Memory does not hold its brick.
    pub fn set(&mut self, voxel: [u32; 3], value: &[f32]) -> Result<(), TryReserveError> {
        let (brick, offset) = self.locate(voxel);
        let place = self.bricks[brick];
        let start = if place != NONE {
            place as usize * VOXELS * self.channels
        } else if value.iter().all(|value| *value == 0.0) {
            return Ok(());
        } else {
            let start = self.values.len();
            let brick_values = VOXELS * self.channels;
            self.values.try_reserve(brick_values)?;
            self.bricks[brick] = (start / brick_values) as u32;
            self.values.resize(start + brick_values, 0.0);
            start
        };
        let at = start + offset * self.channels;
        self.values[at..at + self.channels].copy_from_slice(&value[..self.channels]);
        Ok(())
    }

    /// Takes memory for so many bricks of numbers, and no more.
    ///
    /// # Errors
    /// There is no such memory.
    pub(crate) fn reserve(&mut self, bricks: usize) -> Result<(), TryReserveError> {
        self.values.try_reserve_exact(bricks.saturating_mul(VOXELS))
    }

    /// Sets the values of the whole brick that begins at a voxel of a lattice of numbers, x fastest: finite, and not negative.
    ///
    /// # Errors
    /// Memory does not hold it.
    pub(crate) fn set_brick(&mut self, voxel: [u32; 3], values: &[f32; VOXELS]) -> Result<(), TryReserveError> {
        if values.iter().all(|value| *value == 0.0) {
            return Ok(());
        }
        let (brick, _) = self.locate(voxel);
        self.bricks[brick] = self.add_brick(values)?;
        Ok(())
    }

    /// Gives one value to all voxels of a cube of whole bricks, which begins at `voxel` and is `edge` voxels long. The bricks share their memory: no
    /// voxel in them is set afterwards.
    ///
    /// # Errors
    /// Memory does not hold a brick.
    pub(crate) fn fill(&mut self, voxel: [u32; 3], edge: u32, value: f32) -> Result<(), TryReserveError> {
        let place = self.add_brick(&[value; VOXELS])?;
        let [x, y, z] = voxel.map(|first| (first..first + edge).step_by(BRICK as usize));
        for z in z {
            for y in y.clone() {
                for x in x.clone() {
                    let (brick, _) = self.locate([x, y, z]);
                    self.bricks[brick] = place;
                }
            }
        }
        Ok(())
    }

    /// Bytes of a lattice of colours with as many bricks that are not zero.
    pub(crate) fn coloured_bytes(&self) -> u64 {
        let values = self.kept().count() * VOXELS * CHANNELS;
        (size_of_val(&self.bricks[..]) + values * size_of::<f32>()) as u64
    }

    /// A lattice of the colours that `colour` makes of the place and the value of each voxel of a lattice of numbers, where that is not zero.
    ///
    /// # Errors
    /// Memory does not hold it.
    pub(crate) fn coloured(&self, colour: impl Fn([u32; 3], f32) -> [f32; CHANNELS]) -> Result<Self, TryReserveError> {
        let mut coloured = Self::new(self.size, true)?;
        coloured
            .values
            .try_reserve_exact(self.kept().count() * VOXELS * CHANNELS)?;
        for (brick, values) in self.kept() {
            for (offset, value) in values.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                let within = within_brick(offset);
                let voxel = std::array::from_fn(|axis| (brick[axis] * BRICK as usize + within[axis]) as u32);
                coloured.set(voxel, &colour(voxel, *value))?;
            }
        }
        Ok(coloured)
    }

    /// The bricks that are kept: their numbers along the axes, and their values, voxel by voxel.
    fn kept(&self) -> impl Iterator<Item = ([usize; 3], &[f32])> {
        let [width, height, _] = self.bricks_along();
        let length = VOXELS * self.channels;
        let kept = self.bricks.iter().enumerate().filter(|(_, place)| **place != NONE);
        kept.map(move |(brick, place)| {
            let numbers = [brick % width, brick / width % height, brick / width / height];
            (numbers, &self.values[*place as usize * length..][..length])
        })
    }

    /// Adds a brick, and says its place.
    fn add_brick(&mut self, values: &[f32; VOXELS]) -> Result<u32, TryReserveError> {
        self.values.try_reserve(VOXELS)?;
        let place = (self.values.len() / VOXELS) as u32;
        self.values.extend_from_slice(values);
        Ok(place)
    }

    /// Sets the voxels from `origin` on to those of another lattice with as many channels, which does not reach beyond this one.
    ///
    /// # Errors
    /// Memory does not hold a brick.
    pub(crate) fn copy(&mut self, part: &Self, origin: [u32; 3]) -> Result<(), TryReserveError> {
        let [width, height, depth] = part.size;
        for z in 0..depth {
            for y in 0..height {
                for x in 0..width {
                    let voxel = [origin[0] + x, origin[1] + y, origin[2] + z];
                    self.set(voxel, &part.voxel([x, y, z]).to_rgb())?;
                }
            }
        }
        Ok(())
    }

    /// The brick of a voxel, and the voxel's number in it.
    fn locate(&self, voxel: [u32; 3]) -> (usize, usize) {
        let [x, y, z] = voxel.map(|v| (v / BRICK) as usize);
        let [width, height, _] = self.bricks_along();
        let [u, v, w] = voxel.map(|v| (v % BRICK) as usize);
        let edge = BRICK as usize;
        ((z * height + y) * width + x, (w * edge + v) * edge + u)
    }

    /// Bricks along each axis.
    pub(super) fn bricks_along(&self) -> [usize; 3] {
        self.size.map(|size| size.div_ceil(BRICK) as usize)
    }

    /// The value of a voxel; of a number, in all channels.
    #[must_use]
    pub fn voxel(&self, voxel: [u32; 3]) -> Spectrum {
        let (brick, offset) = self.locate(voxel);
        match self.bricks[brick] {
            NONE => Spectrum::ZERO,
            place => {
                let at = (place as usize * VOXELS + offset) * self.channels;
                match self.channels {
                    1 => Spectrum::splat(self.values[at]),
                    _ => Spectrum::from_channels(std::array::from_fn(|channel| self.values[at + channel])),
                }
            }
        }
    }

    /// The value at a place in terms of voxels: voxel (0, 0, 0) reaches from 0 to 1 on each axis.
    #[must_use]
    pub fn at(&self, place: DVec3, interpolation: Interpolation) -> Spectrum {
        let last = self.size.map(|size| size - 1);
        let clamped = |axis: usize, index: f64| (index.max(0.0) as u32).min(last[axis]);
        if interpolation == Interpolation::Nearest {
            let place = place.to_array();
            return self.voxel(std::array::from_fn(|axis| clamped(axis, place[axis])));
        }
        let place = (place - DVec3::splat(0.5)).to_array();
        let lower = place.map(f64::floor);
        let share: [f32; 3] = std::array::from_fn(|axis| (place[axis] - lower[axis]) as f32);
        let ends: [[u32; 2]; 3] =
            std::array::from_fn(|axis| [clamped(axis, lower[axis]), clamped(axis, lower[axis] + 1.0)]);
        let along = |axis: usize, first: Spectrum, second: Spectrum| first * (1.0 - share[axis]) + second * share[axis];
        let row = |y: u32, z: u32| along(0, self.voxel([ends[0][0], y, z]), self.voxel([ends[0][1], y, z]));
        let face = |z: u32| along(1, row(ends[1][0], z), row(ends[1][1], z));
        along(2, face(ends[2][0]), face(ends[2][1]))
    }

    /// The greatest value of any channel that interpolation finds within each brick, brick by brick, x fastest.
    pub(super) fn greatest(&self) -> Vec<f32> {
        let along = self.bricks_along();
        let mut greatest = vec![0.0_f32; self.bricks.len()];
        // A voxel counts for the bricks that hold it or lie next to it.
        for (origin, values) in self.kept() {
            for (offset, value) in values.chunks(self.channels).enumerate() {
                let value = value.iter().fold(0.0_f32, |most, value| most.max(*value));
                if value == 0.0 {
                    continue;
                }
                let within = within_brick(offset);
                let reached: [std::ops::RangeInclusive<usize>; 3] = std::array::from_fn(|axis| {
                    let before = usize::from(within[axis] == 0 && origin[axis] > 0);
                    let after = usize::from(within[axis] == BRICK as usize - 1 && origin[axis] + 1 < along[axis]);
                    origin[axis] - before..=origin[axis] + after
                });
                for z in reached[2].clone() {
                    for y in reached[1].clone() {
                        for x in reached[0].clone() {
                            let most = &mut greatest[(z * along[1] + y) * along[0] + x];
                            *most = most.max(value);
                        }
                    }
                }
            }
        }
        greatest
    }

    /// Voxels along each axis, as a vector.
    pub(super) fn extent(&self) -> Vec3 {
        Vec3::from_array(self.size.map(|size| size as f32))
    }
}

/// The numbers along the axes of a voxel in its brick.
fn within_brick(offset: usize) -> [usize; 3] {
    let edge = BRICK as usize;
    [offset % edge, offset / edge % edge, offset / edge / edge]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{PathRandom, Stream};

    /// A lattice whose bricks at one end are empty, and its values voxel by voxel.
    fn random_grid(size: [u32; 3], coloured: bool) -> (Grid, Vec<Vec<f32>>) {
        let mut random = PathRandom::new(3, 1, Stream::Probe, 9);
        let mut grid = Grid::new(size, coloured).unwrap();
        let mut values = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let filled = x < size[0] / 2 && y % 3 != 1;
                    let value: Vec<f32> = (0..3).map(|_| if filled { random.next_1d() } else { 0.0 }).collect();
                    grid.set([x, y, z], &value).unwrap();
                    values.push(value);
                }
            }
        }
        (grid, values)
    }

    #[test]
    fn voxels_are_found_again() {
        for coloured in [false, true] {
            let size = [19, 8, 10];
            let (grid, values) = random_grid(size, coloured);
            for (index, value) in values.iter().enumerate() {
                let index = index as u32;
                let voxel = [index % size[0], index / size[0] % size[1], index / size[0] / size[1]];
                let expected = match coloured {
                    true => Spectrum::from_rgb([value[0], value[1], value[2]]),
                    false => Spectrum::splat(value[0]),
                };
                assert_eq!(grid.voxel(voxel), expected);
                let middle = DVec3::from_array(voxel.map(|v| f64::from(v) + 0.5));
                assert_eq!(grid.at(middle, Interpolation::Nearest), expected);
                assert_eq!(grid.at(middle, Interpolation::Linear), expected);
            }
        }
    }

    /// What is linear is found between voxels too, and what lies around the lattice has the value of its edge.
    #[test]
    fn interpolation_is_linear_and_clamped() {
        let mut grid = Grid::new([9, 9, 9], false).unwrap();
        let value = |x: f64, y: f64, z: f64| 1.0 + 0.5 * x + 0.25 * y + 2.0 * z;
        for index in 0..729 {
            let voxel = [index % 9, index / 9 % 9, index / 81];
            let [x, y, z] = voxel.map(f64::from);
            grid.set(voxel, &[value(x, y, z) as f32]).unwrap();
        }
        let found = |x: f64, y: f64, z: f64| f64::from(grid.at(DVec3::new(x, y, z), Interpolation::Linear)[0]);
        for (x, y, z) in [(1.25, 3.5, 8.25), (7.75, 7.9, 0.5), (4.0, 4.0, 4.0)] {
            let expected = value(x - 0.5, y - 0.5, z - 0.5);
            assert!((found(x, y, z) / expected - 1.0).abs() < 1e-6);
        }
        assert_eq!(found(-3.0, 100.0, 4.5), found(0.5, 8.5, 4.5));
        assert_eq!(found(0.2, 4.5, 8.9), found(0.5, 4.5, 8.5));
    }

    /// Bricks' bounds hold for whatever interpolation finds in them.
    #[test]
    fn bounds_of_bricks_hold() {
        let (grid, _) = random_grid([33, 17, 9], true);
        let (greatest, along) = (grid.greatest(), grid.bricks_along());
        assert!(greatest.contains(&0.0), "bricks far from any value are empty");
        let mut random = PathRandom::new(4, 1, Stream::Probe, 2);
        for _ in 0..20_000 {
            let unit = [random.next_1d(), random.next_1d(), random.next_1d()].map(f64::from);
            let place = DVec3::from_array(unit) * grid.extent().as_dvec3();
            let [x, y, z] = place.to_array().map(|p| (p / f64::from(BRICK)) as usize);
            let bound = greatest[(z * along[1] + y) * along[0] + x];
            for interpolation in [Interpolation::Nearest, Interpolation::Linear] {
                assert!(grid.at(place, interpolation).max_component() <= bound * 1.000_001);
            }
        }
    }

    /// A grid of 512^3 voxels, 5 % of them in bricks that are not empty, takes little more than these.
    #[test]
    fn empty_bricks_take_no_memory() {
        let mut grid = Grid::new([512; 3], false).unwrap();
        let mut active = 0_u64;
        for brick in (0..64 * 64 * 64).step_by(20) {
            let corner = [brick % 64, brick / 64 % 64, brick / 4096].map(|c| c * BRICK);
            for offset in 0..512 {
                let voxel = [offset % 8, offset / 8 % 8, offset / 64];
                grid.set(std::array::from_fn(|axis| corner[axis] + voxel[axis]), &[1.0])
                    .unwrap();
                active += 1;
            }
        }
        assert!(grid.bytes() < 2 * 4 * active, "{} bytes", grid.bytes());
    }
}
