//! The scheduler: a pure state machine, without I/O and without a clock.
//!
//! A decision looks at the state and returns [`Change`]s; the caller commits them to a store and only then applies
//! them with [`Farm::evolve`]. What is kept and what is remembered are therefore the same, whatever fails between.
//! A restart is [`Farm::restore`].

mod alive;
mod block;
mod chain;
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

pub use deliver::{Delivered, Delivery};
pub use job::{HeldLease, Job};

use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, FailureKind, JobSpec, JobState};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::worker::Register;
use record::{BlobName, Change, Counters, JobHead, LeaseRecord, Millis, Snapshot, WorkerRecord};
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
    /// Pause after the first failure of an iteration; it doubles with each further one [ms].
    pub retry_ms: Millis,
    /// The longest such pause [ms].
    pub longest_retry_ms: Millis,
    /// Nodes in a row that others must confirm before a worker's are repeated more rarely than always; afterwards they
    /// are with the probability of this number over that of the nodes confirmed. 0: nodes are never repeated.
    pub verify_until: u32,
    /// What the choice of nodes to repeat depends on, unknown to workers.
    pub verify_secret: u64,
    /// Faults in a row that put a worker into quarantine.
    pub max_faults: u32,
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
            retry_ms: 1_000,
            longest_retry_ms: 60_000,
            verify_until: 0,
            verify_secret: 0,
            max_faults: 3,
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

impl Worker {
    /// Whether it is in quarantine.
    fn is_held(&self) -> bool {
        self.record.standing.quarantine.is_some()
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

    /// A worker introduces itself. One that has the name of another in quarantine is there, too.
    #[must_use]
    pub fn register(&self, register: Register, now: Millis) -> Decision<WorkerId> {
        let id = WorkerId(self.counters.worker + 1);
        let namesakes = self.workers.values().filter(|other| other.record.name == register.name);
        let held: Vec<&Worker> = namesakes.filter(|other| other.is_held()).collect();
        let standing = held.first().map(|other| other.record.standing.clone());
        let gone = held
            .iter()
            .filter(|other| self.is_silent(other, now) && !self.holds_leases(other));
        let mut changes: Vec<Change> = gone.map(|other| Change::WorkerForgotten(other.record.id)).collect();
        changes.push(Change::WorkerRegistered(WorkerRecord {
            id,
            name: register.name,
            threads: register.threads,
            renderer: register.renderer,
            tags: register.tags,
            standing: standing.unwrap_or_default(),
        }));
        Decision::new(id, changes)
    }

    fn is_silent(&self, worker: &Worker, now: Millis) -> bool {
        now.saturating_sub(worker.last_seen_ms) >= self.config.lease_ttl_ms
    }

    fn holds_leases(&self, worker: &Worker) -> bool {
        self.leases_of(worker.record.id).next().is_some()
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

    /// A worker could not render a leaf. A fault of the scene ends the job once two workers have found one, or the only one
    /// that is there.
    pub fn fail(
        &self,
        job: JobId,
        token: LeaseToken,
        leaf: u32,
        attempt: Attempt,
        now: Millis,
    ) -> Result<Decision<()>, Refusal> {
        let live = self.live_job(job)?;
        if let Ok(lease) = live.lease(token, attempt.worker)
            && lease.record.verifies
        {
            return Ok(Decision::new((), self.hear_failure(live, &lease.record, now)));
        }
        let Attempt {
            worker, kind, message, ..
        } = attempt.clone();
        let mut changes = live.fail(token, leaf, attempt)?;
        let others = || self.workers.keys().filter(|other| **other != worker);
        let agrees = |other: &WorkerId| live.was_found_broken_by(*other) && !self.workers[other].is_held();
        let alone = || self.workers_for(live, now).all(|other| other == worker);
        if kind == FailureKind::Scene && (others().any(agrees) || alone()) {
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
        if self.workers.get(&worker).is_some_and(|worker| !worker.is_held()) {
            changes.push(Change::WorkerForgotten(worker));
        }
        Decision::new((), changes)
    }

    /// What the clock makes happen: leases end that were not renewed in time, deadlines pass, and workers that were
    /// silent for long are forgotten.
    #[must_use]
    pub fn expire(&self, now: Millis) -> Decision<()> {
        let mut changes = Vec::new();
        for job in self.jobs.values() {
            let stopped = job.meet_deadline(now);
            if stopped.is_empty() {
                changes.extend(job.expire(now));
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
                let job = Job::from_record((**record).clone());
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
