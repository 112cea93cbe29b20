//! What an event costs, in entries of tables that are looked at: it does not grow with the number of jobs, workers,
//! leases and nodes. (To find one entry takes a number of comparisons that grows with the logarithm; that is the
//! tables' business.)

use super::table::LOOKS;
use super::*;

/// Most entries that an event looks at, whatever the size of the farm. An upload looks at 72, more than anything else:
/// at each level of the tree there might be a lease that is done with.
const MOST: u64 = 80;

/// Counts the entries that are looked at.
fn cost<T>(event: impl FnOnce() -> T) -> (T, u64) {
    let before = LOOKS.get();
    let result = event();
    (result, LOOKS.get() - before)
}

/// A farm of `size` workers, each with a lease of the first job, `size` nodes of that job that cannot be merged, `size`
/// leaves that were given up, `size` jobs of others that are lent out, and as many that wait, some of them for workers
/// that are not there.
fn farm_of(size: u64) -> Farm {
    let config = SchedulerConfig {
        verify_until: 0,
        max_attempts: 1,
        max_failures: 1,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    let submit = |farm: &mut Farm, spec: JobSpec, owner: u64| {
        commit(farm, 0, |farm| farm.submit(spec, format!("owner {owner}"), None, 0))
    };
    submit(&mut farm, spec(8 * size as u32), 0);
    for number in 1..=size {
        hire(&mut farm, &format!("w{number}"), 0);
    }
    for number in 1..=size {
        // Every lease is of one leaf, while no speed is known; a gap is left after each node.
        for outcome in 0..2 {
            let lease = grant(&mut farm, number, &[], 0).unwrap();
            assert_eq!((lease.job, lease.node.level), (JobId(1), 0));
            let node = lease.node;
            if outcome == 0 && node.index.is_multiple_of(2) {
                let delivery = Delivery {
                    totals: Totals::default(),
                    ..delivery(&lease, node)
                };
                deliver(&mut farm, &delivery, 0).unwrap();
            } else {
                let attempt = Attempt {
                    worker: lease.worker,
                    kind: FailureKind::Render,
                    message: "it failed".into(),
                    at_ms: 0,
                };
                commit(&mut farm, 0, |farm| {
                    farm.fail(lease.job, lease.token, node.index, attempt, 0).unwrap()
                });
            }
        }
    }
    for number in 1..=size {
        grant(&mut farm, number, &[], 0).unwrap();
    }
    for number in 0..size {
        submit(&mut farm, spec(1), number);
        let tagged = submit(&mut farm, spec(4), number);
        let mut control = farm.job(tagged).unwrap().control().clone();
        control.schedule.tags.insert("gpu".into());
        commit(&mut farm, 0, |_| {
            Decision::new((), vec![Change::JobChanged { job: tagged, control }])
        });
    }
    farm
}

fn event<T>(farm: &mut Farm, decide: impl FnOnce(&Farm) -> Decision<T>) -> T {
    let Decision { reply, changes } = decide(farm);
    changes.iter().for_each(|change| farm.evolve(change, 2));
    reply
}

fn lend(farm: &mut Farm, worker: WorkerId, held: &[LeaseToken]) -> Option<LeaseRecord> {
    let asked = asked(farm, worker.0, held);
    farm.asks(worker, asked.serial, 1).unwrap();
    event(farm, |farm| farm.lease(&asked, 1).unwrap())
}

/// What a lease, a heartbeat and an upload cost in a farm of this size.
fn costs(size: u64) -> [(&'static str, u64); 5] {
    let mut farm = farm_of(size);
    let job = farm.job(JobId(1)).unwrap();
    assert!(job.live_nodes().count() as u64 >= size / 2 && job.given_up().count() as u64 >= size / 2);
    assert!(job.leases_held().len() as u64 == size && farm.jobs().count() as u64 == 1 + 2 * size);
    let worker = WorkerId(size / 2);
    let held: Vec<LeaseToken> = farm.leases_of(worker).map(|lease| lease.token).collect();
    let progress: Vec<LeaseProgress> = held
        .iter()
        .map(|token| LeaseProgress {
            token: *token,
            leaves_done: 1,
        })
        .collect();
    let (lost, heartbeat) = cost(|| farm.heartbeat(worker, &progress, 1).unwrap());
    assert_eq!(lost, []);
    let (lease, lend) = cost(|| lend(&mut farm, worker, &held).unwrap());
    let delivery = delivery(&lease, lease.node);
    let mut upload = || cost(|| event(&mut farm, |farm| farm.deliver(&delivery, 2).unwrap()));
    let ((counted, upload), (known, repeat)) = (upload(), upload());
    assert_eq!([counted, known], [Delivered::Counted, Delivered::Duplicate]);
    let (_, settle) = cost(|| {
        let _merge = farm.job(lease.job).and_then(Job::next_merge);
        event(&mut farm, |farm| farm.settle(lease.job, 3))
    });
    [
        ("a heartbeat", heartbeat),
        ("a lease", lend),
        ("an upload", upload),
        ("an upload that is repeated", repeat),
        ("a look for what to merge", settle),
    ]
}

#[test]
fn what_an_event_costs_does_not_grow_with_the_farm() {
    for size in [16, 2048] {
        for (event, cost) in costs(size) {
            println!("{event} looks at {cost} entries in a farm of size {size}");
            assert!(cost <= MOST, "{event} looks at {cost} entries in a farm of size {size}");
        }
    }
}

#[test]
fn a_worker_without_work_costs_the_same_however_many_jobs_are_lent_out() {
    let idle = |size: u64| {
        let mut farm = farm_of(size);
        let jobs: Vec<JobId> = farm.jobs().map(Job::id).collect();
        for job in jobs {
            commit(&mut farm, 0, |farm| farm.pause(job, true).unwrap());
        }
        let (lease, idle) = cost(|| lend(&mut farm, WorkerId(1), &[]));
        assert!(lease.is_none());
        idle
    };
    assert!(idle(16) <= MOST && idle(2048) <= MOST);
}
