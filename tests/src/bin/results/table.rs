//! The singularity table: which emitters, sensors and chains of bounces each integrator can render at all.

mod layout;
mod report;
mod truth;

use crate::Options;
use crate::render::{each, progress};
use anyhow::{Result, ensure};
use indicatif::ProgressBar;
use layout::{Chain, Emitter, Eye, Layout};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    BdptSettings, IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings, VcmSettings,
};
use photonfarm_tests::render::mean_luminance;
use photonfarm_tests::statistics::Moments;

/// A column of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Path,
    Pppm,
    Pcf,
    NestedPcf,
    FirstVertexPcf,
    Bdpt,
    Vcm,
}

impl Column {
    const ALL: [Self; 7] = [
        Self::Path,
        Self::Pppm,
        Self::Pcf,
        Self::NestedPcf,
        Self::FirstVertexPcf,
        Self::Bdpt,
        Self::Vcm,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Path => "path",
            Self::Pppm => "pppm",
            Self::Pcf => "pcf",
            Self::NestedPcf => "pcf nested",
            Self::FirstVertexPcf => "pcf k=1",
            Self::Bdpt => "bdpt",
            Self::Vcm => "vcm",
        }
    }

    /// Light paths for the chain, over those for the shortest ones: few come all the way of a long one, and fewer in the
    /// narrow kernel on a mirror that shows a diffuse surface.
    fn photon_share(self, chain: Chain) -> u32 {
        match chain {
            Chain::D | Chain::S | Chain::Ss => 1,
            Chain::Sds if self == Self::FirstVertexPcf => 10,
            Chain::Sds => 2,
            Chain::Dsd => 4,
        }
    }

    /// First kernel for the chain: radius [scene units] and half angle \[degrees\].
    fn kernel(self, chain: Chain) -> (f32, f32) {
        match chain {
            Chain::S | Chain::Ss => (0.06, 5.0),
            Chain::Sds if self == Self::FirstVertexPcf => (0.1, 8.0),
            _ => (0.1, 25.0),
        }
    }

    /// Settings for the chain, with `photons` light paths. Kernels are small against everything that light and shade vary over; directions count widely
    /// where a diffuse surface is looked up, which looks the same from everywhere, and narrowly on mirrors.
    fn settings(self, chain: Chain, photons: u32) -> IntegratorSettings {
        let max_depth = Some(chain.edges());
        let (sigma, theta) = self.kernel(chain);
        match self {
            Self::Path => IntegratorSettings::Path(PathSettings {
                samples: 64,
                sampling: Sampling::Independent,
                max_depth,
            }),
            Self::Pppm => IntegratorSettings::Pppm(PppmSettings {
                photons,
                samples: 4,
                sampling: Sampling::Independent,
                sigma1: Some(sigma),
                max_depth,
                ..Default::default()
            }),
            Self::Bdpt => IntegratorSettings::Bdpt(BdptSettings {
                photons,
                samples: 64,
                sampling: Sampling::Independent,
                max_depth,
                ..Default::default()
            }),
            Self::Vcm => IntegratorSettings::Vcm(VcmSettings {
                photons,
                samples: 4,
                sampling: Sampling::Independent,
                sigma1: Some(sigma),
                max_depth,
                ..Default::default()
            }),
            Self::Pcf | Self::NestedPcf | Self::FirstVertexPcf => IntegratorSettings::Pcf(PcfSettings {
                photons,
                samples: 4,
                sampling: Sampling::Independent,
                sigma1: Some(sigma),
                theta1: theta,
                lookup_vertex: if self == Self::FirstVertexPcf {
                    LookupVertex::Fixed(1)
                } else {
                    LookupVertex::Auto
                },
                nested: self == Self::NestedPcf,
                max_depth,
                ..Default::default()
            }),
        }
    }
}

/// The mean radiance of an image over its true value.
#[derive(Clone, Copy, Debug)]
struct Ratio {
    value: f64,
    /// Standard error.
    error: f64,
}

impl Ratio {
    /// Whether nothing at all was seen.
    fn is_black(self) -> bool {
        self.value == 0.0
    }
}

/// Share of the truth that the kernels' bias may take off or add.
const BIAS: f64 = 0.05;

/// Standard errors that a cell of the whole table may miss its expectation by, beside [`BIAS`]. An error is that of eight runs or
/// more, and there are some 300 cells.
const DEVIATIONS: f64 = 5.0;

impl Row {
    /// What a column's ratio should be but for bias and noise: 1, or what the kernel makes of a light that it is wider than. Parallel
    /// rays all look at the middle of the environment's cap, which a kernel of directions averages with what lies around it.
    fn expected(&self, column: Column) -> f64 {
        let Layout { emitter, eye, chain } = self.layout;
        if must_be_black(column, &self.layout) {
            return 0.0;
        }
        match column {
            Column::NestedPcf | Column::FirstVertexPcf
                if eye == Eye::Orthographic && emitter == Emitter::Environment && chain.shows_the_light() =>
            {
                truth::blurred_cap(column.kernel(chain).1.to_radians().into())
            }
            _ => 1.0,
        }
    }

    /// The cells that are neither right nor black where they must be, in words.
    fn outside(&self) -> impl Iterator<Item = String> {
        let told = self
            .ratios
            .iter()
            .filter(|(column, ratio)| !(ratio.is_black() && is_left_to_chance(*column, &self.layout)));
        told.filter_map(|(column, ratio)| {
            let expected = self.expected(*column);
            let reach = if expected == 0.0 {
                0.0
            } else {
                BIAS + DEVIATIONS * ratio.error
            };
            ((ratio.value - expected).abs() > reach || ratio.is_black() != (expected == 0.0)).then(|| {
                let Layout { emitter, eye, chain } = self.layout;
                format!(
                    "{}, {}, {}, {}: {:.3} ± {:.3} for {expected:.3}",
                    eye.name(),
                    emitter.name(),
                    chain.name(),
                    column.name(),
                    ratio.value,
                    ratio.error
                )
            })
        })
    }
}

/// Whether light along the chain is found by light paths alone that hit the lens, so rarely that there may be none.
fn is_left_to_chance(column: Column, layout: &Layout) -> bool {
    let pinhole = Layout {
        eye: Eye::Pinhole,
        ..*layout
    };
    layout.eye == Eye::ThinLens && matches!(column, Column::Bdpt | Column::Vcm) && must_be_black(column, &pinhole)
}

/// Whether the integrator has no way to sample light along the chain.
fn must_be_black(column: Column, layout: &Layout) -> bool {
    let singular = layout.emitter.is_delta();
    match column {
        Column::Path => singular && (layout.chain.shows_the_light() || layout.chain == Chain::Sds),
        Column::Pppm | Column::Pcf => singular && layout.chain.shows_the_light(),
        Column::NestedPcf | Column::FirstVertexPcf => false,
        // Mirrors are connected with nothing, but a light path may hit a lens.
        _ if layout.eye == Eye::ThinLens => false,
        Column::Bdpt => singular && (layout.chain.shows_the_light() || layout.chain == Chain::Sds),
        Column::Vcm => singular && layout.chain.shows_the_light(),
    }
}

/// A row of the table.
#[derive(Clone, Debug)]
struct Row {
    layout: Layout,
    /// Mean radiance of the image; `None` where it is not finite, and the row is empty.
    truth: Option<f64>,
    ratios: Vec<(Column, Ratio)>,
}

/// How much is rendered.
struct Effort {
    eyes: Vec<Eye>,
    /// Light paths per iteration of the shortest chains.
    photons: u32,
    /// Standard error that a ratio should reach.
    noise: f64,
    /// Iterations of a cell, at least and at most.
    iterations: (usize, usize),
}

impl Effort {
    fn full() -> Self {
        Self {
            eyes: Eye::ALL.to_vec(),
            photons: 50_000,
            noise: 0.025,
            iterations: (8, 40),
        }
    }

    fn small() -> Self {
        Self {
            eyes: vec![Eye::Pinhole],
            photons: 25_000,
            noise: 0.12,
            iterations: (6, 6),
        }
    }
}

/// Iterations that tell how many a cell needs; they do not enter its value.
const PILOT: u64 = 4;

/// Mean radiance over the iterations that bring its noise down to that of `effort`.
///
/// All are first iterations, under different seeds, so that the kernels keep their size.
fn cell(scene: &Scene, settings: &IntegratorSettings, effort: &Effort, truth: f64) -> Result<Ratio> {
    let silent = ProgressBar::hidden();
    let measure = |seeds: std::ops::Range<u64>| -> Result<(f64, f64)> {
        let jobs: Vec<(u64, u32)> = seeds.map(|seed| (seed, 1)).collect();
        let mut moments = Moments::default();
        for mean in each(scene, settings, &jobs, &silent, |image| mean_luminance(&image.pixels))? {
            moments.push(&[mean / truth]);
        }
        Ok((moments.mean()[0], moments.squared_error()[0]))
    };
    let (least, most) = effort.iterations;
    let mut needed = least;
    if most > least {
        let (_, pilot) = measure(0..PILOT)?;
        needed = (PILOT as f64 * pilot / (effort.noise * effort.noise)).ceil() as usize;
    }
    let (value, squared_error) = measure(PILOT..PILOT + needed.clamp(least, most) as u64)?;
    Ok(Ratio {
        value,
        error: squared_error.sqrt(),
    })
}

fn measure(effort: &Effort, bar: &ProgressBar) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for layout in layouts(effort) {
        let truth = truth::mean_radiance(&layout)?;
        let mut ratios = Vec::new();
        if let Some(truth) = truth {
            let scene = layout.scene()?;
            for column in Column::ALL {
                let ratio = cell(
                    &scene,
                    &column.settings(layout.chain, effort.photons * column.photon_share(layout.chain)),
                    effort,
                    truth,
                )?;
                ratios.push((column, ratio));
                bar.inc(1);
            }
        }
        rows.push(Row { layout, truth, ratios });
    }
    bar.finish_and_clear();
    Ok(rows)
}

fn layouts(effort: &Effort) -> Vec<Layout> {
    let of_chain = |eye: Eye, emitter: Emitter| Chain::ALL.map(|chain| Layout { emitter, eye, chain });
    let of_eye = |eye: &Eye| {
        Emitter::ALL
            .into_iter()
            .flat_map(move |emitter| of_chain(*eye, emitter))
            .collect::<Vec<_>>()
    };
    effort.eyes.iter().flat_map(of_eye).collect()
}

/// Writes `singularities.csv` and `singularities.md` to the folder `options.out`.
pub(crate) fn run(options: &Options) -> Result<()> {
    let effort = if options.small { Effort::small() } else { Effort::full() };
    let bar = progress("table", (layouts(&effort).len() * Column::ALL.len()) as u64);
    let rows = measure(&effort, &bar)?;
    report::write(&options.out, &effort.eyes, &rows)?;
    let outside: Vec<String> = rows.iter().flat_map(Row::outside).collect();
    ensure!(
        outside.is_empty(),
        "cells that miss their expectation by more than bias and noise explain:\n{}",
        outside.join("\n")
    );
    Ok(())
}

#[cfg(test)]
mod tests;
