//! Processes are killed at random moments, again and again.

use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_test_servers::{Postgres, S3};
use photonfarm_tests::farm::{Farm, Job, Random, Reference, Stores};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Jobs at once: while the blocks of the dead wait to be lent to others, later jobs go on.
const AT_ONCE: usize = 12;

/// Jobs of different shapes: a full tree, one of many maximal nodes, long blocks, a chain, and light in fog and smoke.
fn jobs() -> Vec<Arc<Reference>> {
    let job = |integrator, size, iterations, more| Job {
        scene: "environment",
        integrator,
        size,
        iterations,
        more,
    };
    let in_media = Job {
        scene: "media",
        ..job("vcm", 16, 11, &["--set", "photons=500"])
    };
    vec![
        job("pppm", 16, 16, &["--set", "photons=2000"]).alone(),
        job("pcf", 16, 13, &["--set", "photons=500"]).alone(),
        job("path", 24, 80, &["--set", "samples=2"]).alone(),
        job("sppm", 16, 40, &["--set", "photons=500"]).alone(),
        in_media.alone(),
    ]
}

/// A number from the environment.
fn number(name: &str, default: u64) -> u64 {
    let value = std::env::var(name).ok();
    value.map_or(default, |value| {
        value.parse().unwrap_or_else(|_| panic!("{name}={value} is no number"))
    })
}

/// When something is killed: once so many iterations of the newest job are done, and after a part of the time that one
/// takes; or while a job is being submitted.
#[derive(Debug)]
enum Moment {
    Submission { part: f64 },
    Iteration { done: u64, part: f64 },
}

/// What happens in a round.
#[derive(Debug)]
struct Fate {
    job: usize,
    moment: Moment,
    servers: Vec<usize>,
    workers: Vec<usize>,
    /// The coordinator is killed again at this part of the time that a start takes.
    again: Option<f64>,
    /// The workers killed find an empty cache afterwards.
    forget: bool,
}

impl Fate {
    fn draw(random: &mut Random, jobs: &[Arc<Reference>], servers: usize, workers: usize) -> Self {
        let job = random.below(jobs.len() as u64) as usize;
        let iterations = u64::from(jobs[job].job.iterations);
        let moment = match random.below(8) {
            0 => Moment::Submission {
                part: random.fraction(),
            },
            _ => Moment::Iteration {
                done: random.below(iterations),
                part: random.fraction(),
            },
        };
        let mut one = |count: usize| vec![random.below(count as u64) as usize];
        let (server, worker) = (one(servers), one(workers));
        let (all_servers, all_workers) = ((0..servers).collect(), (0..workers).collect());
        let (servers, workers) = match random.below(10) {
            0..=3 => (server, vec![]),
            4..=6 => (vec![], worker),
            7 => (server, worker),
            8 => (vec![], all_workers),
            _ => (all_servers, all_workers),
        };
        Self {
            job,
            moment,
            servers,
            workers,
            again: (random.below(4) == 0).then(|| random.fraction()),
            forget: random.below(4) == 0,
        }
    }
}

/// A farm under fire.
struct Ground {
    farm: Farm,
    references: Vec<Arc<Reference>>,
    specs: Vec<JobSpec>,
    /// Time that an iteration of each kind of job takes on the calm farm.
    paces: Vec<Duration>,
    /// Time that a start of a coordinator takes.
    start: Duration,
    in_flight: VecDeque<(JobId, Arc<Reference>)>,
}

impl Ground {
    /// Renders one job of each kind in peace.
    fn new(mut farm: Farm, workers: usize) -> Self {
        let references = jobs();
        farm.hire(workers);
        let (mut specs, mut paces) = (Vec::new(), Vec::new());
        for reference in &references {
            let id = farm.submit(reference);
            let began = Instant::now();
            let status: JobStatus = farm.client.when(id, "a calm job's end", |job| job.state.ended());
            paces.push(began.elapsed() / reference.job.iterations);
            specs.push(status.spec);
        }
        let began = Instant::now();
        farm.servers[0].kill();
        farm.servers[0].resume();
        Self {
            farm,
            references,
            specs,
            paces,
            start: began.elapsed(),
            in_flight: VecDeque::new(),
        }
    }

    fn round(&mut self, round: u64, fate: &Fate) {
        let reference = self.references[fate.job].clone();
        let (spec, key) = (self.specs[fate.job].clone(), format!("round {round}"));
        let pace = self.paces[fate.job];
        let client = self.farm.client.clone();
        let id = match fate.moment {
            Moment::Submission { part } => std::thread::scope(|scope| {
                let submission = scope.spawn(|| client.insist(&spec, &key));
                std::thread::sleep(pace.mul_f64(part));
                self.strike(fate);
                submission.join().unwrap()
            }),
            Moment::Iteration { done, part } => {
                let id = client.insist(&spec, &key);
                client.when_done(id, done);
                std::thread::sleep(pace.mul_f64(part));
                self.strike(fate);
                id
            }
        };
        self.farm.expect(id, &reference);
        self.in_flight.push_back((id, reference));
        if self.in_flight.len() >= AT_ONCE
            && let Some((id, reference)) = self.in_flight.pop_front()
        {
            client.check(id, &reference);
        }
    }

    /// Kills, and starts again.
    fn strike(&mut self, fate: &Fate) {
        let Farm { servers, workers, .. } = &mut self.farm;
        fate.servers.iter().for_each(|index| servers[*index].kill());
        for index in &fate.workers {
            workers[*index].kill();
            if fate.forget {
                workers[*index].forget_scenes();
            }
            workers[*index].resume();
        }
        for index in &fate.servers {
            if let Some(part) = fate.again {
                servers[*index].start_in_vain(self.start.mul_f64(part));
            }
            servers[*index].resume();
        }
    }

    /// Strikes so often. Returns the farm, whose jobs go on.
    fn rounds(mut self, name: &str, rounds: u64, seed: u64) -> Farm {
        println!("{name}: {rounds} rounds, PHOTONFARM_SEED={seed}");
        let mut random = Random::new(seed);
        let began = Instant::now();
        for round in 0..rounds {
            let Farm { servers, workers, .. } = &self.farm;
            let fate = Fate::draw(&mut random, &self.references, servers.len(), workers.len());
            println!(
                "{name}: {:8.3} s, round {round}: {fate:?}",
                began.elapsed().as_secs_f64()
            );
            self.round(round, &fate);
        }
        println!(
            "{name}: {:8.3} s, the last round is over",
            began.elapsed().as_secs_f64()
        );
        self.farm
    }
}

/// What the logs say of the dead.
fn report(name: &str, (coordinators, workers): (String, String)) {
    let starts = workers.matches("registered").count();
    let lost = coordinators.matches("was lost while rendering it").count();
    println!("{name}: workers registered {starts} times; {lost} leases ran out");
    assert!(!coordinators.contains("incident"), "{coordinators}");
}

fn kills_of_any_process_leave_no_trace() {
    let (rounds, seed) = (number("PHOTONFARM_ROUNDS", 25), number("PHOTONFARM_SEED", 1));
    let ground = Ground::new(Farm::start(&[]), 3);
    report(
        "one coordinator",
        ground.rounds("one coordinator", rounds, seed).settle(),
    );
}

fn kills_among_two_coordinators_leave_no_trace() {
    let (rounds, seed) = (number("PHOTONFARM_ROUNDS", 25) / 5, number("PHOTONFARM_SEED", 1));
    let (postgres, s3) = (Postgres::start(), S3::start());
    let ground = Ground::new(Farm::on(&Stores::shared(&postgres, &s3), 2), 2);
    let farm = ground.rounds("two coordinators", rounds.max(1), seed);
    report("two coordinators", farm.settle());
}

/// Both wait at times until blocks of the dead are lent to others: they do so side by side.
#[test]
fn kills_leave_no_trace() {
    std::thread::scope(|scope| {
        scope.spawn(kills_of_any_process_leave_no_trace);
        scope.spawn(kills_among_two_coordinators_leave_no_trace);
    });
}
