//! Several coordinators on one farm: news of each other's commits, signs of life of each other's workers, and one of
//! them that leads.

use super::{Service, ServiceError};
use crate::scheduler::record::{Change, Millis};
use crate::store::Beat;
use photonfarm_proto::id::{JobId, WorkerId};
use photonfarm_proto::worker::LeaseProgress;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Time between two measurements of the clock that all coordinators share \[ms\].
const MEASURE_EVERY: Millis = 60_000;
/// Absence of this coordinator, or step of the clock, after which silence is held against no worker \[ms\]: half of the time
/// after which leases expire.
const ABSENCE: i64 = 15_000;
/// Wait after a failure to learn the news.
const PAUSE: Duration = Duration::from_secs(1);

/// What this coordinator knows beyond the farm's state.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// Signs of life that others were not told of yet.
    heard: Mutex<BTreeMap<WorkerId, Beat>>,
    leads: AtomicBool,
    /// When the clock was last measured.
    measured: AtomicU64,
}

impl Service {
    /// Whether this coordinator expires leases, merges nodes and removes garbage.
    pub(super) fn leads(&self) -> bool {
        self.shared.leads.load(Ordering::Relaxed)
    }

    /// Asks the store whether this coordinator leads from now on.
    pub(super) async fn take_lead(&self) -> Result<bool, ServiceError> {
        let leads = self.stores.state.leads().await;
        let leads = leads.inspect_err(|_| self.shared.leads.store(false, Ordering::Relaxed))?;
        self.shared.leads.store(leads, Ordering::Relaxed);
        Ok(leads)
    }

    /// A worker was heard of here: others are told soon.
    pub(super) fn note_beat(&self, worker: WorkerId, leases: &[LeaseProgress], at_ms: Millis) {
        if !self.stores.state.is_shared() {
            return;
        }
        let mut heard = self.shared.heard.lock().unwrap_or_else(PoisonError::into_inner);
        let beat = heard.entry(worker).or_insert_with(|| Beat {
            worker,
            at_ms,
            leases: Vec::new(),
        });
        beat.at_ms = at_ms;
        if !leases.is_empty() {
            beat.leases = leases.to_vec();
        }
    }

    /// Tells others which workers were heard of here, and learns which were heard of there.
    pub(super) async fn exchange_beats(self: &Arc<Self>) -> Result<(), ServiceError> {
        if !self.stores.state.is_shared() {
            return Ok(());
        }
        let heard = std::mem::take(&mut *self.shared.heard.lock().unwrap_or_else(PoisonError::into_inner));
        let beats = self.stores.state.share_beats(heard.into_values().collect()).await?;
        let mut cell = self.fresh_farm().await?;
        for Beat { worker, at_ms, leases } in beats {
            // A worker that is gone, or is not known here yet, matters to nobody here.
            let _lost = cell.farm.heartbeat(worker, &leases, at_ms);
        }
        Ok(())
    }

    /// Follows the clock that all coordinators share. Where this coordinator was not there for a while, since its machine
    /// was suspended, or where that clock was set, leases begin anew as after a start: nobody can have heard of their
    /// workers meanwhile.
    pub(super) async fn watch_clock(self: &Arc<Self>) -> Result<(), ServiceError> {
        let (now, away) = (self.clock.now(), self.clock.suspended());
        let mut step = 0;
        if now.abs_diff(self.shared.measured.load(Ordering::Relaxed)) > MEASURE_EVERY {
            step = self.clock.measure(&*self.stores.state).await?;
            self.shared.measured.store(self.clock.now(), Ordering::Relaxed);
        }
        if away > ABSENCE || step.abs() > ABSENCE {
            tracing::warn!(
                suspended_ms = away,
                clock_step_ms = step,
                "this machine was suspended, or the farm's clock was set: leases begin anew"
            );
            let mut cell = self.fresh_farm().await?;
            self.reload(&mut cell).await?;
        }
        Ok(())
    }

    /// Learns of commits of other coordinators as they happen.
    pub(super) async fn follow(self: Arc<Self>) {
        let mut stopping = self.stopping();
        loop {
            let since = self.farm.lock().await.sequence;
            tokio::select! {
                _ = stopping.wait_for(|stop| *stop) => return,
                () = self.stores.state.wait_for_news(since) => {}
            }
            let learned = async {
                let mut cell = self.fresh_farm().await?;
                self.catch_up(&mut cell).await
            };
            if let Err(error) = learned.await {
                tracing::warn!(%error, "no news of other coordinators");
                tokio::time::sleep(PAUSE).await;
            }
        }
    }

    /// Merges what other coordinators received, if this one leads.
    pub(super) fn fold_news(self: &Arc<Self>, changes: &[Change]) {
        let mut jobs: Vec<JobId> = changes
            .iter()
            .filter_map(|change| match change {
                Change::NodeAdded { job, .. } | Change::LeafFailed { job, .. } => Some(*job),
                _ => None,
            })
            .collect();
        jobs.dedup();
        jobs.into_iter().for_each(|job| self.fold_in_background(job));
    }
}
