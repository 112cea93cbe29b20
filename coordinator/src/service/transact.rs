//! How the farm changes: decisions are committed, then applied, then answered.

use super::{Part, Service, ServiceError, garbage, journal};
use crate::background::{Parcel, unpacked};
use crate::scheduler::record::{Change, Millis};
use crate::scheduler::{Decision, Farm, Refusal};
use crate::store::{Commit, News, Sequence, StoreError};
use std::sync::Arc;
use tokio::sync::MutexGuard;

/// What is to be done upon the state as it is; its reply is of a type that only the caller knows.
type Decide = Box<dyn Fn(&Farm, Millis) -> Result<Decision<Parcel>, Refusal> + Send>;

/// The farm as it is remembered.
pub(super) struct FarmCell {
    pub(super) farm: Farm,
    /// Where the farm stands in the order of commits.
    pub(super) sequence: Sequence,
    doubt: Doubt,
}

/// Whether what is remembered is what is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Doubt {
    /// It is.
    None,
    /// A commit failed with an unknown outcome: the store knows which.
    Outcome,
    /// Changes were being applied when a panic or a lost connection ended it: the state must be loaded again.
    Torn,
}

impl FarmCell {
    pub(super) fn new(farm: Farm, sequence: Sequence) -> Self {
        Self {
            farm,
            sequence,
            doubt: Doubt::None,
        }
    }
}

impl Service {
    /// Decides, commits, applies. Where another coordinator was first, learns what it did and decides again. Runs to
    /// its end even if the caller is dropped, so that what is remembered never differs from what is kept.
    pub(super) async fn transact<T: Send + 'static>(
        self: &Arc<Self>,
        decide: impl Fn(&Farm, Millis) -> Result<Decision<T>, Refusal> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.transact_until(Millis::MAX, decide).await
    }

    /// As [`transact`](Self::transact); after the time `last` nothing is committed.
    pub(super) async fn transact_until<T: Send + 'static>(
        self: &Arc<Self>,
        last: Millis,
        decide: impl Fn(&Farm, Millis) -> Result<Decision<T>, Refusal> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let decide = move |farm: &Farm, now: Millis| {
            let Decision { reply, changes } = decide(farm, now)?;
            let reply: Parcel = Box::new(reply);
            Ok(Decision { reply, changes })
        };
        let task = self.clone().carry_out(last, Box::new(decide));
        let reply = tokio::spawn(task).await.map_err(|_| ServiceError::Stopping)??;
        Ok(unpacked(reply))
    }

    /// Decides until what was decided is kept.
    async fn carry_out(self: Arc<Self>, last: Millis, decide: Decide) -> Result<Parcel, ServiceError> {
        let mut cell = self.fresh_farm().await?;
        loop {
            let now = self.clock.now();
            let Decision { reply, changes } = match decide(&cell.farm, now) {
                Ok(decision) => decision,
                Err(_) if self.catch_up(&mut cell).await? => continue,
                Err(refusal) => return Err(refusal.into()),
            };
            if changes.is_empty() {
                return Ok(reply);
            }
            let changes = cell.farm.with_successors(changes, now);
            let changes = self.with_notices(&cell.farm, changes)?;
            if now > last {
                return Err(garbage::too_late());
            }
            // Whatever ends this task before it says otherwise, a panic too, leaves the state to be loaded again.
            cell.doubt = Doubt::Torn;
            let kept = self
                .stores
                .state
                .commit(cell.sequence, changes.clone())
                .await
                .map_err(ServiceError::from);
            self.note(Part::State, &kept);
            match kept {
                Ok(Commit::Kept(sequence)) => {
                    cell.sequence = sequence;
                    self.apply(&mut cell, &changes, now);
                    cell.doubt = Doubt::None;
                    return Ok(reply);
                }
                Ok(Commit::Behind) => {
                    cell.doubt = Doubt::None;
                    self.catch_up(&mut cell).await?;
                }
                Err(error @ ServiceError::Store(StoreError::TooLate)) => {
                    cell.doubt = Doubt::None;
                    return Err(error);
                }
                Err(error) => {
                    cell.doubt = Doubt::Outcome;
                    return Err(error);
                }
            }
        }
    }

    /// Applies changes of this coordinator that are kept.
    fn apply(self: &Arc<Self>, cell: &mut FarmCell, changes: &[Change], now: Millis) {
        let garbage = garbage::superfluous(&cell.farm, changes);
        self.histories.before(&cell.farm, changes, now);
        self.trace_changes(&cell.farm, changes, now);
        for change in changes {
            journal::note(&cell.farm, change);
            self.counts.note(change);
            self.log.note(&cell.farm, change, now);
            if let Change::JobEnded { job, .. } = change
                && let Some(job) = cell.farm.job(*job)
            {
                job.live_nodes().for_each(|(_, digest)| self.at_hand.forget(digest));
            }
            cell.farm.evolve(change, now);
        }
        self.histories.after(&cell.farm, changes, now);
        self.notify(changes);
        self.collect(garbage);
    }

    /// Learns what other coordinators changed. Returns whether there was anything.
    pub(super) async fn catch_up(self: &Arc<Self>, cell: &mut FarmCell) -> Result<bool, ServiceError> {
        if !self.stores.state.is_shared() {
            return Ok(false);
        }
        match self.stores.state.news(cell.sequence).await? {
            News::Changes(sequence, changes) => {
                let moved = sequence != cell.sequence;
                let now = self.clock.now();
                cell.doubt = Doubt::Torn;
                self.histories.before(&cell.farm, &changes, now);
                for change in &changes {
                    self.log.note(&cell.farm, change, now);
                    cell.farm.evolve(change, now);
                }
                self.histories.after(&cell.farm, &changes, now);
                cell.sequence = sequence;
                cell.doubt = Doubt::None;
                if moved {
                    self.notify(&changes);
                    self.fold_news(&changes);
                }
                Ok(moved)
            }
            News::Forgotten => {
                self.reload(cell).await?;
                Ok(true)
            }
        }
    }

    pub(super) async fn reload(&self, cell: &mut FarmCell) -> Result<(), ServiceError> {
        let (sequence, snapshot) = self.stores.state.load().await?;
        cell.farm = Farm::restore(cell.farm.config().clone(), snapshot, self.clock.now());
        cell.sequence = sequence;
        Ok(())
    }

    /// The farm's state, brought up to date if a commit left it in doubt.
    pub(super) async fn fresh_farm(self: &Arc<Self>) -> Result<MutexGuard<'_, FarmCell>, ServiceError> {
        let mut cell = self.farm.lock().await;
        match cell.doubt {
            Doubt::None => return Ok(cell),
            Doubt::Outcome if self.stores.state.is_shared() => _ = self.catch_up(&mut cell).await?,
            Doubt::Outcome | Doubt::Torn => {
                tracing::warn!("the farm's state is loaded again: what became of a change is not known");
                self.reload(&mut cell).await?;
            }
        }
        cell.doubt = Doubt::None;
        Ok(cell)
    }

    fn notify(&self, changes: &[Change]) {
        self.progress.send_modify(|version| *version += 1);
        let makes_work = |change: &Change| {
            matches!(
                change,
                Change::JobSubmitted(_)
                    | Change::JobChanged { .. }
                    | Change::JobReopened { .. }
                    | Change::LeaseEnded { .. }
                    | Change::NodeJudged { .. }
                    | Change::NodeLost { .. }
                    | Change::FailuresForgotten { .. }
            )
        };
        if changes.iter().any(makes_work) {
            self.waiters.wake();
        }
        if changes.iter().any(|change| matches!(change, Change::NoticeAdded(_))) {
            self.told.notify_one();
        }
    }
}
