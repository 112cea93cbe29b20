//! What happened on the farm since the start, in numbers: the log tells the same in words.

use crate::scheduler::record::Change;
use photonfarm_proto::job::FailureKind;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of what this coordinator decided since its start.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    workers_registered: AtomicU64,
    leases_granted: AtomicU64,
    /// By kind, in the order of [`KINDS`].
    failed_attempts: [AtomicU64; 4],
}

/// The kinds of failed attempts, and their names in figures.
const KINDS: [(FailureKind, &str); 4] = [
    (FailureKind::Scene, "scene"),
    (FailureKind::Render, "render"),
    (FailureKind::Panic, "panic"),
    (FailureKind::Lost, "lost"),
];

impl Counts {
    /// Counts a change that was kept.
    pub(super) fn note(&self, change: &Change) {
        let count = match change {
            Change::WorkerRegistered(_) => Some(&self.workers_registered),
            Change::LeaseGranted(_) => Some(&self.leases_granted),
            Change::LeafFailed { attempt, .. } => {
                let kind = KINDS.iter().position(|(kind, _)| *kind == attempt.attempt.kind);
                kind.map(|kind| &self.failed_attempts[kind])
            }
            _ => None,
        };
        if let Some(count) = count {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Workers that were registered.
    pub(crate) fn workers_registered(&self) -> u64 {
        self.workers_registered.load(Ordering::Relaxed)
    }

    /// Leases that were granted.
    pub(crate) fn leases_granted(&self) -> u64 {
        self.leases_granted.load(Ordering::Relaxed)
    }

    /// Attempts at iterations that failed, by the name of their kind.
    pub(crate) fn failed_attempts(&self) -> [(&'static str, u64); 4] {
        std::array::from_fn(|kind| (KINDS[kind].1, self.failed_attempts[kind].load(Ordering::Relaxed)))
    }
}
