//! Checks as a table, without a clock and without chance.

use crate::scheduler::record::Millis;
use photonfarm_proto::check::{CheckAnswer, CheckAssignment, CheckSpec, CheckState, CheckStatus, CheckToken};
use photonfarm_proto::id::{CheckId, WorkerId};
use photonfarm_proto::waiting::Waiting;

/// Most checks at once.
pub(super) const MOST: usize = 64;
/// Most of them that were asked for with one token.
pub(super) const MOST_OF_OWNER: usize = 16;
/// How long a check is kept after it was asked for \[ms\].
pub(super) const AGE: Millis = 600_000;
/// Workers that may fail to answer.
pub(super) const ATTEMPTS: usize = 3;
/// How long a worker may be at a check, whatever signs of life it gives: longer than workers give themselves \[ms\].
pub(super) const LONGEST: Millis = 180_000;
/// How long a check is left to idle workers \[ms\].
pub(super) const FOR_IDLE: Millis = 2_000;
/// How long a worker that has failed to answer leaves the check to others \[ms\].
pub(super) const FOR_OTHERS: Millis = 5_000;

/// Why there is no room for another check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Full {
    /// All that the token may have are with workers.
    Owner,
    /// All that the farm may have are asked for.
    Farm,
}

#[derive(Debug)]
enum State {
    /// Since when.
    Waiting(Millis),
    Lent(Lent),
    Answered(CheckAnswer),
}

#[derive(Clone, Copy, Debug)]
struct Lent {
    worker: WorkerId,
    nonce: u64,
    since: Millis,
    until: Millis,
}

/// A worker that did not answer.
#[derive(Debug)]
struct Attempt {
    worker: WorkerId,
    at: Millis,
    reason: String,
}

#[derive(Debug)]
struct Check {
    id: CheckId,
    owner: String,
    spec: CheckSpec,
    asked: Millis,
    state: State,
    failed: Vec<Attempt>,
}

impl Check {
    fn lent(&self) -> Option<&Lent> {
        match &self.state {
            State::Lent(lent) => Some(lent),
            _ => None,
        }
    }

    fn is_answered(&self) -> bool {
        matches!(self.state, State::Answered(_))
    }

    /// Whether a worker may be lent it. One that is at work (`beside` which it would load the scene) leaves it to idle ones
    /// first, and one that has failed at it to others.
    fn is_for(&self, worker: WorkerId, beside: bool, now: Millis) -> bool {
        let State::Waiting(since) = self.state else {
            return false;
        };
        let left_to_idle = beside && now < since + FOR_IDLE;
        let mut mine = self.failed.iter().filter(|attempt| attempt.worker == worker);
        !left_to_idle && mine.all(|attempt| now >= attempt.at + FOR_OTHERS)
    }

    /// The worker that has it did not answer, which may end it.
    fn fail(&mut self, lent: Lent, reason: String, now: Millis) -> Option<Outcome> {
        self.failed.push(Attempt {
            worker: lent.worker,
            at: now,
            reason: reason.clone(),
        });
        if self.failed.len() < ATTEMPTS {
            self.state = State::Waiting(now);
            return None;
        }
        self.state = State::Answered(CheckAnswer::Never(format!(
            "it was given to workers {ATTEMPTS} times, and none answered; the last time: {reason}"
        )));
        Some(Outcome::Unanswered)
    }
}

/// How checks end, in the order of [`OUTCOMES`].
#[derive(Clone, Copy, Debug)]
enum Outcome {
    Report,
    Failure,
    Unanswered,
    Forgotten,
}

/// The names of that in figures.
const OUTCOMES: [&str; 4] = ["report", "failure", "unanswered", "forgotten"];

/// Checks in figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CheckFigures {
    /// Those that no worker is at.
    pub(crate) waiting: u64,
    /// Those that a worker is at.
    pub(crate) lent: u64,
    /// Those that ended, by the name of how.
    pub(crate) ended: [(&'static str, u64); 4],
}

/// Checks, oldest first.
#[derive(Debug, Default)]
pub(super) struct Table {
    checks: Vec<Check>,
    /// How many ended, in the order of [`OUTCOMES`].
    ended: [u64; 4],
}

impl Table {
    /// Takes up a check. Where its owner has as many as one may have, it takes the place of the oldest that no worker is at;
    /// where the farm has, that of the oldest that is answered.
    pub(super) fn add(&mut self, id: CheckId, owner: &str, spec: CheckSpec, now: Millis) -> Result<(), Full> {
        self.expire(now);
        let is_own = |check: &Check| check.owner == owner;
        if self.checks.iter().filter(|check| is_own(check)).count() >= MOST_OF_OWNER {
            let answered = self
                .checks
                .iter()
                .position(|check| is_own(check) && check.is_answered());
            let idle = || {
                self.checks
                    .iter()
                    .position(|check| is_own(check) && check.lent().is_none())
            };
            let oldest = answered.or_else(idle).ok_or(Full::Owner)?;
            if !self.checks.remove(oldest).is_answered() {
                self.count(Outcome::Forgotten);
            }
        } else if self.checks.len() >= MOST {
            let oldest = self.checks.iter().position(Check::is_answered).ok_or(Full::Farm)?;
            self.checks.remove(oldest);
        }
        self.checks.push(Check {
            id,
            owner: owner.to_owned(),
            spec,
            asked: now,
            state: State::Waiting(now),
            failed: Vec::new(),
        });
        Ok(())
    }

    fn count(&mut self, outcome: Outcome) {
        self.ended[outcome as usize] += 1;
    }

    /// Checks in figures.
    pub(super) fn figures(&self) -> CheckFigures {
        let waiting = self
            .checks
            .iter()
            .filter(|check| matches!(check.state, State::Waiting(_)));
        CheckFigures {
            waiting: waiting.count() as u64,
            lent: self.lent().count() as u64,
            ended: std::array::from_fn(|outcome| (OUTCOMES[outcome], self.ended[outcome])),
        }
    }

    /// Whether a worker may be needed.
    pub(super) fn has_waiting(&self) -> bool {
        self.checks.iter().any(|check| matches!(check.state, State::Waiting(_)))
    }

    /// Lends the oldest check that there is for a worker, under a nonce; a worker has one at a time.
    pub(super) fn grant(
        &mut self,
        (worker, nonce): (WorkerId, u64),
        beside: bool,
        now: Millis,
        until: Millis,
    ) -> Option<CheckAssignment> {
        self.expire(now);
        if self.lent().any(|lent| lent.worker == worker) {
            return None;
        }
        let check = self.checks.iter_mut().find(|check| check.is_for(worker, beside, now))?;
        check.state = State::Lent(Lent {
            worker,
            nonce,
            since: now,
            until,
        });
        Some(CheckAssignment {
            token: CheckToken { id: check.id, nonce },
            spec: check.spec.clone(),
        })
    }

    fn lent(&self) -> impl Iterator<Item = &Lent> {
        self.checks.iter().filter_map(Check::lent)
    }

    /// The check that is lent to a worker under a token.
    fn held(&mut self, token: CheckToken, worker: WorkerId) -> Option<(&mut Check, Lent)> {
        let check = self.checks.iter_mut().find(|check| check.id == token.id)?;
        let lent = *check.lent()?;
        (lent.worker == worker && lent.nonce == token.nonce).then_some((check, lent))
    }

    /// A sign of life.
    pub(super) fn renew(&mut self, token: CheckToken, worker: WorkerId, until: Millis) {
        if let Some((check, lent)) = self.held(token, worker) {
            check.state = State::Lent(Lent { until, ..lent });
        }
    }

    /// A worker's answer. Replies whether the check was lent to it.
    pub(super) fn answer(&mut self, token: CheckToken, worker: WorkerId, answer: CheckAnswer, now: Millis) -> bool {
        let Some((check, lent)) = self.held(token, worker) else {
            return false;
        };
        let outcome = match answer {
            CheckAnswer::Elsewhere(reason) => check.fail(lent, reason, now),
            answer => {
                let outcome = match &answer {
                    CheckAnswer::Report(_) => Outcome::Report,
                    CheckAnswer::Failure(_) => Outcome::Failure,
                    CheckAnswer::Never(_) | CheckAnswer::Elsewhere(_) => Outcome::Unanswered,
                };
                check.state = State::Answered(answer);
                Some(outcome)
            }
        };
        outcome.into_iter().for_each(|outcome| self.count(outcome));
        true
    }

    /// A worker has gone. Replies whether it was at a check.
    pub(super) fn leave(&mut self, worker: WorkerId, now: Millis) -> bool {
        let left = self
            .checks
            .iter_mut()
            .find(|check| check.lent().is_some_and(|lent| lent.worker == worker));
        left.map(|check| check.state = State::Waiting(now)).is_some()
    }

    /// What the clock makes happen: workers were silent or busy for too long, and what is old is forgotten. Replies whether
    /// there was any of that.
    pub(super) fn expire(&mut self, now: Millis) -> bool {
        let mut outcomes = Vec::new();
        let before = self.checks.len();
        self.checks.retain(|check| {
            let stays = now < check.asked + AGE;
            if !stays && !check.is_answered() {
                outcomes.push(Outcome::Forgotten);
            }
            stays
        });
        let mut changed = self.checks.len() < before;
        for check in &mut self.checks {
            let Some(lent) = check.lent().copied() else { continue };
            let reason = if now >= lent.until {
                format!("worker {} was lost", lent.worker)
            } else if now >= lent.since + LONGEST {
                format!("worker {} did not answer within {} s", lent.worker, LONGEST / 1000)
            } else {
                continue;
            };
            outcomes.extend(check.fail(lent, reason, now));
            changed = true;
        }
        outcomes.into_iter().for_each(|outcome| self.count(outcome));
        changed
    }

    /// The owner of a check, and how far it has come. Where no worker is at it, this is `why_not`, unless some have failed.
    pub(super) fn status(&self, id: CheckId, why_not: (Waiting, String)) -> Option<(&str, CheckStatus)> {
        let check = self.checks.iter().find(|check| check.id == id)?;
        let mut status = CheckStatus {
            id,
            state: CheckState::Done,
            waiting: None,
            waiting_reason: None,
            report: None,
            failure: None,
            reason: None,
        };
        match &check.state {
            State::Waiting(_) => {
                let why = match (check.failed.last(), why_not.0) {
                    (Some(Attempt { reason, .. }), Waiting::Turn) => {
                        (Waiting::Rest, format!("another worker is to try, since {reason}"))
                    }
                    _ => why_not,
                };
                status.state = CheckState::Waiting;
                (status.waiting_reason, status.waiting) = (Some(why.0), Some(why.1));
            }
            State::Lent(_) => status.state = CheckState::Checking,
            State::Answered(CheckAnswer::Report(report)) => status.report = Some((**report).clone()),
            State::Answered(CheckAnswer::Failure(failure)) => status.failure = Some(failure.clone()),
            State::Answered(CheckAnswer::Elsewhere(reason) | CheckAnswer::Never(reason)) => {
                status.state = CheckState::Failed;
                status.reason = Some(reason.clone());
            }
        }
        Some((&check.owner, status))
    }
}
