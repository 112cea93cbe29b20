//! Leases are granted: which job, which block, under which token.

use super::block::{Block, Taker};
use super::record::{Change, JobControl, LeaseRecord, Millis};
use super::roster::{Staff, Worker};
use super::{Decision, Farm, Job, Refusal};
use photonfarm_proto::id::{LeaseToken, WorkerId};

/// Most leases of a worker at once.
const LEASES_OF_A_WORKER: usize = 8;

/// A worker's request for work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asked {
    /// Who asks.
    pub worker: WorkerId,
    /// Counts the worker's requests.
    pub serial: u64,
    /// The leases that it holds.
    pub held: Vec<LeaseToken>,
}

impl Farm {
    /// A worker asks for work. Its leases that it does not name were granted in replies to earlier requests that never arrived:
    /// they end. Of a request that a later one has overtaken nothing follows.
    pub fn lease(&self, asked: &Asked, now: Millis) -> Result<Decision<Option<LeaseRecord>>, Refusal> {
        let (worker, serial) = (asked.worker, asked.serial);
        let known = self.workers.get(worker).ok_or(Refusal::UnknownWorker(worker))?;
        if self.is_overtaken(known, asked) {
            return Ok(Decision::new(None, vec![]));
        }
        let mut changes = self.unnamed(asked);
        changes.extend(self.rests(known, None));
        if !changes.is_empty() {
            return Ok(Decision::new(None, changes));
        }
        let Some(lease) = self.next_lease(worker, serial, now) else {
            return Ok(Decision::new(None, changes));
        };
        changes.extend(self.bind(&lease));
        changes.push(Change::LeaseGranted(lease.clone()));
        Ok(Decision::new(Some(lease), changes))
    }

    /// Whether a later request of the worker was heard.
    pub(super) fn is_overtaken(&self, known: &Worker, asked: &Asked) -> bool {
        let mut leases = self.leases_of(asked.worker);
        known.serial > asked.serial || leases.any(|lease| lease.serial > asked.serial)
    }

    /// Ends the leases that were granted in replies that never arrived.
    pub(super) fn unnamed(&self, asked: &Asked) -> Vec<Change> {
        let unnamed = self
            .leases_of(asked.worker)
            .filter(|lease| lease.serial < asked.serial && !asked.held.contains(&lease.token));
        let ended = unnamed.map(|lease| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        });
        ended.collect()
    }

    /// The first lease of a job binds it to a renderer.
    fn bind(&self, lease: &LeaseRecord) -> Option<Change> {
        let (job, worker) = (self.jobs.get(&lease.job)?, self.workers.get(lease.worker)?);
        if job.control.renderer.is_some() {
            return None;
        }
        Some(Change::JobChanged {
            job: job.id(),
            control: JobControl {
                renderer: Some(worker.record.renderer.clone()),
                ..job.control.clone()
            },
        })
    }

    fn next_lease(&self, worker: WorkerId, serial: u64, now: Millis) -> Option<LeaseRecord> {
        let known = self.workers.get(worker).filter(|known| known.may_work())?;
        if self.leases_of(worker).count() >= LEASES_OF_A_WORKER {
            return None;
        }
        let (job, block) = self
            .something_new(known, now)
            .or_else(|| self.something_late(known, now))?;
        let Block {
            node,
            expected_ms,
            attempt,
            verifies,
        } = block;
        let number = self.counters.token + 1;
        let nonce = self.config.secret.number([number]);
        Some(LeaseRecord {
            token: LeaseToken { number, nonce },
            job: job.id(),
            node,
            worker,
            serial,
            attempt,
            granted_ms: now,
            expected_ms,
            verifies,
            share: self.share_with(job, expected_ms),
            until_ms: now + self.config.lease_ttl_ms,
            restarts: 0,
        })
    }

    /// Whether there are nodes that others than those who rendered them are to repeat.
    #[must_use]
    pub fn wants_repeats(&self) -> bool {
        self.index.wants_repeats > 0
    }

    /// Work that nobody does, of the first job that has some.
    fn something_new(&self, worker: &Worker, now: Millis) -> Option<(&Job, Block)> {
        let jobs = self.index.next_jobs(|demand| worker.skill().meets(demand));
        jobs.map(|id| &self.jobs[&id]).find_map(|job| {
            let staff = self.workers.staff_for(job);
            let taker = self.taker(worker, &staff, now);
            let block = job.next_doubt(&taker).or_else(|| job.next_block(&taker));
            Some((job, block?))
        })
    }

    /// Work that somebody else has had for much longer than it should take.
    fn something_late(&self, worker: &Worker, now: Millis) -> Option<(&Job, Block)> {
        self.held.overdue(now).find_map(|(id, token)| {
            let job = &self.jobs[&id];
            if !worker.fits(job) || job.is_paused() {
                return None;
            }
            let staff = self.workers.staff_for(job);
            let block = job.steal(&job.leases[&token], &self.taker(worker, &staff, now));
            Some((job, block?))
        })
    }

    pub(super) fn taker<'a>(&'a self, worker: &Worker, staff: &'a Staff<'a>, now: Millis) -> Taker<'a> {
        Taker {
            worker: worker.id(),
            principal: worker.principal,
            staff,
            now,
            config: &self.config,
        }
    }
}
