//! How far a job has come, and why nobody is at work on it.

use super::record::{Millis, WorkerRecord};
use super::{Farm, Job, SchedulerConfig};
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::job::{JobStatus, Poisoned};
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeMap;

impl Job {
    /// Leaves rendered, delivered or not.
    #[must_use]
    pub fn rendered(&self) -> u64 {
        let mut undelivered: BTreeMap<NodeKey, u64> = BTreeMap::new();
        for lease in self.leases.values() {
            let left = lease.record.node.leaves() - self.covered_within(lease.record.node);
            let entry = undelivered.entry(lease.record.node).or_default();
            *entry = (*entry).max(lease.leaves_done.min(left));
        }
        self.done() + undelivered.values().sum::<u64>()
    }

    /// How far the job has come.
    #[must_use]
    pub fn status(&self, config: &SchedulerConfig) -> JobStatus {
        let poisoned = self.poisoned(config).map(|(leaf, attempts)| Poisoned {
            iteration: leaf + 1,
            attempts: attempts.to_vec(),
        });
        let mut workers: Vec<WorkerId> = self.leases.values().map(|lease| lease.record.worker).collect();
        workers.sort_unstable();
        workers.dedup();
        JobStatus {
            id: self.id(),
            state: self.state,
            spec: self.spec(),
            integrator: self.integrator().cloned(),
            owner: self.head.owner.clone(),
            created_ms: self.head.created_ms,
            ended_ms: self.ended_ms,
            iterations_done: self.done(),
            iterations_rendered: self.rendered(),
            poisoned: poisoned.collect(),
            failure: self.failure.clone(),
            resolution: self.resolution(),
            totals: self.totals(),
            iterations_per_second: self.pace.iterations_per_second(),
            workers: workers.len() as u32,
            iterations_in_doubt: self.nodes_in_doubt().map(NodeKey::leaves).sum(),
            renderer: self.control.renderer.clone(),
            checkpoint: self.control.checkpoint,
            stop: self.control.stop,
            waiting: None,
        }
    }
}

impl Farm {
    /// How far a job that has not ended has come.
    #[must_use]
    pub fn status(&self, job: &Job, now: Millis) -> JobStatus {
        JobStatus {
            waiting: self.waiting(job, now),
            ..job.status(&self.config)
        }
    }

    /// A worker by number and, where it is known, by name.
    #[must_use]
    pub fn worker_named(&self, id: WorkerId) -> String {
        match self.workers.get(&id) {
            Some(worker) => format!("worker {id} ({})", worker.record.name),
            None => format!("worker {id}"),
        }
    }

    /// Why nobody is at work on a job, while nobody is.
    fn waiting(&self, job: &Job, now: Millis) -> Option<String> {
        if !job.leases.is_empty() || job.done() == job.leaves() && job.nodes_in_doubt().next().is_none() {
            return None;
        }
        if job.is_paused() {
            return Some("it is paused".into());
        }
        let records = self.workers.values().filter(|worker| !self.is_silent(worker, now));
        let connected: Vec<&WorkerRecord> = records.map(|worker| &worker.record).collect();
        self.nobody_for(job, &connected).or_else(|| {
            let disputed = job.nodes_in_doubt().find(|node| job.is_disputed(*node));
            let workers: Vec<WorkerId> = self.workers_for(job, now).collect();
            match disputed {
                Some(node) if workers.iter().all(|worker| job.has_opinion(node, *worker)) => Some(format!(
                    "workers disagree about iterations {} to {}, and another worker is needed to decide",
                    node.first() + 1,
                    node.end()
                )),
                _ => Some("its turn has not come, or an iteration that failed is tried again soon".into()),
            }
        })
    }

    /// Which of the job's demands no connected worker meets.
    fn nobody_for(&self, job: &Job, connected: &[&WorkerRecord]) -> Option<String> {
        if connected.is_empty() {
            return Some("no worker is connected".into());
        }
        let (tags, bound) = (&job.control.schedule.tags, &job.control.renderer);
        let tagged: Vec<_> = connected.iter().filter(|worker| tags.is_subset(&worker.tags)).collect();
        if tagged.is_empty() {
            let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
            return Some(format!("no worker has the tags {}", tags.join(", ")));
        }
        let same = |worker: &&&&WorkerRecord| bound.as_ref().is_none_or(|bound| *bound == worker.renderer);
        let built: Vec<_> = tagged.iter().filter(same).collect();
        if built.is_empty() {
            let bound = bound.as_deref().unwrap_or_default();
            let found = &tagged[0].renderer;
            return Some(format!(
                "it is bound to renderer {bound}, and workers have others, such as {found}: start workers of that build, or have \
                 it rendered anew with `photonfarm resubmit {}`",
                job.id()
            ));
        }
        let held = built.iter().all(|worker| worker.standing.quarantine.is_some());
        held.then(|| "every worker that could do it is in quarantine".into())
    }
}
