//! Workers: they come, belong to somebody, and go.

use super::record::{Change, LeaseRecord, Millis, Origin, Principal, Standing, WorkerRecord};
use super::roster::{Skill, Worker};
use super::{Decision, Farm, Refusal};
use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::id::{JobId, WorkerId};
use photonfarm_proto::worker::Register;
use std::collections::BTreeSet;
use std::sync::Arc;

impl Farm {
    /// The workers heard of lately, oldest first.
    #[must_use]
    pub fn worker_statuses(&self, now: Millis) -> Vec<WorkerStatus> {
        let status = |worker: &Worker| WorkerStatus {
            id: worker.record.id,
            name: worker.record.name.clone(),
            threads: worker.record.threads,
            renderer: worker.record.renderer.clone(),
            tags: worker.record.tags.clone(),
            memory_mb: worker.record.memory_mb,
            token: worker.record.origin.token.clone(),
            machine: worker.record.origin.machine.clone(),
            verified: worker.record.standing.verified,
            faults: worker.record.standing.faults,
            quarantine: worker.record.standing.quarantine.clone(),
            drained: worker.record.standing.drained,
            rest: worker.record.standing.rest,
            silent_ms: now.saturating_sub(worker.last_seen_ms),
            leases: self.held.of(worker.id()).count() as u32,
            jobs: self.held.of(worker.id()).map(|(job, _)| job).collect(),
            iterations_per_second: self.speed_of(worker.id()),
        };
        self.workers.values().map(status).collect()
    }

    /// Iterations per second of a worker on the jobs that it is at work on, on average over these.
    fn speed_of(&self, worker: WorkerId) -> Option<f64> {
        let jobs: BTreeSet<JobId> = self.held.of(worker).map(|(job, _)| job).collect();
        let seconds = jobs
            .iter()
            .filter_map(|job| self.jobs[job].pace.seconds_per_iteration(worker));
        let (count, sum) = seconds.fold((0, 0.0), |(count, sum), seconds| (count + 1, sum + seconds));
        (count > 0).then(|| f64::from(count) / sum)
    }

    pub(super) fn leases_of(&self, worker: WorkerId) -> impl Iterator<Item = &LeaseRecord> {
        let leases = self.held.of(worker);
        leases.map(|(job, token)| &self.jobs[&job].leases[&token].record)
    }

    /// A worker introduces itself. One that has the name of another in quarantine is there, too.
    ///
    /// # Errors
    /// Too many workers of its token, none of which is gone.
    pub fn register(&self, register: Register, origin: Origin, now: Millis) -> Result<Decision<WorkerId>, Refusal> {
        let id = WorkerId(self.counters.worker + 1);
        let mut record = WorkerRecord {
            id,
            name: register.name,
            threads: register.threads,
            renderer: register.renderer,
            tags: register.tags,
            memory_mb: register.memory_mb,
            origin,
            standing: Standing::default(),
        };
        let is_gone = |other: &&Worker| self.is_silent(other, now) && !self.holds_leases(other.id());
        let held: Vec<&Worker> = self.namesakes(&record).filter(|other| other.is_held()).collect();
        if let Some(other) = held.first() {
            record.standing = Standing {
                drained: false,
                rest: None,
                ..other.record.standing.clone()
            };
        }
        let mut forgotten: Vec<WorkerId> = held.into_iter().filter(is_gone).map(Worker::id).collect();
        let of_token = || {
            let token = &record.origin.token;
            self.workers
                .values()
                .filter(move |other| other.record.origin.token == *token)
        };
        let (registered, most) = (of_token().count(), self.config.most_workers);
        if registered - forgotten.len() >= most {
            let dispensable = of_token().filter(|other| is_gone(other) && !other.is_held());
            let oldest = dispensable.min_by_key(|other| other.last_seen_ms);
            forgotten.push(oldest.ok_or(Refusal::TooManyWorkers { registered, most })?.id());
        }
        let mut changes: Vec<Change> = forgotten.into_iter().map(Change::WorkerForgotten).collect();
        changes.push(Change::WorkerRegistered(record));
        Ok(Decision::new(id, changes))
    }

    /// Gives a worker no new work, or work again. One that is started anew is another worker.
    pub fn drain(&self, worker: WorkerId, drained: bool) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(worker).ok_or(Refusal::UnknownWorker(worker))?;
        let before = &known.record.standing;
        if before.drained == drained {
            return Ok(Decision::new((), vec![]));
        }
        let standing = Standing {
            drained,
            ..before.clone()
        };
        Ok(Decision::new((), vec![Change::WorkerJudged { worker, standing }]))
    }

    /// The workers for which quarantine of this one holds, itself among them.
    pub(super) fn namesakes(&self, record: &WorkerRecord) -> impl Iterator<Item = &Worker> {
        self.workers
            .values()
            .filter(move |other| other.record.is_namesake(record))
    }

    /// Refuses somebody who speaks for a worker that was registered with another token. A worker that is not known belongs to
    /// nobody, and holds nothing.
    pub fn check_token(&self, worker: WorkerId, token: &str) -> Result<(), Refusal> {
        match self.workers.get(worker) {
            Some(known) if known.record.origin.token != token => Err(Refusal::ForeignWorker(worker)),
            _ => Ok(()),
        }
    }

    /// Whether a worker is registered.
    #[must_use]
    pub fn knows(&self, worker: WorkerId) -> bool {
        self.workers.get(worker).is_some()
    }

    /// Who is behind a worker, as far as it is known.
    pub(super) fn principal_of(&self, worker: WorkerId) -> Principal {
        let known = self.workers.get(worker);
        known.map_or_else(Principal::default, |worker| worker.principal)
    }

    pub(super) fn is_silent(&self, worker: &Worker, now: Millis) -> bool {
        now.saturating_sub(worker.last_seen_ms) >= self.config.lease_ttl_ms
    }

    pub(super) fn holds_leases(&self, worker: WorkerId) -> bool {
        self.held.of(worker).next().is_some()
    }

    /// What a worker can do.
    #[must_use]
    pub fn skill_of(&self, worker: WorkerId) -> Option<Arc<Skill>> {
        self.workers.get(worker).map(|known| known.skill().clone())
    }

    /// A worker ends: its leases go back, without blame.
    #[must_use]
    pub fn leave(&self, worker: WorkerId) -> Decision<()> {
        let ended = |lease: &LeaseRecord| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        };
        let mut changes: Vec<Change> = self.leases_of(worker).map(ended).collect();
        if self.workers.get(worker).is_some_and(|worker| !worker.is_held()) {
            changes.push(Change::WorkerForgotten(worker));
        }
        Decision::new((), changes)
    }
}
