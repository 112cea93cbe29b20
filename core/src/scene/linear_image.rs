//! What images are decoded into: pixels as the file has them, and linear colour.

use crate::math::pow;
use crate::spectrum::Spectrum;
use crate::texture::Texels;

/// Pixels in linear colour, row by row from the top left. All are finite and none is negative.
#[derive(Debug)]
pub(crate) struct LinearImage {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) texels: Texels,
}

/// How an image is read.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(crate) struct Reading {
    pub(crate) encoding: Encoding,
    pub(crate) channel: Channel,
    /// Whether `1 - v` stands in the place of `v`, and 0 where that is negative.
    pub(crate) inverted: bool,
}

impl Reading {
    /// As the colours of a picture.
    pub(crate) const COLOURS: Self = Self {
        encoding: Encoding::Srgb,
        channel: Channel::All,
        inverted: false,
    };
}

/// What the integers of an image stand for. Floats are linear, and so is alpha.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub(crate) enum Encoding {
    Srgb,
    Linear,
    /// The power of which is linear.
    Gamma(f32),
}

/// Which channels of an image are read; all but the first make a grey texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Channel {
    /// The colour.
    All,
    Red,
    Green,
    Blue,
    /// 1 in images without alpha.
    Alpha,
    /// The luminance of the colour.
    Luminance,
    /// The mean of the colour's channels.
    Mean,
    /// Alpha, encoded as the colour is, where some of the image is not opaque, and else the mean of the colour's channels: what pbrt-v4
    /// takes for a number (`MIPMap::Bilerp`).
    OpacityOrMean,
}

/// Pixels as a file has them.
#[derive(Debug)]
pub(super) struct Pixels {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Grey, grey and alpha, colour, or colour and alpha, by their number: 1 to 4.
    pub(super) channels: usize,
    /// Channels of a pixel side by side.
    pub(super) samples: Samples,
}

/// Numbers of one kind.
#[derive(Debug)]
pub(super) enum Samples {
    Bytes(Vec<u8>),
    Words(Vec<u16>),
    Floats(Vec<f32>),
}

/// Where a grey texture finds its number in a pixel.
enum Place {
    At(usize),
    /// In images without alpha.
    One,
    /// The luminance of the first three.
    Luminance,
    /// The mean of the first three.
    Mean,
}

impl Pixels {
    /// Whether the last channel is that of opaque pixels everywhere.
    fn is_opaque(&self) -> bool {
        let channels = self.channels;
        match &self.samples {
            Samples::Bytes(bytes) => bytes.chunks_exact(channels).all(|p| p[channels - 1] == u8::MAX),
            Samples::Words(words) => words.chunks_exact(channels).all(|p| p[channels - 1] == u16::MAX),
            Samples::Floats(floats) => floats.chunks_exact(channels).all(|p| p[channels - 1] == 1.0),
        }
    }

    /// Decodes the channels that are asked for.
    pub(super) fn decode(self, reading: &Reading) -> LinearImage {
        let channels = self.channels;
        let coloured = channels >= 3;
        let asked = match reading.channel {
            Channel::OpacityOrMean if channels == 4 && !self.is_opaque() => Channel::Alpha,
            Channel::OpacityOrMean => Channel::Mean,
            other => other,
        };
        let place = match asked {
            Channel::All if coloured => None,
            Channel::Luminance if coloured => Some(Place::Luminance),
            Channel::Mean if coloured => Some(Place::Mean),
            Channel::Green if coloured => Some(Place::At(1)),
            Channel::Blue if coloured => Some(Place::At(2)),
            Channel::Alpha if channels.is_multiple_of(2) => Some(Place::At(channels - 1)),
            Channel::Alpha => Some(Place::One),
            _ => Some(Place::At(0)),
        };
        let encoding = match reading.channel {
            Channel::Alpha => Encoding::Linear,
            _ => reading.encoding,
        };
        let texels = match self.samples {
            Samples::Bytes(bytes) => {
                let table = byte_table(encoding);
                let pixels = bytes.chunks_exact(channels);
                match place {
                    None => Texels::ColourBytes(pixels.map(|p| [p[0], p[1], p[2]]).collect(), table),
                    Some(Place::At(i)) => Texels::GreyBytes(pixels.map(|p| p[i]).collect(), table),
                    Some(Place::One) => Texels::GreyBytes(pixels.map(|_| u8::MAX).collect(), table),
                    Some(Place::Luminance | Place::Mean) => decoded(pixels, place, |byte: u8| table[usize::from(byte)]),
                }
            }
            Samples::Words(words) => {
                let table: Vec<f32> = (0..=u16::MAX).map(|step| encoding.linear(step, u16::MAX)).collect();
                decoded(words.chunks_exact(channels), place, |word: u16| {
                    table[usize::from(word)]
                })
            }
            Samples::Floats(floats) => decoded(floats.chunks_exact(channels), place, |float: f32| float),
        };
        LinearImage {
            width: self.width,
            height: self.height,
            texels,
        }
    }
}

/// Texels as floats: colours, or what is at a place.
fn decoded<'p, S: Copy + 'p>(
    pixels: impl Iterator<Item = &'p [S]>,
    place: Option<Place>,
    linear: impl Fn(S) -> f32,
) -> Texels {
    let colour = |pixel: &[S]| Spectrum::from_rgb([linear(pixel[0]), linear(pixel[1]), linear(pixel[2])]);
    match place {
        None => Texels::Colours(pixels.map(colour).collect()),
        Some(Place::At(i)) => Texels::Greys(pixels.map(|pixel| linear(pixel[i])).collect()),
        Some(Place::One) => Texels::Greys(pixels.map(|_| 1.0).collect()),
        Some(Place::Luminance) => Texels::Greys(pixels.map(|pixel| colour(pixel).luminance()).collect()),
        Some(Place::Mean) => Texels::Greys(pixels.map(|pixel| colour(pixel).mean()).collect()),
    }
}

fn byte_table(encoding: Encoding) -> Box<[f32; 256]> {
    let step = |i: usize| encoding.linear(i as u16, u16::from(u8::MAX));
    Box::new(std::array::from_fn(step))
}

impl Encoding {
    /// The linear value of an integer step, of which the largest stands for 1.
    fn linear(self, step: u16, largest: u16) -> f32 {
        let share = f32::from(step) / f32::from(largest);
        match self {
            Self::Srgb => srgb_to_linear(share),
            Self::Linear => share,
            Self::Gamma(gamma) => pow(share, gamma),
        }
    }
}

/// The transfer function of sRGB (IEC 61966-2-1), from encoded to linear.
pub(crate) fn srgb_to_linear(encoded: f32) -> f32 {
    if encoded <= 0.04045 {
        encoded / 12.92
    } else {
        pow((encoded + 0.055) / 1.055, 2.4)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(channels: usize, samples: &[u8]) -> Pixels {
        Pixels {
            width: samples.len() / channels,
            height: 1,
            channels,
            samples: Samples::Bytes(samples.to_vec()),
        }
    }

    fn reading(channel: Channel) -> Reading {
        Reading {
            encoding: Encoding::Linear,
            channel,
            inverted: false,
        }
    }

    /// What each number of channels gives for each that is asked for, of bytes, words and floats alike.
    #[test]
    fn channels_are_picked_from_images_of_every_kind() {
        let pixel = [51, 102, 153, 204].map(|byte| f32::from(byte as u8) / 255.0);
        let luminance = Spectrum::from_rgb([pixel[0], pixel[1], pixel[2]]).luminance();
        let [a, b, c, d] = pixel;
        let mean = (a + b + c) / 3.0;
        let rows = [
            (1, [a, a, a, 1.0, a, a, a]),
            (2, [a, a, a, b, a, a, a]),
            (3, [a, b, c, 1.0, luminance, mean, mean]),
            (4, [a, b, c, d, luminance, mean, d]),
        ];
        let asked = [
            Channel::Red,
            Channel::Green,
            Channel::Blue,
            Channel::Alpha,
            Channel::Luminance,
            Channel::Mean,
            Channel::OpacityOrMean,
        ];
        for (channels, expected) in rows {
            for (channel, expected) in asked.into_iter().zip(expected) {
                let kinds = [
                    Samples::Bytes(vec![51, 102, 153, 204][..channels].to_vec()),
                    Samples::Words(vec![13_107, 26_214, 39_321, 52_428][..channels].to_vec()),
                    Samples::Floats(pixel[..channels].to_vec()),
                ];
                for samples in kinds {
                    let image = Pixels {
                        width: 1,
                        height: 1,
                        channels,
                        samples,
                    };
                    let found = image.decode(&reading(channel)).texels.get(0);
                    let close = (0..3).all(|i| (found[i] - expected).abs() < 1e-6);
                    assert!(close, "{channels} {channel:?}: {found:?}, expected {expected}");
                }
            }
        }
        let opaque = bytes(4, &[51, 102, 153, 255]).decode(&reading(Channel::OpacityOrMean));
        assert!((opaque.texels.get(0)[0] - mean).abs() < 1e-6);
        let colour = bytes(4, &[51, 102, 153, 204])
            .decode(&reading(Channel::All))
            .texels
            .get(0);
        assert_eq!(colour.to_rgb(), [a, b, c]);
    }

    #[test]
    fn integers_are_decoded_as_asked_and_alpha_is_linear() {
        let linear = |encoding, channel| {
            let reading = Reading {
                encoding,
                ..reading(channel)
            };
            bytes(4, &[51, 188, 255, 51]).decode(&reading).texels.get(0)
        };
        let srgb = linear(Encoding::Srgb, Channel::All);
        assert!((srgb[0] - 0.033_105).abs() < 1e-6 && (srgb[1] - 0.502_886).abs() < 1e-6 && srgb[2] == 1.0);
        let gamma = linear(Encoding::Gamma(2.2), Channel::Red)[0];
        assert!((gamma - 0.028_991).abs() < 1e-6, "{gamma}");
        for encoding in [Encoding::Srgb, Encoding::Linear, Encoding::Gamma(2.2)] {
            assert_eq!(linear(encoding, Channel::Alpha)[0], 0.2);
        }
    }

    /// A texel of an image of bytes takes three bytes, or one where it is grey.
    #[test]
    fn bytes_stay_bytes() {
        let colour = bytes(3, &[1, 2, 3]).decode(&Reading::COLOURS).texels;
        assert!(matches!(colour, Texels::ColourBytes(texels, _) if texels == [[1, 2, 3]]));
        let grey = bytes(2, &[7, 9]).decode(&Reading::COLOURS).texels;
        assert!(matches!(grey, Texels::GreyBytes(texels, _) if texels == [7]));
    }
}
