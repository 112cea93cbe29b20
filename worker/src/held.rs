//! The leases this worker holds: what is rendered, and what waits to be delivered.

use photonfarm_proto::id::{JobId, LeaseToken};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::worker::{Lease, LeaseProgress};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How far a lease has come, and whether it is still worth the effort.
#[derive(Debug)]
pub(crate) struct LeaseState {
    job: JobId,
    node: NodeKey,
    leaves_done: AtomicU32,
    rendered: AtomicBool,
    lost: AtomicBool,
}

impl LeaseState {
    /// Of a lease that was just granted.
    pub(crate) fn of(lease: &Lease) -> Self {
        Self {
            job: lease.job,
            node: lease.node,
            leaves_done: AtomicU32::new(0),
            rendered: AtomicBool::new(false),
            lost: AtomicBool::new(false),
        }
    }

    /// All that will be rendered is: it remains to be delivered.
    pub(crate) fn set_rendered(&self) {
        self.rendered.store(true, Ordering::Relaxed);
    }

    /// One more leaf is rendered.
    pub(crate) fn leaf_done(&self) {
        self.leaves_done.fetch_add(1, Ordering::Relaxed);
    }

    /// Leaves rendered.
    pub(crate) fn leaves_done(&self) -> u32 {
        self.leaves_done.load(Ordering::Relaxed)
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
    pub(crate) fn add(&self, lease: &Lease) -> Arc<LeaseState> {
        let fresh = || Arc::new(LeaseState::of(lease));
        self.lock().entry(lease.token).or_insert_with(fresh).clone()
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
            leaves_done: state.leaves_done(),
        };
        self.lock().iter().map(progress).collect()
    }

    /// What there is still to do, in words; none if nothing is.
    pub(crate) fn left_to_do(&self) -> Option<String> {
        let leases = self.lock();
        let (rendered, at_work): (Vec<_>, Vec<_>) = leases
            .values()
            .partition(|state| state.rendered.load(Ordering::Relaxed));
        let mut parts: Vec<String> = at_work
            .iter()
            .map(|state| {
                let iteration = state.node.first() + 1 + u64::from(state.leaves_done());
                format!("the end of iteration {iteration} of job {}", state.job)
            })
            .collect();
        if !rendered.is_empty() {
            let jobs: BTreeSet<String> = rendered.iter().map(|state| state.job.to_string()).collect();
            let jobs: Vec<String> = jobs.into_iter().collect();
            parts.push(format!(
                "the delivery of {} finished leases of job {}",
                rendered.len(),
                jobs.join(", ")
            ));
        }
        (!parts.is_empty()).then(|| parts.join(" and "))
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
