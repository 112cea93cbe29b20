//! Extinction that varies, and the tentative collisions of a path in it.

use super::grid::BRICK;
use super::volume::GridVolume;
use crate::geometry::Ray;
use crate::math::{DVec3, Vec3};
use crate::random::PathRandom;
use crate::spectrum::Spectrum;

/// The extinction of a lattice, with a bound for each of its bricks. Outside of the lattice there is none.
#[derive(Clone, Debug)]
pub struct Field {
    sigma_t: GridVolume,
    /// The greatest extinction of any channel in each brick, x fastest \[1/unit\].
    bounds: Vec<f32>,
    /// Their mean, over those that are not zero.
    mean_bound: f32,
}

/// A place where a path may collide.
#[derive(Clone, Copy, Debug)]
pub(super) struct Collision {
    /// Along the ray.
    pub(super) distance: f32,
    /// In terms of voxels.
    voxels: DVec3,
    /// Bound of the extinction of any channel there \[1/unit\].
    pub(super) bound: f32,
}

/// What interpolation in single precision may add to the bound of a brick, as a factor.
const ROUNDING: f32 = 1.0 + 8.0 * f32::EPSILON;

impl Field {
    /// Extinction coefficients that are finite and not negative.
    #[must_use]
    pub fn new(sigma_t: GridVolume) -> Self {
        let factor = sigma_t.factor.max_component() * ROUNDING;
        let bounds: Vec<f32> = sigma_t.grid.greatest().into_iter().map(|most| most * factor).collect();
        let filled = bounds.iter().filter(|bound| **bound > 0.0);
        let (sum, count) = filled.fold((0.0, 0.0), |(sum, count), bound| (sum + f64::from(*bound), count + 1.0));
        Self {
            sigma_t,
            mean_bound: if count > 0.0 { (sum / count) as f32 } else { 0.0 },
            bounds,
        }
    }

    /// The mean bound of the bricks that hold something \[1/unit\].
    pub(super) fn mean_bound(&self) -> f32 {
        self.mean_bound
    }

    /// The extinction at a collision.
    pub(super) fn at(&self, collision: &Collision) -> Spectrum {
        self.sigma_t.at(collision.voxels)
    }

    /// The extinction at a place in the world: none outside of the lattice.
    pub(super) fn at_place(&self, place: Vec3) -> Spectrum {
        let voxels = self.sigma_t.voxels_at(place);
        let [lower, upper] = self.sigma_t.corners();
        match voxels.cmpge(lower).all() && voxels.cmple(upper).all() {
            true => self.sigma_t.at(voxels),
            false => Spectrum::ZERO,
        }
    }

    /// Whether all channels of every value are the same.
    pub(super) fn is_grey(&self) -> bool {
        super::is_grey(self.sigma_t.factor) && !self.sigma_t.grid.is_coloured()
    }

    /// The distances between which a ray of the length `distance` goes through the lattice.
    pub(super) fn reach(&self, ray: &Ray, distance: f32) -> Option<(f32, f32)> {
        let walk = BrickWalk::new(self, ray, distance)?;
        Some((walk.at as f32, walk.end as f32))
    }

    /// Calls `collide` with one tentative collision after the other along a ray of the length `distance`, until it says no. Their
    /// distances have the density of an extinction as large as the bounds.
    pub(super) fn collisions(
        &self,
        ray: &Ray,
        distance: f32,
        random: &mut PathRandom,
        mut collide: impl FnMut(Collision) -> bool,
    ) {
        let Some(mut walk) = BrickWalk::new(self, ray, distance) else {
            return;
        };
        let mut optical_depth = next_depth(random);
        while let Some((start, end, brick)) = walk.next_brick() {
            let bound = f64::from(self.bounds[brick]);
            let mut at = start;
            loop {
                let rest = bound * (end - at);
                if optical_depth >= rest {
                    optical_depth -= rest;
                    break;
                }
                at = (at + optical_depth / bound).min(end);
                let collision = Collision {
                    distance: at as f32,
                    voxels: walk.origin + walk.direction * at,
                    bound: self.bounds[brick],
                };
                if !collide(collision) {
                    return;
                }
                optical_depth = next_depth(random);
            }
        }
    }
}

/// Optical depth to the next tentative collision.
fn next_depth(random: &mut PathRandom) -> f64 {
    -libm::log1p(-random.next_choice())
}

/// The way of a ray through the bricks of a lattice.
struct BrickWalk {
    /// Of the ray, in terms of voxels; distances along it are those in the world.
    origin: DVec3,
    direction: DVec3,
    /// Number of bricks along each axis, and the brick that comes next.
    along: [usize; 3],
    brick: [usize; 3],
    /// For each axis the distance at which the ray leaves the brick, and how much further it is to the end of the next one.
    leaves: [f64; 3],
    step: [f64; 3],
    at: f64,
    end: f64,
    done: bool,
}

impl BrickWalk {
    /// `None` where the ray misses the lattice.
    fn new(field: &Field, ray: &Ray, distance: f32) -> Option<Self> {
        let volume = &field.sigma_t;
        let matrix = volume.to_local.matrix();
        let origin = volume.voxels_at(ray.origin);
        let direction = volume.to_voxels(matrix.transform_vector3(ray.direction.as_dvec3()));
        let [lower, upper] = volume.corners();
        let (mut start, mut end) = (0.0_f64, f64::from(distance));
        for axis in 0..3 {
            let (from, way) = (origin[axis], direction[axis]);
            if way == 0.0 {
                if !(lower[axis]..upper[axis]).contains(&from) {
                    return None;
                }
                continue;
            }
            let (first, second) = ((lower[axis] - from) / way, (upper[axis] - from) / way);
            start = start.max(first.min(second));
            end = end.min(first.max(second));
        }
        if start >= end {
            return None;
        }
        let along = volume.grid.bricks_along();
        let edge = f64::from(BRICK);
        let entry = origin + direction * start;
        let brick: [usize; 3] =
            std::array::from_fn(|axis| ((entry[axis] / edge).max(0.0) as usize).min(along[axis] - 1));
        let leaves = std::array::from_fn(|axis| {
            let way = direction[axis];
            let side = brick[axis] + usize::from(way > 0.0);
            if way == 0.0 {
                f64::INFINITY
            } else {
                (side as f64 * edge - origin[axis]) / way
            }
        });
        Some(Self {
            origin,
            direction,
            along,
            brick,
            leaves,
            step: std::array::from_fn(|axis| edge / direction[axis].abs()),
            at: start,
            end,
            done: false,
        })
    }

    /// Where the ray enters and leaves the next brick, and the number of the brick.
    fn next_brick(&mut self) -> Option<(f64, f64, usize)> {
        if self.done {
            return None;
        }
        let [x, y, z] = self.brick;
        let number = (z * self.along[1] + y) * self.along[0] + x;
        let axis = (0..3).fold(0, |nearest, axis| {
            if self.leaves[axis] < self.leaves[nearest] {
                axis
            } else {
                nearest
            }
        });
        let start = self.at;
        self.at = self.leaves[axis].clamp(start, self.end);
        self.done = self.leaves[axis] >= self.end || !self.step_along(axis);
        if self.done {
            self.at = self.end;
        }
        Some((start, self.at, number))
    }

    /// Goes on to the next brick along an axis; `false` at the end of the lattice.
    fn step_along(&mut self, axis: usize) -> bool {
        self.leaves[axis] += self.step[axis];
        let next = match self.direction[axis] > 0.0 {
            true => Some(self.brick[axis] + 1).filter(|next| *next < self.along[axis]),
            false => self.brick[axis].checked_sub(1),
        };
        self.brick[axis] = next.unwrap_or(self.brick[axis]);
        next.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Transform;
    use crate::medium::{Grid, Interpolation};
    use std::sync::Arc;

    /// Between the faces of a lattice and where its extinction begins there is none, for flights and for lookups alike.
    #[test]
    fn there_is_no_extinction_in_the_margin() {
        let mut grid = Grid::new([4; 3], false).unwrap();
        for index in 0..64 {
            grid.set([index % 4, index / 4 % 4, index / 16], &[1.0]).unwrap();
        }
        let grid = Arc::new(grid);
        for (margin, at_face) in [(0.0, Spectrum::ONE), (0.5, Spectrum::ZERO)] {
            let field = Field::new(GridVolume {
                grid: grid.clone(),
                to_local: Transform::default(),
                interpolation: Interpolation::Linear,
                factor: Spectrum::ONE,
                margin,
            });
            assert_eq!(field.at_place(Vec3::splat(0.1)), at_face);
            assert_eq!(field.at_place(Vec3::splat(0.15)), Spectrum::ONE);
            let ray = Ray {
                origin: Vec3::new(0.5, 0.5, -1.0),
                direction: Vec3::Z,
                max_distance: f32::INFINITY,
            };
            let begins = 1.0 + 0.25 * margin as f32;
            assert_eq!(field.reach(&ray, f32::INFINITY), Some((begins, 3.0 - begins)));
        }
    }
}
