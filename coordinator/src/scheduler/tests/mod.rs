//! Tests of the scheduler: random histories, and its rules one by one.

mod after;
mod chains;
mod costs;
mod histories;
mod principals;
mod rules;
mod steering;
mod verification;
mod world;

use super::record::{LeaseRecord, Origin};
use super::*;
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_proto::job::{Attempt, FailureKind, JobState, PhaseSeconds, Totals};
use photonfarm_proto::worker::{LeaseProgress, Register};

fn spec(iterations: u32) -> JobSpec {
    JobSpec {
        scene: BlobHash::of(b""),
        main: "scene.xml".into(),
        defines: Default::default(),
        sensor: None,
        integrator: IntegratorSettings::Path(PathSettings::default()).into(),
        iterations,
        seed: 0,
        schedule: Default::default(),
        layers: Vec::new(),
        name: String::new(),
        labels: Default::default(),
        after: None,
        webhook: None,
    }
}

fn introduction() -> Register {
    Register {
        name: "w".into(),
        threads: 1,
        renderer: "1+a".into(),
        tags: Default::default(),
    }
}

/// A token as tests make it up.
fn token(number: u64) -> LeaseToken {
    LeaseToken { number, nonce: 7 }
}

/// A worker of this name and of a principal of its own.
fn hire(farm: &mut Farm, name: &str, now: Millis) -> WorkerId {
    hire_from(farm, name, Origin::default(), now)
}

fn hire_from(farm: &mut Farm, name: &str, origin: Origin, now: Millis) -> WorkerId {
    let register = Register {
        name: name.into(),
        ..introduction()
    };
    commit(farm, now, |farm| farm.register(register, origin, now).unwrap())
}

fn digest(job: JobId, node: NodeKey) -> BlobHash {
    BlobHash::of(format!("{job} {node}").as_bytes())
}

fn delivery(lease: &LeaseRecord, node: NodeKey) -> Delivery {
    let seconds = PhaseSeconds {
        other: 3.0 * node.leaves() as f64,
        ..PhaseSeconds::default()
    };
    Delivery {
        token: lease.token,
        worker: lease.worker,
        job: lease.job,
        node,
        resolution: [4, 4],
        digest: digest(lease.job, node),
        copy: 0,
        unread: false,
        totals: Totals {
            seconds,
            ..Totals::default()
        },
    }
}

/// A farm that repeats no nodes and tries again at once.
fn farm_with(iterations: u32, workers: u64) -> Farm {
    let config = SchedulerConfig {
        verify_until: 0,
        retry_ms: 0,
        longest_retry_ms: 0,
        ..SchedulerConfig::default()
    };
    let mut farm = Farm::restore(config, Snapshot::default(), 0);
    for number in 1..=workers {
        hire(&mut farm, &format!("w{number}"), 0);
    }
    commit(&mut farm, 0, |farm| {
        farm.submit(spec(iterations), String::new(), None, 0)
    });
    farm
}

fn commit<T>(farm: &mut Farm, now: Millis, decide: impl FnOnce(&Farm) -> Decision<T>) -> T {
    farm.pass_time(now);
    let Decision { reply, changes } = decide(farm);
    changes.iter().for_each(|change| farm.evolve(change, now));
    reply
}

/// A worker's next request.
fn asked(farm: &Farm, worker: u64, held: &[LeaseToken]) -> Asked {
    let worker = WorkerId(worker);
    Asked {
        worker,
        serial: farm.workers.get(worker).map_or(0, |known| known.serial) + 1,
        held: held.to_vec(),
    }
}

fn grant(farm: &mut Farm, worker: u64, held: &[LeaseToken], now: Millis) -> Option<LeaseRecord> {
    let asked = asked(farm, worker, held);
    farm.asks(asked.worker, asked.serial, now).unwrap();
    commit(farm, now, |farm| farm.lease(&asked, now).unwrap())
}

fn deliver(farm: &mut Farm, delivery: &Delivery, now: Millis) -> Result<Delivered, Refusal> {
    let decision = farm.deliver(delivery, now)?;
    Ok(commit(farm, now, |_| decision))
}
