//! The farm in figures, without a look at each of its jobs.

use super::record::Millis;
use super::{Farm, Job};
use photonfarm_proto::waiting::Waiting;
use std::collections::BTreeMap;

/// The jobs that have not ended, in figures.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Figures {
    /// Jobs.
    pub jobs: u64,
    /// Jobs of which nothing was lent yet.
    pub queued: u64,
    /// Iterations of jobs that are not paused and that nobody has rendered yet.
    pub pending_iterations: u64,
    /// Leases of the usual length that these make.
    pub pending_leases: u64,
    /// Most memory that one of the jobs at work was measured to take \[MiB\].
    pub memory_mb: u32,
    /// Jobs that nobody is at work on, by the reason.
    pub waiting: BTreeMap<Waiting, u64>,
}

impl Figures {
    /// One job waits for another reason than the one that it was counted under.
    pub fn recount(&mut self, before: Option<Waiting>, after: Option<Waiting>) {
        if let Some(before) = before
            && let Some(jobs) = self.waiting.get_mut(&before)
        {
            *jobs -= 1;
            self.waiting.retain(|_, jobs| *jobs > 0);
        }
        if let Some(after) = after {
            *self.waiting.entry(after).or_default() += 1;
        }
    }
}

impl Farm {
    /// The jobs that have not ended, in figures.
    #[must_use]
    pub fn figures(&self, now: Millis) -> Figures {
        let index = &self.index;
        let mut figures = Figures {
            jobs: self.jobs.len() as u64,
            queued: index.queued,
            pending_iterations: index.left,
            pending_leases: index.leases_left,
            memory_mb: 0,
            waiting: BTreeMap::new(),
        };
        let at_work = index.leased.keys().map(|id| &self.jobs[id]);
        for job in at_work.filter(|job| !job.is_paused()) {
            figures.memory_mb = figures.memory_mb.max(job.control.memory_mb.unwrap_or(0));
            let rendered = job.rendered() - job.done();
            figures.pending_iterations -= rendered;
            figures.pending_leases += self.pending_leases(job, job.leaves() - job.done() - rendered);
        }
        let mut add = |reason: Waiting, jobs: u64| {
            if jobs > 0 {
                *figures.waiting.entry(reason).or_default() += jobs;
            }
        };
        add(Waiting::Merging, index.merging);
        add(Waiting::Paused, index.paused);
        for (demand, jobs) in index.waiting.iter() {
            add(self.lack(demand).unwrap_or(Waiting::Turn), *jobs);
        }
        for id in index.waiting_otherwise.keys() {
            if let Some((reason, _)) = self.waiting(&self.jobs[id], now) {
                add(reason, 1);
            }
        }
        figures
    }

    /// The leases that the iterations left of a job make. One is as many iterations as a worker renders in the time of
    /// a lease; one iteration, until a speed is known. A chain is worked on by one worker at a time.
    fn pending_leases(&self, job: &Job, left: u64) -> u64 {
        let speed = job.pace.iterations_per_second().unwrap_or(0.0) / job.workers().max(1) as f64;
        let target_s = self.config.lease_target_ms as f64 / 1e3;
        let leases = (left as f64 / (speed * target_s).max(1.0)).ceil() as u64;
        match job.is_chain() {
            true => leases.min(1),
            false => leases,
        }
    }
}
