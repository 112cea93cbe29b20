//! The leases this worker holds: what is rendered, and what waits to be delivered.

use photonfarm_proto::id::LeaseToken;
use photonfarm_proto::worker::LeaseProgress;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How far a lease has come, and whether it is still worth the effort.
#[derive(Debug, Default)]
pub(crate) struct LeaseState {
    leaves_done: AtomicU32,
    lost: AtomicBool,
}

impl LeaseState {
    /// One more leaf is rendered.
    pub(crate) fn leaf_done(&self) {
        self.leaves_done.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether the coordinator has taken the lease back: its work is void.
    pub(crate) fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }
}

/// The leases held.
#[derive(Clone, Debug, Default)]
pub(crate) struct Held {
    leases: Arc<Mutex<BTreeMap<LeaseToken, Arc<LeaseState>>>>,
}

impl Held {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<LeaseToken, Arc<LeaseState>>> {
        self.leases.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A lease was granted.
    pub(crate) fn add(&self, token: LeaseToken) -> Arc<LeaseState> {
        self.lock().entry(token).or_default().clone()
    }

    /// A lease is over.
    pub(crate) fn remove(&self, token: LeaseToken) {
        self.lock().remove(&token);
    }

    /// The leases' names.
    pub(crate) fn tokens(&self) -> Vec<LeaseToken> {
        self.lock().keys().copied().collect()
    }

    /// What a heartbeat says.
    pub(crate) fn progress(&self) -> Vec<LeaseProgress> {
        let progress = |(token, state): (&LeaseToken, &Arc<LeaseState>)| LeaseProgress {
            token: *token,
            leaves_done: state.leaves_done.load(Ordering::Relaxed),
        };
        self.lock().iter().map(progress).collect()
    }

    /// The coordinator does not know these leases any more.
    pub(crate) fn lose(&self, tokens: &[LeaseToken]) {
        let leases = self.lock();
        for state in tokens.iter().filter_map(|token| leases.get(token)) {
            state.lost.store(true, Ordering::Relaxed);
        }
    }
}

/// Gives up all leases when dropped, so that what renders for them stops.
#[derive(Debug)]
pub(crate) struct Abandon(pub(crate) Held);

impl Drop for Abandon {
    fn drop(&mut self) {
        self.0.lose(&self.0.tokens());
    }
}
