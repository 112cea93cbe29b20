//! All leases of the farm, by worker and by when they take too long.

use super::SchedulerConfig;
use super::record::{LeaseRecord, Millis};
use super::table::{Set, Table};
use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};

/// The leases.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Held {
    /// Their jobs.
    by_worker: Table<(WorkerId, LeaseToken), JobId>,
    /// By the earliest time at which others may be given a part of the work.
    overdue: Set<(Millis, JobId, LeaseToken)>,
}

impl Held {
    pub(super) fn insert(&mut self, lease: &LeaseRecord, config: &SchedulerConfig) {
        self.by_worker.insert((lease.worker, lease.token), lease.job);
        self.overdue.insert(overdue(lease, config), ());
    }

    pub(super) fn remove(&mut self, lease: &LeaseRecord, config: &SchedulerConfig) {
        self.by_worker.remove(&(lease.worker, lease.token));
        self.overdue.remove(&overdue(lease, config));
    }

    /// The job of a lease, if this worker holds it.
    pub(super) fn job_of(&self, worker: WorkerId, token: LeaseToken) -> Option<JobId> {
        self.by_worker.get(&(worker, token)).copied()
    }

    /// The leases of a worker, and their jobs.
    pub(super) fn of(&self, worker: WorkerId) -> impl Iterator<Item = (JobId, LeaseToken)> + '_ {
        let nobody = LeaseToken { number: 0, nonce: 0 };
        let leases = self.by_worker.range((worker, nobody)..(WorkerId(worker.0 + 1), nobody));
        leases.map(|((_, token), job)| (*job, *token))
    }

    /// Leases that may take too long at the time `now`, the longest overdue first.
    pub(super) fn overdue(&self, now: Millis) -> impl Iterator<Item = (JobId, LeaseToken)> + '_ {
        let overdue = self.overdue.keys().take_while(move |(due, ..)| *due <= now);
        overdue.map(|(_, job, token)| (*job, *token))
    }
}

fn overdue(lease: &LeaseRecord, config: &SchedulerConfig) -> (Millis, JobId, LeaseToken) {
    let patience = config.patience_ms(lease.expected_ms.unwrap_or(0));
    (lease.granted_ms.saturating_add(patience), lease.job, lease.token)
}
