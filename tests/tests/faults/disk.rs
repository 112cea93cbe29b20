//! Disks that run full during a job.

use photonfarm_tests::farm::{Disk, Farm, Job, Reference, Stores};
use photonfarm_tests::processes::{Launch, wait_for};
use std::sync::Arc;

/// What a log says of a full disk: the system's words, and SQLite's.
const FULL: [&str; 2] = ["No space left on device", "database or disk is full"];

fn job() -> Arc<Reference> {
    let job = Job {
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
    let (_, workers) = farm.settle();
    assert!(!workers.contains("work is dropped"), "{workers}");
}

/// How often a log says that the disk is full.
fn failures(farm: &Farm) -> usize {
    let log = farm.servers[0].log();
    FULL.iter().map(|words| log.matches(words).count()).sum()
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
    farm.workers[0]
        .process()
        .wait_for_error("what the work begins with is not at hand");
    assert_eq!(farm.client.when_done(job, 0).iterations_done, 0);
    disk.free();
    farm.client.when_done(job, 5);
    let (coordinators, _) = farm.settle();
    assert!(
        !coordinators.contains("iteration failed"),
        "nobody is to blame: {coordinators}"
    );
}
