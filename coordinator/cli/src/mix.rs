//! `photonfarm mix`: a picture with its lamps brighter, darker, of other colours, or off.

use crate::metrics::decoded;
use crate::output::{PictureFiles, plain_exr};
use crate::say;
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;
use exr::image::{AnyChannel, FlatSamples};
use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers};
use photonfarm_core::film::Image;
use photonfarm_core::integrator::layers::Layers;
use photonfarm_core::picture;
use photonfarm_core::spectrum::Spectrum;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::path::PathBuf;

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm mix image.exr --lamp 'window=#ffcc88' --lamp 'ceiling=0.5' -o evening.exr
      The window in a warmer colour, the ceiling's lamp at half its power; other lamps as they are.
  photonfarm mix image.exr --lamp 'window=1,0.8,0.5*+1.5EV' --lamp '*=0' -o window.exr
      The window with factors for red, green and blue, one and a half stops brighter, and nothing else.

image.exr is a picture with layers of lamps, as `render --layer lamp:window` makes it; NAME is what
follows `lamp:` there, and `*` are all other lamps. GAIN is one or more of these, with `*` between
them: a colour such as #ffcc88 (sRGB, by which light is multiplied in linear light), three factors
R,G,B, a factor, stops such as -1EV. Without any --lamp the picture is the one that the file holds.
The page of a job shows the same, and the command that repeats it.";

/// Most pixels of a picture that is read.
const MOST_PIXELS: usize = 1 << 28;
/// Most bytes of all of its channels.
const MOST_BYTES: usize = 1 << 34;
/// Most stops either way.
const MOST_STOPS: f64 = 64.0;

#[derive(Debug, Args)]
pub(crate) struct MixArgs {
    /// Picture with layers of lamps
    #[arg(value_name = "IMAGE.exr")]
    picture: PathBuf,
    /// A lamp, and by what its light is multiplied
    #[arg(long = "lamp", value_name = "NAME=GAIN", value_parser = lamp)]
    lamps: Vec<(String, [f64; 3])>,
    /// Picture to write; the PNG beside it has the same name with the extension png
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
}

/// A lamp with its gain, as typed.
fn lamp(text: &str) -> Result<(String, [f64; 3])> {
    let (name, gain) = text
        .rsplit_once('=')
        .ok_or_else(|| anyhow!("write NAME=GAIN, such as window=#ffcc88"))?;
    let mut product = [1.0; 3];
    for part in gain.split('*') {
        // Of the error of an argument people see the outermost message alone.
        let factors = factors(part.trim()).map_err(|error| anyhow!("the gain {gain:?} of {name:?}: {error}"))?;
        (0..3).for_each(|channel| product[channel] *= factors[channel]);
    }
    ensure!(
        product.iter().all(|factor| factor.is_finite() && *factor >= 0.0),
        "the gain {gain:?} of {name:?} is not three numbers from zero on"
    );
    Ok((name.trim().to_owned(), product))
}

fn factors(text: &str) -> Result<[f64; 3]> {
    let number = |text: &str| {
        let number: f64 = text.trim().parse().map_err(|_| {
            anyhow!("{text:?} is no factor: give a colour such as #ffcc88, three numbers R,G,B, a number, or stops such as 1.5EV")
        })?;
        Ok::<_, anyhow::Error>(number)
    };
    if let Some(digits) = text.strip_prefix('#') {
        ensure!(
            digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit()),
            "{text:?} is no colour: write six digits, such as #ffcc88"
        );
        let value = u32::from_str_radix(digits, 16)?;
        return Ok([16, 8, 0].map(|shift| decoded(f64::from(value >> shift & 0xff) / 255.0)));
    }
    if let Some(stops) = text.strip_suffix("EV").or_else(|| text.strip_suffix("ev")) {
        let stops = number(stops)?;
        ensure!(
            stops.abs() <= MOST_STOPS,
            "{stops} stops; at most {MOST_STOPS} either way"
        );
        return Ok([stops.exp2(); 3]);
    }
    match text.split(',').map(number).collect::<Result<Vec<f64>>>()?.as_slice() {
        [all] => Ok([*all; 3]),
        [r, g, b] => Ok([*r, *g, *b]),
        other => bail!("{} factors: give one, or three for red, green and blue", other.len()),
    }
}

/// Runs the command.
pub(crate) fn run(args: MixArgs) -> Result<()> {
    let files = PictureFiles::check(&args.output)?;
    let name = args.picture.display().to_string();
    let bytes = std::fs::read(&args.picture).with_context(|| format!("cannot read {name}"))?;
    let mut file =
        LitPicture::read(&bytes).with_context(|| format!("{name} cannot be read as a picture with layers"))?;
    let pixels = file.mixed(&args.lamps).with_context(|| name.clone())?;
    let image = Image {
        width: file.width,
        height: file.height,
        iterations: 1,
        odd_iterations: 1,
        pixels,
        standard_error: vec![],
    };
    let exr = plain_exr(image.width, image.height, |index| image.pixels[index].to_rgb())?;
    files.write(&exr, &picture::encode_png(&image)?)?;
    say::line(format!("wrote {}", files.names()))
}

/// Light of each pixel, channel by channel.
type Light = [Vec<f32>; 3];

/// A picture, and the light of its lamps.
struct LitPicture {
    width: u32,
    height: u32,
    picture: Light,
    /// The light of lamps that have no lamp in common, by what follows `lamp:` in the layer's name.
    lamps: Vec<(String, Light)>,
    /// Layers that share a lamp with one of these.
    shared: BTreeSet<String>,
}

impl LitPicture {
    fn read(bytes: &[u8]) -> Result<Self> {
        for header in MetaData::read_from_buffered(Cursor::new(bytes), false)?.headers {
            let exr::math::Vec2(width, height) = header.layer_size;
            let pixels = width.checked_mul(height).filter(|pixels| *pixels <= MOST_PIXELS);
            let pixels =
                pixels.with_context(|| format!("{width} by {height} pixels; the limit is {MOST_PIXELS} pixels"))?;
            let each = header.channels.bytes_per_pixel;
            ensure!(
                pixels.checked_mul(each).is_some_and(|bytes| bytes <= MOST_BYTES),
                "{pixels} pixels of {each} bytes; the limit is {MOST_BYTES} bytes"
            );
        }
        let metadata = picture::read_metadata(bytes)?;
        let metadata = metadata.context("it does not say which layers it has: give a picture that photonfarm wrote")?;
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(bytes))?;
        let layer = image.layer_data;
        let channels = layer.channel_data.list.into_iter();
        let mut channels: BTreeMap<String, AnyChannel<FlatSamples>> =
            channels.map(|channel| (channel.name.to_string(), channel)).collect();
        let mut take = |name: &str| {
            let channel = channels
                .remove(name)
                .with_context(|| format!("it has no channel {name}"))?;
            Ok::<Vec<f32>, anyhow::Error>(channel.sample_data.values_as_f32().collect())
        };
        let mut light = |[r, g, b]: [&str; 3]| Ok::<Light, anyhow::Error>([take(r)?, take(g)?, take(b)?]);
        let picture = light(["R", "G", "B"])?;
        let (mut lamps, mut shared, mut taken) = (Vec::new(), BTreeSet::new(), BTreeSet::new());
        for layer in &metadata.layers {
            let Some(name) = layer.strip_prefix("lamp:") else {
                continue;
            };
            let names: Vec<&str> = name.split('+').map(str::trim).collect();
            match names.iter().any(|name| taken.contains(name)) {
                true => _ = shared.insert(name.to_owned()),
                false => {
                    let channels = channel_names(layer)?;
                    lamps.push((name.to_owned(), light(channels.each_ref().map(String::as_str))?));
                    taken.extend(names);
                }
            }
        }
        ensure!(
            !lamps.is_empty(),
            "it has no layer of a lamp: render it with --layer lamp:NAME"
        );
        let size = layer.size;
        Ok(Self {
            width: size.width() as u32,
            height: size.height() as u32,
            picture,
            lamps,
            shared,
        })
    }

    /// The picture with its lamps multiplied by these gains; the others are as they are.
    fn mixed(&mut self, gains: &[(String, [f64; 3])]) -> Result<Vec<Spectrum>> {
        let mut by_name = BTreeMap::new();
        for (name, gain) in gains {
            let known = name == OTHERS || self.lamps.iter().any(|(known, _)| known == name);
            ensure!(
                !self.shared.contains(name),
                "the layer lamp:{name} shares a lamp with one before it, and their light would count twice: mix that one"
            );
            if !known {
                let known: Vec<&str> = self.lamps.iter().map(|(name, _)| name.as_str()).collect();
                bail!(
                    "there is no layer lamp:{name}; there are: {}, and `*` for all others",
                    known.join(", ")
                );
            }
            if by_name.insert(name.as_str(), *gain).is_some() {
                bail!("--lamp {name} is given twice");
            }
        }
        let whole = [1.0; 3];
        let gain_of = |name: &str| by_name.get(name).copied().unwrap_or(whole);
        let covered = self.shared.is_empty() && self.lamps.iter().any(|(name, _)| name == OTHERS);
        let rest = if covered { whole } else { gain_of(OTHERS) };
        let same = rest == whole && self.lamps.iter().all(|(name, _)| gain_of(name) == whole);
        let value = |channel: usize, index: usize| {
            let picture = self.picture[channel][index];
            if same {
                return picture;
            }
            let (mut mixed, mut left) = (0.0, f64::from(picture));
            for (name, light) in &self.lamps {
                let light = f64::from(light[channel][index]);
                mixed += gain_of(name)[channel] * light;
                left -= light;
            }
            // What is left of a picture whose lamps are all there are roundings.
            if !covered {
                mixed += rest[channel] * left.max(0.0);
            }
            mixed as f32
        };
        let pixel = |index| Spectrum::from_rgb(std::array::from_fn(|channel| value(channel, index)));
        Ok((0..self.picture[0].len()).map(pixel).collect())
    }
}

/// What follows `lamp:` in the name of the layer of all lamps that no other layer names.
const OTHERS: &str = "*";

/// The names of the channels of a layer of light.
fn channel_names(layer: &str) -> Result<[String; 3]> {
    let layers = Layers::parse(&[layer])?;
    let pixel = Image {
        width: 1,
        height: layers.stack(),
        iterations: 1,
        odd_iterations: 1,
        pixels: vec![Spectrum::ZERO; layers.stack() as usize],
        standard_error: vec![],
    };
    let names: Vec<String> = layers
        .channels(&pixel)?
        .into_iter()
        .map(|channel| channel.name)
        .collect();
    names.try_into().map_err(|_| anyhow!("layer {layer} is no light"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::integrator::layers::Channel;
    use photonfarm_core::picture::PictureMetadata;
    use serde_json::json;

    /// A picture of two pixels with layers, whose lamps shine as they say.
    fn picture(layers: &[(&str, [f32; 2])], whole: [f32; 2]) -> Vec<u8> {
        let metadata: PictureMetadata = serde_json::from_value(json!({
            "version": "", "scene_hash": "", "defines": {}, "integrator": {"type": "path"}, "seed": 0, "iterations": 1,
            "layers": layers.iter().map(|(name, _)| name).collect::<Vec<_>>()}))
        .unwrap();
        let image = Image {
            width: 2,
            height: 1,
            iterations: 1,
            odd_iterations: 1,
            pixels: whole.map(Spectrum::splat).into(),
            standard_error: vec![],
        };
        let channels = layers.iter().flat_map(|(name, light)| {
            let channel = |name| Channel {
                name,
                samples: light.to_vec(),
            };
            channel_names(name).unwrap().map(channel)
        });
        picture::encode_exr(
            &image,
            photonfarm_core::picture::Beside {
                channels: channels.collect(),
                ..Default::default()
            },
            &metadata,
        )
        .unwrap()
    }

    fn mixed(file: &[u8], lamps: &[&str]) -> Result<Vec<[f32; 3]>> {
        let gains: Vec<_> = lamps.iter().map(|text| lamp(text)).collect::<Result<_>>()?;
        let pixels = LitPicture::read(file)?.mixed(&gains)?;
        Ok(pixels.into_iter().map(Spectrum::to_rgb).collect())
    }

    #[test]
    fn lamps_are_multiplied_and_the_others_stay() {
        let file = picture(&[("lamp:a b", [1.0, 0.0]), ("lamp:*", [0.5, 2.0])], [1.75, 2.0]);
        assert_eq!(
            mixed(&file, &[]).unwrap(),
            [[1.75; 3], [2.0; 3]],
            "as it is, roundings included"
        );
        assert_eq!(mixed(&file, &["a b=2"]).unwrap(), [[2.5; 3], [2.0; 3]]);
        assert_eq!(
            mixed(&file, &["*=0", "a b=1EV*1,0.5,0"]).unwrap(),
            [[2.0, 1.0, 0.0], [0.0; 3]]
        );
        let red = mixed(&file, &["a b=#ff0000", "*=0"]).unwrap();
        assert_eq!(red[0], [1.0, 0.0, 0.0]);
        // sRGB 188 is 0.5029 in linear light.
        let grey = mixed(&file, &["a b=#bcbcbc", "*=0"]).unwrap();
        assert!((grey[0][1] - 0.5029).abs() < 1e-3, "{grey:?}");
    }

    #[test]
    fn what_no_layer_holds_is_the_light_of_other_lamps() {
        let file = picture(&[("lamp:a", [1.0, 0.0])], [1.75, 2.0]);
        assert_eq!(mixed(&file, &["a=0"]).unwrap(), [[0.75; 3], [2.0; 3]]);
        assert_eq!(mixed(&file, &["*=0.5"]).unwrap(), [[1.375; 3], [1.0; 3]]);
    }

    #[test]
    fn what_cannot_be_mixed_is_refused_with_advice() {
        let file = picture(
            &[("lamp:a", [1.0, 0.0]), ("lamp:a+b", [1.5, 1.0]), ("albedo", [0.0; 2])],
            [1.75, 2.0],
        );
        let cases: [(&[&str], &str); 10] = [
            (&["c=1"], "there are: a, and `*`"),
            (&["a+b=1"], "shares a lamp"),
            (&["a=1", "a=2"], "given twice"),
            (&["a"], "NAME=GAIN"),
            (&["a=red"], "no factor"),
            (&["a=#12345"], "six digits"),
            (&["a=1,2"], "2 factors"),
            (&["a=-1"], "from zero on"),
            (&["a=nan"], "from zero on"),
            (&["a=65EV"], "at most 64"),
        ];
        for (lamps, advice) in cases {
            let error = format!("{:#}", mixed(&file, lamps).unwrap_err());
            assert!(error.contains(advice), "{lamps:?}: {error}");
        }
        let without = format!(
            "{:#}",
            mixed(&picture(&[("albedo", [0.0; 2])], [1.0; 2]), &[]).unwrap_err()
        );
        assert!(without.contains("no layer of a lamp"), "{without}");
        let plain = plain_exr(1, 1, |_| [1.0; 3]).unwrap();
        let plain = format!("{:#}", mixed(&plain, &[]).unwrap_err());
        assert!(plain.contains("which layers it has"), "{plain}");
    }
}
