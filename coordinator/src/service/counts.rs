//! What happened on the farm since the start, in numbers: the log tells the same in words.

use crate::scheduler::record::Change;
use photonfarm_proto::id::{JobId, LeaseToken};
use photonfarm_proto::job::{FailureKind, JobState};
use photonfarm_proto::webhook::DeliveryState;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Upper bounds of the classes that durations of leases are counted in \[s\]. The usual lease is planned to take some ten seconds.
pub(crate) const LEASE_SECONDS: [f64; 9] = [1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0];

/// Counts of what this coordinator decided since its start.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    workers_registered: AtomicU64,
    leases_granted: AtomicU64,
    nodes_committed: AtomicU64,
    iterations_committed: AtomicU64,
    nodes_merged: AtomicU64,
    nodes_lost: AtomicU64,
    /// By state, in the order of [`ENDS`].
    jobs_ended: [AtomicU64; 3],
    leases: Mutex<Leases>,
    /// By kind, in the order of [`KINDS`].
    failed_attempts: [AtomicU64; 5],
    /// By what became of the delivery, in the order of [`DELIVERIES`].
    deliveries: [AtomicU64; 3],
}

/// Leases that this coordinator granted and that have not ended, with the durations of those that have.
#[derive(Debug, Default)]
struct Leases {
    begun: BTreeMap<(JobId, LeaseToken), Instant>,
    durations: Durations,
}

/// Durations, counted in classes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Durations {
    /// How many are at most as long as each of [`LEASE_SECONDS`].
    pub(crate) at_most: [u64; LEASE_SECONDS.len()],
    /// How many there are.
    pub(crate) count: u64,
    /// Their sum \[s\].
    pub(crate) sum: f64,
}

impl Leases {
    /// Takes the duration of a lease that ended.
    fn end(&mut self, job: JobId, token: LeaseToken) {
        if let Some(since) = self.begun.remove(&(job, token)) {
            self.durations.add(since.elapsed().as_secs_f64());
        }
    }

    /// Takes the durations of all leases of a job that ended.
    fn end_all(&mut self, job: JobId) {
        let first = LeaseToken { number: 0, nonce: 0 };
        let from = self.begun.range((job, first)..).map(|(lease, _)| *lease);
        for (job, token) in from.take_while(|(of, _)| *of == job).collect::<Vec<_>>() {
            self.end(job, token);
        }
    }
}

impl Durations {
    fn add(&mut self, seconds: f64) {
        let classes = self.at_most.iter_mut().zip(LEASE_SECONDS);
        classes.for_each(|(count, bound)| *count += u64::from(seconds <= bound));
        self.count += 1;
        self.sum += seconds;
    }
}

/// What becomes of deliveries to webhooks by an attempt, and the names of that in figures.
const DELIVERIES: [(DeliveryState, &str); 3] = [
    (DeliveryState::Delivered, "delivered"),
    (DeliveryState::Pending, "failed"),
    (DeliveryState::GivenUp, "given_up"),
];

/// How jobs end, and the names of that in figures.
const ENDS: [(JobState, &str); 3] = [
    (JobState::Done, "done"),
    (JobState::Failed, "failed"),
    (JobState::Cancelled, "cancelled"),
];

/// The kinds of failed attempts, and their names in figures.
const KINDS: [(FailureKind, &str); 5] = [
    (FailureKind::Scene, "scene"),
    (FailureKind::Render, "render"),
    (FailureKind::Panic, "panic"),
    (FailureKind::Lost, "lost"),
    (FailureKind::OutOfMemory, "out-of-memory"),
];

impl Counts {
    /// Counts a change that was kept.
    pub(super) fn note(&self, change: &Change) {
        let count = match change {
            Change::WorkerRegistered(_) => Some(&self.workers_registered),
            Change::LeaseGranted(lease) => {
                self.leases().begun.insert((lease.job, lease.token), Instant::now());
                Some(&self.leases_granted)
            }
            Change::LeaseEnded { job, token } => {
                self.leases().end(*job, *token);
                None
            }
            Change::NodeAdded { node, .. } => {
                self.iterations_committed.fetch_add(node.leaves(), Ordering::Relaxed);
                Some(&self.nodes_committed)
            }
            Change::NodeMerged { .. } => Some(&self.nodes_merged),
            Change::NodeLost { .. } => Some(&self.nodes_lost),
            Change::JobEnded { job, state, .. } => {
                self.leases().end_all(*job);
                let end = ENDS.iter().position(|(end, _)| end == state);
                end.map(|end| &self.jobs_ended[end])
            }
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

    fn leases(&self) -> std::sync::MutexGuard<'_, Leases> {
        self.leases.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How long leases took that ended.
    pub(crate) fn lease_durations(&self) -> Durations {
        self.leases().durations
    }

    /// Nodes that came to count, and iterations in them. What is rendered again, or comes as a greater node, counts again.
    pub(crate) fn committed(&self) -> [u64; 2] {
        [&self.nodes_committed, &self.iterations_committed].map(|count| count.load(Ordering::Relaxed))
    }

    /// Nodes that were merged into greater ones.
    pub(crate) fn nodes_merged(&self) -> u64 {
        self.nodes_merged.load(Ordering::Relaxed)
    }

    /// Nodes that counted and do so no more.
    pub(crate) fn nodes_lost(&self) -> u64 {
        self.nodes_lost.load(Ordering::Relaxed)
    }

    /// Jobs that ended, by the name of how.
    pub(crate) fn jobs_ended(&self) -> [(&'static str, u64); 3] {
        std::array::from_fn(|end| (ENDS[end].1, self.jobs_ended[end].load(Ordering::Relaxed)))
    }

    /// An attempt has made this of a delivery.
    pub(crate) fn note_delivery(&self, state: DeliveryState) {
        let found = DELIVERIES
            .iter()
            .zip(&self.deliveries)
            .find(|((known, _), _)| *known == state);
        if let Some((_, count)) = found {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Attempts at deliveries to webhooks, by the name of what became of them.
    pub(crate) fn deliveries(&self) -> [(&'static str, u64); 3] {
        std::array::from_fn(|state| (DELIVERIES[state].1, self.deliveries[state].load(Ordering::Relaxed)))
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
    pub(crate) fn failed_attempts(&self) -> [(&'static str, u64); 5] {
        std::array::from_fn(|kind| (KINDS[kind].1, self.failed_attempts[kind].load(Ordering::Relaxed)))
    }
}
