//! Checks are lent, renewed, lost, answered and forgotten as they should be.

use super::table::{AGE, ATTEMPTS, FOR_IDLE, FOR_OTHERS, Full, LONGEST, MOST, MOST_OF_OWNER, Table};
use crate::scheduler::record::Millis;
use photonfarm_proto::check::{CheckAnswer, CheckError, CheckFailure, CheckSpec, CheckState, CheckStatus, CheckToken};
use photonfarm_proto::id::{CheckId, WorkerId};
use photonfarm_proto::waiting::Waiting;
use serde_json::json;

/// How long a check is lent without a sign of life.
const TTL: Millis = 1000;

fn spec() -> CheckSpec {
    let scene = photonfarm_proto::id::BlobHash::of(b"scene");
    serde_json::from_value(json!({"scene": scene, "main": "a.xml", "integrator": {"type": "path"}})).unwrap()
}

fn add(table: &mut Table, id: u64, owner: &str, now: Millis) -> Result<(), Full> {
    table.add(CheckId(id), owner, spec(), now)
}

/// A table with the check 1, asked for at time 0.
fn one() -> Table {
    let mut table = Table::default();
    add(&mut table, 1, "ann", 0).unwrap();
    table
}

/// An idle worker asks; the nonce is its number.
fn take(table: &mut Table, worker: u64, now: Millis) -> Option<CheckToken> {
    let granted = table.grant((WorkerId(worker), worker), false, now, now + TTL);
    granted.map(|check| check.token)
}

/// A worker at work asks.
fn take_beside(table: &mut Table, worker: u64, now: Millis) -> Option<CheckToken> {
    let granted = table.grant((WorkerId(worker), worker), true, now, now + TTL);
    granted.map(|check| check.token)
}

fn status(table: &Table, id: u64) -> CheckStatus {
    let why_not = (Waiting::Turn, "its turn has not come".into());
    table.status(CheckId(id), why_not).unwrap().1
}

fn state(table: &Table, id: u64) -> CheckState {
    status(table, id).state
}

fn failure() -> CheckAnswer {
    CheckAnswer::Failure(CheckFailure::one(CheckError::of_request(None, "a.xml:1: no")))
}

fn elsewhere() -> CheckAnswer {
    CheckAnswer::Elsewhere("the network is down".into())
}

#[test]
fn the_oldest_check_is_lent_and_a_worker_has_one_at_a_time() {
    let mut table = one();
    add(&mut table, 2, "bob", 0).unwrap();
    assert_eq!(state(&table, 1), CheckState::Waiting);
    let first = take(&mut table, 7, 1).unwrap();
    assert_eq!(
        (first.id, first.nonce, state(&table, 1)),
        (CheckId(1), 7, CheckState::Checking)
    );
    assert_eq!(take(&mut table, 7, 2), None);
    assert_eq!(take(&mut table, 8, 2).unwrap().id, CheckId(2));
    assert_eq!(take(&mut table, 9, 2), None);
    assert!(!table.has_waiting());
}

#[test]
fn an_answer_counts_under_its_token_alone() {
    let mut table = one();
    let token = take(&mut table, 7, 1).unwrap();
    let forged = CheckToken { nonce: 8, ..token };
    assert!(!table.answer(forged, WorkerId(7), failure(), 2));
    assert!(!table.answer(token, WorkerId(8), failure(), 2));
    assert!(table.answer(token, WorkerId(7), failure(), 2));
    assert!(!table.answer(token, WorkerId(7), failure(), 3), "it counts once");
    let done = status(&table, 1);
    assert_eq!((done.state, done.failure.unwrap().errors.len()), (CheckState::Done, 1));
    assert_eq!(take(&mut table, 9, 4), None);
    let (owner, _) = table.status(CheckId(1), (Waiting::Turn, String::new())).unwrap();
    assert_eq!(owner, "ann");
}

#[test]
fn a_silent_worker_loses_its_check_and_one_that_is_heard_of_does_not() {
    let mut table = one();
    let token = take(&mut table, 7, 0).unwrap();
    table.renew(token, WorkerId(7), 900 + TTL);
    assert!(!table.expire(1899));
    assert_eq!(state(&table, 1), CheckState::Checking);
    assert!(table.expire(1900));
    let waiting = status(&table, 1);
    assert_eq!(waiting.waiting_reason, Some(Waiting::Rest));
    assert!(waiting.waiting.unwrap().contains("worker 7 was lost"));
    assert!(
        !table.answer(token, WorkerId(7), failure(), 1901),
        "another one may have it"
    );
    assert_eq!(take(&mut table, 8, 1901).unwrap().id, CheckId(1));
    let slow = table.status(CheckId(1), (Waiting::NoWorker, "no worker is connected".into()));
    assert_eq!(slow.unwrap().1.waiting, None);
}

#[test]
fn a_worker_that_gives_signs_of_life_for_ever_loses_its_check_too() {
    let mut table = one();
    let token = take(&mut table, 7, 0).unwrap();
    for now in (0..LONGEST).step_by(500) {
        table.renew(token, WorkerId(7), now + TTL);
        assert!(!table.expire(now));
    }
    assert!(table.expire(LONGEST));
    assert!(status(&table, 1).waiting.unwrap().contains("180 s"));
}

#[test]
fn whoever_failed_leaves_a_check_to_others_and_the_third_failure_ends_it() {
    let mut table = one();
    for attempt in 1..=ATTEMPTS as u64 {
        let now = attempt * 10 * FOR_OTHERS;
        let token = take(&mut table, 7, now).unwrap();
        assert!(table.answer(token, WorkerId(7), elsewhere(), now));
        assert_eq!(take(&mut table, 7, now + FOR_OTHERS - 1), None);
    }
    let given_up = status(&table, 1);
    assert_eq!((given_up.state, given_up.failure), (CheckState::Failed, None));
    let reason = given_up.reason.unwrap();
    assert!(
        reason.contains("3 times") && reason.contains("the network is down"),
        "{reason}"
    );
}

#[test]
fn an_answer_may_end_the_attempts() {
    let mut table = one();
    let token = take(&mut table, 7, 0).unwrap();
    let never = CheckAnswer::Never("not loaded within 120 s".into());
    assert!(table.answer(token, WorkerId(7), never, 1));
    assert_eq!(state(&table, 1), CheckState::Failed);
    assert!(!table.has_waiting());
}

#[test]
fn workers_at_work_leave_checks_to_idle_ones_for_a_while() {
    let mut table = one();
    assert_eq!(take_beside(&mut table, 7, FOR_IDLE - 1), None);
    assert!(take_beside(&mut table, 7, FOR_IDLE).is_some());
}

#[test]
fn a_worker_that_goes_is_not_blamed() {
    let mut table = one();
    for now in 0..2 * ATTEMPTS as u64 {
        take(&mut table, 7, now).unwrap();
        assert!(table.leave(WorkerId(7), now));
    }
    assert!(!table.leave(WorkerId(7), 9));
    assert_eq!(status(&table, 1).waiting_reason, Some(Waiting::Turn));
}

#[test]
fn a_new_check_of_an_owner_takes_the_place_of_the_oldest_that_no_worker_is_at() {
    let mut table = Table::default();
    let most = MOST_OF_OWNER as u64;
    for id in 1..=most {
        add(&mut table, id, "ann", 0).unwrap();
    }
    let first = take(&mut table, 1, 1).unwrap();
    let second = take(&mut table, 2, 1).unwrap();
    assert!(table.answer(second, WorkerId(2), failure(), 1));
    add(&mut table, 100, "ann", 2).unwrap();
    add(&mut table, 101, "ann", 2).unwrap();
    let known = |table: &Table, id| table.status(CheckId(id), (Waiting::Turn, String::new())).is_some();
    assert_eq!(
        [1, 2, 3, 4, 100, 101].map(|id| known(&table, id)),
        [true, false, false, true, true, true]
    );
    for worker in 10..9 + most {
        take(&mut table, worker, 3).unwrap();
    }
    assert_eq!(add(&mut table, 102, "ann", 3), Err(Full::Owner));
    assert_eq!(add(&mut table, 102, "bob", 3), Ok(()));
    assert!(table.answer(first, WorkerId(1), failure(), 4));
    assert_eq!(add(&mut table, 103, "ann", 4), Ok(()));
}

#[test]
fn the_farm_has_so_many_checks_and_forgets_old_ones() {
    let mut table = Table::default();
    for id in 0..MOST as u64 {
        add(&mut table, id, &(id % 8).to_string(), id).unwrap();
    }
    assert_eq!(add(&mut table, 1000, "ann", 100), Err(Full::Farm));
    let token = take(&mut table, 7, 100).unwrap();
    assert!(table.answer(token, WorkerId(7), failure(), 100));
    assert_eq!(add(&mut table, 1000, "ann", 101), Ok(()), "an answered one goes");
    assert!(table.expire(AGE + 1));
    assert!(table.status(CheckId(1), (Waiting::Turn, String::new())).is_none());
    assert_eq!(state(&table, 2), CheckState::Waiting);
}

#[test]
fn figures_tell_what_is_open_and_how_checks_ended() {
    let mut table = one();
    for id in 2..=4 {
        add(&mut table, id, "ann", 0).unwrap();
    }
    let token = take(&mut table, 7, 1).unwrap();
    let figures = table.figures();
    assert_eq!((figures.waiting, figures.lent), (3, 1));
    assert!(table.answer(token, WorkerId(7), failure(), 2));
    let token = take(&mut table, 7, 3).unwrap();
    assert!(table.answer(token, WorkerId(7), CheckAnswer::Never("no memory".into()), 4));
    // The third is given to workers in vain, and nobody takes the fourth.
    let mut now = 5;
    for worker in 8..8 + ATTEMPTS as u64 {
        assert_eq!(take(&mut table, worker, now).unwrap().id, CheckId(3));
        now += TTL;
        assert!(table.expire(now));
    }
    table.expire(AGE);
    let figures = table.figures();
    assert_eq!((figures.waiting, figures.lent), (0, 0));
    let ended = [("report", 0), ("failure", 1), ("unanswered", 2), ("forgotten", 1)];
    assert_eq!(figures.ended, ended);
}
