//! PostgreSQL and the object store go away during a job, and come back.

use photonfarm_test_servers::{Postgres, S3};
use photonfarm_tests::farm::{Farm, Job, Reference, Stores};
use photonfarm_tests::processes::wait_for;
use std::sync::Arc;
use std::time::Duration;

/// How long the object store is away.
const OUTAGE: Duration = Duration::from_secs(60);

fn job() -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator: "pcf",
        size: 32,
        iterations: 60,
        more: &["--set", "photons=20000"],
    };
    job.alone()
}

fn postgresql_is_restarted_during_a_job() {
    let (postgres, s3) = (Postgres::start(), S3::start());
    let mut farm = Farm::on(&Stores::shared(&postgres, &s3), 2);
    farm.hire(2);
    let job = farm.submit(&job());
    for iterations in [5, 20, 40] {
        let status = farm.client.when_done(job, iterations);
        assert!(
            !status.state.ended(),
            "the job was over before PostgreSQL could be stopped"
        );
        let before = failures(&farm, "state") + failures(&farm, "answers");
        postgres.stop();
        wait_for("a coordinator to notice", || {
            (failures(&farm, "state") + failures(&farm, "answers") > before).then_some(())
        });
        postgres.resume();
    }
    let _logs = farm.settle();
}

/// How often a part of the stores failed in another way than by a full disk.
fn failures(farm: &Farm, part: &str) -> u64 {
    farm.figure(&format!(
        "store_failures_total{{part=\"{part}\",reason=\"store-away\"}}"
    ))
}

fn the_object_store_is_away_for_a_minute() {
    let (postgres, mut s3) = (Postgres::start(), S3::start());
    let mut farm = Farm::on(&Stores::shared(&postgres, &s3), 2);
    farm.hire(2);
    let job = farm.submit(&job());
    farm.client.when_done(job, 15);
    s3.stop();
    std::thread::sleep(OUTAGE);
    let status = farm.client.when_done(job, 0);
    assert!(!status.state.ended(), "the job ended without its bytes");
    s3.restart();
    farm.client.when_done(job, u64::MAX);
    assert!(failures(&farm, "images") > 0, "nobody noticed");
    assert_eq!(farm.figure("workers_registered_total"), 2, "a worker gave up");
    let _logs = farm.settle();
}

/// The tests of this module spend their time waiting: they do so side by side.
#[test]
fn stores_go_away_and_come_back() {
    std::thread::scope(|scope| {
        scope.spawn(postgresql_is_restarted_during_a_job);
        scope.spawn(the_object_store_is_away_for_a_minute);
    });
}
