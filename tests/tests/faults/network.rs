//! Networks that cut, lose, delay, or pass one way only. Coordinator and workers are on hosts of their own.

use photonfarm_proto::id::JobId;
use photonfarm_test_servers::Postgres;
use photonfarm_tests::farm::{Farm, Job, Network, Reference, Stores};
use photonfarm_tests::processes::{photonfarm, wait_for};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long a fault lasts that no lease must end of.
const SHORT: Duration = Duration::from_secs(8);

fn job(iterations: u32) -> Arc<Reference> {
    let job = Job {
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
    // Beyond loopback there must be a token.
    let made = photonfarm(&["token", "create", "boss", "--role", "admin", "--data", data]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let token = String::from_utf8(made.stdout).unwrap();
    let listen = format!("{}:7800", network.centre.address());
    let mut farm = Farm::at(&listen, &Stores::folder(&folder));
    farm.client = farm.client.clone().with_token(Some(token.trim()));
    for host in &network.hosts {
        farm.hire_with(host.launch(), None);
    }
    farm
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
    let (coordinators, workers) = network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(240));
        for (to_centre, from_centre) in [("drop", "drop"), ("drop", "accept"), ("accept", "drop")] {
            wait_for_work(&farm, job);
            network
                .hosts
                .iter()
                .for_each(|host| network.fault(host, to_centre, from_centre));
            // What is on its way may still arrive.
            let [before, after] = [(); 2].map(|()| {
                std::thread::sleep(SHORT / 2);
                farm.client.when_done(job, 0).iterations_done
            });
            assert_eq!(before, after, "the network was not cut");
            network.hosts.iter().for_each(|host| network.heal(host));
            farm.client.when_done(job, after + 4);
        }
        farm.settle()
    });
    assert!(!coordinators.contains("was lost"), "a lease ended: {coordinators}");
    assert_eq!(workers.matches("registered").count(), 2, "a worker gave up: {workers}");
}

fn a_cut_longer_than_a_lease_costs_the_lease_and_nothing_else() {
    let network = Network::new(1);
    let (coordinators, workers) = network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(60));
        assert!(!farm.client.when_done(job, 10).state.ended());
        wait_for_work(&farm, job);
        network.cut(&network.hosts[0]);
        wait_for("the lease's end", || {
            farm.servers[0]
                .log()
                .contains("was lost while rendering it")
                .then_some(())
        });
        network.heal(&network.hosts[0]);
        farm.settle()
    });
    assert!(coordinators.contains("iteration failed"), "{coordinators}");
    assert!(
        workers.contains("the lease is lost") || workers.contains("work is dropped"),
        "{workers}"
    );
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
        let postgres = Postgres::start();
        let (folder, url) = (
            tempfile::tempdir().unwrap(),
            postgres.listen(&network.centre.address().to_string()),
        );
        let made = photonfarm(&["token", "create", "boss", "--role", "admin", "--state", &url]);
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let token = String::from_utf8(made.stdout).unwrap();
        let mut farm = Farm::across(&network.hosts, &Stores::database(&url, folder.path()));
        farm.client = farm.client.clone().with_token(Some(token.trim()));
        farm.hire(1);
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

fn lossy_and_slow_links_slow_a_job_and_no_more() {
    let network = Network::new(3);
    let [lossy, lossier, slow] = network.hosts.as_slice() else {
        panic!("three hosts were asked for")
    };
    network.lose(lossy, 10);
    network.lose(lossier, 20);
    network.narrow(slow, 512);
    let (_, workers) = network.centre.inside(|| {
        let mut farm = farm(&network);
        let job = farm.submit(&job(60));
        let status = farm.client.when(job, "the end", |job| job.state.ended());
        println!("{:.1} s", (status.ended_ms.unwrap() - status.created_ms) as f64 / 1e3);
        farm.settle()
    });
    println!("registered {} times", workers.matches("registered").count());
}

/// The tests of this module spend their time waiting: they do so side by side.
#[test]
fn networks_fail_and_farms_go_on() {
    let tests = [
        short_cuts_and_half_open_connections_cost_no_lease,
        a_cut_longer_than_a_lease_costs_the_lease_and_nothing_else,
        a_host_that_vanishes_leaves_its_work_to_others,
        a_coordinator_whose_host_vanishes_holds_up_no_other,
        lossy_and_slow_links_slow_a_job_and_no_more,
    ];
    std::thread::scope(|scope| tests.iter().for_each(|test| drop(scope.spawn(test))));
}
