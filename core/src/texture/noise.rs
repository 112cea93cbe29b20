//! Perlin's noise and what pbrt makes of it: sums over octaves, wind and marble (Pharr, Jakob and Humphreys 2016, *Physically Based
//! Rendering*, section 10.6). Nothing is filtered: the samples of a pixel spread over it.

use super::TexturePoint;
use crate::math::{Transform, Vec3, sin};
use crate::spectrum::Spectrum;

/// Perlin's permutation of 0 to 255 (Perlin 2002, "Improving Noise").
#[rustfmt::skip]
const PERMUTATION: [u8; 256] = [
    151, 160, 137, 91, 90, 15, 131, 13, 201, 95, 96, 53, 194, 233, 7, 225, 140, 36, 103, 30, 69, 142, 8, 99, 37, 240, 21, 10, 23,
    190, 6, 148, 247, 120, 234, 75, 0, 26, 197, 62, 94, 252, 219, 203, 117, 35, 11, 32, 57, 177, 33, 88, 237, 149, 56, 87, 174,
    20, 125, 136, 171, 168, 68, 175, 74, 165, 71, 134, 139, 48, 27, 166, 77, 146, 158, 231, 83, 111, 229, 122, 60, 211, 133, 230,
    220, 105, 92, 41, 55, 46, 245, 40, 244, 102, 143, 54, 65, 25, 63, 161, 1, 216, 80, 73, 209, 76, 132, 187, 208, 89, 18, 169,
    200, 196, 135, 130, 116, 188, 159, 86, 164, 100, 109, 198, 173, 186, 3, 64, 52, 217, 226, 250, 124, 123, 5, 202, 38, 147,
    118, 126, 255, 82, 85, 212, 207, 206, 59, 227, 47, 16, 58, 17, 182, 189, 28, 42, 223, 183, 170, 213, 119, 248, 152, 2, 44,
    154, 163, 70, 221, 153, 101, 155, 167, 43, 172, 9, 129, 22, 39, 253, 19, 98, 108, 110, 79, 113, 224, 232, 178, 185, 112, 104,
    218, 246, 97, 228, 251, 34, 242, 193, 238, 210, 144, 12, 191, 179, 162, 241, 81, 51, 145, 235, 249, 14, 239, 107, 49, 192,
    214, 31, 181, 199, 106, 157, 184, 84, 204, 176, 115, 121, 50, 45, 127, 4, 150, 254, 138, 236, 205, 93, 222, 114, 67, 29, 24,
    72, 243, 141, 128, 195, 78, 66, 215, 61, 156, 180,
];

/// Coordinates beyond this are folded: their fractions have too few digits.
const FARTHEST: f32 = (1 << 22) as f32;

/// Perlin's gradient noise: zero at points with whole coordinates, in about [-1, 1].
pub(crate) fn perlin(p: Vec3) -> f32 {
    let p = p % FARTHEST;
    let cell = p.floor();
    let within = p - cell;
    let [x, y, z] = [cell.x, cell.y, cell.z].map(|c| c as i32);
    let corner = |i: i32, j: i32, k: i32| {
        let offset = within - Vec3::new(i as f32, j as f32, k as f32);
        gradient(x + i, y + j, z + k).dot(offset)
    };
    let weight = within * within * within * (within * (within * 6.0 - Vec3::splat(15.0)) + Vec3::splat(10.0));
    let lerp = |t: f32, a: f32, b: f32| a + t * (b - a);
    let along_x = |j, k| lerp(weight.x, corner(0, j, k), corner(1, j, k));
    let along_y = |k| lerp(weight.y, along_x(0, k), along_x(1, k));
    lerp(weight.z, along_y(0), along_y(1))
}

/// The gradient at a lattice point: towards the middle of an edge of a cube, four of the sixteen twice.
fn gradient(x: i32, y: i32, z: i32) -> Vec3 {
    let permuted = |i: i32| i32::from(PERMUTATION[(i & 255) as usize]);
    let hash = permuted(permuted(permuted(x) + y) + z) & 15;
    let first = if hash < 8 || hash == 12 || hash == 13 {
        Vec3::X
    } else {
        Vec3::Y
    };
    let second = if hash < 4 || hash == 12 || hash == 13 {
        Vec3::Y
    } else {
        Vec3::Z
    };
    let signed = |axis: Vec3, bit: i32| if hash & bit != 0 { -axis } else { axis };
    signed(first, 1) + signed(second, 2)
}

/// Noises of rising frequency that are added.
#[derive(Clone, Copy, Debug)]
pub struct Octaves {
    /// How many.
    pub count: u32,
    /// Amplitude of each over that of the one before (pbrt's `roughness`).
    pub falloff: f32,
}

/// Frequency of an octave over that of the one before.
const LACUNARITY: f32 = 1.99;

impl Octaves {
    fn sum(self, p: Vec3, shape: impl Fn(f32) -> f32) -> (f32, f32) {
        let (mut sum, mut frequency, mut amplitude) = (0.0, 1.0, 1.0);
        for _ in 0..self.count {
            sum += amplitude * shape(perlin(p * frequency));
            frequency *= LACUNARITY;
            amplitude *= self.falloff;
        }
        (sum, amplitude)
    }

    /// Fractional Brownian motion.
    fn brownian(self, p: Vec3) -> f32 {
        self.sum(p, |noise| noise).0
    }

    /// Turbulence; 0.2 stands for the mean of the octave after the last.
    fn turbulence(self, p: Vec3) -> f32 {
        let (sum, amplitude) = self.sum(p, f32::abs);
        sum + 0.2 * amplitude
    }
}

/// What noise is made into.
#[derive(Clone, Copy, Debug)]
pub enum Noise {
    /// Fractional Brownian motion (pbrt's `fbm`).
    Brownian(Octaves),
    /// Turbulence (pbrt's `wrinkled`).
    Wrinkled(Octaves),
    /// Waves that a wind of varying strength makes (pbrt's `windy`).
    Windy,
    /// Layers of stone, disturbed (pbrt's `marble`).
    Marble {
        /// The disturbance.
        octaves: Octaves,
        /// Layers per length.
        scale: f32,
        /// Strength of the disturbance.
        variation: f32,
    },
}

impl Noise {
    /// The value at a point of the texture's own space.
    pub(super) fn eval(&self, p: Vec3) -> Spectrum {
        match self {
            Self::Brownian(octaves) => Spectrum::splat(octaves.brownian(p)),
            Self::Wrinkled(octaves) => Spectrum::splat(octaves.turbulence(p)),
            Self::Windy => {
                let octaves = |count| Octaves { count, falloff: 0.5 };
                let strength = octaves(3).brownian(p * 0.1);
                Spectrum::splat(strength.abs() * octaves(6).brownian(p))
            }
            Self::Marble {
                octaves,
                scale,
                variation,
            } => {
                let p = p * *scale;
                marble(0.5 + 0.5 * sin(p.y + variation * octaves.brownian(p)))
            }
        }
    }

    /// The mean over a cube of 16 units, at points that lie evenly in it.
    pub(super) fn mean(&self, clamped: impl Fn(Spectrum) -> Spectrum) -> Spectrum {
        const SIDE: usize = 16;
        Spectrum::average((0..SIDE * SIDE * SIDE).map(|i| {
            let place = [i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE].map(|c| c as f32 + 0.37);
            clamped(self.eval(Vec3::from(place)))
        }))
    }
}

impl TexturePoint {
    /// The position in the texture's own space, absurd ones brought into range.
    pub(super) fn local(&self, to_local: &Transform) -> Vec3 {
        let p = to_local.point(self.position);
        if p.is_finite() {
            p.clamp(Vec3::splat(-1e9), Vec3::splat(1e9))
        } else {
            Vec3::ZERO
        }
    }
}

/// Colours of layers of marble: the control points of pbrt's spline, of which four in a row make a segment.
const LAYERS: [[f32; 3]; 9] = [
    [0.58, 0.58, 0.6],
    [0.58, 0.58, 0.6],
    [0.58, 0.58, 0.6],
    [0.5, 0.5, 0.5],
    [0.6, 0.59, 0.58],
    [0.58, 0.58, 0.6],
    [0.58, 0.58, 0.6],
    [0.2, 0.2, 0.33],
    [0.58, 0.58, 0.6],
];

/// The colour at `t` in [0, 1], by de Casteljau's algorithm, and brightened by half.
fn marble(t: f32) -> Spectrum {
    let segments = LAYERS.len() - 3;
    let place = t * segments as f32;
    let first = (place as usize).min(segments - 1);
    let t = place - first as f32;
    let mut points: [Spectrum; 4] = std::array::from_fn(|i| Spectrum::from_rgb(LAYERS[first + i]));
    for last in (1..4).rev() {
        for i in 0..last {
            points[i] = points[i] * (1.0 - t) + points[i + 1] * t;
        }
    }
    points[0] * 1.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_permutation_is_one() {
        let mut sorted = PERMUTATION;
        sorted.sort_unstable();
        assert!(sorted.iter().enumerate().all(|(i, v)| i == usize::from(*v)));
    }

    #[test]
    fn noise_vanishes_on_the_lattice_and_rises_along_the_gradient() {
        for i in 0..200 {
            let [x, y, z] = [i % 7 - 3, (i * 5) % 11 - 4, (i * 3) % 13 + 250];
            let p = Vec3::new(x as f32, y as f32, z as f32);
            assert_eq!(perlin(p), 0.0);
            let step = 1e-2;
            let slope = |axis: Vec3| (perlin(p + axis * step) - perlin(p - axis * step)) / (2.0 * step);
            let found = Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z));
            assert!((found - gradient(x, y, z)).length() < 1e-2, "{p} {found}");
        }
    }

    /// In the middle of a cell all weights are 1/2: the mean of the corners' contributions.
    #[test]
    fn the_middle_of_a_cell_has_the_mean_of_its_corners() {
        for z in 0..50 {
            let middle = Vec3::new(0.5, 3.5, z as f32 + 0.5);
            let mut sum = 0.0;
            for corner in 0..8 {
                let [i, j, k] = [corner & 1, corner >> 1 & 1, corner >> 2];
                let offset = Vec3::new(0.5 - i as f32, 0.5 - j as f32, 0.5 - k as f32);
                sum += gradient(i, 3 + j, z + k).dot(offset);
            }
            assert!((perlin(middle) - sum / 8.0).abs() < 1e-6);
        }
    }

    #[test]
    fn octaves_are_sums_of_noises() {
        let p = Vec3::new(0.3, 1.7, -2.4);
        let octaves = Octaves { count: 3, falloff: 0.6 };
        let noises = [1.0, 1.99, 1.99 * 1.99].map(|f: f32| perlin(p * f));
        let brownian = noises[0] + 0.6 * noises[1] + 0.36 * noises[2];
        assert!((octaves.brownian(p) - brownian).abs() < 1e-6);
        let turbulence = noises[0].abs() + 0.6 * noises[1].abs() + 0.36 * noises[2].abs() + 0.216 * 0.2;
        assert!((octaves.turbulence(p) - turbulence).abs() < 1e-6);
    }

    #[test]
    fn marble_starts_and_ends_with_its_first_and_last_colour() {
        let close = |a: Spectrum, b: [f32; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-6);
        assert!(close(marble(0.0), [0.87, 0.87, 0.9]) && close(marble(1.0), [0.87, 0.87, 0.9]));
        // The middle of the fourth segment: (c3 + 3 c4 + 3 c5 + c6) / 8.
        let middle = [
            0.5 + 3.0 * (0.6 + 0.58) + 0.58,
            0.5 + 3.0 * (0.59 + 0.58) + 0.58,
            0.5 + 3.0 * (0.58 + 0.6) + 0.6,
        ];
        assert!(
            close(marble(3.5 / 6.0), middle.map(|c: f32| c / 8.0 * 1.5)),
            "{:?}",
            marble(3.5 / 6.0)
        );
    }
}
