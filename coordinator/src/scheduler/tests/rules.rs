//! What the scheduler promises, case by case.

use super::*;
use crate::store::memory::Rows;

#[test]
fn leases_grow_to_their_time_and_shrink_towards_the_end() {
    let mut farm = farm_with(64, 1);
    let mut levels = Vec::new();
    let mut now = 0;
    while let Some(lease) = grant(&mut farm, 1, &[], now) {
        levels.push(lease.node.level);
        now += 3_000 * lease.node.leaves();
        deliver(&mut farm, &delivery(&lease, lease.node), now).unwrap();
    }
    assert_eq!(
        levels,
        [0, 0, 1, 2, 3, 3, 3, 3, 3, 3, 2, 1, 0, 0],
        "at 3 s each, a lease of 30 s has 8 leaves"
    );
}

#[test]
fn several_workers_leave_each_other_a_share() {
    let mut farm = farm_with(16, 4);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&first, first.node), 100).unwrap();
    for worker in 1..=4 {
        let lease = grant(&mut farm, worker, &[], 200).unwrap();
        assert!(lease.node.leaves() <= 2, "{:?}", lease.node);
    }
}

#[test]
fn a_repeated_node_is_known_and_another_digest_is_an_incident() {
    let mut farm = farm_with(4, 2);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let good = delivery(&lease, lease.node);
    assert_eq!(deliver(&mut farm, &good, 1), Ok(Delivered::Counted));
    assert_eq!(deliver(&mut farm, &good, 2), Ok(Delivered::Duplicate));
    let bad = Delivery {
        digest: BlobHash::of(b"other"),
        ..good
    };
    assert!(matches!(deliver(&mut farm, &bad, 3), Err(Refusal::Conflict { .. })));
    assert_eq!(farm.job(JobId(1)).unwrap().done(), 1);
}

#[test]
fn stale_and_foreign_tokens_are_refused() {
    let mut farm = farm_with(4, 2);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let foreign = Delivery {
        worker: WorkerId(2),
        ..delivery(&lease, lease.node)
    };
    assert_eq!(deliver(&mut farm, &foreign, 1), Err(Refusal::StaleLease(lease.token)));
    commit(&mut farm, 40_000, |farm| farm.expire(40_000));
    let late = delivery(&lease, lease.node);
    assert_eq!(deliver(&mut farm, &late, 40_001), Err(Refusal::StaleLease(lease.token)));
    let again = grant(&mut farm, 2, &[], 40_002).unwrap();
    assert_eq!((again.node, again.attempt), (lease.node, 2));
    assert!(again.token > lease.token);
}

#[test]
fn heartbeats_keep_a_lease_and_name_lost_ones() {
    let mut farm = farm_with(4, 1);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let beat = |token| [LeaseProgress { token, leaves_done: 0 }];
    for now in [20_000, 40_000, 60_000] {
        assert_eq!(farm.heartbeat(WorkerId(1), &beat(lease.token), now), Ok(vec![]));
        assert_eq!(farm.expire(now).changes, []);
    }
    commit(&mut farm, 90_001, |farm| farm.expire(90_001));
    assert_eq!(
        farm.heartbeat(WorkerId(1), &beat(lease.token), 90_002),
        Ok(vec![lease.token])
    );
    assert_eq!(
        farm.heartbeat(WorkerId(9), &[], 0),
        Err(Refusal::UnknownWorker(WorkerId(9)))
    );
}

#[test]
fn an_iteration_is_given_up_after_its_failures_and_the_job_says_so() {
    let mut farm = farm_with(2, 1);
    for attempt in 1..=3 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        assert_eq!((lease.node, lease.attempt), (NodeKey::leaf(0), attempt));
        let failed = Attempt {
            worker: WorkerId(1),
            kind: FailureKind::Panic,
            message: format!("boom {attempt}"),
            at_ms: 0,
        };
        commit(&mut farm, 0, |farm| {
            farm.fail(lease.job, lease.token, 0, failed, 0).unwrap()
        });
    }
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(lease.node, NodeKey::leaf(1));
    deliver(&mut farm, &delivery(&lease, lease.node), 0).unwrap();
    let settled = farm.settle(lease.job, 5).changes;
    let [
        Change::JobEnded {
            state: JobState::Failed,
            failure: Some(failure),
            ..
        },
    ] = settled.as_slice()
    else {
        panic!("{settled:?}");
    };
    assert!(
        failure.contains("1 of 2") && failure.contains("iteration 1") && failure.contains("boom 3"),
        "{failure}"
    );
}

#[test]
fn a_fault_of_the_scene_ends_the_job_at_once() {
    let mut farm = farm_with(8, 1);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let fault = Attempt {
        worker: WorkerId(1),
        kind: FailureKind::Scene,
        message: "scene.xml:3: no".into(),
        at_ms: 0,
    };
    commit(&mut farm, 0, |farm| {
        farm.fail(lease.job, lease.token, 0, fault, 0).unwrap()
    });
    assert!(farm.job(lease.job).is_none());
}

#[test]
fn a_fault_of_the_scene_that_one_of_several_workers_finds_is_looked_for_by_another() {
    let fault = |worker, at_ms| Attempt {
        worker: WorkerId(worker),
        kind: FailureKind::Scene,
        message: "scene.xml:3: no".into(),
        at_ms,
    };
    let mut farm = farm_with(8, 3);
    let mut now = 0;
    for worker in [1, 2] {
        let lease = grant(&mut farm, worker, &[], now).unwrap();
        assert_eq!(lease.node, NodeKey::leaf(0), "the leaf goes to another worker");
        commit(&mut farm, now, |farm| {
            farm.fail(lease.job, lease.token, 0, fault(worker, now), now).unwrap()
        });
        assert_eq!(farm.job(lease.job).is_none(), worker == 2, "two agree");
        now += 1_500;
    }
}

#[test]
fn a_lease_whose_reply_was_lost_goes_back_without_blame() {
    let mut farm = farm_with(8, 1);
    let lost = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(
        grant(&mut farm, 1, &[], 1),
        None,
        "the first request only returns the orphan"
    );
    let again = grant(&mut farm, 1, &[], 2).unwrap();
    assert_eq!((again.node, again.attempt), (lost.node, 1));
    assert!(again.token > lost.token);
}

#[test]
fn a_straggler_gets_a_second_lease_and_the_first_result_ends_both() {
    let mut farm = farm_with(2, 2);
    let fast = grant(&mut farm, 1, &[], 0).unwrap();
    let slow = grant(&mut farm, 2, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&fast, fast.node), 3_000).unwrap();
    assert_eq!(grant(&mut farm, 1, &[], 4_000), None, "too early");
    let second = grant(&mut farm, 1, &[], 10_000).unwrap();
    assert_eq!((second.node, second.attempt), (slow.node, 2));
    assert_eq!(grant(&mut farm, 1, &[second.token], 60_000), None, "no third");
    assert_eq!(
        deliver(&mut farm, &delivery(&second, second.node), 61_000),
        Ok(Delivered::Counted)
    );
    assert_eq!(
        deliver(&mut farm, &delivery(&slow, slow.node), 62_000),
        Ok(Delivered::Duplicate)
    );
    let beat = [LeaseProgress {
        token: slow.token,
        leaves_done: 0,
    }];
    assert_eq!(farm.heartbeat(WorkerId(2), &beat, 62_000), Ok(vec![slow.token]));
}

#[test]
fn a_whole_block_takes_the_place_of_its_parts() {
    let mut farm = farm_with(4, 2);
    let (job, block) = (JobId(1), NodeKey { level: 1, index: 0 });
    let [first, second] = [1, 2].map(|number| LeaseRecord {
        token: token(number),
        job,
        node: block,
        worker: WorkerId(number),
        serial: 0,
        attempt: 1,
        granted_ms: 0,
        expected_ms: None,
        verifies: false,
        share: [0; 2],
        until_ms: 0,
        restarts: 0,
    });
    farm.evolve(&Change::LeaseGranted(first.clone()), 0);
    farm.evolve(&Change::LeaseGranted(second.clone()), 0);
    let deliveries = [(&first, NodeKey::leaf(1)), (&second, block), (&first, NodeKey::leaf(0))];
    let replies = deliveries.map(|(lease, node)| deliver(&mut farm, &delivery(lease, node), 1).unwrap());
    assert_eq!(replies, [Delivered::Counted, Delivered::Counted, Delivered::Duplicate]);
    let job = farm.job(job).unwrap();
    assert_eq!(job.live_nodes().map(|(node, _)| node).collect::<Vec<_>>(), [block]);
    assert!(job.leases.is_empty());
}

#[test]
fn an_iteration_that_was_given_up_is_not_lent_as_a_straggler() {
    let mut farm = farm_with(2, 4);
    let slow = grant(&mut farm, 2, &[], 0).unwrap();
    let fast = grant(&mut farm, 1, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&fast, fast.node), 3_000).unwrap();
    let mut now = 10_000;
    for worker in [1, 3, 4] {
        let beat = [LeaseProgress {
            token: slow.token,
            leaves_done: 0,
        }];
        farm.heartbeat(WorkerId(2), &beat, now).unwrap();
        let lease = grant(&mut farm, worker, &[], now).unwrap();
        let failed = Attempt {
            worker: WorkerId(worker),
            kind: FailureKind::Render,
            message: "no".into(),
            at_ms: 0,
        };
        commit(&mut farm, now, |farm| {
            farm.fail(lease.job, lease.token, slow.node.index, failed, now).unwrap()
        });
        now += 1_000;
    }
    assert_eq!(grant(&mut farm, 1, &[], now), None);
    assert_eq!(
        farm.settle(JobId(1), now).changes,
        [],
        "the slow worker may still deliver"
    );
    assert_eq!(
        deliver(&mut farm, &delivery(&slow, slow.node), now),
        Ok(Delivered::Counted)
    );
}

#[test]
fn leases_survive_a_restart_with_time_to_reconnect() {
    let mut rows = Rows::default();
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let mut keep = |changes: Vec<Change>| {
        for change in &changes {
            rows.apply(change);
            farm.evolve(change, 0);
        }
        farm.clone()
    };
    let farm = keep(
        Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0)
            .submit(spec(4), String::new(), None, 0)
            .changes,
    );
    let farm = keep(farm.register(introduction(), Origin::default(), 0).unwrap().changes);
    let Decision { reply, changes } = farm.lease(&asked(&farm, 1, &[]), 0).unwrap();
    keep(changes);
    let lease = reply.unwrap();
    let later = 10_000_000;
    let farm = Farm::restore(SchedulerConfig::default(), rows.snapshot(), later);
    assert_eq!(farm.expire(later + 59_000).changes, []);
    assert!(farm.expire(later + 60_000).changes.contains(&Change::LeaseEnded {
        job: lease.job,
        token: lease.token
    }));
}

#[test]
fn a_lost_parent_is_made_of_its_children_again() {
    let mut farm = farm_with(2, 1);
    for _ in 0..2 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        deliver(&mut farm, &delivery(&lease, lease.node), 1).unwrap();
    }
    let (job, parent) = (JobId(1), NodeKey { level: 1, index: 0 });
    let merge = |farm: &Farm| farm.merge(job, parent, digest(job, parent));
    assert!(commit(&mut farm, 2, merge));
    assert!(commit(&mut farm, 3, |farm| farm.lose(job, parent, "it is gone", 3)));
    assert!(!commit(&mut farm, 3, |farm| farm.lose(job, parent, "it is gone", 3)));
    assert_eq!(farm.job(job).unwrap().failures.len(), 0, "nobody is to blame");
    for _ in 0..2 {
        let lease = grant(&mut farm, 1, &[], 4).unwrap();
        let counted = deliver(&mut farm, &delivery(&lease, lease.node), 5);
        assert_eq!(counted, Ok(Delivered::Counted));
    }
    assert!(commit(&mut farm, 6, merge));
    commit(&mut farm, 7, |farm| farm.settle(job, 7));
    assert!(farm.job(job).is_none(), "the job has ended");
}

#[test]
fn a_job_ends_only_when_every_image_was_read_and_a_false_one_is_its_workers_failure() {
    let mut farm = farm_with(1, 1);
    let job = JobId(1);
    let stored = |lease: &LeaseRecord| Delivery {
        unread: true,
        ..delivery(lease, lease.node)
    };
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    deliver(&mut farm, &stored(&lease), 1).unwrap();
    assert_eq!(farm.settle(job, 2).changes, []);
    let (unread, _) = farm.job(job).unwrap().next_unread().unwrap();
    commit(&mut farm, 2, |farm| farm.lose(job, unread, "its image is missing", 2));
    let failures = &farm.job(job).unwrap().failures[&0];
    let attempts: Vec<&Attempt> = failures.iter().map(|failed| &failed.attempt).collect();
    assert_eq!(
        (attempts[0].worker, attempts[0].kind),
        (WorkerId(1), FailureKind::Render)
    );

    let lease = grant(&mut farm, 1, &[], 3).unwrap();
    assert_eq!(lease.attempt, 2);
    deliver(&mut farm, &stored(&lease), 4).unwrap();
    commit(&mut farm, 5, |farm| farm.check(job, lease.node));
    assert_eq!(farm.job(job).unwrap().next_unread(), None);
    commit(&mut farm, 6, |farm| farm.settle(job, 6));
    assert!(farm.job(job).is_none(), "the job has ended");
}
