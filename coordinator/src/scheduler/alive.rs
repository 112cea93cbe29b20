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
        let leases = self.jobs.values().flat_map(|job| job.leases.values());
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
            let mut jobs = self.jobs.values_mut();
            match jobs.find(|job| job.lease(progress.token, worker).is_ok()) {
                Some(job) => {
                    if let Some(lease) = job.leases.get_mut(&progress.token) {
                        lease.expires_ms = lease.expires_ms.max(until);
                        let done = u64::from(progress.leaves_done).min(lease.record.node.leaves());
                        lease.leaves_done = lease.leaves_done.max(done);
                    }
                    let rendered = job.rendered();
                    job.pace.sample(now, rendered);
                }
                None => lost.push(progress.token),
            }
        }
        Ok(lost)
    }

    /// A worker asks for work, which is a sign of life.
    pub fn asks(&mut self, worker: WorkerId, serial: u64, now: Millis) -> Result<(), Refusal> {
        self.seen(worker, now)?;
        if let Some(worker) = self.workers.get_mut(&worker) {
            worker.serial = worker.serial.max(serial);
        }
        Ok(())
    }

    /// A worker was heard of.
    pub fn seen(&mut self, worker: WorkerId, now: Millis) -> Result<(), Refusal> {
        let worker = self.workers.get_mut(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        worker.last_seen_ms = worker.last_seen_ms.max(now);
        Ok(())
    }
}

fn renewed(renewals: Vec<Renewal>) -> Vec<Change> {
    match renewals.is_empty() {
        true => vec![],
        false => vec![Change::LeasesRenewed(renewals)],
    }
}
