//! What people ask of jobs: order, pause, extension, stops, tags; and what becomes of leases.

use super::*;
use crate::scheduler::record::{JobControl, JobRecord};
use crate::store::memory::Rows;
use photonfarm_proto::schedule::{Schedule, Stop, StopReason};
use photonfarm_proto::waiting::Waiting;
use std::collections::BTreeMap;

const JOB: JobId = JobId(1);

fn submit(farm: &mut Farm, iterations: u32, owner: &str, schedule: Schedule) -> JobId {
    let spec = JobSpec {
        schedule,
        ..spec(iterations)
    };
    commit(farm, 0, |farm| farm.submit(spec, owner.into(), None, 0))
}

fn priority(priority: u32) -> Schedule {
    Schedule {
        priority,
        ..Schedule::default()
    }
}

/// One worker works for a while; returns the leaves that each job got.
fn serve(farm: &mut Farm, leases: usize, now: &mut Millis) -> BTreeMap<JobId, u64> {
    let mut leaves = BTreeMap::new();
    for _ in 0..leases {
        let lease = grant(farm, 1, &[], *now).unwrap();
        *leaves.entry(lease.job).or_default() += lease.node.leaves();
        *now += 3_000 * lease.node.leaves();
        deliver(farm, &delivery(&lease, lease.node), *now).unwrap();
    }
    leaves
}

#[test]
fn owners_share_evenly_and_their_jobs_by_priority() {
    let mut farm = farm_with(1, 1);
    serve(&mut farm, 1, &mut 0);
    let first = submit(&mut farm, 100_000, "ann", priority(30));
    let second = submit(&mut farm, 100_000, "ann", priority(10));
    let other = submit(&mut farm, 100_000, "bob", priority(1));
    let leaves = serve(&mut farm, 800, &mut 0);
    let total: u64 = leaves.values().sum();
    for (job, share) in [(first, 0.375), (second, 0.125), (other, 0.5)] {
        let found = leaves[&job] as f64 / total as f64;
        assert!(
            (found / share - 1.0).abs() < 0.05,
            "job {job} has {found} of the farm, not {share}"
        );
    }
}

#[test]
fn a_late_job_neither_waits_nor_takes_all() {
    let mut farm = farm_with(100_000, 1);
    let mut now = 0;
    serve(&mut farm, 200, &mut now);
    let late = submit(&mut farm, 100_000, "", Schedule::default());
    let leaves = serve(&mut farm, 40, &mut now);
    let share = leaves[&late] as f64 / leaves.values().sum::<u64>() as f64;
    assert!((0.4..0.6).contains(&share), "the late job has {share}");
}

#[test]
fn a_first_lease_counts_by_what_it_took() {
    let mut farm = farm_with(100_000, 1);
    let mut now = 0;
    serve(&mut farm, 200, &mut now);
    let late = submit(&mut farm, 100_000, "bob", Schedule::default());
    // Its first lease is of one iteration, which is charged like a lease of the usual length and takes a tenth of that:
    // the second, which begins with an odd leaf, is its own, too.
    assert_eq!(serve(&mut farm, 2, &mut now), [(late, 2)].into());
}

#[test]
fn a_job_whose_priority_is_raised_is_served_soon() {
    let mut farm = farm_with(100_000, 1);
    let mut now = 0;
    commit(&mut farm, 0, |farm| farm.prioritize(JOB, 100).unwrap());
    let other = submit(&mut farm, 100_000, "", priority(1));
    assert!(serve(&mut farm, 40, &mut now)[&other] > 0);
    commit(&mut farm, now, |farm| farm.prioritize(other, 100).unwrap());
    let leaves = serve(&mut farm, 10, &mut now);
    let share = leaves[&other] as f64 / leaves.values().sum::<u64>() as f64;
    assert!((0.3..0.7).contains(&share), "it has {share}");
}

#[test]
fn a_paused_job_hands_out_nothing_and_takes_what_is_at_work() {
    let mut farm = farm_with(4, 1);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    for _ in 0..2 {
        commit(&mut farm, 1, |farm| farm.pause(JOB, true).unwrap());
    }
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 2),
        Ok(Delivered::Counted)
    );
    assert_eq!(grant(&mut farm, 1, &[], 3), None);
    let job = farm.job(JOB).unwrap();
    assert_eq!(farm.status(job, 3).waiting.as_deref(), Some("it is paused"));
    commit(&mut farm, 4, |farm| farm.pause(JOB, false).unwrap());
    assert_eq!(grant(&mut farm, 1, &[], 5).unwrap().node, NodeKey::leaf(1));
    assert_eq!(farm.pause(JOB, false).unwrap().changes, [], "a repeat changes nothing");
    assert_eq!(farm.pause(JobId(9), true), Err(Refusal::UnknownJob(JobId(9))));
}

#[test]
fn a_job_that_is_done_goes_on_where_it_was() {
    let mut farm = farm_with(1, 1);
    let mut rows = Rows::default();
    let keep = |farm: &mut Farm, rows: &mut Rows, changes: Vec<Change>| {
        for change in &changes {
            rows.apply(change);
            farm.evolve(change, 1);
        }
    };
    let submitted = farm.submit(spec(2), String::new(), None, 0).changes;
    keep(&mut farm, &mut rows, submitted);
    let job = JobId(2);
    for _ in 0..3 {
        farm.seen(WorkerId(1), 1).unwrap();
        let lease = farm.lease(&asked(&farm, 1, &[]), 1).unwrap();
        let (record, changes) = (lease.reply.unwrap(), lease.changes);
        if record.job == job {
            keep(&mut farm, &mut rows, changes);
            let delivered = farm.deliver(&delivery(&record, record.node), 1).unwrap();
            keep(&mut farm, &mut rows, delivered.changes);
        } else {
            commit(&mut farm, 1, |farm| farm.cancel(JOB, 1).unwrap());
        }
    }
    let parent = NodeKey { level: 1, index: 0 };
    let merged = farm.merge(job, parent, digest(job, parent)).changes;
    keep(&mut farm, &mut rows, merged);
    let settled = farm.settle(job, 9).changes;
    keep(&mut farm, &mut rows, settled);
    assert!(farm.job(job).is_none());
    let ended = rows.jobs[&job].clone();
    assert!(matches!(farm.extend(job, 1, Some(&ended)), Err(Refusal::Invalid(_))));
    assert_eq!(farm.extend(job, 2, Some(&ended)).unwrap().changes, []);
    let extended = farm.extend(job, 5, Some(&ended)).unwrap().changes;
    keep(&mut farm, &mut rows, extended);
    let known = farm.job(job).unwrap();
    assert_eq!((known.done(), known.leaves()), (2, 5));
    assert_eq!(rows.snapshot().jobs.len(), 1);
    let lease = grant(&mut farm, 1, &[], 10).unwrap();
    assert_eq!((lease.job, lease.node), (job, NodeKey::leaf(2)));
}

#[test]
fn a_noise_target_is_tested_at_checkpoints_and_leaves_out_the_rest() {
    let mut farm = farm_with(1, 1);
    serve(&mut farm, 1, &mut 0);
    let schedule = Schedule {
        noise_target: Some(0.5),
        ..Schedule::default()
    };
    let job = submit(&mut farm, 100, "", schedule);
    let merged = |farm: &mut Farm| {
        while let Some(parent) = farm.job(job).and_then(Job::next_merge) {
            commit(farm, 0, |farm| farm.merge(job, parent, digest(job, parent)));
        }
    };
    let mut leaves = 0;
    while leaves < 24 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        leaves = lease.node.end();
        deliver(&mut farm, &delivery(&lease, lease.node), 0).unwrap();
    }
    merged(&mut farm);
    let due = |farm: &Farm| farm.job(job).unwrap().due_checkpoint().map(|(node, _)| node);
    let prefix = |level| NodeKey { level, index: 0 };
    assert_eq!(
        due(&farm),
        Some(prefix(2)),
        "eight iterations wait, unmerged, for the test at four"
    );
    assert_eq!(farm.settle(job, 0).changes, []);
    assert_eq!(
        farm.checkpoint(job, prefix(3), Some(0.1)).changes,
        [],
        "not that one now"
    );
    let unknown = farm.checkpoint(job, prefix(2), None).changes;
    assert!(
        matches!(&unknown[..], [Change::JobChanged { control, .. }] if control.stop.is_none()),
        "a prefix that is black goes on: {unknown:?}"
    );
    commit(&mut farm, 0, |farm| farm.checkpoint(job, prefix(2), Some(0.7)));
    merged(&mut farm);
    assert_eq!(due(&farm), Some(prefix(3)));
    commit(&mut farm, 0, |farm| farm.checkpoint(job, prefix(3), Some(0.4)));
    let stopped = farm.job(job).unwrap();
    assert_eq!((stopped.done(), stopped.leaves()), (8, 8));
    assert!(stopped.leases.is_empty() && stopped.control.stop.unwrap().asked == 100);
    let settled = farm.settle(job, 1).changes;
    assert!(
        matches!(
            &settled[..],
            [Change::JobEnded {
                state: JobState::Done,
                ..
            }]
        ),
        "{settled:?}"
    );
}

#[test]
fn a_deadline_ends_a_job_with_its_complete_prefix() {
    let mut farm = farm_with(1, 2);
    serve(&mut farm, 1, &mut 0);
    let schedule = Schedule {
        deadline_ms: Some(50_000),
        ..Schedule::default()
    };
    let job = submit(&mut farm, 100, "", schedule.clone());
    let late = submit(&mut farm, 100, "", schedule);
    commit(&mut farm, 0, |farm| farm.pause(late, true).unwrap());
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    let second = grant(&mut farm, 2, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&first, first.node), 1).unwrap();
    let third = grant(&mut farm, 1, &[], 2).unwrap();
    assert_eq!([&first, &second, &third].map(|lease| lease.node.first()), [0, 1, 2]);
    deliver(&mut farm, &delivery(&third, third.node), 3).unwrap();
    assert_eq!(farm.expire(20_000).changes, []);
    let ended = farm.expire(50_000).changes;
    ended.iter().for_each(|change| farm.evolve(change, 50_000));
    let stopped = farm.job(job).unwrap();
    assert_eq!((stopped.done(), stopped.leaves(), stopped.leases.len()), (1, 1, 0));
    assert!(matches!(
        &farm.settle(job, 50_001).changes[..],
        [Change::JobEnded {
            state: JobState::Done,
            ..
        }]
    ));
    assert!(farm.job(late).is_none(), "a job without any iteration fails");
}

/// Iterations take three seconds and leases up to thirty, so that the one that begins after 24 s would be over at 48 s.
#[test]
fn leases_are_cut_to_the_deadline() {
    let mut farm = farm_with(1, 1);
    serve(&mut farm, 1, &mut 0);
    let schedule = Schedule {
        deadline_ms: Some(42_000),
        ..Schedule::default()
    };
    let job = submit(&mut farm, 1000, "", schedule);
    let (mut now, mut lengths) = (0, Vec::new());
    while now < 42_000 {
        let lease = grant(&mut farm, 1, &[], now).unwrap();
        now += 3_000 * lease.node.leaves();
        lengths.push(lease.node.leaves());
        assert!(now <= 42_000, "{lengths:?}: the last lease would be void");
        deliver(&mut farm, &delivery(&lease, lease.node), now).unwrap();
    }
    assert_eq!(lengths, [1, 1, 2, 4, 4, 2]);
    commit(&mut farm, now, |farm| farm.expire(now));
    assert_eq!(farm.job(job).unwrap().leaves(), 14);
}

#[test]
fn jobs_ask_for_tags_and_keep_to_one_renderer() {
    let mut farm = farm_with(1, 1);
    serve(&mut farm, 1, &mut 0);
    let schedule = Schedule {
        tags: ["gpu=no".to_owned()].into(),
        ..Schedule::default()
    };
    let job = submit(&mut farm, 4, "", schedule);
    let waiting = |farm: &Farm| farm.status(farm.job(job).unwrap(), 0).waiting;
    assert_eq!(grant(&mut farm, 1, &[], 0), None);
    assert_eq!(waiting(&farm).as_deref(), Some("no worker has the tags gpu=no"));
    for renderer in ["1+a", "1+b"] {
        let register = Register {
            renderer: renderer.into(),
            tags: ["gpu=no".to_owned(), "x".to_owned()].into(),
            ..introduction()
        };
        commit(&mut farm, 0, |farm| {
            farm.register(register, Origin::default(), 0).unwrap()
        });
    }
    let lease = grant(&mut farm, 2, &[], 0).unwrap();
    assert_eq!(waiting(&farm), None);
    assert_eq!(farm.job(job).unwrap().control.renderer.as_deref(), Some("1+a"));
    assert_eq!(grant(&mut farm, 3, &[], 0), None, "the other build waits");
    commit(&mut farm, 0, |farm| farm.release(job, lease.token, WorkerId(2)));
    commit(&mut farm, 0, |farm| farm.leave(WorkerId(2)));
    assert!(waiting(&farm).unwrap().contains("bound to renderer 1+a"));
}

#[test]
fn extending_a_job_that_has_stopped_drops_its_target_and_its_deadline() {
    for ends in [false, true] {
        let mut farm = farm_with(1, 1);
        let mut rows = Rows::default();
        let schedule = Schedule {
            deadline_ms: Some(50_000),
            noise_target: Some(0.5),
            ..Schedule::default()
        };
        let spec = JobSpec { schedule, ..spec(8) };
        let decision = farm.submit(spec, String::new(), None, 0);
        let mut apply = |farm: &mut Farm, changes: &[Change], now| {
            for change in changes {
                rows.apply(change);
                farm.evolve(change, now);
            }
            rows.jobs.get(&JobId(2)).cloned()
        };
        let job = decision.reply;
        apply(&mut farm, &decision.changes, 0);
        let stop = Stop {
            reason: StopReason::Noise,
            asked: 8,
        };
        let control = JobControl {
            iterations: 4,
            stop: Some(stop),
            ..farm.job(job).unwrap().control().clone()
        };
        apply(&mut farm, &[Change::JobChanged { job, control }], 1);
        let mut ended = None;
        if ends {
            let end = Change::JobEnded {
                job,
                state: JobState::Done,
                failure: None,
                ended_ms: 2,
            };
            ended = apply(&mut farm, &[end], 2);
        }
        let decision = farm.extend(job, 16, ended.as_ref()).unwrap();
        apply(&mut farm, &decision.changes, 3);
        let control = farm.job(job).unwrap().control();
        let schedule = &control.schedule;
        assert_eq!((control.iterations, control.stop), (16, None));
        assert_eq!(
            (schedule.deadline_ms, schedule.noise_target),
            (None, None),
            "ended: {ends}"
        );
    }
}

#[test]
fn part_of_what_a_straggler_has_not_come_to_is_lent_again() {
    let mut farm = farm_with(8, 2);
    let block = NodeKey { level: 3, index: 0 };
    let lease = |number: u64, node| LeaseRecord {
        token: token(number),
        job: JOB,
        node,
        worker: WorkerId(number),
        serial: 0,
        attempt: 1,
        granted_ms: 0,
        expected_ms: Some(10_000),
        verifies: false,
        share: [0; 2],
        until_ms: 0,
        restarts: 0,
    };
    farm.evolve(&Change::LeaseGranted(lease(1, block)), 0);
    let beat = [LeaseProgress {
        token: token(1),
        leaves_done: 2,
    }];
    farm.heartbeat(WorkerId(1), &beat, 19_000).unwrap();
    assert_eq!(grant(&mut farm, 2, &[], 19_000), None, "too early");
    let mut stolen = Vec::new();
    let mut now = 21_000;
    while let Some(lease) = grant(&mut farm, 2, &[], now) {
        stolen.push(lease.node);
        now += 1_000;
        deliver(&mut farm, &delivery(&lease, lease.node), now).unwrap();
        farm.heartbeat(WorkerId(1), &beat, now).unwrap();
    }
    let node = |level, index| NodeKey { level, index };
    assert_eq!(stolen, [node(2, 1), node(0, 3), node(0, 2), node(0, 1), node(0, 0)]);
    assert!(farm.job(JOB).unwrap().leases.is_empty());
}

#[test]
fn totals_are_those_of_the_image_however_its_parts_came() {
    let mut farm = farm_with(2, 2);
    let block = NodeKey { level: 1, index: 0 };
    let mut lease = grant(&mut farm, 1, &[], 0).unwrap();
    lease.node = block;
    farm.evolve(&Change::LeaseGranted(lease.clone()), 0);
    deliver(&mut farm, &delivery(&lease, NodeKey::leaf(0)), 3_000).unwrap();
    let seconds = |farm: &Farm| farm.job(JOB).unwrap().totals().seconds.total();
    assert_eq!(seconds(&farm), 3.0);
    deliver(&mut farm, &delivery(&lease, block), 6_000).unwrap();
    assert_eq!(
        seconds(&farm),
        6.0,
        "the block was rendered whole, and its part is in it once"
    );
}

/// A farm that is started again every 20 s, with a worker that is heard of after each start or never.
fn restart_often(alive: bool) -> Option<Millis> {
    let mut rows = Rows::default();
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let keep = |farm: &mut Farm, rows: &mut Rows, changes: Vec<Change>, now| {
        for change in &changes {
            rows.apply(change);
            farm.evolve(change, now);
        }
    };
    let changes = farm.register(introduction(), Origin::default(), 0).unwrap().changes;
    keep(&mut farm, &mut rows, changes, 0);
    let changes = farm.submit(spec(4), String::new(), None, 0).changes;
    keep(&mut farm, &mut rows, changes, 0);
    let changes = farm.lease(&asked(&farm, 1, &[]), 0).unwrap().changes;
    keep(&mut farm, &mut rows, changes, 0);
    let token = rows.jobs[&JOB].leases[0].token;
    for start in 1..100 {
        let now = start * 20_000;
        farm = Farm::restore(SchedulerConfig::default(), rows.snapshot(), now);
        let changes = farm.restarted().changes;
        keep(&mut farm, &mut rows, changes, now);
        if alive {
            let beat = [LeaseProgress { token, leaves_done: 0 }];
            assert_eq!(farm.heartbeat(WorkerId(1), &beat, now + 1_000), Ok(vec![]));
            let changes = farm.reconnected(WorkerId(1), now + 1_000).changes;
            keep(&mut farm, &mut rows, changes, now + 1_000);
        }
        for second in (0..20_000).step_by(1_000) {
            if !farm.expire(now + second).changes.is_empty() {
                return Some(now + second);
            }
        }
    }
    None
}

#[test]
fn frequent_starts_do_not_keep_the_lease_of_a_dead_worker() {
    let expired = restart_often(false).expect("the lease ends");
    assert!((60_000..120_000).contains(&expired), "it ended after {expired} ms");
    assert_eq!(restart_often(true), None, "a worker that reconnects keeps its lease");
}

#[test]
fn an_iteration_that_failed_rests_and_goes_to_another_worker() {
    let mut farm = Farm::restore(
        SchedulerConfig {
            verify_until: 0,
            ..SchedulerConfig::default()
        },
        Snapshot::default(),
        0,
    );
    for name in ["w1", "w2"] {
        hire(&mut farm, name, 0);
    }
    submit(&mut farm, 1, "", Schedule::default());
    let failed = |farm: &mut Farm, lease: &LeaseRecord, now| {
        let attempt = Attempt {
            worker: lease.worker,
            kind: FailureKind::Panic,
            message: "boom".into(),
            at_ms: now,
        };
        commit(farm, now, |farm| farm.fail(JOB, lease.token, 0, attempt, now).unwrap());
    };
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    failed(&mut farm, &lease, 0);
    assert_eq!(grant(&mut farm, 2, &[], 999), None, "it rests for a second");
    assert_eq!(grant(&mut farm, 1, &[], 5_000), None, "another worker is there to try");
    let lease = grant(&mut farm, 2, &[], 5_000).unwrap();
    failed(&mut farm, &lease, 5_000);
    assert_eq!(grant(&mut farm, 1, &[], 6_999), None, "then for two");
    assert!(
        grant(&mut farm, 1, &[], 7_000).is_some(),
        "nobody is left who did not fail"
    );
}

/// Whatever keeps a job from going on is said, and it is one thing.
#[test]
fn a_job_that_waits_says_for_what() {
    let mut farm = Farm::restore(SchedulerConfig::default(), Snapshot::default(), 0);
    let job = submit(&mut farm, 1, "", Schedule::default());
    let reason = |farm: &Farm, now| farm.status(farm.job(job).unwrap(), now).waiting_reason;
    assert_eq!(reason(&farm, 0), Some(Waiting::NoWorker));
    hire(&mut farm, "w1", 0);
    assert_eq!(reason(&farm, 0), Some(Waiting::Turn));
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    assert_eq!(reason(&farm, 0), None, "somebody is at work");
    let attempt = Attempt {
        worker: WorkerId(1),
        kind: FailureKind::Render,
        message: String::new(),
        at_ms: 0,
    };
    commit(&mut farm, 0, |farm| farm.fail(job, lease.token, 0, attempt, 0).unwrap());
    assert_eq!(reason(&farm, 999), Some(Waiting::Rest));
    assert_eq!(reason(&farm, 1000), Some(Waiting::Turn));
    commit(&mut farm, 1000, |farm| farm.quarantine(WorkerId(1), "x").unwrap());
    assert_eq!(reason(&farm, 1000), Some(Waiting::Quarantine));
    commit(&mut farm, 1000, |farm| farm.pause(job, true).unwrap());
    assert_eq!(reason(&farm, 1000), Some(Waiting::Paused));
    commit(&mut farm, 1000, |farm| farm.pause(job, false).unwrap());
    commit(&mut farm, 1000, |farm| farm.release_worker(WorkerId(1)).unwrap());
    let lease = grant(&mut farm, 1, &[], 1000).unwrap();
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 1001),
        Ok(Delivered::Counted)
    );
    assert_eq!(reason(&farm, 1001), Some(Waiting::Merging));
}

/// Fails every attempt at the first leaf of a job until it is given up.
fn give_up(farm: &mut Farm, job: JobId, kept: &mut Rows) {
    while farm.job(job).is_some_and(|job| job.given_up.is_empty()) {
        let lease = grant(farm, 1, &[], 0).unwrap();
        let attempt = Attempt {
            worker: lease.worker,
            kind: FailureKind::Render,
            message: "no".into(),
            at_ms: 0,
        };
        let failed = farm.fail(job, lease.token, lease.node.first() as u32, attempt, 0);
        for change in failed.unwrap().changes {
            if matches!(change, Change::LeafFailed { .. }) {
                kept.apply(&change);
            }
            farm.evolve(&change, 0);
        }
    }
}

#[test]
fn iterations_that_were_given_up_are_tried_again_when_asked() {
    let mut farm = Farm::restore(farm_with(1, 0).config().clone(), Snapshot::default(), 0);
    hire(&mut farm, "w", 0);
    let mut rows = Rows::default();
    let submitted = farm.submit(spec(1), String::new(), None, 0).changes;
    let keep = |farm: &mut Farm, rows: &mut Rows, changes: Vec<Change>| {
        for change in &changes {
            rows.apply(change);
            farm.evolve(change, 1);
        }
    };
    keep(&mut farm, &mut rows, submitted);
    let changes = farm.retry(JOB, None).unwrap().changes;
    assert!(changes.is_empty(), "nothing was given up yet");

    give_up(&mut farm, JOB, &mut rows);
    assert_eq!(grant(&mut farm, 1, &[], 0), None);
    for _ in 0..2 {
        let changes = farm.retry(JOB, None).unwrap().changes;
        keep(&mut farm, &mut rows, changes);
    }
    assert!(rows.jobs[&JOB].failures.is_empty());

    give_up(&mut farm, JOB, &mut rows);
    let ended = farm.settle(JOB, 2).changes;
    keep(&mut farm, &mut rows, ended);
    let record = rows.jobs[&JOB].clone();
    assert_eq!((record.state, farm.job(JOB).is_none()), (JobState::Failed, true));
    let changes = farm.retry(JOB, Some(&record)).unwrap().changes;
    keep(&mut farm, &mut rows, changes);
    let record = &rows.jobs[&JOB];
    assert_eq!(
        (record.state, &record.failure, record.failures.len()),
        (JobState::Running, &None, 0)
    );
    let lease = grant(&mut farm, 1, &[], 3).unwrap();
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 3),
        Ok(Delivered::Counted)
    );
    let ended = farm.settle(JOB, 4).changes;
    assert!(matches!(
        ended[..],
        [Change::JobEnded {
            state: JobState::Done,
            ..
        }]
    ));

    let refused = |state| {
        let record = JobRecord {
            state,
            ended_ms: Some(2),
            ..record.clone()
        };
        let other = Farm::restore(farm.config().clone(), Snapshot::default(), 0);
        other.retry(JOB, Some(&record)).map(|decision| decision.changes.len())
    };
    assert_eq!(refused(JobState::Cancelled), Err(Refusal::JobEnded(JOB)));
    assert_eq!(refused(JobState::Done), Ok(0));
}

#[test]
fn a_drained_worker_finishes_what_it_holds_and_gets_no_more() {
    let mut farm = farm_with(8, 1);
    let worker = WorkerId(1);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    for _ in 0..2 {
        commit(&mut farm, 0, |farm| farm.drain(worker, true).unwrap());
    }
    assert_eq!(grant(&mut farm, 1, &[lease.token], 0), None);
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 1),
        Ok(Delivered::Counted)
    );
    assert_eq!(grant(&mut farm, 1, &[], 1), None);
    assert!(farm.worker_statuses(1)[0].drained);
    let waiting = farm.status(farm.job(JOB).unwrap(), 1).waiting;
    assert!(waiting.unwrap().ends_with("or drained"));
    // Quarantine and release leave it as it is.
    commit(&mut farm, 1, |farm| farm.quarantine(worker, "smoke").unwrap());
    commit(&mut farm, 1, |farm| farm.release_worker(worker).unwrap());
    assert_eq!(grant(&mut farm, 1, &[], 1), None);
    commit(&mut farm, 1, |farm| farm.drain(worker, false).unwrap());
    assert!(grant(&mut farm, 1, &[], 1).is_some());
    assert_eq!(farm.drain(WorkerId(9), true), Err(Refusal::UnknownWorker(WorkerId(9))));
}
