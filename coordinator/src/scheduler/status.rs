//! How far a job has come, and why nobody is at work on it.

use super::block::Taker;
use super::record::{FailedAttempt, Millis, Principal, WorkerRecord};
use super::{Farm, Job, SchedulerConfig, Worker};
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::job::{JobStatus, Poisoned};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::waiting::Waiting;
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
            attempts: attempts.iter().map(|failed| failed.attempt.clone()).collect(),
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
            waiting_reason: None,
        }
    }
}

impl Farm {
    /// How far a job that has not ended has come.
    #[must_use]
    pub fn status(&self, job: &Job, now: Millis) -> JobStatus {
        let (waiting_reason, waiting) = self.waiting(job, now).unzip();
        JobStatus {
            waiting,
            waiting_reason,
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
    fn waiting(&self, job: &Job, now: Millis) -> Option<(Waiting, String)> {
        if !job.leases.is_empty() {
            return None;
        }
        let merging = || (Waiting::Merging, "its iterations are being added up".to_owned());
        if job.done() == job.leaves() && job.nodes_in_doubt().next().is_none() {
            return Some(merging());
        }
        if job.is_paused() {
            return Some((Waiting::Paused, "it is paused".into()));
        }
        let records = self.workers.values().filter(|worker| !self.is_silent(worker, now));
        let connected: Vec<&WorkerRecord> = records.map(|worker| &worker.record).collect();
        let reason = self.nobody_for(job, &connected).or_else(|| self.nothing_for(job, now));
        Some(reason.unwrap_or_else(merging))
    }

    /// Why none of the workers that could work on a job has work on it; nothing where there is none left.
    fn nothing_for(&self, job: &Job, now: Millis) -> Option<(Waiting, String)> {
        let workers: Vec<&Worker> = self.workers_for(job, now).collect();
        let all: Vec<Principal> = workers.iter().map(|worker| worker.principal).collect();
        let could = |worker: &&Worker| {
            let taker = Taker {
                worker: worker.record.id,
                principal: worker.principal,
                all: &all,
                now,
                config: &self.config,
            };
            job.next_doubt(&taker).or_else(|| job.next_block(&taker)).is_some()
        };
        // Workers differ only in what they failed at, and in what they have said already.
        let differ = !job.failures.is_empty() || job.nodes_in_doubt().next().is_some();
        if workers.iter().take(if differ { workers.len() } else { 1 }).any(could) {
            return Some((Waiting::Turn, "its turn has not come".into()));
        }
        let range = |node: NodeKey| format!("{} to {}", node.first() + 1, node.end());
        let known = |node: &NodeKey| all.iter().all(|principal| job.has_opinion(*node, *principal));
        if let Some(node) = job.nodes_in_doubt().filter(known).find(|node| job.is_disputed(*node)) {
            let detail = "and another worker is needed to decide";
            let detail = format!("workers disagree about iterations {}, {detail}", range(node));
            return Some((Waiting::Dispute, detail));
        }
        let covered = |leaf: u32| job.covering(NodeKey::leaf(leaf)).is_some();
        let open = |(leaf, attempts): &(&u32, &Vec<FailedAttempt>)| {
            u64::from(**leaf) < job.leaves() && !covered(**leaf) && !self.config.is_poisoned(attempts)
        };
        if let Some((leaf, attempts)) = job.failures.iter().find(open) {
            let times = attempts.len();
            let detail = format!(
                "iteration {} failed (attempts so far: {times}), and rests before it is tried again",
                leaf + 1
            );
            return Some((Waiting::Rest, detail));
        }
        let node = job.nodes_in_doubt().next()?;
        let detail = format!("iterations {} wait for another worker to confirm them", range(node));
        Some((Waiting::Doubt, detail))
    }

    /// Which of the job's demands no connected worker meets.
    fn nobody_for(&self, job: &Job, connected: &[&WorkerRecord]) -> Option<(Waiting, String)> {
        if connected.is_empty() {
            return Some((Waiting::NoWorker, "no worker is connected".into()));
        }
        let (tags, bound) = (&job.control.schedule.tags, &job.control.renderer);
        let tagged: Vec<_> = connected.iter().filter(|worker| tags.is_subset(&worker.tags)).collect();
        if tagged.is_empty() {
            let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
            return Some((Waiting::Tags, format!("no worker has the tags {}", tags.join(", "))));
        }
        let same = |worker: &&&&WorkerRecord| bound.as_ref().is_none_or(|bound| *bound == worker.renderer);
        let built: Vec<_> = tagged.iter().filter(same).collect();
        if built.is_empty() {
            let bound = bound.as_deref().unwrap_or_default();
            let found = &tagged[0].renderer;
            let detail = format!(
                "it is bound to renderer {bound}, and workers have others, such as {found}: start workers of that build, or have \
                 it rendered anew with `photonfarm resubmit {}`",
                job.id()
            );
            return Some((Waiting::Renderer, detail));
        }
        let held = built.iter().all(|worker| worker.standing.quarantine.is_some());
        held.then(|| {
            (
                Waiting::Quarantine,
                "every worker that could do it is in quarantine".into(),
            )
        })
    }
}
