//! Who is served next: stride scheduling (Waldspurger and Weihl 1995) with the time of leases as its measure.
//!
//! A job's share is the time that it has had of the farm, stretched by the sum of the priorities of its owner's jobs
//! over its own: with several owners each gets the same, whatever the number of their jobs. The job with the smallest
//! share goes first. A job that comes late, or could not run for a while, begins with the share of the one served
//! last, so that it neither waits for what others had before nor makes up for what it left. A lease is charged for what
//! it should take, and what it took corrects that once it is over. A change of priority holds for what a job is ahead,
//! too.

use super::record::Millis;
use super::{Farm, Job};

impl Farm {
    /// The job's share as it stands against others.
    pub(super) fn share_of(&self, job: &Job) -> Millis {
        job.share_ms().max(self.counters.share)
    }

    /// The job's share before and after a lease that should take `expected_ms`.
    pub(super) fn share_with(&self, job: &Job, expected_ms: Option<Millis>) -> [Millis; 2] {
        let from = self.share_of(job);
        let cost = expected_ms.unwrap_or(self.config.lease_target_ms).max(1);
        let weight = job.weight();
        let all = self.index.weight_of(&job.head.owner).max(weight);
        let stretched = cost.saturating_mul(all).div_ceil(weight);
        [from, from.saturating_add(stretched).min(MOST)]
    }
}

/// Far beyond what any farm reaches, and within what databases keep.
const MOST: Millis = 1 << 62;
