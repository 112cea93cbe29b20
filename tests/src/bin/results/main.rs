//! Repeats the measurements and pictures of `docs/results`.

mod csv;
mod figures;
mod leaks;
mod plot;
mod render;
mod sampling;
mod slopes;
mod table;

use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cargo run --release -p photonfarm-tests --bin results -- all
      Everything in docs/results, in place.
  cargo run --release -p photonfarm-tests --bin results -- slopes --small --out /tmp/results
      How variance and bias shrink with the number of iterations, roughly, somewhere else.";

/// Repeats the measurements and pictures of docs/results.
///
/// Seeds are fixed: the same command writes the same numbers on any machine, but for those that are times.
#[derive(Debug, Parser)]
#[command(name = "results", after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    part: Part,
    #[command(flatten)]
    options: Options,
}

#[derive(Clone, Copy, Debug, Subcommand)]
enum Part {
    /// All of the below
    All,
    /// Fitted slopes of variance and bias over the number of iterations, against the theory
    Slopes,
    /// Mean radiance over its true value for every emitter, sensor and chain of bounces: the singularity table
    Table,
    /// Pictures and plots of example scenes
    Figures,
    /// Variance under low-discrepancy sampling over that under independent sampling
    Sampling,
    /// Light leaks and boundary bias, with and without the surface test
    Leaks,
    /// The error of each integrator against its time
    EqualTime,
    /// What each bidirectional technique finds alone, as pictures
    Strategies,
}

/// What every part is told.
#[derive(Clone, Debug, Args)]
pub(crate) struct Options {
    /// Fewer runs and smaller pictures: seconds instead of minutes, and wider intervals
    #[arg(long, global = true)]
    pub(crate) small: bool,
    /// Folder that holds the example scenes
    #[arg(long, global = true, value_name = "FOLDER", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes"))]
    pub(crate) scenes: PathBuf,
    /// Folder of scenes made by others; what needs `torus`, `water-caustic` or `veach-bidir` in it is left out without
    #[arg(long, global = true, value_name = "FOLDER", env = "PHOTONFARM_SCENES")]
    pub(crate) others: Option<PathBuf>,
    /// Folder to write to; it is made where it is missing
    #[arg(long, global = true, value_name = "FOLDER", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/results"))]
    pub(crate) out: PathBuf,
}

fn main() -> Result<()> {
    let Arguments { part, options } = Arguments::parse();
    std::fs::create_dir_all(&options.out).with_context(|| format!("cannot make {}", options.out.display()))?;
    let part_is = |other: fn(&Part) -> bool| matches!(part, Part::All) || other(&part);
    if part_is(|p| matches!(p, Part::Slopes)) {
        slopes::run(&options).context("slopes")?;
    }
    if part_is(|p| matches!(p, Part::Table)) {
        table::run(&options).context("table")?;
    }
    if part_is(|p| matches!(p, Part::Figures)) {
        figures::run(&options).context("figures")?;
    }
    if part_is(|p| matches!(p, Part::Sampling)) {
        sampling::run(&options).context("sampling")?;
    }
    if part_is(|p| matches!(p, Part::Leaks)) {
        leaks::run(&options).context("leaks")?;
    }
    if part_is(|p| matches!(p, Part::EqualTime)) {
        figures::race::run(&options).context("equal time")?;
    }
    if part_is(|p| matches!(p, Part::Strategies)) {
        figures::strategies::run(&options).context("strategies")?;
    }
    Ok(())
}
