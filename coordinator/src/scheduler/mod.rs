//! The scheduler: a pure state machine, without I/O and without a clock.
//!
//! A decision looks at the state and returns [`Change`]s; the caller commits them to a store and only then applies
//! them with [`Farm::evolve`]. What is kept and what is remembered are therefore the same, whatever fails between.
//! A restart is [`Farm::restore`].

mod alive;
mod block;
mod chain;
mod config;
mod deliver;
mod failure;
mod finish;
mod grant;
mod job;
mod pace;
pub mod record;
mod resolve;
mod share;
mod status;
mod steer;
mod stop;
#[cfg(test)]
mod tests;
mod verify;
mod workers;

pub use config::{SchedulerConfig, Secret};
pub use deliver::{Delivered, Delivery};
pub use grant::Asked;
pub use job::{HeldLease, Job};

use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::node::NodeKey;
use record::{BlobName, Change, Counters, JobHead, LeaseRecord, Millis, Snapshot, WorkerRecord};
use std::collections::BTreeMap;
use thiserror::Error;
use workers::Worker;

/// Why something is refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// No such job among those that go on.
    #[error("there is no job {0}")]
    UnknownJob(JobId),
    /// A worker that is not registered.
    #[error("worker {0} is not registered")]
    UnknownWorker(WorkerId),
    /// A worker that was registered with another token.
    #[error("worker {0} was registered with another token")]
    ForeignWorker(WorkerId),
    /// One worker too many of a token.
    #[error(
        "{registered} workers are registered with this token, and no more than {most} may be: stop some, or wait until those that are gone are forgotten"
    )]
    TooManyWorkers {
        /// Workers registered with the token.
        registered: usize,
        /// Most of them.
        most: usize,
    },
    /// The lease has expired, was revoked, or is somebody else's.
    #[error("lease {0} has expired or was revoked")]
    StaleLease(LeaseToken),
    /// The job has ended.
    #[error("job {0} has ended")]
    JobEnded(JobId),
    /// The job goes on.
    #[error("job {0} goes on: cancel it first")]
    JobGoesOn(JobId),
    /// Something that cannot be.
    #[error("{0}")]
    Invalid(String),
    /// Workers say different things of the settings that a scene decides. Nobody knows yet who is right.
    #[error("workers disagree about the settings that the scene of job {0} decides")]
    Disagreement(JobId),
    /// Two results for one node: one of the workers is broken, or renders with another program.
    #[error("job {job}: node {node} was counted with digest {counted}, not {offered}")]
    Conflict {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
        /// Digest that counts.
        counted: BlobHash,
        /// Digest that was offered.
        offered: BlobHash,
    },
}

/// What was decided, and what it changes.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision<T> {
    /// The answer.
    pub reply: T,
    /// The changes, to be committed before the answer is given.
    pub changes: Vec<Change>,
}

impl<T> Decision<T> {
    fn new(reply: T, changes: Vec<Change>) -> Self {
        Self { reply, changes }
    }
}

/// The state of the farm: workers, and the jobs that have not ended.
#[derive(Clone, Debug)]
pub struct Farm {
    config: SchedulerConfig,
    counters: Counters,
    workers: BTreeMap<WorkerId, Worker>,
    jobs: BTreeMap<JobId, Job>,
}

impl Farm {
    /// The farm as it was left. Leases last long enough for workers to reconnect.
    #[must_use]
    pub fn restore(config: SchedulerConfig, snapshot: Snapshot, now: Millis) -> Self {
        let worker = |record: WorkerRecord| (record.id, Worker::new(record, now));
        let job = |record| {
            let mut job = Job::from_record(record);
            for lease in job.leases.values_mut() {
                lease.expires_ms = lease.after_restart(&config, now);
            }
            (job.id(), job)
        };
        Self {
            counters: snapshot.counters,
            workers: snapshot.workers.into_iter().map(worker).collect(),
            jobs: snapshot.jobs.into_iter().map(job).collect(),
            config,
        }
    }

    /// How it decides.
    #[must_use]
    pub fn config(&self) -> &SchedulerConfig {
        &self.config
    }

    /// A job that has not ended.
    #[must_use]
    pub fn job(&self, id: JobId) -> Option<&Job> {
        self.jobs.get(&id)
    }

    /// Jobs that have not ended, oldest first.
    pub fn jobs(&self) -> impl Iterator<Item = &Job> {
        self.jobs.values()
    }

    fn live_job(&self, id: JobId) -> Result<&Job, Refusal> {
        self.jobs.get(&id).ok_or(Refusal::UnknownJob(id))
    }

    /// Somebody submits a job; bundle and limits have been checked.
    #[must_use]
    pub fn submit(&self, spec: JobSpec, owner: String, key: Option<String>, now: Millis) -> Decision<JobId> {
        let id = JobId(self.counters.job + 1);
        let head = JobHead {
            id,
            spec,
            owner,
            key,
            created_ms: now,
        };
        Decision::new(id, vec![Change::JobSubmitted(head)])
    }

    /// A worker gives a lease back. Giving back what is not held changes nothing.
    #[must_use]
    pub fn release(&self, job: JobId, token: LeaseToken, worker: WorkerId) -> Decision<()> {
        let held = self.jobs.get(&job).filter(|job| job.lease(token, worker).is_ok());
        Decision::new((), held.map(|job| job.end_lease(token)).into_iter().collect())
    }

    /// What the clock makes happen: leases end that were not renewed in time, deadlines pass, and workers that were
    /// silent for long are forgotten.
    #[must_use]
    pub fn expire(&self, now: Millis) -> Decision<()> {
        let mut changes = Vec::new();
        for job in self.jobs.values() {
            let stopped = job.meet_deadline(now);
            if stopped.is_empty() {
                changes.extend(self.expire_leases(job, now));
                changes.extend(self.waive(job, now));
            }
            changes.extend(stopped);
        }
        let silent = |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) > self.config.forget_worker_ms;
        for worker in self.workers.values().filter(silent) {
            if !worker.is_held() && !self.holds_leases(worker) {
                changes.push(Change::WorkerForgotten(worker.record.id));
            }
        }
        Decision::new((), changes)
    }

    /// The image of a node that others make up is safe in the store: it replaces them.
    #[must_use]
    pub fn merge(&self, job: JobId, node: NodeKey, image: impl Into<BlobName>) -> Decision<bool> {
        let image = image.into();
        let changes = self.jobs.get(&job).and_then(|job| job.merge(node, image));
        Decision::new(changes.is_some(), changes.unwrap_or_default())
    }

    /// The image of a node is missing or damaged: its leaves go back to the pool. Replies whether it counted.
    #[must_use]
    pub fn lose(&self, job: JobId, node: NodeKey, reason: &str, now: Millis) -> Decision<bool> {
        let lost = self
            .jobs
            .get(&job)
            .map(|job| job.lose(node, reason, now))
            .unwrap_or_default();
        Decision::new(!lost.is_empty(), lost)
    }

    /// The image of a node was read, and is what it should be.
    #[must_use]
    pub fn check(&self, job: JobId, node: NodeKey) -> Decision<()> {
        let checked = self.jobs.get(&job).and_then(|job| job.check(node));
        Decision::new((), checked.into_iter().collect())
    }

    /// Ends a job that is complete.
    #[must_use]
    pub fn settle(&self, job: JobId, now: Millis) -> Decision<()> {
        let ended = self.jobs.get(&job).and_then(|job| job.settle(&self.config, now));
        Decision::new((), ended.into_iter().collect())
    }

    /// Applies a committed change. A job that ends leaves the farm: it lives on in the store.
    pub fn evolve(&mut self, change: &Change, now: Millis) {
        let lease_until = now + self.config.lease_ttl_ms;
        match change {
            Change::WorkerRegistered(record) => {
                self.counters.worker = self.counters.worker.max(record.id.0);
                self.workers.insert(record.id, Worker::new(record.clone(), now));
            }
            Change::WorkerJudged { worker, standing } => {
                if let Some(worker) = self.workers.get_mut(worker) {
                    worker.record.standing = standing.clone();
                }
            }
            Change::WorkerForgotten(worker) => _ = self.workers.remove(worker),
            Change::JobSubmitted(head) => {
                self.counters.job = self.counters.job.max(head.id.0);
                self.jobs.insert(head.id, Job::new(head.clone()));
            }
            Change::JobReopened { record, .. } => {
                let job = Job::from_record((**record).clone());
                self.jobs.insert(job.id(), job);
            }
            Change::JobEnded { job, .. } => _ = self.jobs.remove(job),
            // It had left the farm when it ended.
            Change::JobDeleted { .. } => {}
            Change::LeasesRenewed(_) => {
                let jobs = self.jobs.values_mut();
                jobs.for_each(|job| job.evolve(change, lease_until));
            }
            Change::LeaseGranted(LeaseRecord { job, token, share, .. }) => {
                self.counters.share = self.counters.share.max(share[0]);
                self.counters.token = self.counters.token.max(token.number);
                self.evolve_job(*job, change, lease_until);
            }
            Change::LeaseEnded { job, .. }
            | Change::JobChanged { job, .. }
            | Change::NodeAdded { job, .. }
            | Change::NodeJudged { job, .. }
            | Change::NodeMerged { job, .. }
            | Change::NodeLost { job, .. }
            | Change::LeafFailed { job, .. } => self.evolve_job(*job, change, lease_until),
        }
    }

    fn evolve_job(&mut self, job: JobId, change: &Change, lease_until: Millis) {
        if let Some(job) = self.jobs.get_mut(&job) {
            job.evolve(change, lease_until);
        }
    }
}
