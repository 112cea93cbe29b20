//! Memory: what jobs are measured to take, which workers have it, and workers that ran out of it.

use super::*;
use photonfarm_proto::memory::Shortage;
use photonfarm_proto::schedule::Schedule;
use photonfarm_proto::waiting::Waiting;

const JOB: JobId = JobId(1);

/// A farm with a job, and workers that have so much memory [MiB], each of a principal of its own.
fn farm_of(memory: &[Option<u32>], schedule: Schedule) -> Farm {
    let config = SchedulerConfig {
        retry_ms: 0,
        longest_retry_ms: 0,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    for (index, memory_mb) in memory.iter().enumerate() {
        let register = Register {
            name: format!("w{index}"),
            memory_mb: *memory_mb,
            ..introduction()
        };
        commit(&mut farm, 0, |farm| {
            farm.register(register, Origin::default(), 0).unwrap()
        });
    }
    let spec = JobSpec { schedule, ..spec(8) };
    commit(&mut farm, 0, |farm| farm.submit(spec, String::new(), None, 0));
    farm
}

fn measured(farm: &mut Farm, lease: &LeaseRecord, memory_mb: u32) {
    let delivery = Delivery {
        memory_mb: Some(memory_mb),
        ..delivery(lease, lease.node)
    };
    assert_eq!(deliver(farm, &delivery, 0), Ok(Delivered::Counted));
}

fn waiting(farm: &Farm) -> (Option<Waiting>, String) {
    let status = farm.status(farm.job(JOB).unwrap(), 0);
    (status.waiting_reason, status.waiting.unwrap_or_default())
}

fn attempt(worker: u64) -> Attempt {
    Attempt {
        worker: WorkerId(worker),
        kind: FailureKind::OutOfMemory,
        message: "out of memory".into(),
        at_ms: 0,
    }
}

/// The process of a worker is killed for lack of memory, and its next one says so.
fn run_out(farm: &mut Farm, lease: &LeaseRecord, has_mb: Option<u32>) -> Result<(), Refusal> {
    let shortage = Shortage {
        held_mb: Some(900),
        has_mb,
    };
    let leaf = lease.node.first() as u32;
    let decision = farm.out_of_memory(JOB, lease.token, leaf, attempt(lease.worker.0), shortage)?;
    commit(farm, 0, |_| decision);
    Ok(())
}

#[test]
fn a_job_goes_to_workers_with_the_memory_that_it_was_measured_to_take() {
    let mut farm = farm_of(&[Some(1000), Some(2000), None], Schedule::default());
    for (memory, largest) in [(700, 700), (600, 700), (1001, 1001)] {
        let lease = grant(&mut farm, 1, &[], 0).expect("nothing is known to be too much");
        measured(&mut farm, &lease, memory);
        assert_eq!(farm.job(JOB).unwrap().status().memory_mb, Some(largest));
    }
    assert_eq!(grant(&mut farm, 1, &[], 0), None);
    for worker in [2, 3] {
        let lease = grant(&mut farm, worker, &[], 0).expect("it has the memory, or does not say");
        commit(&mut farm, 0, |farm| farm.release(JOB, lease.token, lease.worker));
    }
    for worker in [2, 3] {
        commit(&mut farm, 0, |farm| farm.leave(WorkerId(worker)));
    }
    let (reason, text) = waiting(&farm);
    assert_eq!(reason, Some(Waiting::Memory));
    assert_eq!(
        text,
        "it was measured to take 1001 MiB of memory, and the largest worker that could do it has 1000 MiB: start one with \
         at least 1024 MiB"
    );
    assert_eq!(farm.figures(0).waiting.get(&Waiting::Memory), Some(&1));
}

#[test]
fn a_job_asks_for_memory_before_it_was_measured() {
    let schedule = Schedule {
        memory_mb: Some(1500),
        ..Schedule::default()
    };
    let mut farm = farm_of(&[Some(1499)], schedule.clone());
    assert_eq!(grant(&mut farm, 1, &[], 0), None);
    let (reason, text) = waiting(&farm);
    assert_eq!(reason, Some(Waiting::Memory));
    assert!(text.starts_with("it asks for 1500 MiB of memory"), "{text}");
    let mut farm = farm_of(&[Some(1499), Some(1500)], schedule);
    let lease = grant(&mut farm, 2, &[], 0).expect("it has just as much");
    measured(&mut farm, &lease, 100);
    assert!(grant(&mut farm, 1, &[], 0).is_some(), "what was measured counts");
}

#[test]
fn three_that_ran_out_of_memory_leave_a_job_to_larger_workers() {
    let mut farm = farm_of(&[Some(1000), Some(1000), Some(1200)], Schedule::default());
    for (worker, has_mb) in [(1, 1000), (3, 1200), (2, 1000)] {
        let lease = grant(&mut farm, worker, &[], 0).expect("two may be chance");
        run_out(&mut farm, &lease, Some(has_mb)).unwrap();
        assert!(farm.job(JOB).unwrap().leases_held().is_empty());
    }
    assert_eq!([1, 2].map(|worker| grant(&mut farm, worker, &[], 0)), [None, None]);
    let lease = grant(&mut farm, 3, &[], 0).expect("one that is larger ran out once, which may be chance");
    commit(&mut farm, 0, |farm| farm.release(JOB, lease.token, lease.worker));
    commit(&mut farm, 0, |farm| farm.leave(WorkerId(3)));
    let (reason, text) = waiting(&farm);
    assert_eq!(reason, Some(Waiting::Memory));
    assert!(
        text.starts_with("workers with 1000 MiB of memory ran out of it"),
        "{text}"
    );
    assert!(text.ends_with("at least 1001 MiB"), "{text}");
    let status = farm.job(JOB).unwrap().status();
    assert_eq!(
        (status.poisoned.len(), status.memory_mb),
        (0, Some(900)),
        "nothing is given up"
    );
    let forgotten = farm.retry(JOB, None).unwrap();
    commit(&mut farm, 0, |_| forgotten);
    assert!(grant(&mut farm, 1, &[], 0).is_some(), "somebody wants it tried again");
}

#[test]
fn an_iteration_is_given_up_where_nobody_says_how_much_memory_was_too_little() {
    let mut farm = farm_of(&[None], Schedule::default());
    for _ in 0..3 {
        let lease = grant(&mut farm, 1, &[], 0).unwrap();
        assert_eq!(lease.node, NodeKey::leaf(0));
        run_out(&mut farm, &lease, None).unwrap();
    }
    let poisoned = farm.job(JOB).unwrap().status().poisoned;
    assert_eq!((poisoned.len(), poisoned[0].attempts.len()), (1, 3));
    assert_eq!(poisoned[0].attempts[0].kind, FailureKind::OutOfMemory);
}

#[test]
fn what_is_said_after_the_lease_has_ended_counts_once_and_for_a_worker_that_was_lost() {
    let mut farm = farm_of(&[Some(1000)], Schedule::default());
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let after = farm.config().lease_ttl_ms;
    commit(&mut farm, after, |farm| farm.expire(after));
    let stranger = LeaseRecord {
        worker: WorkerId(9),
        ..lease.clone()
    };
    assert_eq!(
        run_out(&mut farm, &stranger, Some(1000)),
        Err(Refusal::StaleLease(lease.token))
    );
    run_out(&mut farm, &lease, Some(1000)).unwrap();
    assert_eq!(
        run_out(&mut farm, &lease, Some(1000)),
        Err(Refusal::StaleLease(lease.token))
    );
    let attempts = farm.job(JOB).unwrap().failed_attempts();
    let kinds: Vec<FailureKind> = attempts[0].attempts.iter().map(|attempt| attempt.kind).collect();
    assert_eq!(kinds, [FailureKind::Lost, FailureKind::OutOfMemory]);
}

#[test]
fn memory_is_remembered_through_a_restart() {
    let mut farm = farm_of(&[Some(1000)], Schedule::default());
    let mut rows = crate::store::memory::Rows::default();
    rows.apply(&Change::JobSubmitted(Box::new(farm.job(JOB).unwrap().head().clone())));
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    rows.apply(&Change::LeaseGranted(lease.clone()));
    let delivery = Delivery {
        memory_mb: Some(1234),
        ..delivery(&lease, lease.node)
    };
    let changes = farm.deliver(&delivery, 0).unwrap().changes;
    changes.iter().for_each(|change| rows.apply(change));
    let again = Job::from_record(rows.jobs[&JOB].clone(), farm.config());
    assert_eq!(again.status().memory_mb, Some(1234));
    assert_eq!(again.demand.memory_mb, 1280);
}
