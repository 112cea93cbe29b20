//! Light leaks and boundary bias: what the surface test and the kernels' shape do to them, and that they vanish either way.

use crate::Options;
use crate::csv;
use crate::render::{each, progress};
use anyhow::{Context, Result};
use photonfarm_core::settings::{IntegratorSettings, KernelShape, LookupVertex, PathSettings, PcfSettings};
use photonfarm_core::spectrum::Spectrum;
use photonfarm_tests::scenes;
use std::fmt::Write;

/// Pixels across and down.
const SIZE: usize = 32;

/// Pixels of a block, across and down: errors are judged block by block.
const BLOCK: usize = 4;

/// First spatial bandwidths [scene units; the room is two wide], each with its first angular one \[degrees\].
const BANDWIDTHS: [(f32, f32); 4] = [(0.2, 36.0), (0.1, 18.0), (0.05, 9.0), (0.025, 4.5)];

/// Blocks brighter than this many times the median show the lamp, whose edge is noise and no bias.
const LAMP_OVER_MEDIAN: f64 = 4.0;

/// Writes `leaks.csv` and `leaks.md` to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let runs: u32 = if options.small { 8 } else { 64 };
    let scene = scenes::named("diffuse-box", SIZE)?;
    let reference = IntegratorSettings::Path(PathSettings {
        samples: 64,
        max_depth: Some(5),
        ..Default::default()
    });
    let bar = progress("leaks", u64::from(runs) * (1 + 4 * BANDWIDTHS.len() as u64));
    let jobs: Vec<(u64, u32)> = (1..=runs).map(|iteration| (1, iteration)).collect();
    let truth = blocks(&each(&scene, &reference, &jobs, &bar, |image| image.pixels)?);
    // Every run is a first iteration, so that its bandwidth is the first.
    let jobs: Vec<(u64, u32)> = (1..=u64::from(runs)).map(|seed| (seed + 1, 1)).collect();
    let mut rows = Vec::new();
    for (kernel, surface_test) in [
        (KernelShape::Box, false),
        (KernelShape::Box, true),
        (KernelShape::Epanechnikov, false),
        (KernelShape::Epanechnikov, true),
    ] {
        for (sigma, theta) in BANDWIDTHS {
            let settings = IntegratorSettings::Pcf(PcfSettings {
                photons: 100_000,
                samples: 2,
                sigma1: Some(sigma),
                theta1: theta,
                kernel,
                surface_test,
                lookup_vertex: LookupVertex::Fixed(1),
                max_depth: Some(5),
                ..Default::default()
            });
            let estimate = blocks(&each(&scene, &settings, &jobs, &bar, |image| image.pixels)?);
            rows.push(Row::new(kernel, surface_test, sigma, &estimate, &truth));
        }
    }
    bar.finish();
    write(options, runs, &rows)
}

/// Mean luminance of each block over the images, with its squared standard error.
fn blocks(images: &[Vec<Spectrum>]) -> Vec<(f64, f64)> {
    let across = SIZE / BLOCK;
    let n = images.len() as f64;
    let value = |image: &[Spectrum], block: usize| -> f64 {
        let (x0, y0) = (block % across * BLOCK, block / across * BLOCK);
        let pixels = (0..BLOCK * BLOCK).map(|i| (y0 + i / BLOCK) * SIZE + x0 + i % BLOCK);
        pixels.map(|p| f64::from(image[p].luminance())).sum::<f64>() / (BLOCK * BLOCK) as f64
    };
    (0..across * across)
        .map(|block| {
            let values: Vec<f64> = images.iter().map(|image| value(image, block)).collect();
            let mean = values.iter().sum::<f64>() / n;
            let spread = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            (mean, spread / (n - 1.0) / n)
        })
        .collect()
}

/// One line of the table.
struct Row {
    kernel: &'static str,
    surface_test: bool,
    sigma: f32,
    /// Difference of the image's mean from the truth, over it.
    mean: f64,
    /// Root of the mean squared bias of the blocks over the mean, noise taken off.
    bias: f64,
    /// Root of the mean squared noise of the blocks over the mean.
    noise: f64,
}

impl Row {
    fn new(kernel: KernelShape, surface_test: bool, sigma: f32, estimate: &[(f64, f64)], truth: &[(f64, f64)]) -> Self {
        let mut levels: Vec<f64> = truth.iter().map(|t| t.0).collect();
        levels.sort_by(f64::total_cmp);
        let lamp = LAMP_OVER_MEDIAN * levels[levels.len() / 2];
        let pairs = || estimate.iter().zip(truth).filter(|(_, t)| t.0 < lamp);
        let n = pairs().count() as f64;
        let scale = pairs().map(|(_, t)| t.0).sum::<f64>() / n;
        let squared = pairs().map(|(e, t)| (e.0 - t.0).powi(2)).sum::<f64>() / n;
        let noise = pairs().map(|(e, t)| e.1 + t.1).sum::<f64>() / n;
        Self {
            kernel: match kernel {
                KernelShape::Box => "box",
                KernelShape::Epanechnikov => "epanechnikov",
            },
            surface_test,
            sigma,
            mean: (pairs().map(|(e, _)| e.0).sum::<f64>() / n - scale) / scale,
            bias: (squared - noise).max(0.0).sqrt() / scale,
            noise: noise.sqrt() / scale,
        }
    }
}

fn write(options: &Options, runs: u32, rows: &[Row]) -> Result<()> {
    let cells: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            let numbers = [f64::from(row.sigma), row.mean, row.bias, row.noise].map(csv::number);
            [
                vec![row.kernel.to_owned(), row.surface_test.to_string()],
                numbers.to_vec(),
            ]
            .concat()
        })
        .collect();
    let header = ["kernel", "surface_test", "sigma", "mean_difference", "bias", "noise"];
    csv::write(&options.out.join("leaks.csv"), &header, &cells)?;
    let mut page = format!(
        "# Light leaks and boundary bias\n\nRepeat with\n\n    cargo run --release -p photonfarm-tests --bin results -- leaks\n\n\
         `pcf` with `lookup_vertex=1` on `tests/scenes/diffuse-box.xml` (a room two wide, all corners in view) at one bandwidth, \
         {runs} runs, against `path`. \"Bias\" is the root of the mean squared bias over blocks of {BLOCK} x {BLOCK} pixels, over the \
         mean, the noise taken off; \"mean\" is the difference of the image's mean; blocks that show the lamp are left out. theta_1 is 18 degrees at sigma 0.1 and in proportion \
         elsewhere.\n\n`surface_test=true` counts cones that lie close to the query's tangent plane, with a similar normal and on its \
         side, and divides by the share of the kernel that lies on such a surface: of the disc by eight probing rays, of the cone \
         of directions by what the horizon leaves of it. On a smooth surface all of \
         this holds of itself as the bandwidth shrinks, so that both estimators have the same limit: in either column the bias \
         falls towards zero.\n\n| kernel | sigma | mean, off | bias, off | mean, on | bias, on | noise, off / on |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n"
    );
    for off in rows.iter().filter(|row| !row.surface_test) {
        let on = rows
            .iter()
            .find(|row| row.surface_test && row.kernel == off.kernel && row.sigma == off.sigma)
            .context("each bandwidth is measured with the surface test too")?;
        let percent = |value: f64| format!("{:.2} %", 100.0 * value);
        let [a, b, c, d, e, f] = [off.mean, off.bias, on.mean, on.bias, off.noise, on.noise].map(percent);
        writeln!(
            page,
            "| {} | {} | {a} | {b} | {c} | {d} | {e} / {f} |",
            off.kernel, off.sigma
        )?;
    }
    std::fs::write(options.out.join("leaks.md"), page).context("cannot write leaks.md")
}
