//! `photonfarm compare`: how far two pictures are from each other.

use crate::flip::{self, ErrorMap};
use crate::magma;
use crate::metrics::{EPSILON, Errors, Pixels, decoded, encoded, ssim};
use crate::output::{OutputFile, plain_exr};
use crate::say;
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use photonfarm_core::picture::{self, ToneCurve};
use photonfarm_core::spectrum::Spectrum;
use serde::Serialize;
use std::io::Cursor;
use std::path::{Path, PathBuf};

pub(crate) const EXAMPLES: &str = "\
Examples:
  photonfarm compare now.exr reference.exr
      MSE, relMSE, SSIM and FLIP of now.exr against reference.exr.
  photonfarm compare now.exr reference.exr --difference where.png
      Shows where: red where now.exr is brighter, blue where it is darker, black where they agree.
  photonfarm compare now.exr reference.exr --difference signed.exr
      Writes now.exr minus reference.exr.
  photonfarm compare now.exr reference.exr --flip seen.png
      Shows where somebody who flips between the two sees a difference: black where none, yellow where most.
  photonfarm compare now.exr reference.exr --json | jq .relmse
      For scripts.

MSE is the mean of (a - b)^2 over pixels and channels, relMSE that of (a - b)^2 / (b^2 + epsilon), with
b the reference. SSIM is that of Wang et al. (2004) on grey values as a screen shows them: of EXR
pictures under the tone curve that fits the reference. FLIP is the mean error of Andersson et al. (2020)
of the same, between 0 and 1, on a screen with 67 pixels in a degree of sight; of EXR pictures HDR-FLIP
(2021) as well, the largest error at any exposure. A PNG is compared with a PNG, by linear values between
0 and 1.";

/// Most pixels of a picture that is read.
const MOST_PIXELS: usize = 1 << 28;
/// How an OpenEXR file begins.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// Picture: EXR or PNG
    #[arg(value_name = "A")]
    picture: PathBuf,
    /// Picture of the same kind and size that it is held against
    #[arg(value_name = "B")]
    reference: PathBuf,
    /// Write a picture of the differences: as PNG for the eye, as EXR with signed values
    #[arg(long, value_name = "OUT.png|OUT.exr")]
    difference: Option<PathBuf>,
    /// Write the errors of FLIP as a picture, of EXR pictures those of HDR-FLIP: as PNG in colours, as EXR in numbers
    #[arg(long, value_name = "OUT.png|OUT.exr")]
    flip: Option<PathBuf>,
    /// What is added to the square of the reference in relMSE
    #[arg(long, value_name = "E", default_value_t = EPSILON, value_parser = crate::args::positive)]
    epsilon: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is told.
#[derive(Debug, Serialize)]
struct Report {
    width: u32,
    height: u32,
    #[serde(flatten)]
    errors: Errors,
    epsilon: f64,
    /// Nothing for pictures smaller than a window.
    ssim: Option<f64>,
    /// Mean error as the eye sees it, of what a screen shows.
    flip: f64,
    /// The same of radiance; nothing for what is none.
    hdr_flip: Option<f64>,
    /// Mean luminances of both.
    means: [f64; 2],
}

/// A picture as it was read.
pub(crate) struct Read {
    pub(crate) pixels: Pixels,
    /// Whether its values are what a screen shows.
    is_display: bool,
}

/// Runs the command.
pub(crate) fn run(args: CompareArgs) -> Result<()> {
    let place = |option, path: &Option<PathBuf>| path.as_deref().map(|path| Place::check(option, path)).transpose();
    let difference = place("--difference", &args.difference)?;
    let error_map = place("--flip", &args.flip)?;
    let [a, b] = [&args.picture, &args.reference].map(|path| read(path));
    let (a, b) = (a?, b?);
    let [name_a, name_b] = [&args.picture, &args.reference].map(|path| path.display().to_string());
    ensure!(
        a.is_display == b.is_display,
        "one of {name_a} and {name_b} is a PNG, which holds what a screen shows, and the other an EXR with radiance: compare \
         pictures of one kind"
    );
    a.pixels.check_size(&name_a, &b.pixels, &name_b)?;
    let curve = (!b.is_display).then(|| ToneCurve::fit(&b.pixels.values));
    let grey = |pixels: &Pixels| pixels.grey(curve.as_ref());
    let width = a.pixels.width as usize;
    let [shown_a, shown_b] = [&a, &b].map(|read| read.pixels.shown(curve.as_ref()));
    let seen = flip::ldr(&shown_a, &shown_b, width);
    let radiance = |read: &Read| {
        read.pixels
            .values
            .iter()
            .map(|pixel| pixel.to_rgb())
            .collect::<Vec<_>>()
    };
    let seen_hdr = curve.as_ref().map(|_| flip::hdr(&radiance(&a), &radiance(&b), width));
    let report = Report {
        width: a.pixels.width,
        height: a.pixels.height,
        errors: a.pixels.errors(&b.pixels, args.epsilon),
        epsilon: args.epsilon,
        ssim: ssim(&grey(&a.pixels), &grey(&b.pixels), width),
        flip: seen.mean(),
        hdr_flip: seen_hdr.as_ref().map(ErrorMap::mean),
        means: [a.pixels.mean(), b.pixels.mean()],
    };
    if let Some(Place { file, is_exr }) = difference {
        file.write(&match is_exr {
            true => signed(&a.pixels, &b.pixels)?,
            false => coloured(&a.pixels, &b.pixels, args.epsilon)?,
        })?;
    }
    if let Some(place) = error_map {
        let errors = seen_hdr.unwrap_or(seen);
        place.file.write(&map(&errors, width, place.is_exr)?)?;
    }
    match args.json {
        true => say::json(&report),
        false => say::line(report.text()),
    }
}

impl Report {
    fn text(&self) -> String {
        let ssim = match self.ssim {
            Some(ssim) => format!("{ssim:.6}"),
            None => "unknown: the pictures are smaller than its window of 11 by 11 pixels".to_owned(),
        };
        let [mean, reference] = self.means;
        let hdr = self.hdr_flip.map(|error| format!(", HDR-FLIP {error:.6}"));
        let flip = format!("{:.6}{}", self.flip, hdr.unwrap_or_default());
        format!(
            "MSE     {:.6e}\nrelMSE  {:.6e}  with epsilon {}\nSSIM    {ssim}\nFLIP    {flip}\nmean luminance {mean:.6} and {reference:.6}, {} by {} pixels",
            self.errors.mse, self.errors.relmse, self.epsilon, self.width, self.height
        )
    }
}

/// Reads a picture whose values are all numbers.
pub(crate) fn read(path: &Path) -> Result<Read> {
    let name = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
    let read = match bytes.starts_with(&EXR) {
        true => read_exr(&bytes),
        false => read_png(&bytes),
    };
    let read = read.with_context(|| format!("{name} cannot be read as a picture"))?;
    read.pixels.check(&name)?;
    Ok(read)
}

/// Pixels of an EXR in memory.
pub(crate) fn read_exr(bytes: &[u8]) -> Result<Read> {
    let decoded = picture::decode_exr(bytes, MOST_PIXELS)?;
    Ok(Read {
        pixels: Pixels {
            width: decoded.width,
            height: decoded.height,
            values: decoded.pixels,
        },
        is_display: false,
    })
}

fn read_png(bytes: &[u8]) -> Result<Read> {
    if image::guess_format(bytes).ok() != Some(image::ImageFormat::Png) {
        bail!("it is neither an OpenEXR file nor a PNG");
    }
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), image::ImageFormat::Png);
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MOST_PIXELS as u64 * 8);
    reader.limits(limits);
    let picture = reader.decode()?.into_rgb32f();
    let linear = |value: f32| decoded(value.into()) as f32;
    Ok(Read {
        pixels: Pixels {
            width: picture.width(),
            height: picture.height(),
            values: picture.pixels().map(|p| Spectrum::from_rgb(p.0.map(linear))).collect(),
        },
        is_display: true,
    })
}

/// Where a picture of differences or errors goes.
struct Place {
    file: OutputFile,
    is_exr: bool,
}

impl Place {
    fn check(option: &str, path: &Path) -> Result<Self> {
        let end = path.extension().map(|end| end.to_string_lossy().to_lowercase());
        let is_exr = match end.as_deref() {
            Some("exr") => true,
            Some("png") => false,
            _ => bail!("{option} {}: name a file that ends in png or exr", path.display()),
        };
        let file = OutputFile::check(path)?;
        Ok(Self { file, is_exr })
    }
}

/// The one minus the other, as OpenEXR.
fn signed(a: &Pixels, b: &Pixels) -> Result<Vec<u8>> {
    plain_exr(a.width, a.height, |index| {
        let (a, b) = (a.values[index].to_rgb(), b.values[index].to_rgb());
        std::array::from_fn(|channel| a[channel] - b[channel])
    })
}

/// A map of errors: as OpenEXR in numbers, as PNG in colours.
fn map(errors: &ErrorMap, width: usize, is_exr: bool) -> Result<Vec<u8>> {
    let (values, height) = (&errors.0, errors.0.len() / width.max(1));
    if is_exr {
        return plain_exr(width as u32, height as u32, |index| [values[index]; 3]);
    }
    let samples: Vec<u8> = values.iter().flat_map(|error| magma::colour(*error)).collect();
    png_of(width as u32, height as u32, &samples)
}

/// The difference of luminance over what relMSE divides by: red where the first is brighter, blue where it is darker.
fn coloured(a: &Pixels, b: &Pixels, epsilon: f64) -> Result<Vec<u8>> {
    let colour = |(a, b): (&Spectrum, &Spectrum)| {
        let (a, b) = (f64::from(a.luminance()), f64::from(b.luminance()));
        let relative = (a - b) / (b * b + epsilon).sqrt();
        let shade = (encoded(relative.abs().min(1.0)) * 255.0).round() as u8;
        match relative > 0.0 {
            true => [shade, shade / 3, 0],
            false => [0, shade / 2, shade],
        }
    };
    let samples: Vec<u8> = a.values.iter().zip(&b.values).flat_map(colour).collect();
    png_of(a.width, a.height, &samples)
}

fn png_of(width: u32, height: u32, samples: &[u8]) -> Result<Vec<u8>> {
    let mut file = Cursor::new(Vec::new());
    let kind = image::ExtendedColorType::Rgb8;
    image::write_buffer_with_format(&mut file, samples, width, height, kind, image::ImageFormat::Png)?;
    Ok(file.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(width: u32, values: &[[f32; 3]]) -> Pixels {
        Pixels {
            width,
            height: values.len() as u32 / width,
            values: values.iter().map(|rgb| Spectrum::from_rgb(*rgb)).collect(),
        }
    }

    #[test]
    fn differences_are_signed_and_coloured() {
        let a = pixels(3, &[[1.0; 3], [0.5; 3], [0.0; 3]]);
        let b = pixels(3, &[[0.5; 3], [0.5; 3], [1.0; 3]]);
        let signed = read_exr(&signed(&a, &b).unwrap()).unwrap().pixels;
        let red: Vec<f32> = signed.values.iter().map(|p| p.to_rgb()[0]).collect();
        assert_eq!(red, [0.5, 0.0, -1.0]);
        let png = image::load_from_memory(&coloured(&a, &b, EPSILON).unwrap())
            .unwrap()
            .to_rgb8();
        let [brighter, same, darker] = [0, 1, 2].map(|x| png.get_pixel(x, 0).0);
        assert!(brighter[0] > 200 && brighter[2] == 0, "{brighter:?}");
        assert!(darker[2] > 200 && darker[0] == 0, "{darker:?}");
        assert_eq!(same, [0, 0, 0]);
    }

    #[test]
    fn error_maps_are_numbers_or_colours() {
        let errors = ErrorMap(vec![0.0, 0.5, 1.0]);
        let numbers = read_exr(&map(&errors, 3, true).unwrap()).unwrap().pixels;
        let red: Vec<f32> = numbers.values.iter().map(|p| p.to_rgb()[0]).collect();
        assert_eq!(red, errors.0);
        let png = image::load_from_memory(&map(&errors, 3, false).unwrap())
            .unwrap()
            .to_rgb8();
        let colours = [0, 1, 2].map(|x| png.get_pixel(x, 0).0);
        assert_eq!(colours, [[0, 0, 4], [183, 55, 121], [252, 253, 191]]);
    }

    #[test]
    fn what_cannot_be_compared_is_refused_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let picture = pixels(2, &[[1.0; 3], [2.0; 3]]);
        std::fs::write(at("a.exr"), signed(&picture, &pixels(2, &[[0.0; 3]; 2])).unwrap()).unwrap();
        let wide = pixels(3, &[[0.0; 3]; 3]);
        std::fs::write(at("wide.exr"), signed(&wide, &wide).unwrap()).unwrap();
        std::fs::write(at("a.png"), coloured(&picture, &picture, EPSILON).unwrap()).unwrap();
        std::fs::write(at("text"), "no picture").unwrap();
        let cut: Vec<u8> = std::fs::read(at("a.exr")).unwrap()[..40].to_vec();
        std::fs::write(at("cut.exr"), cut).unwrap();
        let nan = pixels(2, &[[f32::NAN; 3], [0.0; 3]]);
        std::fs::write(at("nan.exr"), signed(&nan, &picture).unwrap()).unwrap();
        let compared = |a: &str, b: &str, difference: Option<&str>| {
            let args = CompareArgs {
                picture: at(a),
                reference: at(b),
                difference: difference.map(at),
                flip: None,
                epsilon: EPSILON,
                json: false,
            };
            format!("{:#}", run(args).unwrap_err())
        };
        for (a, b, difference, advice) in [
            ("a.exr", "wide.exr", None, "has 2 by 1 pixels and"),
            ("a.exr", "a.png", None, "of one kind"),
            ("text", "a.exr", None, "neither an OpenEXR file nor a PNG"),
            ("a.exr", "cut.exr", None, "cut.exr cannot be read as a picture"),
            ("nan.exr", "a.exr", None, "the first at 0,0"),
            ("missing.exr", "a.exr", None, "cannot read"),
            ("a.exr", "a.exr", Some("d.jpg"), "png or exr"),
        ] {
            let error = compared(a, b, difference);
            assert!(error.contains(advice), "{a} {b}: {error}");
        }
    }
}
