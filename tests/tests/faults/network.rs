//! Networks that cut, lose, delay, or pass one way only. Coordinator and workers are on hosts of their own.

use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_test_servers::Postgres;
use photonfarm_tests::farm::{Farm, Job, Network, Reference, Stores};
use photonfarm_tests::processes::{photonfarm, printed, wait_for};
use reqwest::Method;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long a fault lasts that no lease must end of.
const SHORT: Duration = Duration::from_secs(8);

/// The figure that counts leases that ended without a sign of life.
const LOST: &str = "failed_attempts_total{kind=\"lost\"}";

fn job(iterations: u32) -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator: "pcf",
        size: 32,
        iterations,
        more: &["--set", "photons=20000"],
    };
    job.alone()
}

/// A farm with a worker on each host of the network but the one in the middle, where the coordinator is, and the
/// calling thread.
fn farm(network: &Network) -> Farm {
    let folder = tempfile::tempdir().unwrap().keep();
    let data = folder.to_str().unwrap();
    let token = administrator("--data", data);
    let listen = format!("{}:7800", network.centre.address());
    let mut farm = Farm::at(&listen, &Stores::folder(&folder));
    farm.client = farm.client.clone().with_token(Some(&token));
    for host in &network.hosts {
        farm.hire_with(host.launch(), None);
    }
    farm
}

/// A token of the farm that is kept there: beyond loopback there must be one.
fn administrator(option: &str, place: &str) -> String {
    printed(&photonfarm(&[
        "token", "create", "boss", "--role", "admin", option, place,
    ]))
}

/// A farm with a coordinator on each host of the network but the one in the middle, where the database is, the worker,
/// and the calling thread; before it what it lives on, which is to be dropped after it.
fn farm_on_a_database(network: &Network) -> (Postgres, TempDir, Farm) {
    let postgres = Postgres::start();
    let folder = tempfile::tempdir().unwrap();
    let url = postgres.listen(&network.centre.address().to_string());
    let token = administrator("--state", &url);
    let mut farm = Farm::across(&network.hosts, &Stores::database(&url, folder.path()));
    farm.client = farm.client.clone().with_token(Some(&token));
    farm.hire(1);
    (postgres, folder, farm)
}

/// Waits until workers hold leases of the job, all of them.
fn wait_for_work(farm: &Farm, job: JobId) {
    let count = farm.workers.len() as u32;
    let status = farm.client.when(job, "all workers to be at work", |job| {
        job.workers == count || job.state.ended()
    });
    assert!(!status.state.ended(), "the job was over before anything happened to it");
}

fn short_cuts_and_half_open_connections_cost_no_lease() {
    let network = Network::new(2);
    network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(240));
        for (to_centre, from_centre) in [("drop", "drop"), ("drop", "accept"), ("accept", "drop")] {
            wait_for_work(&farm, job);
            network
                .hosts
                .iter()
                .for_each(|host| network.fault(host, to_centre, from_centre));
            for host in &network.hosts {
                wait_for("packets that are lost", || (network.dropped(host) > 0).then_some(()));
            }
            std::thread::sleep(SHORT);
            let after = farm.client.when_done(job, 0).iterations_done;
            network.hosts.iter().for_each(|host| network.heal(host));
            farm.client.when_done(job, after + 4);
        }
        farm.client.when_done(job, u64::MAX);
        assert_eq!(farm.figure(LOST), 0, "a lease ended");
        assert_eq!(farm.figure("workers_registered_total"), 2, "a worker gave up");
        let _logs = farm.settle();
    });
}

fn a_cut_longer_than_a_lease_costs_the_lease_and_nothing_else() {
    let network = Network::new(1);
    network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(60));
        assert!(!farm.client.when_done(job, 10).state.ended());
        wait_for_work(&farm, job);
        network.cut(&network.hosts[0]);
        wait_for("the lease's end", || (farm.figure(LOST) == 1).then_some(()));
        network.heal(&network.hosts[0]);
        farm.client.when_done(job, u64::MAX);
        assert_eq!(farm.failed_attempts(), 1);
        let _logs = farm.settle();
    });
}

fn a_host_that_vanishes_leaves_its_work_to_others() {
    let network = Network::new(2);
    network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(60));
        wait_for_work(&farm, job);
        // No packet tells of the end: for the coordinator the connections live on.
        network.cut(&network.hosts[0]);
        farm.workers[0].kill();
        let began = Instant::now();
        farm.client.when(job, "the end", |job| job.state.ended());
        println!("the others needed {:.1} s", began.elapsed().as_secs_f64());
        farm.workers.remove(0);
        let _logs = farm.settle();
    });
}

/// The database's server hears nothing of the end: for it, the connections of the coordinator that leads live on, with the
/// lock that says so.
fn a_coordinator_whose_host_vanishes_holds_up_no_other() {
    let network = Network::new(2);
    network.centre.inside(|| {
        let (_postgres, _folder, mut farm) = farm_on_a_database(&network);
        let job = farm.submit(&job(40));
        assert!(!farm.client.when_done(job, 5).state.ended());
        network.cut(&network.hosts[0]);
        farm.servers[0].kill();
        // Only one that leads adds up images, without which no job ends.
        farm.client.when(job, "the end", |job| job.state.ended());
        farm.servers.remove(0);
        let _logs = farm.settle();
    });
}

/// The database is silent: packets to and from it are lost, and no connection is closed.
fn a_silent_database_is_named_and_the_farm_goes_on_with_it_by_itself() {
    let network = Network::new(1);
    network.centre.inside(|| {
        let (_postgres, _folder, mut farm) = farm_on_a_database(&network);
        let (first, second) = (job(60), job(4));
        let first_id = farm.submit(&first);
        let status = farm.client.when_done(first_id, 5);
        assert!(!status.state.ended());
        let spec = JobSpec {
            iterations: 4,
            ..status.spec
        };

        let host = &network.hosts[0];
        network.fault(host, "tcp dport 5432 drop", "tcp sport 5432 drop");
        let problem = wait_for("`healthz` to say so", || farm.client.health()?.err());
        assert_eq!(problem.code, ErrorCode::Unavailable, "{problem:?}");
        // Each request is answered, if only by a problem.
        let (status, answer) = farm.client.send(Method::GET, "jobs", &[], Vec::new()).unwrap();
        let problem: Problem = serde_json::from_slice(&answer).unwrap();
        assert_eq!((status, problem.code), (503, ErrorCode::Unavailable), "{problem:?}");
        assert!(
            problem.retryable && problem.detail.contains("the database"),
            "{problem:?}"
        );
        assert_eq!(farm.figure("store_failing{part=\"answers\"}"), 1);

        let second_id = std::thread::scope(|scope| {
            let submission = scope.spawn(|| farm.client.insist(&spec, "sent while the database is silent"));
            wait_for("another look at the database", || {
                let away = farm.figure("store_failures_total{part=\"answers\",reason=\"store-away\"}");
                (away > 1).then_some(())
            });
            network.heal(host);
            submission.join().unwrap()
        });
        farm.expect(second_id, &second);
        wait_for("`healthz`", || farm.client.health()?.ok());
        farm.client.when_done(first_id, u64::MAX);
        assert_eq!(farm.figure("workers_registered_total"), 1, "the worker gave up");
        let _logs = farm.settle();
    });
}

fn lossy_and_slow_links_slow_a_job_and_no_more() {
    let network = Network::new(3);
    let [lossy, lossier, slow] = network.hosts.as_slice() else {
        panic!("three hosts were asked for")
    };
    network.lose(lossy, 10);
    network.lose(lossier, 20);
    network.narrow(slow, 512);
    network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(60));
        let status = farm.client.when(job, "the end", |job| job.state.ended());
        println!("{:.1} s", (status.ended_ms.unwrap() - status.created_ms) as f64 / 1e3);
        println!("registered {} times", farm.figure("workers_registered_total"));
        let _logs = farm.settle();
    });
}

/// The tests of this module spend their time waiting: they do so side by side.
#[test]
fn networks_fail_and_farms_go_on() {
    let tests = [
        short_cuts_and_half_open_connections_cost_no_lease,
        a_cut_longer_than_a_lease_costs_the_lease_and_nothing_else,
        a_host_that_vanishes_leaves_its_work_to_others,
        a_coordinator_whose_host_vanishes_holds_up_no_other,
        a_silent_database_is_named_and_the_farm_goes_on_with_it_by_itself,
        lossy_and_slow_links_slow_a_job_and_no_more,
    ];
    std::thread::scope(|scope| tests.iter().for_each(|test| drop(scope.spawn(test))));
}
