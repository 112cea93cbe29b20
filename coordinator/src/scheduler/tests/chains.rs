//! Jobs whose iterations go on from each other.

use super::*;
use photonfarm_core::settings::SppmSettings;

const JOB: JobId = JobId(1);

/// A farm with workers of different names and one chain, which repeats every node or none.
fn farm_of(iterations: u32, workers: u64, verifies: bool) -> Farm {
    let config = SchedulerConfig {
        verify_until: if verifies { u32::MAX } else { 0 },
        retry_ms: 0,
        longest_retry_ms: 0,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    for number in 1..=workers {
        hire(&mut farm, &format!("w{number}"), 0);
    }
    let chain = JobSpec {
        integrator: IntegratorSettings::Sppm(SppmSettings::default()).into(),
        ..spec(iterations)
    };
    commit(&mut farm, 0, |farm| farm.submit(chain, String::new(), None, 0));
    farm
}

fn give(farm: &mut Farm, lease: &LeaseRecord, node: NodeKey) -> Delivered {
    deliver(farm, &delivery(lease, node), 1).unwrap()
}

#[test]
fn a_chain_is_lent_to_one_worker_at_a_time_and_goes_on_from_what_counts() {
    let mut farm = farm_of(8, 2, false);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(first.node, NodeKey::leaf(0));
    assert_eq!(grant(&mut farm, 2, &[], 0), None);
    let nothing = farm.checkpoint_of(JOB, first.token, WorkerId(1));
    assert!(matches!(nothing, Err(Refusal::Invalid(_))));
    give(&mut farm, &first, first.node);
    let second = grant(&mut farm, 2, &[], 1).unwrap();
    assert_eq!(second.node, NodeKey::leaf(1));
    let (header, found) = farm
        .checkpoint_of(JOB, second.token, WorkerId(2))
        .unwrap()
        .reply
        .unwrap();
    assert_eq!((header.key, found.hash), (first.node, digest(JOB, first.node)));
    assert_eq!(header.statistics, 2);
    give(&mut farm, &second, second.node);
    let third = grant(&mut farm, 1, &[], 2).unwrap();
    assert_eq!(
        third.node,
        NodeKey { level: 1, index: 1 },
        "as many as fit into a lease"
    );
    assert_eq!(grant(&mut farm, 2, &[], 2), None);
}

#[test]
fn what_was_built_on_untrusted_work_goes_with_it() {
    let mut farm = farm_of(16, 2, false);
    let lie = grant(&mut farm, 1, &[], 0).unwrap();
    give(&mut farm, &lie, lie.node);
    let built = grant(&mut farm, 2, &[], 1).unwrap();
    give(&mut farm, &built, built.node);
    let held = grant(&mut farm, 2, &[], 2).unwrap();
    commit(&mut farm, 3, |farm| farm.quarantine(WorkerId(1), "it lied").unwrap());
    assert_eq!(farm.job(JOB).unwrap().done(), 0);
    let late = farm.deliver(&delivery(&held, held.node), 4);
    assert_eq!(late, Err(Refusal::StaleLease(held.token)));
    assert_eq!(grant(&mut farm, 2, &[], 5).unwrap().node.first(), 0);
}

#[test]
fn nothing_is_built_on_a_node_in_doubt() {
    let mut farm = farm_of(4, 2, true);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    give(&mut farm, &first, first.node);
    assert_eq!(grant(&mut farm, 1, &[], 1), None);
    let repeat = grant(&mut farm, 2, &[], 1).unwrap();
    assert!(repeat.verifies);
    give(&mut farm, &repeat, repeat.node);
    assert_eq!(grant(&mut farm, 1, &[], 2).unwrap().node, NodeKey::leaf(1));
}

/// The first part of a delivery was lost, and what follows the gap is in doubt: it can be repeated only once the gap is filled.
#[test]
fn a_doubt_beyond_a_gap_does_not_stop_a_chain() {
    let mut farm = farm_of(4, 2, true);
    for _ in 0..2 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        give(&mut farm, &lease, lease.node);
        let repeat = grant(&mut farm, 2, &[], 0).unwrap();
        give(&mut farm, &repeat, repeat.node);
    }
    let block = grant(&mut farm, 1, &[], 1).unwrap();
    assert_eq!(block.node, NodeKey { level: 1, index: 1 });
    give(&mut farm, &block, NodeKey::leaf(3));
    commit(&mut farm, 1, |farm| farm.release(JOB, block.token, WorkerId(1)));
    let gap = grant(&mut farm, 2, &[], 2).unwrap();
    assert_eq!((gap.node, gap.verifies), (NodeKey::leaf(2), false));
    give(&mut farm, &gap, gap.node);
    let repeats: Vec<NodeKey> = [1, 2]
        .iter()
        .map(|worker| {
            let repeat = grant(&mut farm, *worker, &[], 3).unwrap();
            assert!(repeat.verifies);
            repeat.node
        })
        .collect();
    assert_eq!(repeats, [NodeKey::leaf(2), NodeKey::leaf(3)]);
}

#[test]
fn a_chain_fails_where_an_iteration_is_given_up() {
    let mut farm = farm_of(4, 1, false);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    give(&mut farm, &first, first.node);
    for at_ms in 0..3 {
        let lease = grant(&mut farm, 1, &[], at_ms).unwrap();
        let attempt = Attempt {
            worker: WorkerId(1),
            kind: FailureKind::Render,
            message: "no".into(),
            at_ms,
        };
        commit(&mut farm, at_ms, |farm| {
            farm.fail(JOB, lease.token, 1, attempt, at_ms).unwrap()
        });
    }
    let ended = farm.settle(JOB, 4).changes;
    let [Change::JobEnded { state, failure, .. }] = ended.as_slice() else {
        panic!("{ended:?}");
    };
    assert_eq!(*state, JobState::Failed);
    assert!(
        failure
            .as_ref()
            .unwrap()
            .starts_with("iteration 2 could not be rendered")
    );
}

/// What lies beyond the iteration that was given up cannot be repeated, and is not waited for.
#[test]
fn a_doubt_beyond_an_iteration_that_is_given_up_does_not_keep_a_chain_from_its_end() {
    let mut farm = farm_of(2, 2, true);
    farm.config.max_failures = 1;
    let block = LeaseRecord {
        node: NodeKey { level: 1, index: 0 },
        ..grant(&mut farm, 1, &[], 0).unwrap()
    };
    farm.evolve(&Change::LeaseGranted(block.clone()), 0);
    give(&mut farm, &block, NodeKey::leaf(1));
    let attempt = Attempt {
        worker: WorkerId(1),
        kind: FailureKind::Render,
        message: "no".into(),
        at_ms: 1,
    };
    commit(&mut farm, 1, |farm| farm.fail(JOB, block.token, 0, attempt, 1).unwrap());
    assert_eq!(grant(&mut farm, 2, &[], 2), None, "what it goes on from is not there");
    let ended = farm.settle(JOB, 3).changes;
    let failed = JobState::Failed;
    assert!(matches!(ended.as_slice(), [Change::JobEnded { state, .. }] if *state == failed));
}
