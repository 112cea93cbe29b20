//! PostgreSQL and the object store go away during a job, and come back.

use photonfarm_test_servers::{Postgres, S3};
use photonfarm_tests::farm::{Farm, Job, Reference, Server, Stores};
use std::sync::Arc;
use std::time::Duration;

/// How long the object store is away.
const OUTAGE: Duration = Duration::from_secs(60);

fn job() -> Arc<Reference> {
    let job = Job {
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
        let logs = |farm: &Farm| farm.servers.iter().map(Server::log).collect::<String>();
        let before = logs(&farm).matches("database").count();
        postgres.stop();
        photonfarm_tests::processes::wait_for("a coordinator to notice", || {
            (logs(&farm).matches("database").count() > before).then_some(())
        });
        postgres.resume();
    }
    let (coordinators, _) = farm.settle();
    assert!(coordinators.contains("the database failed") || coordinators.contains("no connection to the database"));
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
    let (coordinators, workers) = farm.settle();
    assert!(coordinators.contains("the object store failed"), "{coordinators}");
    assert_eq!(workers.matches("registered").count(), 2, "a worker gave up: {workers}");
}

/// The tests of this module spend their time waiting: they do so side by side.
#[test]
fn stores_go_away_and_come_back() {
    std::thread::scope(|scope| {
        scope.spawn(postgresql_is_restarted_during_a_job);
        scope.spawn(the_object_store_is_away_for_a_minute);
    });
}
