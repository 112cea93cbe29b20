//! The scheduler: a pure state machine, without I/O and without a clock.
//!
//! A decision looks at the state and returns [`Change`]s; the caller commits them to a store and only then applies
//! them with [`Farm::evolve`]. What is kept and what is remembered are therefore the same, whatever fails between.
//! A restart is [`Farm::restore`].
//!
//! What an event costs grows with the logarithm of the numbers of jobs, leases and nodes: [`Farm::evolve`] keeps
//! indexes up to date ([`index`], [`held`], [`roster`], [`nodes`]), and decisions look there instead of searching.

mod after;
mod alive;
mod block;
mod chain;
mod change;
mod config;
mod deliver;
mod demand;
mod failure;
mod figures;
mod finish;
mod grant;
mod held;
mod index;
mod job;
mod keep;
mod lent;
mod nodes;
mod pace;
mod ranges;
pub mod record;
mod resolve;
mod roster;
mod share;
mod status;
mod steer;
mod stop;
mod table;
#[cfg(test)]
mod tests;
mod verify;
mod workers;

pub use config::{NonceKey, SchedulerConfig};
pub use deliver::{Delivered, Delivery};
pub use figures::Figures;
pub use grant::Asked;
pub use job::{HeldLease, Job};
pub use roster::Skill;

use held::Held;
use index::JobIndex;
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::node::NodeKey;
use record::{BlobName, Change, Counters, JobControl, JobHead, Millis, Snapshot};
use roster::{Roster, Worker};
use std::collections::BTreeSet;
use table::Table;
use thiserror::Error;

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
    workers: Roster,
    jobs: Table<JobId, Job>,
    index: JobIndex,
    held: Held,
}

impl Farm {
    /// The farm as it was left. Leases last long enough for workers to reconnect.
    #[must_use]
    pub fn restore(config: SchedulerConfig, snapshot: Snapshot, now: Millis) -> Self {
        let mut farm = Self {
            counters: snapshot.counters,
            workers: Roster::default(),
            jobs: Table::default(),
            index: JobIndex::default(),
            held: Held::default(),
            config,
        };
        farm.index.serve(farm.counters.share);
        for worker in snapshot.workers {
            farm.workers.register(worker, now);
        }
        for record in snapshot.jobs {
            let mut job = Job::from_record(record, &farm.config);
            job.reconnect(&farm.config, now);
            farm.insert(job);
        }
        farm
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

    /// Somebody submits a job; bundle and limits have been checked. The job that it comes after goes on, or is done.
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
        let done = head.spec.after.is_some_and(|first| self.job(first).is_none());
        let begins = done.then(|| Change::JobChanged {
            job: id,
            control: JobControl {
                after: None,
                ..JobControl::of(&head.spec)
            },
        });
        let changes = [Change::JobSubmitted(head.into())].into_iter().chain(begins);
        Decision::new(id, changes.collect())
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
        let mut stopped = BTreeSet::new();
        for ((_, id), ()) in self.index.deadlines.range(..=(now, JobId(u64::MAX))) {
            let met = self.jobs[id].meet_deadline(now);
            if !met.is_empty() {
                stopped.insert(*id);
            }
            changes.extend(met);
        }
        for id in self.index.leased.keys().filter(|id| !stopped.contains(id)) {
            changes.extend(self.expire_leases(&self.jobs[id], now));
        }
        for id in self.index.in_doubt.keys().filter(|id| !stopped.contains(id)) {
            changes.extend(self.accept_lonely(&self.jobs[id]));
        }
        let silent = |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) > self.config.forget_worker_ms;
        for worker in self.workers.values().filter(silent) {
            if !worker.is_held() && !self.holds_leases(worker.id()) {
                changes.push(Change::WorkerForgotten(worker.id()));
            }
        }
        Decision::new((), changes)
    }

    /// Time has passed: workers that were silent for as long as leases last are heard of no more, and it is noted how
    /// fast jobs go. Nothing of it is kept.
    pub fn pass_time(&mut self, now: Millis) {
        if let Some(since) = now.checked_sub(self.config.lease_ttl_ms) {
            self.workers.miss(since);
        }
        for id in self.index.leased.keys() {
            if let Some(job) = self.jobs.get_mut(id) {
                job.note_pace(now);
            }
        }
    }

    /// Jobs of which images are to be added up or read, or that may be complete.
    #[must_use]
    pub fn jobs_to_fold(&self) -> Vec<JobId> {
        self.index.to_fold.keys().copied().collect()
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
        let ended = self.jobs.get(&job).and_then(|job| job.settle(now));
        Decision::new((), ended.into_iter().collect())
    }

    /// Applies a committed change. A job that ends leaves the farm: it lives on in the store.
    pub fn evolve(&mut self, change: &Change, now: Millis) {
        match change {
            Change::WorkerRegistered(record) => {
                self.counters.worker = self.counters.worker.max(record.id.0);
                self.workers.register(record.clone(), now);
            }
            Change::WorkerJudged { worker, standing } => self.workers.judge(*worker, standing),
            Change::WorkerForgotten(worker) => self.workers.forget(*worker),
            Change::JobSubmitted(head) => {
                self.counters.job = self.counters.job.max(head.id.0);
                self.insert(Job::new((**head).clone()));
            }
            Change::JobReopened { record, .. } => self.insert(Job::from_record((**record).clone(), &self.config)),
            Change::JobEnded { job, .. } => self.remove(*job),
            Change::LeasesRenewed(renewals) => {
                for renewal in renewals {
                    if let Some(job) = self.jobs.get_mut(&renewal.job) {
                        job.renew(renewal);
                    }
                }
            }
            // It had left the farm when it ended.
            Change::JobDeleted { .. } => {}
            // The store keeps it.
            Change::NoticeAdded(_) => {}
            Change::LeaseGranted(lease) => {
                self.evolve_job(lease.job, change, now);
                self.counters.share = self.counters.share.max(lease.share[0]);
                self.counters.token = self.counters.token.max(lease.token.number);
                self.index.serve(self.counters.share);
                self.held.insert(lease, &self.config);
            }
            Change::LeaseEnded { job, token } => {
                if let Some(lease) = self.jobs.get(job).and_then(|job| job.leases.get(token)) {
                    self.held.remove(&lease.record, &self.config);
                }
                self.evolve_job(*job, change, now);
            }
            Change::JobChanged { job, .. }
            | Change::NodeAdded { job, .. }
            | Change::NodeJudged { job, .. }
            | Change::NodeMerged { job, .. }
            | Change::NodeLost { job, .. }
            | Change::LeafFailed { job, .. }
            | Change::FailuresForgotten { job } => self.evolve_job(*job, change, now),
        }
    }

    fn evolve_job(&mut self, id: JobId, change: &Change, now: Millis) {
        if let Some(job) = self.jobs.get_mut(&id) {
            let before = job.facts();
            if let Change::JobChanged { control, .. } = change {
                job.reweigh(control, self.counters.share);
            }
            job.evolve(change, now + self.config.lease_ttl_ms, &self.config);
            self.index.update(id, &before, &job.facts());
        }
    }

    fn insert(&mut self, job: Job) {
        self.remove(job.id());
        let leases = job.leases.values();
        leases.for_each(|lease| self.held.insert(&lease.record, &self.config));
        self.index.insert(job.id(), &job.facts());
        self.jobs.insert(job.id(), job);
    }

    fn remove(&mut self, id: JobId) {
        if let Some(job) = self.jobs.remove(&id) {
            let leases = job.leases.values();
            leases.for_each(|lease| self.held.remove(&lease.record, &self.config));
            self.index.remove(id, &job.facts());
        }
    }
}
