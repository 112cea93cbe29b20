//! How the scheduler decides.

use super::record::{FailedAttempt, Millis};
use photonfarm_proto::job::FailureKind;
use std::fmt;

/// How the scheduler decides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SchedulerConfig {
    /// How long a lease should take \[ms\].
    pub lease_target_ms: Millis,
    /// How long a lease lasts without a heartbeat \[ms\].
    pub lease_ttl_ms: Millis,
    /// How long leases last after a restart without a heartbeat \[ms\].
    pub reconnect_ms: Millis,
    /// A lease is a straggler when it takes this many times as long as expected,
    pub straggler_factor: u64,
    /// and at least this long \[ms\].
    pub straggler_ms: Millis,
    /// Failures that a worker reported after which an iteration is given up.
    pub max_failures: usize,
    /// Attempts that failed in any way, lost workers included, after which an iteration is given up.
    pub max_attempts: usize,
    /// Pause after the first failure of an iteration; it doubles with each further one \[ms\].
    pub retry_ms: Millis,
    /// The longest such pause \[ms\].
    pub longest_retry_ms: Millis,
    /// Nodes in a row that others must confirm before a worker's are repeated more rarely than always; afterwards they
    /// are with the probability of this number over that of the nodes confirmed. 0: nodes are never repeated.
    pub verify_until: u32,
    /// What nonces of leases and the choice of nodes to repeat depend on, unknown to workers.
    pub secret: NonceKey,
    /// Faults in a row that put a worker into quarantine.
    pub max_faults: u32,
    /// A worker silent for this long counts no more \[ms\].
    pub forget_worker_ms: Millis,
    /// Most workers of one token.
    pub most_workers: usize,
    /// Deadlines of jobs that went on when the coordinator ended.
    pub deadlines: Deadlines,
}

/// What becomes of the deadlines of jobs that an earlier coordinator has left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Deadlines {
    /// They stay: time goes by for a farm that rests, too.
    #[default]
    Kept,
    /// All have this one, or none, from the start on: time counts only while there is a coordinator, and somebody else counts it.
    Replaced(Option<Millis>),
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
            secret: NonceKey::default(),
            max_faults: 3,
            forget_worker_ms: 600_000,
            most_workers: 16_384,
            deadlines: Deadlines::default(),
        }
    }
}

impl SchedulerConfig {
    /// How long a lease may take that should take `expected_ms`, before others are given a part of its work \[ms\].
    pub(super) fn patience_ms(&self, expected_ms: Millis) -> Millis {
        let usual = expected_ms.saturating_mul(self.straggler_factor);
        usual.max(self.straggler_ms)
    }

    /// Whether a leaf that failed like this is tried no more.
    pub(super) fn gives_up(&self, attempts: &[FailedAttempt]) -> bool {
        // Who ran out of memory says nothing of the leaf: it waits for a larger worker.
        let counts = attempts
            .iter()
            .filter(|failed| !failed.repeated && failed.memory_mb.is_none());
        let reported = counts.clone().filter(|failed| failed.attempt.kind != FailureKind::Lost);
        reported.count() >= self.max_failures || counts.count() >= self.max_attempts
    }
}

/// Random bits that no worker learns. Their debug text hides them.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct NonceKey(pub [u8; 32]);

impl NonceKey {
    /// A number that nobody can foresee who does not know the secret: a keyed hash of the numbers given.
    pub(super) fn number<const N: usize>(&self, of: [u64; N]) -> u64 {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        of.iter().for_each(|number| _ = hasher.update(&number.to_le_bytes()));
        let mut number = [0; 8];
        hasher.finalize_xof().fill(&mut number);
        u64::from_le_bytes(number)
    }
}

impl fmt::Debug for NonceKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("NonceKey")
    }
}
