//! The scheduler: a pure state machine, without I/O and without a clock.
//!
//! A decision looks at the state and returns [`Change`]s; the caller commits them to a store and only then applies
//! them with [`Farm::evolve`]. What is kept and what is remembered are therefore the same, whatever fails between.
//! A restart is [`Farm::restore`].

mod block;
mod job;
mod pace;
pub mod record;
#[cfg(test)]
mod tests;

pub use job::{Delivered, Delivery, HeldLease, Job};

use block::Block;
use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobSpec, JobState};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::worker::{LeaseProgress, Register};
use record::{Change, Counters, JobHead, LeaseRecord, Millis, Snapshot, Standing, WorkerRecord};
use std::collections::BTreeMap;
use thiserror::Error;

/// How the scheduler decides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SchedulerConfig {
    /// How long a lease should take [ms].
    pub lease_target_ms: Millis,
    /// How long a lease lasts without a heartbeat [ms].
    pub lease_ttl_ms: Millis,
    /// How long leases last after a restart without a heartbeat [ms].
    pub reconnect_ms: Millis,
    /// A lease is a straggler when it takes this many times as long as expected,
    pub straggler_factor: u64,
    /// and at least this long [ms].
    pub straggler_ms: Millis,
    /// Failures that a worker reported after which an iteration is given up.
    pub max_failures: usize,
    /// Attempts that failed in any way, lost workers included, after which an iteration is given up.
    pub max_attempts: usize,
    /// A worker silent for this long counts no more [ms].
    pub forget_worker_ms: Millis,
}

impl Default for SchedulerConfig {
    fn default() -> Self {
        Self {
            lease_target_ms: 30_000,
            lease_ttl_ms: 30_000,
            reconnect_ms: 60_000,
            straggler_factor: 2,
            straggler_ms: 5_000,
            max_failures: 3,
            max_attempts: 6,
            forget_worker_ms: 600_000,
        }
    }
}

impl SchedulerConfig {
    fn is_poisoned(&self, attempts: &[Attempt]) -> bool {
        let reported = attempts
            .iter()
            .filter(|attempt| attempt.kind != FailureKind::Lost)
            .count();
        reported >= self.max_failures || attempts.len() >= self.max_attempts
    }
}

/// Why something is refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// No such job among those that go on.
    #[error("there is no job {0}")]
    UnknownJob(JobId),
    /// A worker that is not registered.
    #[error("worker {0} is not registered")]
    UnknownWorker(WorkerId),
    /// The lease ended, or is somebody else's.
    #[error("lease {0} is not held any more")]
    StaleLease(LeaseToken),
    /// The job has ended.
    #[error("job {0} has ended")]
    JobEnded(JobId),
    /// Something that cannot be.
    #[error("{0}")]
    Invalid(String),
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

/// A registered worker.
#[derive(Clone, Debug)]
struct Worker {
    record: WorkerRecord,
    last_seen_ms: Millis,
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
        let leases_until = now + config.reconnect_ms;
        let worker = |record: WorkerRecord| {
            (
                record.id,
                Worker {
                    record,
                    last_seen_ms: now,
                },
            )
        };
        let job = |record| {
            let job = Job::from_record(record, leases_until);
            (job.id(), job)
        };
        Self {
            config,
            counters: snapshot.counters,
            workers: snapshot.workers.into_iter().map(worker).collect(),
            jobs: snapshot.jobs.into_iter().map(job).collect(),
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

    /// The workers heard of lately, oldest first.
    #[must_use]
    pub fn worker_statuses(&self, now: Millis) -> Vec<WorkerStatus> {
        let status = |worker: &Worker| WorkerStatus {
            id: worker.record.id,
            name: worker.record.name.clone(),
            threads: worker.record.threads,
            renderer: worker.record.renderer.clone(),
            tags: worker.record.tags.clone(),
            verified: worker.record.standing.verified,
            faults: worker.record.standing.faults,
            quarantine: worker.record.standing.quarantine.clone(),
            silent_ms: now.saturating_sub(worker.last_seen_ms),
            leases: self.leases_of(worker.record.id).count() as u32,
        };
        self.workers.values().map(status).collect()
    }

    fn leases_of(&self, worker: WorkerId) -> impl Iterator<Item = &LeaseRecord> {
        let records = self
            .jobs
            .values()
            .flat_map(|job| job.leases.values().map(|lease| &lease.record));
        records.filter(move |record| record.worker == worker)
    }

    /// A worker introduces itself.
    #[must_use]
    pub fn register(&self, register: Register) -> Decision<WorkerId> {
        let id = WorkerId(self.counters.worker + 1);
        let record = WorkerRecord {
            id,
            name: register.name,
            threads: register.threads,
            renderer: register.renderer,
            tags: register.tags,
            standing: Standing::default(),
        };
        Decision::new(id, vec![Change::WorkerRegistered(record)])
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

    /// Somebody cancels a job.
    pub fn cancel(&self, job: JobId, now: Millis) -> Result<Decision<()>, Refusal> {
        let job = self.live_job(job)?.id();
        let ended = Change::JobEnded {
            job,
            state: JobState::Cancelled,
            failure: None,
            ended_ms: now,
        };
        Ok(Decision::new((), vec![ended]))
    }

    /// A worker asks for work. Its leases that it does not name were granted in replies that never arrived: they end.
    pub fn lease(
        &self,
        worker: WorkerId,
        held: &[LeaseToken],
        now: Millis,
    ) -> Result<Decision<Option<LeaseRecord>>, Refusal> {
        if !self.workers.contains_key(&worker) {
            return Err(Refusal::UnknownWorker(worker));
        }
        let orphans = self.leases_of(worker).filter(|lease| !held.contains(&lease.token));
        let mut changes: Vec<Change> = orphans
            .map(|lease| Change::LeaseEnded {
                job: lease.job,
                token: lease.token,
            })
            .collect();
        let orphaned = !changes.is_empty();
        let granted = if orphaned { None } else { self.next_lease(worker, now) };
        changes.extend(granted.clone().map(Change::LeaseGranted));
        Ok(Decision::new(granted, changes))
    }

    fn next_lease(&self, worker: WorkerId, now: Millis) -> Option<LeaseRecord> {
        let workers = self.active_workers(now);
        let fresh = |job: &Job| Some((job.id(), job.next_block(worker, workers, &self.config)?));
        let again = |job: &Job| Some((job.id(), job.straggler(worker, now, &self.config)?));
        let (job, block) = self
            .jobs
            .values()
            .find_map(fresh)
            .or_else(|| self.jobs.values().find_map(again))?;
        let Block {
            node,
            expected_ms,
            attempt,
        } = block;
        let token = LeaseToken(self.counters.token + 1);
        Some(LeaseRecord {
            token,
            job,
            node,
            worker,
            attempt,
            granted_ms: now,
            expected_ms,
            verifies: false,
            share: [0; 2],
            until_ms: now + self.config.lease_ttl_ms,
            restarts: 0,
        })
    }

    fn active_workers(&self, now: Millis) -> u64 {
        let heard = |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) < self.config.lease_ttl_ms;
        self.workers.values().filter(heard).count() as u64
    }

    /// A worker delivers a node of a job that has not ended. For one that has, ask [`Job::deliver`].
    pub fn deliver(&self, delivery: &Delivery) -> Result<Decision<Delivered>, Refusal> {
        let (reply, changes) = self.live_job(delivery.job)?.deliver(delivery)?;
        Ok(Decision::new(reply, changes))
    }

    /// A worker could not render a leaf. A fault of the scene ends the job at once.
    pub fn fail(
        &self,
        job: JobId,
        token: LeaseToken,
        leaf: u32,
        attempt: Attempt,
        now: Millis,
    ) -> Result<Decision<()>, Refusal> {
        let live = self.live_job(job)?;
        let (kind, message) = (attempt.kind, attempt.message.clone());
        let mut changes = live.fail(token, leaf, attempt)?;
        if kind == FailureKind::Scene {
            let failure = Some(message);
            changes.push(Change::JobEnded {
                job,
                state: JobState::Failed,
                failure,
                ended_ms: now,
            });
        }
        Ok(Decision::new((), changes))
    }

    /// A worker gives a lease back. Giving back what is not held changes nothing.
    #[must_use]
    pub fn release(&self, job: JobId, token: LeaseToken, worker: WorkerId) -> Decision<()> {
        let held = self.jobs.get(&job).filter(|job| job.lease(token, worker).is_ok());
        Decision::new((), held.map(|job| job.end_lease(token)).into_iter().collect())
    }

    /// A worker ends: its leases go back, without blame.
    #[must_use]
    pub fn leave(&self, worker: WorkerId) -> Decision<()> {
        let ended = |lease: &LeaseRecord| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        };
        let mut changes: Vec<Change> = self.leases_of(worker).map(ended).collect();
        if self.workers.contains_key(&worker) {
            changes.push(Change::WorkerForgotten(worker));
        }
        Decision::new((), changes)
    }

    /// Ends leases that were not renewed in time, and forgets workers that were silent for long.
    #[must_use]
    pub fn expire(&self, now: Millis) -> Decision<()> {
        let mut changes: Vec<Change> = self.jobs.values().flat_map(|job| job.expire(now)).collect();
        let silent = |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) > self.config.forget_worker_ms;
        for worker in self.workers.values().filter(silent) {
            if self.leases_of(worker.record.id).next().is_none() {
                changes.push(Change::WorkerForgotten(worker.record.id));
            }
        }
        Decision::new((), changes)
    }

    /// The image of a parent is safe in the store: it replaces its children.
    #[must_use]
    pub fn merge(&self, job: JobId, parent: NodeKey, digest: BlobHash) -> Decision<bool> {
        let changes = self.jobs.get(&job).and_then(|job| job.merge(parent, digest));
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

    /// A sign of life: renews the leases named and returns those that are not held any more. Nothing of it is kept.
    pub fn heartbeat(
        &mut self,
        worker: WorkerId,
        leases: &[LeaseProgress],
        now: Millis,
    ) -> Result<Vec<LeaseToken>, Refusal> {
        self.seen(worker, now)?;
        let until = now + self.config.lease_ttl_ms;
        let mut lost = Vec::new();
        for progress in leases {
            let mut jobs = self.jobs.values_mut();
            match jobs.find(|job| job.lease(progress.token, worker).is_ok()) {
                Some(job) => {
                    if let Some(lease) = job.leases.get_mut(&progress.token) {
                        lease.expires_ms = lease.expires_ms.max(until);
                        lease.leaves_done = u64::from(progress.leaves_done).min(lease.record.node.leaves());
                    }
                    let rendered = job.rendered();
                    job.pace.sample(now, rendered);
                }
                None => lost.push(progress.token),
            }
        }
        Ok(lost)
    }

    /// A worker was heard of.
    pub fn seen(&mut self, worker: WorkerId, now: Millis) -> Result<(), Refusal> {
        let worker = self.workers.get_mut(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        worker.last_seen_ms = now;
        Ok(())
    }

    /// A delivery was counted: learns how fast its worker is. Nothing of it is kept.
    pub fn observe(&mut self, delivery: &Delivery, now: Millis) {
        if let Some(job) = self.jobs.get_mut(&delivery.job) {
            let seconds = delivery.totals.seconds.total();
            job.pace.observe(delivery.worker, seconds, delivery.node.leaves());
            let rendered = job.rendered();
            job.pace.sample(now, rendered);
        }
    }

    /// Applies a committed change. A job that ends leaves the farm: it lives on in the store.
    pub fn evolve(&mut self, change: &Change, now: Millis) {
        let lease_until = now + self.config.lease_ttl_ms;
        match change {
            Change::WorkerRegistered(record) => {
                self.counters.worker = self.counters.worker.max(record.id.0);
                self.workers.insert(
                    record.id,
                    Worker {
                        record: record.clone(),
                        last_seen_ms: now,
                    },
                );
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
                let job = Job::from_record((**record).clone(), lease_until);
                self.jobs.insert(job.id(), job);
            }
            Change::JobEnded { job, .. } => _ = self.jobs.remove(job),
            Change::LeasesRenewed(_) => {
                let jobs = self.jobs.values_mut();
                jobs.for_each(|job| job.evolve(change, lease_until));
            }
            Change::LeaseGranted(LeaseRecord { job, token, share, .. }) => {
                self.counters.share = self.counters.share.max(share[0]);
                self.counters.token = self.counters.token.max(token.0);
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
