//! Variance under low-discrepancy sampling against that under independent sampling, at equal numbers of iterations.

use crate::Options;
use crate::csv;
use crate::render::{each, progress};
use anyhow::{Context, Result};
use photonfarm_core::film::{Image, Node};
use photonfarm_core::random::Sampling;
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings};
use photonfarm_core::spectrum::Spectrum;
use photonfarm_core::tree::Average;
use photonfarm_tests::scenes;
use std::fmt::Write;

const SCENES: [&str; 3] = ["diffuse-box", "mirror-glass", "environment"];

/// Pixels across and down.
const SIZE: usize = 16;

/// Numbers of iterations whose average is judged.
const COUNTS: [usize; 3] = [1, 16, 64];

/// Light paths per iteration: not a power of two, as in most jobs.
const PHOTONS: u32 = 5000;

/// Writes `sampling.csv` and `sampling.md` to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let seeds = if options.small { 6 } else { 32 };
    let counts = if options.small { &COUNTS[..2] } else { &COUNTS[..] };
    let last = counts[counts.len() - 1];
    let bar = progress("sampling", (SCENES.len() * 3 * 2 * seeds * last) as u64);
    let mut rows = Vec::new();
    for name in SCENES {
        let scene = scenes::named(name, SIZE)?;
        for integrator in ["path", "pppm", "pcf"] {
            let [independent, sobol] = [Sampling::Independent, Sampling::Sobol].map(|sampling| {
                let jobs: Vec<(u64, u32)> = (1..=seeds as u64)
                    .flat_map(|seed| (1..=last as u32).map(move |iteration| (seed, iteration)))
                    .collect();
                each(&scene, &settings(integrator, sampling), &jobs, &bar, |image| {
                    image.pixels
                })
            });
            let (independent, sobol) = (independent?, sobol?);
            for &count in counts {
                let averages = |images: &[Vec<Spectrum>]| -> Vec<Vec<f64>> {
                    let average = |job: &[Vec<Spectrum>]| average(&luminances(&job[..count]));
                    images.chunks(last).map(average).collect()
                };
                let (a, b) = (averages(&independent), averages(&sobol));
                rows.push(Row {
                    scene: name,
                    integrator,
                    iterations: count,
                    pixel: Ratio::new(&b, &a),
                    image: Ratio::new(&whole(&b), &whole(&a)),
                    independent: relative_error(&a),
                    stated: stated_over_true(sobol.chunks(last).map(|job| &job[..count]))?,
                });
            }
        }
    }
    bar.finish_and_clear();
    write(options, seeds, &rows)
}

struct Row {
    scene: &'static str,
    integrator: &'static str,
    iterations: usize,
    /// Of the mean over pixels of the variance of a pixel.
    pixel: Ratio,
    /// Of the variance of the mean of the picture.
    image: Ratio,
    /// Root mean square error of a pixel over the picture's mean, independent sampling.
    independent: f64,
    /// The standard error that a picture states over the one that it has, low discrepancy; `None` for one iteration, which states none.
    stated: Option<f64>,
}

/// Bandwidths are chosen by the integrators, as in most jobs.
fn settings(integrator: &str, sampling: Sampling) -> IntegratorSettings {
    match integrator {
        "path" => IntegratorSettings::Path(PathSettings {
            sampling,
            ..Default::default()
        }),
        "pppm" => IntegratorSettings::Pppm(PppmSettings {
            photons: PHOTONS,
            sampling,
            ..Default::default()
        }),
        _ => IntegratorSettings::Pcf(PcfSettings {
            photons: PHOTONS,
            sampling,
            ..Default::default()
        }),
    }
}

fn luminances(images: &[Vec<Spectrum>]) -> Vec<Vec<f64>> {
    let of_image = |image: &Vec<Spectrum>| image.iter().map(|pixel| f64::from(pixel.luminance())).collect();
    images.iter().map(of_image).collect()
}

/// The mean over pixels and jobs of the standard error that a job's picture states, over the mean over pixels of the standard deviation of
/// the pictures.
fn stated_over_true<'a>(jobs: impl Iterator<Item = &'a [Vec<Spectrum>]>) -> Result<Option<f64>> {
    let picture = |job: &[Vec<Spectrum>]| -> Result<Image> {
        let mut average = Average::default();
        for (leaf, pixels) in job.iter().enumerate() {
            average.push(Node::leaf(leaf as u32, SIZE as u32, SIZE as u32, pixels)?)?;
        }
        average.finish().context("a job has iterations")
    };
    let pictures = jobs.map(picture).collect::<Result<Vec<Image>>>()?;
    let stated: f64 = pictures
        .iter()
        .flat_map(|picture| &picture.standard_error)
        .map(|e| f64::from(*e))
        .sum();
    let values: Vec<Vec<Spectrum>> = pictures.iter().map(|picture| picture.pixels.clone()).collect();
    let values = luminances(&values);
    let deviation = |pixel: usize| {
        let of_pixel: Vec<Vec<f64>> = values.iter().map(|image| vec![image[pixel]]).collect();
        variance(&of_pixel, None).sqrt()
    };
    let truth: f64 = (0..SIZE * SIZE).map(deviation).sum();
    Ok((stated > 0.0).then(|| stated / pictures.len() as f64 / truth))
}

fn average(images: &[Vec<f64>]) -> Vec<f64> {
    let n = images.len() as f64;
    (0..images[0].len())
        .map(|pixel| images.iter().map(|image| image[pixel]).sum::<f64>() / n)
        .collect()
}

/// The mean of each picture, as a picture of one pixel.
fn whole(images: &[Vec<f64>]) -> Vec<Vec<f64>> {
    images
        .iter()
        .map(|image| vec![image.iter().sum::<f64>() / image.len() as f64])
        .collect()
}

/// Mean over pixels of the variance over pictures, without picture `left_out`.
fn variance(images: &[Vec<f64>], left_out: Option<usize>) -> f64 {
    let used: Vec<&Vec<f64>> = images
        .iter()
        .enumerate()
        .filter(|(i, _)| Some(*i) != left_out)
        .map(|(_, image)| image)
        .collect();
    let n = used.len() as f64;
    let pixels = images[0].len();
    let sum: f64 = (0..pixels)
        .map(|pixel| {
            let mean = used.iter().map(|image| image[pixel]).sum::<f64>() / n;
            used.iter().map(|image| (image[pixel] - mean).powi(2)).sum::<f64>() / (n - 1.0)
        })
        .sum();
    sum / pixels as f64
}

fn relative_error(images: &[Vec<f64>]) -> f64 {
    let mean = average(&whole(images))[0];
    variance(images, None).sqrt() / mean
}

/// A ratio of variances with its 95 % confidence interval.
struct Ratio {
    value: f64,
    interval: [f64; 2],
}

impl Ratio {
    /// The variance of `numerator` over that of `denominator`. The interval is normal in the logarithm, whose error is
    /// found by leaving out one picture at a time (jackknife).
    fn new(numerator: &[Vec<f64>], denominator: &[Vec<f64>]) -> Self {
        let error2 = |images: &[Vec<f64>]| {
            let n = images.len() as f64;
            let logs: Vec<f64> = (0..images.len()).map(|i| variance(images, Some(i)).ln()).collect();
            let mean = logs.iter().sum::<f64>() / n;
            (n - 1.0) / n * logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>()
        };
        let value = variance(numerator, None) / variance(denominator, None);
        let factor = (1.96 * (error2(numerator) + error2(denominator)).sqrt()).exp();
        Self {
            value,
            interval: [value / factor, value * factor],
        }
    }

    fn cells(&self) -> [String; 3] {
        [self.value, self.interval[0], self.interval[1]].map(csv::number)
    }

    fn text(&self) -> String {
        format!("{:.3} ({:.3} to {:.3})", self.value, self.interval[0], self.interval[1])
    }
}

fn write(options: &Options, seeds: usize, rows: &[Row]) -> Result<()> {
    let header = [
        "scene",
        "integrator",
        "iterations",
        "relative_error_independent",
        "pixel_variance_ratio",
        "pixel_low",
        "pixel_high",
        "image_variance_ratio",
        "image_low",
        "image_high",
        "stated_over_true_error",
    ];
    let cells: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            let mut cells = vec![
                row.scene.to_owned(),
                row.integrator.to_owned(),
                row.iterations.to_string(),
            ];
            cells.push(csv::number(row.independent));
            cells.extend(row.pixel.cells());
            cells.extend(row.image.cells());
            cells.push(row.stated.map_or("-".into(), csv::number));
            cells
        })
        .collect();
    csv::write(&options.out.join("sampling.csv"), &header, &cells)?;

    let mut text = format!(
        "# Low-discrepancy against independent sampling\n\n\
         Repeat with\n\n    cargo run --release -p photonfarm-tests --bin results -- sampling\n\n\
         Variance with `sampling=sobol` over that with `sampling=independent`: below 1, low discrepancy is better. Scenes of \
         `tests/scenes` at {SIZE} x {SIZE} pixels, each integrator with its own defaults but {PHOTONS} light paths per iteration; \
         variances of the average of N iterations over {seeds} seeds. \"Pixel\" is the mean variance of a pixel, \"picture\" the variance \
         of the picture's mean; in parentheses 95 % confidence intervals (jackknife over seeds). \"Noise\" is the standard deviation of a \
         pixel under independent sampling over the picture's mean.\n\n\
         \"Stated\" is the standard error that a picture states under low-discrepancy sampling (from differences of halves, [FARM.md](../FARM.md#the-tree)) over the \
         one that it has (the standard deviation over seeds), means over pixels: 1 is right, above it the picture is better than it says. \
         A single iteration states none.\n\n\
         | scene | integrator | N | noise | pixel | picture | stated |\n| --- | --- | --- | --- | --- | --- | --- |\n"
    );
    for row in rows {
        let (pixel, image) = (row.pixel.text(), row.image.text());
        let stated = row.stated.map_or("-".into(), |ratio| format!("{ratio:.2}"));
        writeln!(
            text,
            "| {} | `{}` | {} | {:.1} % | {pixel} | {image} | {stated} |",
            row.scene,
            row.integrator,
            row.iterations,
            100.0 * row.independent
        )?;
    }
    let path = options.out.join("sampling.md");
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_of_variances_is_inside_its_interval() {
        let spread = |scale: f64| -> Vec<Vec<f64>> { (0..40).map(|i| vec![scale * f64::from(i * 7 % 40)]).collect() };
        let ratio = Ratio::new(&spread(1.0), &spread(2.0));
        assert!((ratio.value - 0.25).abs() < 1e-12);
        assert!(ratio.interval[0] > 0.15 && ratio.interval[0] < 0.25);
        assert!(ratio.interval[1] < 0.42 && ratio.interval[1] > 0.25);
    }
}
