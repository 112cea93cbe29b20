//! Few workers with large images.

use crate::farm::{Farm, Planes};
use anyhow::{Context, Result, ensure};
use clap::Args;
use photonfarm_proto::id::JobId;
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::worker::Lease;
use photonfarm_tests::processes::Coordinator;
use std::fs::File;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

#[derive(Args)]
pub(crate) struct Options {
    /// Iterations of the job.
    #[arg(long, default_value_t = 512)]
    iterations: u32,
    /// Nodes have at most two to this power iterations: larger leases are delivered in parts.
    #[arg(long, default_value_t = 2)]
    level: u32,
    /// Workers that deliver at once.
    #[arg(long, default_value_t = 4)]
    workers: u32,
    /// Pixels across.
    #[arg(long, default_value_t = 1920)]
    width: u32,
    /// Pixels down.
    #[arg(long, default_value_t = 1080)]
    height: u32,
}

/// What an iteration is said to take \[s\]; it is believed to take no longer than its lease has lasted.
const SECONDS: f64 = 60.0;

/// Images of the plain copy.
const COPIES: u32 = 32;

/// A worker waits for a lease as long, and then looks whether its job has ended \[ms\].
const SHORT_WAIT_MS: u64 = 1000;

/// Times that the memory is told.
const LOOKS: u64 = 8;

pub(crate) fn measure(
    runtime: &Runtime,
    farm: &Farm,
    options: &Options,
    folder: &Path,
    coordinator: Option<&Coordinator>,
) -> Result<()> {
    let planes = Planes::new(options.width, options.height);
    let image_mb = planes.bytes().len() as f64 * 1e-6;
    println!(
        "images of {} x {} pixels, {image_mb:.1} MB each",
        options.width, options.height
    );
    let copied = f64::from(COPIES) * image_mb / copy(planes.bytes(), folder, options.workers)?;
    println!(
        "plain copy through a socket to synced files, {} at once: {copied:.0} MB/s",
        options.workers
    );
    let begin = Instant::now();
    let job = runtime.block_on(farm.submit(options.iterations))?;
    let workers: Vec<_> = (0..options.workers)
        .map(|number| {
            let name = format!("simulated-{number}");
            runtime.spawn(deliver(farm.clone(), job, name, planes.clone(), options.level))
        })
        .collect();
    let mut looks = 0;
    let status = loop {
        let status = runtime.block_on(farm.status(job))?;
        if status.iterations_done * LOOKS >= u64::from(options.iterations) * (looks + 1) {
            looks = status.iterations_done * LOOKS / u64::from(options.iterations);
            if let Some(bytes) = coordinator.and_then(Coordinator::resident_memory) {
                println!(
                    "after {} iterations: {:.0} MB of memory",
                    status.iterations_done,
                    bytes as f64 * 1e-6
                );
            }
        }
        if status.state.ended() {
            break status;
        }
        std::thread::sleep(Duration::from_millis(200));
    };
    let seconds = begin.elapsed().as_secs_f64();
    let mut nodes = 0;
    for worker in workers {
        nodes += runtime.block_on(worker)??;
    }
    ensure!(status.iterations_done == u64::from(options.iterations), "{status:?}");
    let rate = f64::from(nodes) * image_mb / seconds;
    println!(
        "{} iterations in {nodes} nodes, {seconds:.0} s: {rate:.0} MB/s, merging included; {:.0} % of the plain copy",
        options.iterations,
        100.0 * rate / copied
    );
    Ok(())
}

/// A worker that delivers as fast as it can, until its job ends; the number of nodes.
async fn deliver(farm: Farm, job: JobId, name: String, planes: Planes, level: u32) -> Result<u32> {
    let worker = farm.register(name).await?.worker;
    let mut nodes = 0;
    while !farm.status(job).await?.state.ended() {
        if let Some(lease) = farm.lease(worker, SHORT_WAIT_MS).await? {
            for node in parts(lease.node, level) {
                farm.deliver(&Lease { node, ..lease }, &planes, SECONDS).await?;
                nodes += 1;
            }
        }
    }
    Ok(nodes)
}

/// A node, or its parts of a level below it, from left to right.
fn parts(node: NodeKey, level: u32) -> impl Iterator<Item = NodeKey> {
    let level = level.min(node.level);
    let below = node.level - level;
    let first = node.index << below;
    (first..first + (1 << below)).map(move |index| NodeKey { level, index })
}

/// Seconds to send [`COPIES`] images through loopback sockets, `threads` at once, to files that are synced to disk.
fn copy(image: &[u8], folder: &Path, threads: u32) -> Result<f64> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    let begin = Instant::now();
    std::thread::scope(|scope| -> Result<()> {
        for number in 0..threads {
            let sender = move || -> Result<()> {
                for _ in (number..COPIES).step_by(threads as usize) {
                    let mut stream = TcpStream::connect(address)?;
                    stream.write_all(image)?;
                    stream.shutdown(std::net::Shutdown::Write)?;
                    let mut done = [0];
                    stream.read_exact(&mut done).context("the receiver's answer")?;
                }
                Ok(())
            };
            scope.spawn(move || sender().expect("the sender's socket works"));
        }
        let receivers: Vec<_> = (0..COPIES)
            .map(|number| -> Result<_> {
                let (stream, _) = listener.accept()?;
                let path = folder.join(format!("copy-{number}"));
                Ok(scope.spawn(move || receive(stream, &path)))
            })
            .collect::<Result<_>>()?;
        receivers
            .into_iter()
            .try_for_each(|receiver| receiver.join().expect("no panic"))
    })?;
    Ok(begin.elapsed().as_secs_f64())
}

/// Writes what comes to a file, syncs it, answers, and removes the file.
fn receive(mut stream: TcpStream, path: &Path) -> Result<()> {
    let mut file = File::create(path)?;
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = stream.read(&mut buffer)?;
        if count == 0 {
            break;
        }
        file.write_all(&buffer[..count])?;
    }
    file.sync_all()?;
    stream.write_all(&[1])?;
    std::fs::remove_file(path)?;
    Ok(())
}
