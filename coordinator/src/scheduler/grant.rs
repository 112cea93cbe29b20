//! Leases are granted: which job, which block, under which token.

use super::block::{Block, Taker};
use super::record::{Change, JobControl, LeaseRecord, Millis, Principal};
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
        let Asked { worker, serial, held } = asked;
        let (worker, serial) = (*worker, *serial);
        let known = self.workers.get(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        if known.serial > serial || self.leases_of(worker).any(|lease| lease.serial > serial) {
            return Ok(Decision::new(None, vec![]));
        }
        let orphans = self
            .leases_of(worker)
            .filter(|lease| lease.serial < serial && !held.contains(&lease.token));
        let mut changes: Vec<Change> = orphans
            .map(|lease| Change::LeaseEnded {
                job: lease.job,
                token: lease.token,
            })
            .collect();
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

    /// The first lease of a job binds it to a renderer.
    fn bind(&self, lease: &LeaseRecord) -> Option<Change> {
        let (job, worker) = (self.jobs.get(&lease.job)?, self.workers.get(&lease.worker)?);
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
        let known = self.workers.get(&worker)?;
        if self.leases_of(worker).count() >= LEASES_OF_A_WORKER {
            return None;
        }
        let mut jobs = self.jobs_by_share();
        jobs.retain(|job| known.fits(job));
        let (job, block) = self.choose(&jobs, worker, now)?;
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

    /// The first job that has something new to do, or else something that takes others too long.
    fn choose<'a>(&'a self, jobs: &[&'a Job], worker: WorkerId, now: Millis) -> Option<(&'a Job, Block)> {
        let offer = |again: bool| {
            jobs.iter().find_map(|job| {
                let all: Vec<Principal> = self.workers_for(job, now).map(|other| other.principal).collect();
                let taker = Taker {
                    worker,
                    principal: self.principal_of(worker),
                    all: &all,
                    now,
                    config: &self.config,
                };
                let block = match again {
                    true => job.straggler(&taker),
                    false => job.next_doubt(&taker).or_else(|| job.next_block(&taker)),
                };
                Some((*job, block?))
            })
        };
        offer(false).or_else(|| offer(true))
    }
}
