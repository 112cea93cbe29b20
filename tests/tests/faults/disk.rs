//! Disks that run full during a job.

use photonfarm_proto::api::Health;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::waiting::Waiting;
use photonfarm_tests::farm::{Disk, Farm, Job, Reference, Stores};
use photonfarm_tests::processes::{Launch, wait_for};
use std::sync::Arc;

fn job() -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator: "pcf",
        size: 64,
        iterations: 50,
        more: &["--set", "photons=10000"],
    };
    job.alone()
}

/// Runs a job on a farm of which `disk` holds a part, and lets the disk run full: while the coordinator runs, and then
/// while it is killed and started again.
fn run_full(disk: &Disk, stores: &Stores) {
    let mut farm = Farm::on(stores, 1);
    farm.hire(2);
    let job = farm.submit(&job());
    assert!(!farm.client.when_done(job, 10).state.ended());
    for restarted in [false, true] {
        let before = failures(&farm);
        wait_for("the disk to be found full", || {
            disk.fill();
            (failures(&farm) > before).then_some(())
        });
        wait_for("everybody to be told of the full disk", || {
            disk.fill();
            is_told(&farm, job).then_some(())
        });
        let status = farm.client.when_done(job, 0);
        assert!(!status.state.ended(), "the job ended on a full disk: {status:?}");
        if restarted {
            farm.servers[0].kill();
            disk.fill();
            let running = farm.servers[0].try_to_resume();
            disk.free();
            if !running {
                farm.servers[0].resume();
            }
        } else {
            disk.free();
            farm.client.when_done(job, status.iterations_done + 5);
        }
    }
    farm.client.when_done(job, u64::MAX);
    assert_eq!(farm.failed_attempts(), 0, "nobody is to blame");
    let _logs = farm.settle();
}

/// How often a store failed since its disk was full.
fn failures(farm: &Farm) -> u64 {
    let of = |part| farm.figure(&format!("store_failures_total{{part=\"{part}\",reason=\"disk-full\"}}"));
    ["answers", "state", "images", "scenes"].into_iter().map(of).sum()
}

/// Whether the job's status, `healthz` and `/metrics` say that the disk is full.
fn is_told(farm: &Farm, job: JobId) -> bool {
    let waits = |status: JobStatus| status.waiting_reason == Some(Waiting::DiskFull);
    let status: Option<JobStatus> = farm.client.get(&format!("jobs/{job}"));
    let health = farm.client.health().and_then(Result::ok);
    let obstructed = |health: Health| {
        let found = health
            .obstacles
            .iter()
            .any(|obstacle| obstacle.reason == Waiting::DiskFull);
        found && health.status == "failing" && health.waiting.get(&Waiting::DiskFull) == Some(&1)
    };
    status.is_some_and(waits)
        && health.is_some_and(obstructed)
        && farm.figure("jobs_waiting{reason=\"disk-full\"}") == 1
}

#[test]
fn a_full_disk_loses_neither_state_nor_bytes() {
    let disk = Disk::new(16);
    run_full(&disk, &Stores::folder(disk.path()));
}

#[test]
fn a_full_disk_of_the_state_loses_nothing() {
    let (disk, bytes) = (Disk::new(16), tempfile::tempdir().unwrap());
    run_full(&disk, &Stores::folders(disk.path(), bytes.path()));
}

#[test]
fn a_full_disk_of_a_worker_keeps_nothing_from_others() {
    let disk = Disk::new(1);
    disk.fill();
    let mut farm = Farm::start(&[]);
    farm.hire_with(Launch::default(), Some(disk.path().join("cache")));
    let job = farm.submit(&job());
    wait_for("the worker to give leases back", || {
        (farm.figure("leases_granted_total") > 2).then_some(())
    });
    assert_eq!(farm.client.when_done(job, 0).iterations_done, 0);
    disk.free();
    farm.client.when_done(job, 5);
    farm.client.when_done(job, u64::MAX);
    assert_eq!(farm.failed_attempts(), 0, "nobody is to blame");
    let _logs = farm.settle();
}
