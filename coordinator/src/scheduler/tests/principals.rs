//! Who is behind a worker: whom it listens to, and how often its word counts.

use super::*;

const JOB: JobId = JobId(1);

fn rack(machine: &str) -> Origin {
    Origin {
        token: "rack".into(),
        machine: machine.into(),
    }
}

/// A farm that repeats every node, with workers of these origins, named by their numbers.
fn farm_of(origins: &[Origin]) -> Farm {
    let config = SchedulerConfig {
        verify_until: u32::MAX,
        retry_ms: 0,
        longest_retry_ms: 0,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    for (index, origin) in origins.iter().enumerate() {
        hire_from(&mut farm, &format!("w{}", index + 1), origin.clone(), 0);
    }
    commit(&mut farm, 0, |farm| farm.submit(spec(2), String::new(), None, 0));
    farm
}

fn fail(farm: &mut Farm, worker: u64, kind: FailureKind, now: Millis) {
    let lease = grant(farm, worker, &[], now).unwrap();
    let attempt = Attempt {
        worker: WorkerId(worker),
        kind,
        message: "no".into(),
        at_ms: now,
    };
    let leaf = lease.node.first() as u32;
    commit(farm, now, |farm| {
        farm.fail(JOB, lease.token, leaf, attempt, now).unwrap()
    });
}

#[test]
fn one_machine_does_not_confirm_its_own_work_by_a_second_worker() {
    let mut farm = farm_of(&[rack("10.0.0.1"), rack("10.0.0.1"), rack("10.0.0.2")]);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&lease, lease.node), 1).unwrap();
    assert!(farm.job(JOB).unwrap().is_in_doubt(lease.node));
    let other = grant(&mut farm, 2, &[], 1).unwrap();
    assert!(!other.verifies, "the twin gets new work");
    let repeat = grant(&mut farm, 3, &[], 1).unwrap();
    assert!(repeat.verifies && repeat.node == lease.node);
    deliver(&mut farm, &delivery(&repeat, repeat.node), 2).unwrap();
    assert!(!farm.job(JOB).unwrap().is_in_doubt(lease.node));
}

#[test]
fn what_only_twins_could_repeat_is_believed_and_what_they_say_against_each_other_is_not_heard() {
    let mut farm = farm_of(&[rack("10.0.0.1"), rack("10.0.0.1")]);
    let first = grant(&mut farm, 1, &[], 0).unwrap();
    let twin = LeaseRecord {
        token: token(50),
        worker: WorkerId(2),
        ..first.clone()
    };
    farm.evolve(&Change::LeaseGranted(twin.clone()), 0);
    deliver(&mut farm, &delivery(&first, first.node), 1).unwrap();
    assert!(!farm.job(JOB).unwrap().is_in_doubt(first.node), "nobody else is there");
    let other = Delivery {
        digest: BlobHash::of(b"other"),
        ..delivery(&twin, twin.node)
    };
    assert!(matches!(deliver(&mut farm, &other, 1), Err(Refusal::Conflict { .. })));
}

#[test]
fn without_tokens_names_tell_principals_apart() {
    let at = |machine: &str| Origin {
        token: String::new(),
        machine: machine.into(),
    };
    assert_eq!(at("127.0.0.1").principal("a"), at("::").principal("a"));
    assert_ne!(at("127.0.0.1").principal("a"), at("127.0.0.1").principal("b"));
    assert_eq!(rack("10.0.0.1").principal("a"), rack("10.0.0.1").principal("b"));
    assert_ne!(rack("10.0.0.1").principal("a"), rack("10.0.0.2").principal("a"));
    // No text of a token and a machine reads as another pair.
    let pair = |token: &str, machine: &str| {
        Origin {
            token: token.into(),
            machine: machine.into(),
        }
        .principal("")
    };
    assert_ne!(pair("a", "bc"), pair("ab", "c"));
}

#[test]
fn a_scene_is_broken_when_two_principals_say_so() {
    let mut farm = farm_of(&[rack("10.0.0.1"), rack("10.0.0.1"), rack("10.0.0.2")]);
    fail(&mut farm, 1, FailureKind::Scene, 0);
    fail(&mut farm, 2, FailureKind::Scene, 1);
    assert!(farm.job(JOB).is_some(), "one machine has said so twice");
    fail(&mut farm, 3, FailureKind::Scene, 2);
    assert!(farm.job(JOB).is_none());
}

#[test]
fn one_principal_has_no_iteration_given_up_that_others_could_render() {
    let mut farm = farm_of(&[rack("10.0.0.1"), rack("10.0.0.1"), rack("10.0.0.2")]);
    for now in 0..9 {
        fail(&mut farm, 1 + now % 2, FailureKind::Panic, now);
    }
    let given_up = |farm: &Farm| farm.job(JOB).unwrap().given_up().count();
    assert_eq!(given_up(&farm), 0, "it has failed nine times, and counts once");
    fail(&mut farm, 3, FailureKind::Panic, 10);
    assert_eq!(given_up(&farm), 0);
    fail(&mut farm, 1, FailureKind::Panic, 11);
    assert_eq!(given_up(&farm), 1, "all that are there have failed: three times in all");
}

#[test]
fn only_the_token_that_registered_a_worker_speaks_for_it() {
    let farm = farm_of(&[rack("10.0.0.1")]);
    assert_eq!(farm.check_token(WorkerId(1), "rack"), Ok(()));
    let foreign = Err(Refusal::ForeignWorker(WorkerId(1)));
    assert_eq!(farm.check_token(WorkerId(1), "other"), foreign);
    assert_eq!(farm.check_token(WorkerId(1), ""), foreign);
}

#[test]
fn nonces_of_leases_cannot_be_foreseen_and_are_needed() {
    let mut farm = farm_of(&[rack("10.0.0.1")]);
    farm.config.secret = NonceKey([1; 32]);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let mut other = farm_of(&[rack("10.0.0.1")]);
    other.config.secret = NonceKey([2; 32]);
    assert_ne!(grant(&mut other, 1, &[], 0).unwrap().token.nonce, lease.token.nonce);
    let mut guessed = delivery(&lease, lease.node);
    guessed.token.nonce ^= 1;
    assert_eq!(deliver(&mut farm, &guessed, 1), Err(Refusal::StaleLease(guessed.token)));
    assert_eq!(farm.release(JOB, guessed.token, WorkerId(1)).changes, []);
    let beat = [LeaseProgress {
        token: guessed.token,
        leaves_done: 1,
    }];
    assert_eq!(farm.heartbeat(WorkerId(1), &beat, 1), Ok(vec![guessed.token]));
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 1),
        Ok(Delivered::Counted)
    );
}

#[test]
fn quarantine_holds_for_all_of_a_name_that_are_connected_and_not_for_a_namesake_with_another_token() {
    let config = SchedulerConfig::default();
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    let other = Origin {
        token: "other".into(),
        machine: "10.0.0.9".into(),
    };
    for (name, origin) in [
        ("twin", rack("10.0.0.1")),
        ("twin", rack("10.0.0.2")),
        ("twin", other),
        ("w", rack("10.0.0.1")),
    ] {
        hire_from(&mut farm, name, origin, 0);
    }
    commit(&mut farm, 0, |farm| farm.submit(spec(8), String::new(), None, 0));
    let done = grant(&mut farm, 2, &[], 0).unwrap();
    deliver(&mut farm, &delivery(&done, done.node), 1).unwrap();
    let held = grant(&mut farm, 2, &[], 1).unwrap();
    commit(&mut farm, 2, |farm| farm.quarantine(WorkerId(1), "by hand").unwrap());
    let list = farm.worker_statuses(2);
    let quarantined = [true, true, false, false];
    assert_eq!(
        list.iter()
            .map(|worker| worker.quarantine.is_some())
            .collect::<Vec<_>>(),
        quarantined
    );
    assert_eq!(
        deliver(&mut farm, &delivery(&held, held.node), 3),
        Err(Refusal::StaleLease(held.token))
    );
    assert_eq!(
        farm.job(JOB).unwrap().done(),
        0,
        "the namesake's unconfirmed work is given up, too"
    );
    assert_eq!(grant(&mut farm, 2, &[], 3), None);
    assert!(grant(&mut farm, 3, &[], 3).is_some());
    commit(&mut farm, 4, |farm| farm.release_worker(WorkerId(2)).unwrap());
    assert!(farm.worker_statuses(4).iter().all(|worker| worker.quarantine.is_none()));
}

#[test]
fn a_token_registers_a_bounded_number_of_workers() {
    let mut farm = farm_of(&[]);
    farm.config.most_workers = 2;
    hire_from(&mut farm, "w1", rack("10.0.0.1"), 0);
    hire_from(&mut farm, "w2", rack("10.0.0.1"), 1);
    let register = |farm: &Farm, now| farm.register(introduction(), rack("10.0.0.2"), now);
    let full = Refusal::TooManyWorkers { registered: 2, most: 2 };
    assert_eq!(register(&farm, 2), Err(full));
    assert!(
        farm.register(introduction(), Origin::default(), 2).is_ok(),
        "another token has a bound of its own"
    );
    let later = 30_001;
    let Decision { changes, .. } = register(&farm, later).unwrap();
    assert_eq!(
        changes[0],
        Change::WorkerForgotten(WorkerId(1)),
        "the one that is gone makes room"
    );
    assert_eq!(changes.len(), 2);
}

#[test]
fn a_request_that_a_later_one_has_overtaken_ends_nothing_and_gets_nothing() {
    let mut farm = farm_of(&[rack("10.0.0.1")]);
    let zombie = asked(&farm, 1, &[]);
    farm.asks(zombie.worker, zombie.serial, 0).unwrap();
    let lease = grant(&mut farm, 1, &[], 1).unwrap();
    assert_eq!(farm.lease(&zombie, 2).unwrap().changes, []);
    // A coordinator that did not hear the later request knows its lease.
    farm.workers.set_serial(WorkerId(1), zombie.serial);
    assert_eq!(farm.lease(&zombie, 2).unwrap().changes, []);
    assert_eq!(
        deliver(&mut farm, &delivery(&lease, lease.node), 3),
        Ok(Delivered::Counted)
    );
}

#[test]
fn a_worker_is_believed_no_more_seconds_than_its_lease_has_lasted() {
    let mut farm = farm_of(&[rack("10.0.0.1")]);
    let lease = grant(&mut farm, 1, &[], 0).unwrap();
    let mut lie = delivery(&lease, lease.node);
    lie.totals.seconds.trace_camera = f64::MAX;
    lie.totals.seconds.other = f64::MAX;
    deliver(&mut farm, &lie, 4_000).unwrap();
    let seconds = farm.job(JOB).unwrap().totals().seconds.total();
    assert!(seconds <= 4.0, "{seconds} s");
    let next = grant(&mut farm, 1, &[], 4_000).unwrap();
    assert!(next.expected_ms.unwrap() <= 4_000, "{next:?}");
    hire_from(&mut farm, "w2", rack("10.0.0.2"), 4_000);
    let again = grant(&mut farm, 2, &[], 4_000 + 2 * 4_000 + 1).unwrap();
    assert_eq!(
        again.node, next.node,
        "a worker that was slow once does not keep its next lease for ever"
    );
}
