//! Counter-based random numbers: a pure function of (job seed, iteration, stream, path, dimension).
//!
//! No generator is shared and no state is carried between paths, so the numbers do not depend on threads or on
//! who renders what. The mixing function is the finaliser of SplitMix64 (Steele, Lea and Flood 2014) applied to a
//! counter; each path has its own key.

use crate::math::Vec2;

/// What a path's random numbers are for; streams never share numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Stream {
    /// Paths traced from the camera.
    Camera = 1,
    /// Paths traced from the lights.
    Light = 2,
    /// Paths that measure the scene before rendering.
    Probe = 3,
    /// Directions of the cones at the vertices of light paths.
    Cone = 4,
}

/// The random numbers of one path, drawn in order of dimension.
#[derive(Clone, Debug)]
pub struct PathRandom {
    key: u64,
    dimension: u64,
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Finaliser of SplitMix64.
const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl PathRandom {
    /// The numbers of path `path` of iteration `iteration` (1, 2, ...) under the job's `seed`.
    #[must_use]
    pub const fn new(seed: u64, iteration: u32, stream: Stream, path: u64) -> Self {
        let key = mix(seed.wrapping_add(GOLDEN));
        let key = mix(key ^ mix((iteration as u64) << 8 | stream as u64));
        Self {
            key: mix(key ^ path.wrapping_mul(GOLDEN)),
            dimension: 0,
        }
    }

    /// The next number, uniform on [0, 1): 24 random bits.
    #[must_use]
    pub fn next_1d(&mut self) -> f32 {
        (self.next_bits() >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
    }

    /// The next two numbers.
    #[must_use]
    pub fn next_2d(&mut self) -> Vec2 {
        let bits = self.next_bits();
        let scale = 1.0 / (1u64 << 24) as f32;
        Vec2::new((bits >> 40) as f32 * scale, ((bits >> 8) & 0xff_ffff) as f32 * scale)
    }

    fn next_bits(&mut self) -> u64 {
        self.dimension += 1;
        mix(self.key.wrapping_add(self.dimension.wrapping_mul(GOLDEN)))
    }
}
