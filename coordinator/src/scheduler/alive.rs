//! Signs of life: which leases go on, how fast workers are, and what a start of the coordinator changes about it.

use super::record::{Change, Millis, Renewal};
use super::{Decision, Farm, Refusal};
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::worker::LeaseProgress;

impl Farm {
    /// The coordinator was started again: keeps until when leases last, so that the next start does not renew those of
    /// workers that are not heard of.
    #[must_use]
    pub fn restarted(&self) -> Decision<()> {
        let leased = self.index.leased.keys();
        let leases = leased.flat_map(|id| self.jobs[id].leases.values());
        let renewals = leases.map(|lease| Renewal {
            job: lease.record.job,
            token: lease.record.token,
            until_ms: lease.expires_ms,
            restarts: lease.record.restarts.saturating_add(1),
        });
        Decision::new((), renewed(renewals.collect()))
    }

    /// A worker was heard of for the first time since a start: keeps that.
    #[must_use]
    pub fn reconnected(&self, worker: WorkerId, now: Millis) -> Decision<()> {
        let leases = self.leases_of(worker).filter(|lease| lease.restarts > 0);
        let renewals = leases.map(|lease| Renewal {
            job: lease.job,
            token: lease.token,
            until_ms: now + self.config.lease_ttl_ms,
            restarts: 0,
        });
        Decision::new((), renewed(renewals.collect()))
    }

    /// A sign of life: renews the leases named and returns those that have expired or were revoked. Nothing of it is kept.
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
            let job = self.held.job_of(worker, progress.token);
            let job = job.and_then(|job| self.jobs.get_mut(&job));
            match job.and_then(|job| job.leases.get_mut(&progress.token)) {
                Some(lease) => {
                    lease.expires_ms = lease.expires_ms.max(until);
                    let done = u64::from(progress.leaves_done).min(lease.record.node.leaves());
                    lease.leaves_done = lease.leaves_done.max(done);
                }
                None => lost.push(progress.token),
            }
        }
        Ok(lost)
    }

    /// A worker asks for work, which is a sign of life.
    pub fn asks(&mut self, worker: WorkerId, serial: u64, now: Millis) -> Result<(), Refusal> {
        self.hear(worker, serial, now)
    }

    /// A worker was heard of.
    pub fn seen(&mut self, worker: WorkerId, now: Millis) -> Result<(), Refusal> {
        self.hear(worker, 0, now)
    }

    fn hear(&mut self, worker: WorkerId, serial: u64, now: Millis) -> Result<(), Refusal> {
        match self.workers.hear(worker, serial, now) {
            true => Ok(()),
            false => Err(Refusal::UnknownWorker(worker)),
        }
    }
}

fn renewed(renewals: Vec<Renewal>) -> Vec<Change> {
    match renewals.is_empty() {
        true => vec![],
        false => vec![Change::LeasesRenewed(renewals)],
    }
}
