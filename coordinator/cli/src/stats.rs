//! What a render took, as JSON.

use photonfarm_core::integrator::Counts;
use photonfarm_proto::job::{BandwidthRange, JobStatus, PhaseSeconds};
use serde::Serialize;

/// The content of `--stats FILE`.
#[derive(Debug, Serialize)]
pub(crate) struct Stats {
    /// Iterations in the picture.
    iterations: u64,
    /// Pixels across and down.
    resolution: Option<[u32; 2]>,
    /// Threads that rendered.
    threads: usize,
    /// From reading the scene to the finished picture \[s\].
    wall_seconds: f64,
    /// Reading and building the scene \[s\], part of the wall time.
    load_seconds: f64,
    /// Wall time by phase of the iterations, summed over iterations \[s\].
    seconds: PhaseSeconds,
    /// Light paths, records, rays.
    #[serde(flatten)]
    counts: Counts,
    /// Largest and smallest bandwidth; absent for `path`.
    bandwidth: Option<BandwidthRange>,
    /// Most memory that the process held at a time [bytes], where the system tells.
    peak_memory_bytes: Option<u64>,
}

impl Stats {
    pub(crate) fn new(status: &JobStatus, threads: usize, wall_seconds: f64, load_seconds: f64) -> Self {
        Self {
            iterations: status.iterations_done,
            resolution: status.resolution,
            threads,
            wall_seconds,
            load_seconds,
            seconds: status.totals.seconds,
            counts: status.totals.counts,
            bandwidth: status.totals.bandwidth,
            peak_memory_bytes: peak_memory(),
        }
    }

    pub(crate) fn to_json(&self) -> anyhow::Result<Vec<u8>> {
        let mut json = serde_json::to_vec_pretty(self)?;
        json.push(b'\n');
        Ok(json)
    }
}

/// The high-water mark of resident memory, `VmHWM` of proc(5).
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn peak_memory_is_plausible() {
        let bytes = super::peak_memory().unwrap();
        assert!((1 << 20..1 << 40).contains(&bytes), "{bytes}");
    }
}
