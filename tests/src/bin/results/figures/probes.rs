//! Figures 5.4 to 5.7: the error at three places of a picture against the number of iterations.

use super::page::{Page, Picture};
use super::picture;
use super::runs::{Estimate, Sum, average, estimate};
use super::stage::{self, Block, CAMERA};
use crate::plot::{self, Chart, Scale, Series, Stroke};
use crate::render::{each, progress};
use crate::{Options, csv};
use anyhow::Result;
use photonfarm_core::integrator::{Bandwidth, Iteration, bandwidth};
use photonfarm_core::picture::ToneCurve;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{IntegratorSettings, LookupVertex};
use std::path::PathBuf;

/// A block of pixels that is watched.
struct Probe {
    name: &'static str,
    what: &'static str,
    /// Centre, in fractions of the image.
    at: [f32; 2],
}

/// How the true values are found.
enum Reference {
    /// `path` through the probes' pixels, so many iterations of so many samples each.
    Path { iterations: u32, samples: u32 },
    /// `pppm` over the whole image with a small first radius.
    Pppm { iterations: u32, photons: u32, sigma1: f32 },
}

/// A scene with its probes.
struct Study {
    /// The thesis's figures.
    figures: &'static str,
    name: &'static str,
    scene: PathBuf,
    size: [u32; 2],
    probes: [Probe; 3],
    sigma1: f32,
    photons: u32,
    iterations: u32,
    /// Independent runs over which errors are averaged.
    runs: u64,
    reference: Reference,
}

/// Camera samples per pixel and iteration, as in the thesis's figures.
const SAMPLES: u32 = 2;
const ALPHA: f64 = 0.2;
const P: f64 = 1.0;

/// What a study found.
struct Findings {
    blocks: Vec<Block>,
    /// True radiance at each probe.
    truth: Vec<Estimate>,
    /// Numbers of iterations at which errors are taken.
    counts: Vec<u32>,
    /// Kernel sizes of iterations `counts`.
    bandwidths: Vec<Bandwidth>,
    /// Root mean square over the runs of the error of the average, by count and probe.
    errors: Vec<Vec<f64>>,
    /// The same for `path` with as many camera samples, expected from the noise of the reference; empty where that is not `path`.
    path_errors: Vec<Vec<f64>>,
    /// The average of all runs.
    picture: picture::Pixels,
}

fn studies(options: &Options) -> Vec<Study> {
    let scaled = |full: u32, small: u32| if options.small { small } else { full };
    let size = [scaled(160, 80), scaled(120, 60)];
    let iterations = scaled(128, 16);
    let runs = if options.small { 4 } else { 2 };
    let box_room = Study {
        figures: "5.6 and 5.7",
        name: "box",
        scene: options.scenes.join("box"),
        size,
        probes: [
            Probe {
                name: "A",
                what: "on the caustic",
                at: [0.706, 0.838],
            },
            Probe {
                name: "B",
                what: "on the reflection of the caustic",
                at: [0.875, 0.638],
            },
            Probe {
                name: "C",
                what: "on a side of the block that light reaches only indirectly",
                at: [0.536, 0.46],
            },
        ],
        sigma1: 0.1,
        photons: scaled(100_000, 20_000),
        iterations,
        runs,
        reference: Reference::Path {
            iterations: scaled(100, 24),
            samples: scaled(2048, 1024),
        },
    };
    let torus = stage::torus(options).map(|scene| Study {
        figures: "5.4 and 5.5",
        name: "torus",
        scene,
        size,
        probes: [
            Probe {
                name: "A",
                what: "on a dim reflection in the glass",
                at: [0.625, 0.69],
            },
            Probe {
                name: "B",
                what: "on a bright spot of the caustics",
                at: [0.367, 0.646],
            },
            Probe {
                name: "C",
                what: "on the torus",
                at: [0.734, 0.52],
            },
        ],
        // A tenth of half the side of the glass cube.
        sigma1: 1.0,
        photons: scaled(100_000, 20_000),
        iterations,
        runs,
        reference: Reference::Pppm {
            iterations: scaled(150, 16),
            photons: scaled(200_000, 50_000),
            sigma1: 0.15,
        },
    });
    torus.into_iter().chain([box_room]).collect()
}

/// Carries out all studies; writes pictures, plots and tables of values, and shows them on the page.
pub(super) fn run(options: &Options, page: &mut Page) -> Result<()> {
    page.heading(2, "Errors at three places (figures 5.4 to 5.7)");
    page.paragraph(
        "`pcf` with sigma_1 = 0.1 for a room of side 2, theta_1 = 18 degrees, alpha = 0.2, p = 1, S = 2 and `lookup_vertex=auto`. \
         The thesis ran 4000 iterations of 1 to 4 million cones; here there are fewer and smaller ones. Errors are those of the \
         average of the first N iterations over a block of 2x2 pixels, root mean square over independent runs.",
    );
    for study in studies(options) {
        let scene = stage::load(&study.scene, study.size)?;
        let findings = study.measure(&scene)?;
        study.report(options, page, &findings)?;
    }
    Ok(())
}

impl Probe {
    fn block(&self, size: [u32; 2]) -> Block {
        Block {
            at: [0, 1].map(|i| (self.at[i] * size[i] as f32 - 1.0).round() as u32),
            size: [2, 2],
        }
    }
}

/// Mean luminance over a block of an image.
fn mean_over(iteration: &Iteration, pixels: impl Iterator<Item = usize>) -> f64 {
    let values: Vec<f64> = pixels.map(|i| f64::from(iteration.pixels[i].luminance())).collect();
    values.iter().sum::<f64>() / values.len() as f64
}

impl Study {
    fn settings(&self, scene: &Scene) -> IntegratorSettings {
        let settings = stage::pcf(scene, self.photons, SAMPLES, self.sigma1);
        stage::aimed(&settings, LookupVertex::Auto, CAMERA)
    }

    fn measure(&self, scene: &Scene) -> Result<Findings> {
        let blocks: Vec<Block> = self.probes.iter().map(|p| p.block(self.size)).collect();
        let settings = self.settings(scene);
        let truth = self.truth(scene, &blocks)?;
        let counts: Vec<u32> = (0..).map(|i| 1 << i).take_while(|&n| n <= self.iterations).collect();
        let mut squares = vec![vec![0.0; blocks.len()]; counts.len()];
        let mut sum = Sum::new(scene);
        let bar = progress(
            &format!("figures {}", self.figures),
            self.runs * u64::from(self.iterations),
        );
        for seed in 1..=self.runs {
            let mut values: Vec<Vec<f64>> = Vec::new();
            average(scene, &settings, seed, self.iterations, |iteration| {
                values.push(
                    blocks
                        .iter()
                        .map(|b| mean_over(iteration, b.pixels(self.size[0])))
                        .collect(),
                );
                sum.add(iteration);
                bar.inc(1);
            })?;
            for (squares, &n) in squares.iter_mut().zip(&counts) {
                for (i, square) in squares.iter_mut().enumerate() {
                    let mean = values[..n as usize].iter().map(|v| v[i]).sum::<f64>() / f64::from(n);
                    *square += (mean - truth[i].mean).powi(2) / self.runs as f64;
                }
            }
        }
        bar.finish_and_clear();
        let bandwidths = counts
            .iter()
            .map(|&n| bandwidth(scene, &settings, n).expect("pcf has a bandwidth"))
            .collect();
        Ok(Findings {
            path_errors: self.path_errors(&truth, &counts),
            blocks,
            truth,
            counts,
            bandwidths,
            errors: squares
                .into_iter()
                .map(|s| s.into_iter().map(f64::sqrt).collect())
                .collect(),
            picture: sum.mean(),
        })
    }

    /// Standard deviation of `path` at each count and probe, with as many camera samples as `pcf` has.
    fn path_errors(&self, truth: &[Estimate], counts: &[u32]) -> Vec<Vec<f64>> {
        let Reference::Path { iterations, samples } = self.reference else {
            return Vec::new();
        };
        let share = |n: u32| f64::from(iterations * samples) / f64::from(n * SAMPLES);
        counts
            .iter()
            .map(|&n| truth.iter().map(|t| t.standard_error * share(n).sqrt()).collect())
            .collect()
    }

    /// True radiance at each block, under seeds of its own.
    fn truth(&self, scene: &Scene, blocks: &[Block]) -> Result<Vec<Estimate>> {
        const SEED: u64 = 1_000;
        let bar = progress(&format!("reference {}", self.name), self.reference.jobs(blocks.len()));
        match self.reference {
            Reference::Path { iterations, samples } => blocks
                .iter()
                .map(|&block| {
                    let mut narrowed = stage::load(&self.scene, self.size)?;
                    stage::crop(&mut narrowed, block)?;
                    let settings = stage::path(&narrowed, samples);
                    let jobs: Vec<_> = (1..=iterations).map(|i| (SEED, i)).collect();
                    let values = each(&narrowed, &settings, &jobs, &bar, |i| mean_over(&i, 0..i.pixels.len()))?;
                    Ok(estimate(&values))
                })
                .collect(),
            Reference::Pppm {
                iterations,
                photons,
                sigma1,
            } => {
                let settings = stage::pppm(scene, photons, SAMPLES, sigma1);
                let jobs: Vec<_> = (1..=iterations).map(|i| (SEED, i)).collect();
                let values = each(scene, &settings, &jobs, &bar, |iteration| {
                    blocks
                        .iter()
                        .map(|b| mean_over(&iteration, b.pixels(self.size[0])))
                        .collect::<Vec<_>>()
                })?;
                let of_block = |i: usize| estimate(&values.iter().map(|v| v[i]).collect::<Vec<_>>());
                Ok((0..blocks.len()).map(of_block).collect())
            }
        }
    }

    fn report(&self, options: &Options, page: &mut Page, findings: &Findings) -> Result<()> {
        let picture = format!("figure-{}-{}.png", &self.figures[..3], self.name);
        let plot = format!("figure-{}-{}.png", &self.figures[self.figures.len() - 3..], self.name);
        let curve = ToneCurve::fit(&findings.picture.values);
        picture::write(&options.out.join(&picture), &findings.picture, &curve, &findings.blocks)?;
        self.draw(&options.out.join(&plot), findings)?;
        self.write_values(options, findings)?;

        page.heading(3, &format!("The {} ({})", self.name, self.figures));
        page.paragraph(&format!(
            "{} runs of {} iterations of {} light paths, {}x{} pixels. The true values are those of {}.",
            self.runs,
            self.iterations,
            self.photons,
            self.size[0],
            self.size[1],
            self.reference.in_words()
        ));
        page.pictures(&[
            Picture {
                caption: "probes A (blue), B (orange), C (green)".into(),
                file: picture,
            },
            Picture {
                caption: "bandwidths and errors against iterations".into(),
                file: plot,
            },
        ]);
        let (first, last) = (&findings.errors[0], &findings.errors[findings.errors.len() - 1]);
        let rows: Vec<Vec<String>> = (0..self.probes.len())
            .map(|i| {
                let truth = findings.truth[i];
                let percent = |error: f64| format!("{:.1} %", 100.0 * error / truth.mean);
                vec![
                    format!("{}: {}", self.probes[i].name, self.probes[i].what),
                    format!("{:.4} ± {:.4}", truth.mean, truth.standard_error),
                    percent(first[i]),
                    percent(last[i]),
                    findings
                        .path_errors
                        .last()
                        .map_or("unknown".into(), |path| percent(path[i])),
                    format!("{:.2}", findings.slope(i)),
                ]
            })
            .collect();
        page.table(
            &[
                "probe",
                "true luminance",
                "error of 1 iteration",
                &format!("of {} iterations", self.iterations),
                "of path with as many camera samples",
                "slope of the error (log-log)",
            ],
            &rows,
        );
        page.paragraph(&format!(
            "Theory: bias falls as N^{:.2}, the standard deviation as N^{:.2}. A slope near the first says that bias \
             rules at a probe, one near the second that noise does.",
            (ALPHA - 1.0) / (P + 1.0),
            -0.5 * ALPHA
        ));
        Ok(())
    }

    fn draw(&self, path: &std::path::Path, findings: &Findings) -> Result<()> {
        let over = |y: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
            findings
                .counts
                .iter()
                .enumerate()
                .map(|(i, &n)| (f64::from(n), y(i)))
                .collect()
        };
        let chart = |title: &str, y: &str, series| Chart {
            title: format!("{}, {title}", self.name),
            x: "iterations N".into(),
            y: y.into(),
            scales: (Scale::Log, Scale::Log),
            series,
        };
        let sigma = over(&|i| f64::from(findings.bandwidths[i].sigma));
        let theta = over(&|i| f64::from(findings.bandwidths[i].theta).to_degrees());
        let mut errors: Vec<Series> = (0..self.probes.len())
            .map(|p| Series::new(self.probes[p].name, Stroke::Dots, p, over(&|i| findings.errors[i][p])))
            .collect();
        let slope = (ALPHA - 1.0) / (P + 1.0);
        let start = findings.errors[0].iter().copied().fold(0.0, f64::max);
        let guide = over(&|i| start * f64::from(findings.counts[i]).powf(slope));
        errors.push(Series::new(format!("N^{slope:.2}"), Stroke::Dashes, 6, guide));
        let mut charts = vec![
            chart(
                "spatial bandwidth",
                "sigma",
                vec![Series::new("sigma", Stroke::Dots, 6, sigma)],
            ),
            chart(
                "angular bandwidth",
                "theta [degrees]",
                vec![Series::new("theta", Stroke::Dots, 6, theta)],
            ),
            chart("error", "absolute error", errors),
        ];
        if !findings.path_errors.is_empty() {
            let series = |p: usize| {
                Series::new(
                    self.probes[p].name,
                    Stroke::Dots,
                    p,
                    over(&|i| findings.path_errors[i][p]),
                )
            };
            let series = (0..self.probes.len()).map(series).collect();
            charts.push(chart(
                "error of path with as many camera samples",
                "absolute error",
                series,
            ));
        }
        plot::write(path, &charts, 2)
    }

    fn write_values(&self, options: &Options, findings: &Findings) -> Result<()> {
        let header = [
            "iterations",
            "sigma",
            "theta_degrees",
            "error_a",
            "error_b",
            "error_c",
            "path_error_a",
            "path_error_b",
            "path_error_c",
        ];
        let unknown = vec![vec![f64::NAN; self.probes.len()]; findings.counts.len()];
        let path_errors = if findings.path_errors.is_empty() {
            &unknown
        } else {
            &findings.path_errors
        };
        let rows: Vec<Vec<String>> = findings
            .counts
            .iter()
            .zip(&findings.bandwidths)
            .zip(&findings.errors)
            .zip(path_errors)
            .map(|(((n, bandwidth), errors), path_errors)| {
                let kernel = [f64::from(bandwidth.sigma), f64::from(bandwidth.theta).to_degrees()];
                let values = kernel.into_iter().chain(errors.iter().chain(path_errors).copied());
                std::iter::once(n.to_string()).chain(values.map(csv::number)).collect()
            })
            .collect();
        csv::write(
            &options.out.join(format!("figures-5-{}.csv", self.name)),
            &header,
            &rows,
        )
    }
}

impl Reference {
    /// Iterations to render for a number of blocks.
    fn jobs(&self, blocks: usize) -> u64 {
        match self {
            Self::Path { iterations, .. } => u64::from(*iterations) * blocks as u64,
            Self::Pppm { iterations, .. } => u64::from(*iterations),
        }
    }

    fn in_words(&self) -> String {
        match self {
            Self::Path { iterations, samples } => {
                format!(
                    "`path` through these pixels alone, {} samples each",
                    iterations * samples
                )
            }
            Self::Pppm {
                iterations,
                photons,
                sigma1,
            } => format!(
                "`pppm` with another seed, {iterations} iterations of {photons} light paths, sigma_1 = {sigma1}: paths cannot find \
                 the sun through the glass"
            ),
        }
    }
}

impl Findings {
    /// Fitted slope of the logarithm of a probe's error over the logarithm of the number of iterations.
    fn slope(&self, probe: usize) -> f64 {
        let points: Vec<(f64, f64)> = self
            .counts
            .iter()
            .zip(&self.errors)
            .map(|(&n, e)| (f64::from(n).ln(), e[probe].ln()))
            .collect();
        let n = points.len() as f64;
        let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
        let (xy, xx) = points.iter().fold((0.0, 0.0), |(xy, xx), p| {
            (xy + (p.0 - x) * (p.1 - y), xx + (p.0 - x).powi(2))
        });
        xy / xx
    }
}
