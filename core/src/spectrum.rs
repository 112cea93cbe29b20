//! Colour. Nothing outside this module knows how many channels there are.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Index, Mul, MulAssign, Sub};

/// Channels of a [`Spectrum`]: linear Rec. 709 (sRGB primaries, D65 white) red, green and blue.
pub const CHANNELS: usize = 3;

/// A quantity per wavelength band: radiance [W/(m^2 sr)], flux \[W\], reflectance, or an optical constant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spectrum([f32; CHANNELS]);

impl Spectrum {
    /// Zero in every channel.
    pub const ZERO: Self = Self([0.0; CHANNELS]);
    /// One in every channel.
    pub const ONE: Self = Self([1.0; CHANNELS]);

    /// The same value in every channel.
    #[must_use]
    #[inline]
    pub const fn splat(v: f32) -> Self {
        Self([v; CHANNELS])
    }

    /// From linear Rec. 709 values.
    #[must_use]
    #[inline]
    pub const fn from_rgb(rgb: [f32; 3]) -> Self {
        Self(rgb)
    }

    /// As linear Rec. 709 values.
    #[must_use]
    #[inline]
    pub const fn to_rgb(self) -> [f32; 3] {
        self.0
    }

    /// From the value of each channel.
    #[must_use]
    #[inline]
    pub const fn from_channels(channels: [f32; CHANNELS]) -> Self {
        Self(channels)
    }

    /// The value of each channel.
    #[must_use]
    #[inline]
    pub const fn channels(self) -> [f32; CHANNELS] {
        self.0
    }

    /// The average, summed at double precision.
    #[must_use]
    pub fn average(values: impl ExactSizeIterator<Item = Self>) -> Self {
        let count = values.len() as f64;
        let mut sums = [0.0; CHANNELS];
        for value in values {
            for (sum, channel) in sums.iter_mut().zip(value.0) {
                *sum += f64::from(channel);
            }
        }
        Self(sums.map(|sum| (sum / count) as f32))
    }

    /// Applies `f` to each channel.
    #[must_use]
    #[inline]
    pub fn map(self, mut f: impl FnMut(f32) -> f32) -> Self {
        Self(self.0.map(&mut f))
    }

    /// Combines two spectra channel by channel.
    #[must_use]
    #[inline]
    pub fn zip(self, other: Self, mut f: impl FnMut(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|i| f(self.0[i], other.0[i])))
    }

    /// Luminance by Rec. 709 weights.
    #[must_use]
    #[inline]
    pub fn luminance(self) -> f32 {
        0.212_671 * self.0[0] + 0.715_160 * self.0[1] + 0.072_169 * self.0[2]
    }

    /// As one number: the value of all channels where they agree, and else the luminance.
    #[must_use]
    #[inline]
    pub fn number(self) -> f32 {
        let [first, rest @ ..] = self.0;
        match rest.iter().all(|channel| *channel == first) {
            true => first,
            false => self.luminance(),
        }
    }

    /// The largest channel.
    #[must_use]
    #[inline]
    pub fn max_component(self) -> f32 {
        self.0.into_iter().fold(f32::NEG_INFINITY, f32::max)
    }

    /// The mean over channels.
    #[must_use]
    #[inline]
    pub fn mean(self) -> f32 {
        self.0.into_iter().sum::<f32>() / CHANNELS as f32
    }

    /// Whether every channel is exactly zero.
    #[must_use]
    #[inline]
    pub fn is_black(self) -> bool {
        self.0 == [0.0; CHANNELS]
    }

    /// Whether every channel is finite and not negative.
    #[must_use]
    #[inline]
    pub fn is_valid(self) -> bool {
        self.0.iter().all(|c| c.is_finite() && *c >= 0.0)
    }
}

impl Index<usize> for Spectrum {
    type Output = f32;
    #[inline]
    fn index(&self, channel: usize) -> &f32 {
        &self.0[channel]
    }
}

impl Add for Spectrum {
    type Output = Self;
    #[inline]
    fn add(self, rhs: Self) -> Self {
        self.zip(rhs, |a, b| a + b)
    }
}

impl AddAssign for Spectrum {
    #[inline]
    fn add_assign(&mut self, rhs: Self) {
        *self = *self + rhs;
    }
}

impl Sub for Spectrum {
    type Output = Self;
    #[inline]
    fn sub(self, rhs: Self) -> Self {
        self.zip(rhs, |a, b| a - b)
    }
}

impl Mul for Spectrum {
    type Output = Self;
    #[inline]
    fn mul(self, rhs: Self) -> Self {
        self.zip(rhs, |a, b| a * b)
    }
}

impl Mul<f32> for Spectrum {
    type Output = Self;
    #[inline]
    fn mul(self, rhs: f32) -> Self {
        self.map(|a| a * rhs)
    }
}

impl MulAssign for Spectrum {
    #[inline]
    fn mul_assign(&mut self, rhs: Self) {
        *self = *self * rhs;
    }
}

impl MulAssign<f32> for Spectrum {
    #[inline]
    fn mul_assign(&mut self, rhs: f32) {
        *self = *self * rhs;
    }
}

impl Div<f32> for Spectrum {
    type Output = Self;
    #[inline]
    fn div(self, rhs: f32) -> Self {
        self.map(|a| a / rhs)
    }
}

impl Sum for Spectrum {
    #[inline]
    fn sum<I: Iterator<Item = Self>>(iter: I) -> Self {
        iter.fold(Self::ZERO, |a, b| a + b)
    }
}
