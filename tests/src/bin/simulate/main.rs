//! Simulated workers: the real protocol, with made-up images in place of rendering.
//!
//! They find out what a coordinator bears: how many workers, leases and bytes, and how much memory it takes. A coordinator is started
//! for the purpose, unless one is named.

mod farm;
mod ingest;
mod leases;

use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use farm::Farm;
use photonfarm_test_servers::Postgres;
use photonfarm_tests::processes::Coordinator;
use std::path::PathBuf;

/// Loads a coordinator with simulated workers and measures it.
///
/// They speak the protocol of photonfarm-worker, but wait instead of rendering and deliver made-up images.
#[derive(Parser)]
#[command(name = "simulate")]
struct Cli {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    target: Target,
}

#[derive(Args)]
struct Target {
    /// A coordinator that runs, such as http://127.0.0.1:7800; its memory is not measured then. One is started otherwise.
    #[arg(long, global = true)]
    coordinator: Option<String>,
    /// Keeps the state of the coordinator that is started in a PostgreSQL cluster of its own rather than in SQLite.
    #[arg(long, global = true, conflicts_with = "coordinator")]
    postgres: bool,
    /// Folder of the coordinator that is started, on the disk to be measured; a temporary one otherwise.
    #[arg(long, global = true)]
    folder: Option<PathBuf>,
}

#[derive(Subcommand)]
enum What {
    /// Many workers with small images: leases per second, and how long a worker waits for one.
    Leases(leases::Options),
    /// Few workers with large images: bytes per second, against a plain copy through a socket to the same disk; and memory.
    Ingest(ingest::Options),
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    let temporary;
    let folder = match cli.target.folder {
        Some(folder) => folder,
        None => {
            temporary = tempfile::tempdir().context("no temporary folder")?;
            temporary.path().to_owned()
        }
    };
    std::fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let cluster = cli.target.postgres.then(Postgres::start);
    let started = match &cli.target.coordinator {
        Some(_) => None,
        None => {
            let state = cluster.as_ref().map(Postgres::database);
            let options = state.iter().flat_map(|url| ["--state", url]);
            // Leases are short, so that workers ask for many.
            let options: Vec<&str> = options.chain(["--lease-seconds", "1"]).collect();
            Some(Coordinator::start_with(&folder.join("farm"), &options))
        }
    };
    let url = match (&cli.target.coordinator, &started) {
        (Some(url), _) => url,
        (None, Some(started)) => &started.url,
        (None, None) => unreachable!("a coordinator is named or started"),
    };
    let farm = Farm::new(url)?;
    let runtime = tokio::runtime::Runtime::new()?;
    match cli.what {
        What::Leases(options) => runtime.block_on(leases::measure(&farm, &options))?,
        What::Ingest(options) => ingest::measure(&runtime, &farm, &options, &folder, started.as_ref())?,
    }
    if let Some(bytes) = started.as_ref().and_then(Coordinator::peak_memory) {
        println!("coordinator: at most {:.0} MB of memory", bytes as f64 * 1e-6);
    }
    Ok(())
}
