//! Figures 5.4 to 5.7: the error at three places of a picture against the number of iterations.

mod report;

use super::page::Page;
use super::picture;
use super::runs::{Estimate, Sum, average, estimate};
use super::stage::{self, Block, CAMERA};
use crate::Options;
use crate::render::{each, progress};
use anyhow::Result;
use indicatif::ProgressBar;
use photonfarm_core::integrator::{Bandwidth, Iteration, bandwidth};
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
    /// `path` through the probes' pixels, so many iterations of so many samples each under each seed.
    Path { iterations: u32, samples: u32 },
    /// `pppm` over the whole image with a small first radius, so many iterations under each seed.
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

/// Seeds of the reference.
const REFERENCE_SEEDS: std::ops::Range<u64> = 1_001..1_011;

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
    /// The same for `path` with as many camera samples; empty where the reference is not `path`.
    path_errors: Vec<Vec<f64>>,
    /// The average of all runs.
    picture: picture::Pixels,
}

fn studies(options: &Options) -> Vec<Study> {
    let scaled = |full: u32, small: u32| if options.small { small } else { full };
    let size = [scaled(128, 80), scaled(96, 60)];
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
        photons: scaled(60_000, 20_000),
        iterations,
        runs,
        reference: Reference::Path {
            iterations: scaled(5, 3),
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
        photons: scaled(60_000, 20_000),
        iterations,
        runs,
        reference: Reference::Pppm {
            iterations: scaled(10, 2),
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
    page.paragraph(
        "Where the first disc is wider than a caustic, the error starts slower than the theory's slope, which holds once the disc fits \
         into what it sees. With so few light paths noise soon rules at the dim places. Errors below the reference's \
         own standard error say nothing: in the small version that is most of the torus.",
    );
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

/// Mean luminance of an image.
fn whole(iteration: Iteration) -> f64 {
    mean_over(&iteration, 0..iteration.pixels.len())
}

fn square_roots(squares: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    squares
        .into_iter()
        .map(|row| row.into_iter().map(f64::sqrt).collect())
        .collect()
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
            path_errors: self.path_errors(&truth, &blocks, &counts)?,
            blocks,
            truth,
            counts,
            bandwidths,
            errors: square_roots(squares),
            picture: sum.mean(),
        })
    }

    /// Root mean square error of `path` at each count and probe, with as many camera samples as `pcf` has.
    fn path_errors(&self, truth: &[Estimate], blocks: &[Block], counts: &[u32]) -> Result<Vec<Vec<f64>>> {
        const SEEDS: std::ops::Range<u64> = 2_001..2_017;
        if !matches!(self.reference, Reference::Path { .. }) {
            return Ok(Vec::new());
        }
        let mut squares = vec![vec![0.0; blocks.len()]; counts.len()];
        for (i, &block) in blocks.iter().enumerate() {
            let narrowed = self.narrowed(block)?;
            let settings = stage::path(&narrowed, SAMPLES);
            for seed in SEEDS {
                let jobs: Vec<_> = (1..=self.iterations).map(|i| (seed, i)).collect();
                let values = each(&narrowed, &settings, &jobs, &ProgressBar::hidden(), whole)?;
                for (squares, &n) in squares.iter_mut().zip(counts) {
                    let mean = values[..n as usize].iter().sum::<f64>() / f64::from(n);
                    squares[i] += (mean - truth[i].mean).powi(2) / SEEDS.count() as f64;
                }
            }
        }
        Ok(square_roots(squares))
    }

    /// The scene, seen through a block alone.
    fn narrowed(&self, block: Block) -> Result<Scene> {
        let mut scene = stage::load(&self.scene, self.size)?;
        stage::crop(&mut scene, block)?;
        Ok(scene)
    }

    /// True radiance at each block, with its noise from averages under seeds of their own.
    fn truth(&self, scene: &Scene, blocks: &[Block]) -> Result<Vec<Estimate>> {
        let bar = progress(&format!("reference {}", self.name), self.reference.jobs(blocks.len()));
        let jobs = |iterations| -> Vec<_> {
            REFERENCE_SEEDS
                .flat_map(|seed| (1..=iterations).map(move |i| (seed, i)))
                .collect()
        };
        let over_seeds = |values: &[f64], iterations: u32| {
            let averages = values
                .chunks(iterations as usize)
                .map(|v| v.iter().sum::<f64>() / v.len() as f64);
            estimate(&averages.collect::<Vec<_>>())
        };
        match self.reference {
            Reference::Path { iterations, samples } => blocks
                .iter()
                .map(|&block| {
                    let narrowed = self.narrowed(block)?;
                    let settings = stage::path(&narrowed, samples);
                    let values = each(&narrowed, &settings, &jobs(iterations), &bar, whole)?;
                    Ok(over_seeds(&values, iterations))
                })
                .collect(),
            Reference::Pppm {
                iterations,
                photons,
                sigma1,
            } => {
                let settings = stage::pppm(scene, photons, SAMPLES, sigma1);
                let values = each(scene, &settings, &jobs(iterations), &bar, |iteration| {
                    let of_block = |b: &Block| mean_over(&iteration, b.pixels(self.size[0]));
                    blocks.iter().map(of_block).collect::<Vec<_>>()
                })?;
                let of_block = |i: usize| values.iter().map(|v| v[i]).collect::<Vec<_>>();
                Ok((0..blocks.len())
                    .map(|i| over_seeds(&of_block(i), iterations))
                    .collect())
            }
        }
    }
}

impl Reference {
    /// Iterations to render for a number of blocks.
    fn jobs(&self, blocks: usize) -> u64 {
        let seeds = REFERENCE_SEEDS.count() as u64;
        match self {
            Self::Path { iterations, .. } => seeds * u64::from(*iterations) * blocks as u64,
            Self::Pppm { iterations, .. } => seeds * u64::from(*iterations),
        }
    }
}
