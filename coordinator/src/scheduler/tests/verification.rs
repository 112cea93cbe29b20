//! Nodes that are repeated, workers that are confirmed, refuted, at fault, in quarantine.

use super::*;

const JOB: JobId = JobId(1);

/// A farm with workers of different names, which repeats nodes until so many in a row were confirmed.
fn farm_of(iterations: u32, workers: u64, verify_until: u32) -> Farm {
    let config = SchedulerConfig {
        verify_until,
        secret: NonceKey([3; 32]),
        retry_ms: 0,
        longest_retry_ms: 0,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    (1..=workers).for_each(|number| _ = hire(&mut farm, &format!("w{number}"), 0));
    commit(&mut farm, 0, |farm| {
        farm.submit(spec(iterations), String::new(), None, 0)
    });
    farm
}

fn send(farm: &mut Farm, lease: &LeaseRecord, bits: &str) -> Delivered {
    let delivery = Delivery {
        digest: BlobHash::of(format!("{bits} {}", lease.node).as_bytes()),
        ..delivery(lease, lease.node)
    };
    deliver(farm, &delivery, 1).unwrap()
}

fn standing(farm: &Farm, worker: u64) -> record::Standing {
    farm.workers.get(WorkerId(worker)).unwrap().record.standing.clone()
}

#[test]
fn a_node_in_doubt_is_repeated_by_another_before_it_is_merged() {
    let mut farm = farm_of(2, 2, u32::MAX);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(send(&mut farm, &lease, "right"), Delivered::Counted);
    let rest = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(rest.node, NodeKey::leaf(1), "nobody repeats its own work");
    send(&mut farm, &rest, "right");
    let job = farm.job(JOB).unwrap();
    assert_eq!((job.done(), job.next_merge()), (2, None));
    assert_eq!(farm.status(job, 1).iterations_in_doubt, 2);
    assert_eq!(farm.settle(JOB, 1).changes, []);
    for leaf in 0..2 {
        let repeat = grant(&mut farm, 2, &[], 1).unwrap();
        assert!(repeat.verifies && repeat.node == NodeKey::leaf(leaf));
        assert_eq!(send(&mut farm, &repeat, "right"), Delivered::Repeated);
    }
    assert_eq!(
        farm.job(JOB).unwrap().next_merge(),
        Some(NodeKey { level: 1, index: 0 })
    );
    assert_eq!([1, 2].map(|worker| standing(&farm, worker).verified), [2, 2]);
}

#[test]
fn a_third_worker_decides_and_the_liar_loses_its_unconfirmed_work() {
    let mut farm = farm_of(64, 3, 1);
    // Worker 1 is confirmed twice, so that some of its later nodes are not repeated.
    for _ in 0..2 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        send(&mut farm, &lease, "right");
        let repeat = grant(&mut farm, 2, &[], 0).unwrap();
        send(&mut farm, &repeat, "right");
    }
    let mut lies = Vec::new();
    while farm.job(JOB).unwrap().nodes_in_doubt().next().is_none() {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        send(&mut farm, &lease, "wrong");
        lies.push(lease.node);
    }
    assert!(
        lies.len() > 1,
        "some lies were not to be repeated: choose another secret"
    );
    let second = grant(&mut farm, 2, &[], 1).unwrap();
    send(&mut farm, &second, "right");
    assert!(farm.job(JOB).unwrap().is_disputed(second.node));
    let third = grant(&mut farm, 3, &[], 1).unwrap();
    assert_eq!((third.node, third.verifies), (second.node, true));
    send(&mut farm, &third, "right");
    assert!(standing(&farm, 1).quarantine.unwrap().contains("two others agree"));
    assert_eq!(standing(&farm, 2).verified, 3);
    let job = farm.job(JOB).unwrap();
    let left: Vec<NodeKey> = job.live_nodes().map(|(node, _)| node).collect();
    assert!(left.contains(&second.node), "the node stays, with the right bits");
    assert!(
        lies.iter()
            .all(|lie| *lie == second.node || job.covering(*lie).is_none()),
        "{left:?}"
    );
    assert_eq!(job.nodes.all[&second.node].worker, Some(WorkerId(2)));
    assert_eq!(grant(&mut farm, 1, &[], 2), None, "no work in quarantine");
    assert!(farm.worker_statuses(2)[0].quarantine.is_some());
}

#[test]
fn what_rests_on_a_liars_work_is_given_up_whole() {
    let mut farm = farm_of(4, 2, 0);
    for worker in [1, 2] {
        let lease = grant(&mut farm, worker, &[], 0).unwrap();
        send(&mut farm, &lease, "wrong");
    }
    let parent = NodeKey { level: 1, index: 0 };
    commit(&mut farm, 1, |farm| farm.merge(JOB, parent, digest(JOB, parent)));
    commit(&mut farm, 1, |farm| farm.quarantine(WorkerId(1), "by hand").unwrap());
    assert_eq!(farm.job(JOB).unwrap().done(), 0);
    assert_eq!(grant(&mut farm, 2, &[], 2).unwrap().node.first(), 0);
}

/// Binomial: with a probability of 6e-5 a right rate is off by more than four standard deviations.
#[test]
fn the_rate_falls_with_the_nodes_confirmed() {
    for (verified, until, expected) in [
        (0, 10, 1.0),
        (10, 10, 1.0),
        (40, 10, 0.25),
        (1_000, 10, 0.01),
        (7, 0, 0.0),
    ] {
        let mut farm = farm_of(1 << 20, 2, until);
        let standing = record::Standing {
            verified,
            ..record::Standing::default()
        };
        let worker = WorkerId(1);
        farm.evolve(&Change::WorkerJudged { worker, standing }, 0);
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        let job = farm.job(JOB).unwrap();
        let count = 20_000;
        let chosen = (0..count).filter(|index| {
            let delivery = delivery(&lease, NodeKey::leaf(*index));
            farm.is_chosen(job, &delivery)
        });
        let found = chosen.count() as f64 / f64::from(count);
        let deviation = (expected * (1.0 - expected) / f64::from(count)).sqrt();
        assert!(
            (found - expected).abs() <= 4.0 * deviation,
            "{found} after {verified}, not {expected}"
        );
    }
}

#[test]
fn what_nobody_can_repeat_is_believed() {
    let mut farm = farm_of(4, 1, u32::MAX);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    send(&mut farm, &lease, "right");
    assert_eq!(
        farm.job(JOB).unwrap().nodes_in_doubt().count(),
        0,
        "there is no other worker"
    );
    hire(&mut farm, "w2", 0);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    send(&mut farm, &lease, "right");
    assert_eq!(farm.job(JOB).unwrap().nodes_in_doubt().count(), 1);
    assert_eq!(farm.expire(10_000).changes, []);
    farm.seen(WorkerId(1), 40_000).unwrap();
    commit(&mut farm, 40_000, |farm| farm.expire(40_000));
    assert_eq!(
        farm.job(JOB).unwrap().nodes_in_doubt().count(),
        0,
        "the other worker is gone"
    );
}

#[test]
fn failing_at_what_others_can_do_leads_to_quarantine_which_a_new_start_does_not_end() {
    let mut farm = farm_of(8, 2, 0);
    for fault in 1..=3 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        let attempt = Attempt {
            worker: WorkerId(1),
            kind: FailureKind::Panic,
            message: "no memory".into(),
            at_ms: 0,
        };
        let leaf = lease.node.first() as u32;
        commit(&mut farm, 0, |farm| {
            farm.fail(JOB, lease.token, leaf, attempt, 0).unwrap()
        });
        assert_eq!(standing(&farm, 1).faults, fault - 1);
        let again = grant(&mut farm, 2, &[], 0).unwrap();
        assert_eq!(again.node, lease.node);
        send(&mut farm, &again, "right");
    }
    assert_eq!(standing(&farm, 1).quarantine.as_deref(), Some("3 faults in a row"));
    commit(&mut farm, 0, |farm| farm.leave(WorkerId(1)));
    hire(&mut farm, "w1", 0);
    assert!(standing(&farm, 3).quarantine.is_some(), "it has the same name");
    assert_eq!(grant(&mut farm, 3, &[], 0), None);
    commit(&mut farm, 0, |farm| farm.release_worker(WorkerId(3)).unwrap());
    assert_eq!([1, 3].map(|worker| standing(&farm, worker).quarantine), [None, None]);
    assert!(grant(&mut farm, 3, &[], 0).is_some());
    assert_eq!(
        farm.quarantine(WorkerId(9), "x"),
        Err(Refusal::UnknownWorker(WorkerId(9)))
    );
}

#[test]
fn two_results_for_one_node_are_decided_by_a_third_worker() {
    let mut farm = farm_of(8, 3, 0);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    let straggler = LeaseRecord {
        token: token(50),
        worker: WorkerId(2),
        ..first.clone()
    };
    farm.evolve(&Change::LeaseGranted(straggler.clone()), 0);
    send(&mut farm, &first, "wrong");
    assert_eq!(send(&mut farm, &straggler, "right"), Delivered::Disputed);
    let third = grant(&mut farm, 3, &[], 1).unwrap();
    assert!(third.verifies && third.node == first.node);
    send(&mut farm, &third, "right");
    assert!(standing(&farm, 1).quarantine.is_some());
    assert_eq!([2, 3].map(|worker| standing(&farm, worker).verified), [1, 1]);
}
