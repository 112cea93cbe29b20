//! Many workers with small images.

use crate::farm::{Farm, Planes};
use anyhow::{Result, ensure};
use clap::Args;
use photonfarm_proto::id::JobId;
use photonfarm_proto::worker::Lease;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

#[derive(Args)]
pub(crate) struct Options {
    /// Workers at once.
    #[arg(long, default_value_t = 1000)]
    workers: u32,
    /// How long each pretends to render a lease \[ms\]; 0 asks for as much as the coordinator gives.
    #[arg(long, default_value_t = 10_000)]
    render_ms: u64,
    /// Jobs of this many iterations each, of which the state is full before the measurement.
    #[arg(long, default_value_t = 1_000_000)]
    iterations: u32,
    /// How many such jobs.
    #[arg(long, default_value_t = 1)]
    jobs: u32,
    /// How long to measure, once all workers are at work \[s\].
    #[arg(long, default_value_t = 30)]
    seconds: u64,
}

/// An iteration is said to take longer than a lease should. It is believed to take as long as its lease lasts, so that leases are of
/// one iteration where pretending to render takes a second or more (`--lease-seconds 1`).
const SECONDS_PER_ITERATION: f64 = 60.0;

/// The longest wait for a lease in one request \[ms\].
const WAIT_MS: u64 = 10_000;

/// Side of the images \[pixels\].
const SIDE: u32 = 8;

#[derive(Default)]
struct Tally {
    delivered: AtomicU64,
    /// Iterations delivered, by job.
    iterations: Mutex<BTreeMap<JobId, u64>>,
    lost: AtomicU64,
    heartbeats: AtomicU64,
}

pub(crate) async fn measure(farm: &Farm, options: &Options) -> Result<()> {
    let submitting = Instant::now();
    for _ in 0..options.jobs {
        farm.submit(options.iterations).await?;
    }
    println!(
        "{} jobs submitted in {:.1} s",
        options.jobs,
        submitting.elapsed().as_secs_f64()
    );
    let planes = Planes::new(SIDE, SIDE);
    let tally = Arc::new(Tally::default());
    let registering = Instant::now();
    let mut workers = Vec::new();
    for number in 0..options.workers {
        workers.push(farm.register(format!("simulated-{number}")).await?);
    }
    let registered = registering.elapsed().as_secs_f64();
    let begin = Instant::now() + Duration::from_millis(options.render_ms);
    let end = begin + Duration::from_secs(options.seconds);
    let tasks: Vec<_> = workers
        .into_iter()
        .enumerate()
        .map(|(number, registered)| {
            let (farm, planes, tally) = (farm.clone(), planes.clone(), tally.clone());
            let render = Duration::from_millis(options.render_ms);
            let beat = Duration::from_millis(registered.heartbeat_ms);
            // Workers do not all begin at the same moment.
            let delay = render.mul_f64(number as f64 / f64::from(options.workers));
            tokio::spawn(async move {
                tokio::time::sleep(delay).await;
                let mut waits = Vec::new();
                while Instant::now() < end {
                    let asked = Instant::now();
                    let Some(lease) = farm.lease(registered.worker, WAIT_MS).await? else {
                        continue;
                    };
                    if asked >= begin {
                        waits.push(asked.elapsed().as_secs_f64() * 1e3);
                    }
                    if pretend(&farm, &lease, render, beat, &tally).await? {
                        farm.deliver(&lease, &planes, SECONDS_PER_ITERATION).await?;
                        tally.delivered.fetch_add(1, Ordering::Relaxed);
                        let mut iterations = tally.iterations.lock().unwrap_or_else(PoisonError::into_inner);
                        *iterations.entry(lease.job).or_default() += lease.node.leaves();
                    }
                }
                anyhow::Ok(waits)
            })
        })
        .collect();
    let mut waits = Vec::new();
    for task in tasks {
        waits.extend(task.await??);
    }
    waits.sort_by(f64::total_cmp);
    ensure!(!waits.is_empty(), "no lease was given");
    let at = |share: f64| waits[((waits.len() - 1) as f64 * share) as usize];
    let iterations = std::mem::take(&mut *tally.iterations.lock().unwrap_or_else(PoisonError::into_inner));
    let mut counted = 0;
    for (job, delivered) in iterations {
        let done = farm.status(job).await?.iterations_done;
        ensure!(
            done == delivered,
            "every iteration of job {job} that was delivered counts once"
        );
        counted += done;
    }
    let delivered = tally.delivered.load(Ordering::Relaxed);
    println!(
        "{} workers, registered in {registered:.1} s: {:.0} leases per second over {} s",
        options.workers,
        waits.len() as f64 / options.seconds as f64,
        options.seconds
    );
    println!(
        "a lease after {:.1} ms in the median, {:.1} ms at the 99th percentile, {:.1} ms at most",
        at(0.5),
        at(0.99),
        at(1.0)
    );
    println!(
        "{delivered} nodes delivered, {counted} iterations counted, {} leases lost, {} heartbeats",
        tally.lost.load(Ordering::Relaxed),
        tally.heartbeats.load(Ordering::Relaxed)
    );
    Ok(())
}

/// Holds a lease as long as rendering would take, with heartbeats; whether it is held at the end.
async fn pretend(farm: &Farm, lease: &Lease, render: Duration, beat: Duration, tally: &Tally) -> Result<bool> {
    let done = Instant::now() + render;
    while Instant::now() + beat < done {
        tokio::time::sleep(beat).await;
        tally.heartbeats.fetch_add(1, Ordering::Relaxed);
        if !farm.heartbeat(lease).await? {
            tally.lost.fetch_add(1, Ordering::Relaxed);
            return Ok(false);
        }
    }
    tokio::time::sleep(done.saturating_duration_since(Instant::now())).await;
    Ok(true)
}
