//! Lengths that are drawn for photon surfaces.

use crate::math::{exp, exp_m1, ln_1p};
use crate::medium::{Medium, Space};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::CHANNELS;

/// A mixture of exponential densities of lengths, one for each channel that a medium extinguishes.
///
/// What comes through is evaluated for the place that is found, so that any density is right. This one fits a medium that is the
/// same everywhere in all channels at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rates {
    /// Of the channels that count, at the front \[1/unit\].
    rates: [f32; CHANNELS],
    count: usize,
}

impl Rates {
    /// Those of a medium; `None` where it extinguishes nothing.
    pub(super) fn of(medium: &Medium) -> Option<Self> {
        let (mut rates, mut count) = ([0.0; CHANNELS], 0);
        for rate in medium.typical_extinction().channels() {
            if rate > 0.0 {
                rates[count] = rate;
                count += 1;
            }
        }
        (count > 0).then_some(Self { rates, count })
    }

    /// Those of the first of some spaces whose medium extinguishes something, or a rate that suits the size of the scene where none does.
    pub(super) fn of_first(spaces: impl IntoIterator<Item = Space>, scene: &Scene) -> Self {
        let mut spaces = spaces.into_iter();
        spaces
            .find_map(|space| Self::of(scene.medium(space)?.1))
            .unwrap_or_else(|| {
                let (lower, upper) = scene.geometry.bounds();
                Self::single(1.0 / (upper - lower).length().max(f32::MIN_POSITIVE))
            })
    }

    fn single(rate: f32) -> Self {
        let mut rates = [0.0; CHANNELS];
        rates[0] = rate;
        Self { rates, count: 1 }
    }

    fn mean(&self, of_rate: impl Fn(f32) -> f32) -> f32 {
        let rates = &self.rates[..self.count];
        rates.iter().map(|rate| of_rate(*rate)).sum::<f32>() / self.count as f32
    }

    /// The density of a length \[1/unit\].
    pub(super) fn density(&self, length: f32) -> f32 {
        self.mean(|rate| rate * exp(-rate * length))
    }

    /// The probability of a greater length.
    pub(super) fn exceeds(&self, length: f32) -> f32 {
        self.mean(|rate| exp(-rate * length))
    }

    /// A length.
    pub(super) fn sample(&self, random: &mut PathRandom) -> f32 {
        let rate = self.choose(random.next_1d());
        -ln_1p(-random.next_1d()) / rate
    }

    /// A length below `most`, perhaps infinite, with its density \[1/unit\].
    pub(super) fn sample_below(&self, most: f32, random: &mut PathRandom) -> (f32, f32) {
        let rate = self.choose(random.next_1d());
        let length = (-ln_1p(random.next_1d() * exp_m1(-rate * most)) / rate).min(most);
        (length, self.density_below(length, most))
    }

    /// The density of a length below `most` \[1/unit\].
    pub(super) fn density_below(&self, length: f32, most: f32) -> f32 {
        self.mean(|rate| rate * exp(-rate * length) / -exp_m1(-rate * most))
    }

    fn choose(&self, u: f32) -> f32 {
        self.rates[((u * self.count as f32) as usize).min(self.count - 1)]
    }
}
