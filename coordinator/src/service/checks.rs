//! Checks: a worker loads a scene before a job is made of it. What is asked and what is answered is kept in memory, for some
//! minutes, and lost at a start: whoever misses it asks again.

mod table;
#[cfg(test)]
mod tests;

use super::{Service, ServiceError, random_bits};
use crate::access::Caller;
use crate::scheduler::record::Millis;
use photonfarm_proto::check::{
    ANSWER_BYTES, CheckAssignment, CheckResult, CheckSpec, CheckState, CheckStatus, Checking,
};
use photonfarm_proto::id::{CheckId, WorkerId};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::Role;
use photonfarm_proto::worker::Heartbeat;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use table::{Full, Table};
use tokio::sync::watch;

pub(crate) use table::CheckFigures;

/// Seconds after which whoever found the table full may ask again.
const RETRY_S: u16 = 5;

/// The checks of this coordinator.
#[derive(Debug, Default)]
pub(super) struct Checks {
    table: Mutex<Table>,
    /// Rises whenever one of them has changed.
    changed: watch::Sender<u64>,
}

impl Checks {
    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note_change(&self) {
        self.changed.send_modify(|version| *version += 1);
    }

    /// What the clock makes happen.
    pub(super) fn pass_time(&self, now: Millis) {
        if self.table().expire(now) {
            self.note_change();
        }
    }

    /// A worker has gone: what it was at waits again, without blame.
    pub(super) fn leave(&self, worker: WorkerId, now: Millis) {
        if self.table().leave(worker, now) {
            self.note_change();
        }
    }
}

impl Service {
    /// Checks in figures.
    pub(crate) fn check_figures(&self) -> CheckFigures {
        self.checks.table().figures()
    }

    /// Asks for a check.
    pub(crate) async fn ask_check(
        self: &Arc<Self>,
        spec: CheckSpec,
        caller: &Caller,
    ) -> Result<CheckStatus, ServiceError> {
        self.check_job(&spec.clone().job()).await?;
        // Browsers read numbers of 53 bits.
        let id = CheckId(random_number()? >> 11);
        let added = self.checks.table().add(id, &caller.name, spec, self.clock.now());
        added.map_err(|full| {
            let detail = match full {
                Full::Owner => "all checks that were asked for with this token are with workers: wait for one of them",
                Full::Farm => "the farm has as many checks as it takes: wait until some are done",
            };
            Problem::new(ErrorCode::TooManyRequests, detail).after(RETRY_S)
        })?;
        self.checks.note_change();
        self.waiters.wake();
        self.check_status(id, caller, Duration::ZERO).await
    }

    /// How far a check has come: as soon as that is final, or after some time.
    pub(crate) async fn check_status(
        self: &Arc<Self>,
        id: CheckId,
        caller: &Caller,
        wait: Duration,
    ) -> Result<CheckStatus, ServiceError> {
        let last = Instant::now() + wait;
        let (mut changed, mut stopping) = (self.checks.changed.subscribe(), self.stopping());
        loop {
            changed.borrow_and_update();
            let status = self.check_now(id, caller).await?;
            let is_final = matches!(status.state, CheckState::Done | CheckState::Failed);
            let left = last.saturating_duration_since(Instant::now());
            if is_final || left.is_zero() || *stopping.borrow() {
                return Ok(status);
            }
            tokio::select! {
                _ = changed.changed() => {}
                _ = stopping.changed() => {}
                () = tokio::time::sleep(left) => {}
            }
        }
    }

    async fn check_now(self: &Arc<Self>, id: CheckId, caller: &Caller) -> Result<CheckStatus, ServiceError> {
        let why_not = self.fresh_farm().await?.farm.waiting_check();
        let table = self.checks.table();
        let (owner, status) = table.status(id, why_not).ok_or_else(|| {
            let detail = format!(
                "there is no check {id}: a coordinator keeps checks for ten minutes, and loses them when it starts; ask again"
            );
            Problem::new(ErrorCode::NotFound, detail)
        })?;
        if caller.role != Role::Admin && owner != caller.name {
            let detail = format!("check {id} was not asked for with the token {:?}", caller.name);
            return Err(Problem::new(ErrorCode::Forbidden, detail).into());
        }
        Ok(status)
    }

    /// A check for a worker that asks for work.
    pub(super) async fn grant_check(
        self: &Arc<Self>,
        worker: WorkerId,
        serial: u64,
    ) -> Result<Option<CheckAssignment>, ServiceError> {
        self.lend_check(worker, Some(serial)).await
    }

    /// A worker at work says what it does about checks. It is lent one that idle workers have not taken.
    pub(crate) async fn beat_check(
        self: &Arc<Self>,
        heartbeat: &Heartbeat,
    ) -> Result<Option<CheckAssignment>, ServiceError> {
        match heartbeat.checking {
            Checking::Not => Ok(None),
            Checking::Ready => self.lend_check(heartbeat.worker, None).await,
            Checking::At(token) => {
                let ttl = self.check_ttl().await?;
                self.checks
                    .table()
                    .renew(token, heartbeat.worker, self.clock.now() + ttl);
                Ok(None)
            }
        }
    }

    async fn lend_check(
        self: &Arc<Self>,
        worker: WorkerId,
        serial: Option<u64>,
    ) -> Result<Option<CheckAssignment>, ServiceError> {
        if !self.checks.table().has_waiting() {
            return Ok(None);
        }
        let ttl = self.check_ttl().await?;
        if !self.fresh_farm().await?.farm.may_check(worker, serial) {
            return Ok(None);
        }
        let (nonce, now) = (random_number()?, self.clock.now());
        let beside = serial.is_none();
        let lent = self.checks.table().grant((worker, nonce), beside, now, now + ttl);
        if let Some(check) = &lent {
            tracing::debug!(%worker, check = %check.token.id, "a check is lent");
            self.checks.note_change();
        }
        Ok(lent)
    }

    /// How long a check is lent without a sign of life: some heartbeats.
    async fn check_ttl(self: &Arc<Self>) -> Result<Millis, ServiceError> {
        Ok(self.fresh_farm().await?.farm.config().lease_ttl_ms / 2)
    }

    /// A worker has answered.
    pub(crate) fn answer_check(&self, result: CheckResult) -> Result<(), ServiceError> {
        let CheckResult { token, worker, answer } = result;
        let bytes = serde_json::to_string(&answer).map_or(usize::MAX, |text| text.len());
        if bytes > ANSWER_BYTES {
            let detail = format!("the answer has {bytes} bytes, and one to a check has at most {ANSWER_BYTES}");
            return Err(Problem::new(ErrorCode::Limit, detail).into());
        }
        if !self.checks.table().answer(token, worker, answer, self.clock.now()) {
            let detail = format!("check {} is not lent to worker {worker} any more", token.id);
            return Err(Problem::new(ErrorCode::StaleLease, detail).into());
        }
        self.checks.note_change();
        // Another worker may be needed.
        self.waiters.wake();
        Ok(())
    }
}

fn random_number() -> Result<u64, Problem> {
    let [a, b, c, d, e, f, g, h, ..] = random_bits()?;
    Ok(u64::from_le_bytes([a, b, c, d, e, f, g, h]))
}
