//! How fast a job goes: kept in memory only, learned anew after a restart.

use super::record::Millis;
use photonfarm_proto::id::WorkerId;
use std::collections::{BTreeMap, VecDeque};

/// Weight of the newest observation in a worker's speed.
const NEWEST: f64 = 0.5;
/// Length of the window for the job's rate.
const WINDOW_MS: Millis = 30_000;
/// Least time between two samples of the rate.
const SAMPLE_MS: Millis = 1_000;

/// Speeds seen lately.
#[derive(Clone, Debug, Default)]
pub(super) struct Pace {
    seconds_per_iteration: BTreeMap<WorkerId, f64>,
    /// Seconds and iterations of all that was rendered, for workers that are new to the job.
    all: (f64, u64),
    samples: VecDeque<(Millis, u64)>,
}

impl Pace {
    /// `iterations` were rendered before, in `seconds`.
    pub(super) fn begin_with(&mut self, seconds: f64, iterations: u64) {
        self.all = (seconds, iterations);
    }

    /// A worker took `seconds` for `iterations`, as it says within what the coordinator saw.
    pub(super) fn observe(&mut self, worker: WorkerId, seconds: f64, iterations: u64) {
        let newest = (seconds / iterations as f64).max(1e-4);
        self.seconds_per_iteration
            .entry(worker)
            .and_modify(|known| *known += NEWEST * (newest - *known))
            .or_insert(newest);
        self.all = (self.all.0 + seconds, self.all.1 + iterations);
    }

    /// Seconds that `worker` takes for an iteration of this job, or that its workers took on average.
    pub(super) fn seconds_per_iteration(&self, worker: WorkerId) -> Option<f64> {
        let (seconds, iterations) = self.all;
        let mean = (seconds > 0.0 && iterations > 0).then(|| seconds / iterations as f64);
        self.seconds_per_iteration.get(&worker).copied().or(mean)
    }

    /// Whether enough time has passed since the last sample of the rate.
    pub(super) fn is_due(&self, now: Millis) -> bool {
        self.samples.back().is_none_or(|(last, _)| now >= last + SAMPLE_MS)
    }

    /// `rendered` leaves are rendered by now.
    pub(super) fn sample(&mut self, now: Millis, rendered: u64) {
        self.samples.push_back((now, rendered));
        while self.samples.front().is_some_and(|(first, _)| first + WINDOW_MS < now) {
            self.samples.pop_front();
        }
    }

    /// Iterations per second of wall-clock time over the last half minute.
    pub(super) fn iterations_per_second(&self) -> Option<f64> {
        let ((start, before), (end, after)) = (self.samples.front()?, self.samples.back()?);
        let seconds = end.checked_sub(*start).filter(|ms| *ms > 0)? as f64 / 1e3;
        Some(after.saturating_sub(*before) as f64 / seconds)
    }
}
