//! Pictures that are to be compared: PNGs under one tone curve, enlarged, with probes marked.

use super::stage::Block;
use crate::plot::colour;
use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::spectrum::Spectrum;
use std::path::Path;

/// Longer side that a written picture has at least \[pixels\].
const SIDE: u32 = 256;

/// An image: radiance of each pixel, row by row from the top left.
#[derive(Clone, Debug)]
pub(super) struct Pixels {
    pub(super) size: [u32; 2],
    pub(super) values: Vec<Spectrum>,
}

/// Pictures of one size, `columns` in a row, from left to right and top to bottom.
pub(super) fn montage(pictures: &[&Pixels], columns: usize) -> Pixels {
    let [width, height] = pictures[0].size.map(|side| side as usize);
    let rows = pictures.len().div_ceil(columns);
    let value = |index: usize| {
        let (x, y) = (index % (columns * width), index / (columns * width));
        let picture = pictures.get(y / height * columns + x / width);
        picture.map_or(Spectrum::ZERO, |picture| picture.values[y % height * width + x % width])
    };
    Pixels {
        size: [(columns * width) as u32, (rows * height) as u32],
        values: (0..columns * width * rows * height).map(value).collect(),
    }
}

/// Writes an image as PNG in sRGB through `curve`, each pixel as a square, with a frame around each block of `marks` in the
/// plots' colours, the first in the first colour and so on.
pub(super) fn write(path: &Path, pixels: &Pixels, curve: &ToneCurve, marks: &[Block]) -> Result<()> {
    let [width, height] = pixels.size;
    let zoom = SIDE.div_ceil(width.max(height));
    let mut picture = RgbImage::from_fn(zoom * width, zoom * height, |x, y| {
        let value = pixels.values[(y / zoom * width + x / zoom) as usize];
        Rgb(curve.apply(value).map(srgb))
    });
    for (i, mark) in marks.iter().enumerate() {
        frame(&mut picture, zoom, *mark, Rgb(colour(i)));
    }
    picture
        .save(path)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Draws a frame a few pixels away from the block.
fn frame(picture: &mut RgbImage, zoom: u32, block: Block, colour: Rgb<u8>) {
    const GAP: i64 = 3;
    const WIDTH: i64 = 2;
    let low = block.at.map(|n| i64::from(n * zoom) - GAP);
    let high = [0, 1].map(|i| i64::from((block.at[i] + block.size[i]) * zoom) + GAP);
    for y in low[1] - WIDTH..high[1] + WIDTH {
        for x in low[0] - WIDTH..high[0] + WIDTH {
            let inside = (low[0]..high[0]).contains(&x) && (low[1]..high[1]).contains(&y);
            let pixel = u32::try_from(x).ok().zip(u32::try_from(y).ok());
            if let Some(pixel) = pixel
                .and_then(|(x, y)| picture.get_pixel_mut_checked(x, y))
                .filter(|_| !inside)
            {
                *pixel = colour;
            }
        }
    }
}

/// The sRGB transfer function (IEC 61966-2-1), in steps of 1/255.
fn srgb(linear: f32) -> u8 {
    let value = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    (value * 255.0 + 0.5) as u8
}
