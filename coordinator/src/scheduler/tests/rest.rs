//! Workers that rest.

use super::*;
use photonfarm_proto::rest::{RestReason, Resting};
use photonfarm_proto::waiting::Waiting;

const JOB: JobId = JobId(1);
const RESTING: Resting = Resting {
    reason: RestReason::Hours,
    until_ms: Some(1_764_529_200_000),
};

fn rest(farm: &mut Farm, worker: u64, held: &[LeaseToken], now: Millis) {
    let asked = asked(farm, worker, held);
    farm.asks(asked.worker, asked.serial, now).unwrap();
    commit(farm, now, |farm| farm.rest(&asked, RESTING).unwrap());
}

#[test]
fn a_worker_that_rests_keeps_what_it_names_and_gets_no_more_until_it_asks() {
    let mut farm = farm_with(8, 1);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    rest(&mut farm, 1, &[lease.token], 1);
    assert_eq!(farm.worker_statuses(1)[0].rest, Some(RESTING));
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 1),
        Ok(Delivered::Counted)
    );
    let status = farm.status(farm.job(JOB).unwrap(), 1);
    assert_eq!(status.waiting_reason, Some(Waiting::Resting));
    let text = status.waiting.unwrap();
    assert!(text.ends_with("the first until 2025-11-30T19:00:00.000Z"), "{text}");
    assert_eq!(farm.figures(1).waiting.get(&Waiting::Resting), Some(&1));
    let said = asked(&farm, 1, &[]);
    let again = farm.rest(&said, RESTING).unwrap();
    assert_eq!(again.changes, [], "it is said once");
    // The first request ends the rest, and is repeated by the coordinator itself.
    assert_eq!(grant(&mut farm, 1, &[], 2), None);
    assert_eq!(farm.worker_statuses(2)[0].rest, None);
    assert!(grant(&mut farm, 1, &[], 2).is_some());
}

#[test]
fn a_lease_that_was_granted_as_the_rest_began_goes_back() {
    let mut farm = farm_with(8, 2);
    let lost = grant(&mut farm, 1, &[], 0).unwrap();
    rest(&mut farm, 1, &[], 1);
    assert!(farm.job(JOB).unwrap().leases_held().is_empty());
    let other = grant(&mut farm, 2, &[], 1).unwrap();
    assert_eq!(other.node, lost.node);
    assert!(farm.job(JOB).unwrap().failed_attempts().is_empty(), "nobody is blamed");
}

#[test]
fn a_rest_that_a_later_request_has_overtaken_counts_no_more() {
    let mut farm = farm_with(8, 1);
    let late = asked(&farm, 1, &[]);
    let lease = {
        let asked = Asked {
            serial: late.serial + 1,
            ..late.clone()
        };
        farm.asks(asked.worker, asked.serial, 0).unwrap();
        commit(&mut farm, 0, |farm| farm.lease(&asked, 0).unwrap()).unwrap()
    };
    commit(&mut farm, 0, |farm| farm.rest(&late, RESTING).unwrap());
    assert_eq!(farm.worker_statuses(0)[0].rest, None);
    assert_eq!(farm.job(JOB).unwrap().leases_held()[0].record.token, lease.token);
    let unknown = Asked {
        worker: WorkerId(9),
        ..late
    };
    assert_eq!(
        farm.rest(&unknown, RESTING).err(),
        Some(Refusal::UnknownWorker(WorkerId(9)))
    );
}

/// One that rests for longer than silent workers are remembered is remembered by what it says.
#[test]
fn a_worker_that_rests_is_not_forgotten() {
    let mut farm = farm_with(1, 1);
    let step = farm.config().forget_worker_ms / 2;
    for now in (1..6).map(|times| times * step) {
        rest(&mut farm, 1, &[], now);
        commit(&mut farm, now, |farm| farm.expire(now));
        assert_eq!(farm.worker_statuses(now).len(), 1);
    }
}
