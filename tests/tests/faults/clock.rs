//! Clocks that are wrong by hours.

use photonfarm_test_servers::{Postgres, S3};
use photonfarm_tests::farm::{Clock, Farm, Job, Reference, Stores, wrong_clock};
use std::sync::Arc;

fn job() -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator: "pppm",
        size: 24,
        iterations: 40,
        more: &["--set", "photons=20000"],
    };
    job.alone()
}

#[test]
fn workers_may_have_any_time_with_signed_urls_as_well() {
    let (postgres, s3) = (Postgres::start(), S3::start());
    let clock = Clock::new("+0");
    let mut farm = Farm::on(&Stores::shared(&postgres, &s3), 1);
    for launch in [wrong_clock("+7h"), wrong_clock("-7h"), clock.launch()] {
        farm.hire_with(launch, None);
    }
    let job = farm.submit(&job());
    for (iterations, jump) in [(10, "-30d"), (20, "+30d")] {
        assert!(!farm.client.when_done(job, iterations).state.ended());
        clock.set(jump);
    }
    farm.client.when_done(job, u64::MAX);
    assert_eq!(farm.figure("workers_registered_total"), 3, "a worker gave up");
    let _logs = farm.settle();
}

#[test]
fn a_coordinator_may_start_with_another_time() {
    let mut farm = Farm::start(&[]);
    farm.hire(2);
    let job = farm.submit(&job());
    let right = farm.servers[0].launch.clone();
    for (iterations, offset) in [(10, "-7h"), (20, "+7h")] {
        assert!(!farm.client.when_done(job, iterations).state.ended());
        farm.servers[0].kill();
        farm.servers[0].launch = wrong_clock(offset);
        farm.servers[0].resume();
    }
    let _logs = farm.settle_after(|server| server.launch = right);
}
