//! The random numbers that drive paths: a pure function of (job seed, iteration, stream, path, dimension).
//!
//! A path draws them from a [`PathRandom`], whatever they are: numbers by counters, points of a Sobol' sequence, or a vector that
//! somebody wrote down or changed. Paths of the same numbers are the same path, to the last bit.
//!
//! No generator is shared and no state is carried between paths, so the numbers do not depend on threads or on
//! who renders what. The mixing function is the finaliser of SplitMix64 (Steele, Lea and Flood 2014) applied to a
//! counter; each path has its own key.

mod sobol;

use crate::math::{DVec2, Vec2};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

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
    /// Points of the discs about queries.
    Disc = 5,
    /// Points of the lens, and pixels, that light paths are connected with.
    Lens = 6,
    /// Times within the shutter interval.
    Time = 7,
}

/// How the random numbers of paths relate to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// All numbers are independent; so are the iterations of a job.
    Independent,
    /// The first numbers of the paths of one [`Sequence`] are points of a scrambled Sobol' sequence. Iterations of a job share the
    /// sequence and are not independent of each other; jobs with other seeds are.
    Sobol,
}

/// Paths of one iteration that sample the same integral: those of a pixel, or those from the lights.
#[derive(Clone, Copy, Debug)]
pub struct Sequence {
    /// Key of the iteration's independent numbers.
    key: u64,
    /// Number of the first path among those of all integrals.
    first_path: u64,
    /// Where Sobol' points are used: their key, and the place of the first path's.
    points: Option<(u64, u64)>,
}

/// The random numbers of one path, drawn in order of dimension.
#[derive(Clone, Debug)]
pub struct PathRandom {
    key: u64,
    /// Draws so far.
    dimension: u64,
    source: Source,
}

/// Where the first draws of a path come from; the others are independent numbers.
#[derive(Clone, Debug)]
enum Source {
    Independent,
    Point(sobol::Point),
    Vector(Arc<[DVec2]>),
}

/// Draws of a path that are taken from a Sobol' sequence: pixel, lens and three vertices of a camera path, emission and three
/// vertices of a light path.
const SOBOL_DRAWS: u64 = 16;

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Finaliser of SplitMix64.
const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

const fn iteration_key(seed: u64, iteration: u32, stream: Stream) -> u64 {
    mix(mix(seed.wrapping_add(GOLDEN)) ^ mix((iteration as u64) << 8 | stream as u64))
}

impl Sampling {
    /// The paths of iteration `iteration` (1, 2, ...) that sample integral `integral` of the `stream` (the pixel, or zero), `paths`
    /// in each iteration.
    #[must_use]
    pub fn sequence(self, seed: u64, iteration: u32, stream: Stream, integral: u64, paths: u32) -> Sequence {
        let points = match self {
            Self::Independent => None,
            Self::Sobol => {
                let key = mix(iteration_key(seed, 0, stream) ^ integral.wrapping_mul(GOLDEN));
                Some((key, u64::from(iteration.saturating_sub(1)) * u64::from(paths)))
            }
        };
        Sequence {
            key: iteration_key(seed, iteration, stream),
            first_path: integral * u64::from(paths),
            points,
        }
    }
}

impl Sequence {
    /// The numbers of path `path` (0, 1, ...).
    #[must_use]
    pub fn path(&self, path: u32) -> PathRandom {
        let path = u64::from(path);
        PathRandom {
            key: path_key(self.key, self.first_path + path),
            dimension: 0,
            source: match self.points {
                None => Source::Independent,
                Some((key, first)) => Source::Point(sobol::Point::new(key, first + path)),
            },
        }
    }
}

const fn path_key(iteration_key: u64, path: u64) -> u64 {
    mix(iteration_key ^ path.wrapping_mul(GOLDEN))
}

impl PathRandom {
    /// The numbers of path `path` of iteration `iteration` (1, 2, ...) under the job's `seed`, all independent.
    #[must_use]
    pub const fn new(seed: u64, iteration: u32, stream: Stream, path: u64) -> Self {
        Self {
            key: path_key(iteration_key(seed, iteration, stream), path),
            dimension: 0,
            source: Source::Independent,
        }
    }

    /// The draws so far as a vector of the primary sample space (Kelemen et al. 2002): each as two numbers on [0, 1), of which a draw of
    /// one number has used the first.
    #[must_use]
    pub fn recorded(&self) -> Vec<DVec2> {
        let mut again = Self {
            dimension: 0,
            ..self.clone()
        };
        (0..self.dimension).map(|_| again.next_choice_2d()).collect()
    }

    /// The same path from its start, but with the draws of `vector`, two numbers on [0, 1) each; beyond its end with independent ones.
    #[must_use]
    pub fn replay(&self, vector: &[DVec2]) -> Self {
        Self {
            key: self.key,
            dimension: 0,
            source: Source::Vector(vector.into()),
        }
    }

    /// The next number, uniform on [0, 1): 24 random bits.
    #[must_use]
    pub fn next_1d(&mut self) -> f32 {
        self.dimension += 1;
        let upper = match &self.source {
            Source::Point(point) if self.dimension <= SOBOL_DRAWS => point.coordinate(self.dimension),
            Source::Vector(vector) => self.pair_of(vector)[0],
            _ => (self.bits() >> 32) as u32,
        };
        (upper >> 8) as f32 * UNIT
    }

    /// The next two numbers: 24 random bits each.
    #[must_use]
    pub fn next_2d(&mut self) -> Vec2 {
        let [x, y] = self.next_pair();
        Vec2::new((x >> 8) as f32 * UNIT, (y >> 8) as f32 * UNIT)
    }

    /// The next number for a choice, uniform on [0, 1): 53 random bits, so that shares far below 2^-24 are met.
    #[must_use]
    pub fn next_choice(&mut self) -> f64 {
        self.next_choice_2d().x
    }

    /// The next two numbers for choices. Where the upper 32 bits are those of a Sobol' point, the others are random: a scrambled
    /// digit beyond those that are stratified.
    #[must_use]
    pub fn next_choice_2d(&mut self) -> DVec2 {
        if let Source::Vector(vector) = &self.source
            && let Some(draw) = vector.get(self.dimension as usize)
        {
            self.dimension += 1;
            return *draw;
        }
        let [x, y] = self.next_pair();
        let below = mix(self.bits());
        let number = |upper: u32, lower: u32| (u64::from(upper) << 21 | u64::from(lower >> 11)) as f64 * UNIT_OF_CHOICE;
        DVec2::new(number(x, (below >> 32) as u32), number(y, below as u32))
    }

    /// Independent numbers of their own, made of the next draw: for what takes nobody knows how many.
    #[must_use]
    pub fn apart(&mut self) -> Self {
        let draw = self.next_choice_2d();
        Self {
            key: mix(draw.x.to_bits() ^ mix(draw.y.to_bits().wrapping_add(GOLDEN))),
            dimension: 0,
            source: Source::Independent,
        }
    }

    fn next_pair(&mut self) -> [u32; 2] {
        self.dimension += 1;
        match &self.source {
            Source::Point(point) if self.dimension <= SOBOL_DRAWS => point.pair(self.dimension),
            Source::Vector(vector) => self.pair_of(vector),
            _ => self.independent_pair(),
        }
    }

    /// The upper 32 bits of both numbers of a draw from a vector. Nothing draws so often from one that its code should stand in the
    /// way of the other sources'.
    #[cold]
    fn pair_of(&self, vector: &[DVec2]) -> [u32; 2] {
        match vector.get(self.dimension as usize - 1) {
            Some(draw) => [upper(draw.x), upper(draw.y)],
            None => self.independent_pair(),
        }
    }

    fn independent_pair(&self) -> [u32; 2] {
        let bits = self.bits();
        [(bits >> 32) as u32, bits as u32]
    }

    fn bits(&self) -> u64 {
        mix(self.key.wrapping_add(self.dimension.wrapping_mul(GOLDEN)))
    }
}

/// The upper 32 bits of a number on [0, 1).
fn upper(number: f64) -> u32 {
    (number * (1u64 << 32) as f64) as u32
}

/// One over the number of values of 24 bits.
const UNIT: f32 = 1.0 / (1u64 << 24) as f32;

/// One over the number of values of 53 bits.
const UNIT_OF_CHOICE: f64 = 1.0 / (1u64 << 53) as f64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chi_square::{Domain, chi_square};

    /// Path `path` of iteration `iteration` of a thousand light paths each.
    fn light_path(seed: u64, iteration: u32, path: u32) -> PathRandom {
        Sampling::Sobol
            .sequence(seed, iteration, Stream::Light, 0, 1000)
            .path(path)
    }

    fn unit_square(cells: usize) -> Domain {
        Domain {
            lower: [0.0; 2],
            upper: [1.0; 2],
            cells: [cells; 2],
        }
    }

    /// Over seeds, every path's numbers are uniform, whatever its place in the sequence: the estimate of each iteration is
    /// unbiased.
    #[test]
    fn the_numbers_of_each_path_are_uniform_over_seeds() {
        for (iteration, path, skipped) in [(1, 0, 0), (1, 1, 3), (7, 999, 1), (5_000_000, 3, 15)] {
            let outcome = chi_square(
                &unit_square(16),
                100_000,
                1,
                |random| {
                    let seed = u64::from(random.next_1d().to_bits()) << 32 | u64::from(random.next_1d().to_bits());
                    let mut numbers = light_path(seed, iteration, path);
                    for _ in 0..skipped {
                        let _ = numbers.next_1d();
                    }
                    Some(numbers.next_2d().as_dvec2().to_array())
                },
                |_| 1.0,
            );
            assert!(outcome.passes(4), "iteration {iteration}, path {path}: {outcome:?}");
        }
    }

    /// Draws of one path are independent of each other although each is stratified over the paths.
    #[test]
    fn different_draws_are_independent_of_each_other() {
        let mut path = 0;
        for (first, second) in [(0, 1), (2, 13), (14, 15), (15, 16)] {
            let outcome = chi_square(
                &unit_square(16),
                100_000,
                1,
                |_| {
                    path += 1;
                    let mut numbers = light_path(3, 1 + path / 1000, path % 1000);
                    let draws: [f32; 17] = std::array::from_fn(|_| numbers.next_1d());
                    Some([f64::from(draws[first]), f64::from(draws[second])])
                },
                |_| 1.0,
            );
            assert!(outcome.passes(4), "draws {first} and {second}: {outcome:?}");
        }
    }

    /// Consecutive iterations take consecutive slices: 64 iterations of 16 paths are the first 1024 points.
    #[test]
    fn iterations_share_the_sequence() {
        let mut cells = vec![false; 1024];
        for index in 0..1024 {
            let p = Sampling::Sobol
                .sequence(3, 1 + index / 16, Stream::Camera, 7, 16)
                .path(index % 16)
                .next_2d();
            let cell = (p.x * 32.0) as usize * 32 + (p.y * 32.0) as usize;
            assert!(!std::mem::replace(&mut cells[cell], true), "two points in one cell");
        }
    }

    /// Numbers for choices are those of the other draws with more digits, and over seeds their last digits are as random as the first.
    #[test]
    fn numbers_for_choices_have_53_random_bits() {
        for sampling in [Sampling::Independent, Sampling::Sobol] {
            let draws: Vec<(Vec2, DVec2)> = (0..20_000)
                .map(|seed| {
                    let mut numbers = sampling.sequence(seed, 2, Stream::Light, 0, 100).path(7);
                    (numbers.clone().next_2d(), numbers.next_choice_2d())
                })
                .collect();
            let unit = 1.0 / f64::from(1_u32 << 24);
            for (coarse, fine) in &draws {
                let below = *fine - coarse.as_dvec2();
                assert!(
                    below.min_element() >= 0.0 && below.max_element() < unit,
                    "{coarse} and {fine}"
                );
            }
            for scale in [24, 32, 45] {
                let digits = |(_, fine): &(Vec2, DVec2)| (*fine * (1_u64 << scale) as f64).fract().to_array();
                let mut next = draws.iter().map(digits);
                let outcome = chi_square(&unit_square(8), 20_000, 1, |_| next.next(), |_| 1.0);
                assert!(outcome.passes(6), "{sampling:?} from bit {scale}: {outcome:?}");
            }
        }
    }

    #[test]
    fn pixels_and_streams_have_their_own_points() {
        let first = |seed, stream, integral| Sampling::Sobol.sequence(seed, 1, stream, integral, 9).path(0).next_2d();
        let one = first(3, Stream::Light, 0);
        for other in [
            first(3, Stream::Light, 1),
            first(4, Stream::Light, 0),
            first(3, Stream::Camera, 0),
        ] {
            assert_ne!(one, other);
        }
    }

    /// Draws of every kind, more of them than a Sobol' point has coordinates for.
    #[test]
    fn a_recorded_path_is_replayed() {
        let draw = |numbers: &mut PathRandom, index: u32| match index % 3 {
            0 => DVec2::new(f64::from(numbers.next_1d()), 0.0),
            1 => numbers.next_2d().as_dvec2(),
            _ => numbers.next_choice_2d(),
        };
        for sampling in [Sampling::Independent, Sampling::Sobol] {
            let sequence = sampling.sequence(5, 2, Stream::Camera, 10, 4);
            let mut path = sequence.path(3);
            let drawn: Vec<DVec2> = (0..40).map(|index| draw(&mut path, index)).collect();
            let vector = path.recorded();
            assert_eq!(vector.len(), 40);
            let mut other = sequence.path(0).replay(&vector);
            let again: Vec<DVec2> = (0..40).map(|index| draw(&mut other, index)).collect();
            assert_eq!(again, drawn);
            assert_ne!(
                other.next_2d(),
                path.next_2d(),
                "beyond the vector each path has its own numbers"
            );
        }
    }

    #[test]
    fn independent_paths_are_numbered_through() {
        let mut path = Sampling::Independent.sequence(5, 2, Stream::Camera, 10, 4).path(3);
        let mut same = PathRandom::new(5, 2, Stream::Camera, 43);
        assert_eq!(path.next_2d(), same.next_2d());
        assert_eq!(path.next_1d(), same.next_1d());
    }
}
