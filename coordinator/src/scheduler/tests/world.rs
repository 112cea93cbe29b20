//! A farm, its store, a network that loses and repeats, and workers that come and go, work, fail and lie.

mod checks;
mod hands;
mod model;

use super::*;
use crate::store::memory::Rows;
use model::{Random, added_up, noise};
use photonfarm_core::settings::{IntegratorSettings, PathSettings, SppmSettings};
use photonfarm_proto::schedule::Schedule;
use record::{JobRecord, NodeRecord};
use std::collections::{BTreeMap, BTreeSet};

/// What a history is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Nobody lies.
    Honest,
    /// Everything is repeated, and two honest workers are always there.
    Guarded,
    /// Anything.
    Free,
}

/// What a worker is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Honest,
    /// Fails now and then at what others can render.
    Clumsy,
    /// Sends wrong bits more often than not.
    Liar,
}

#[derive(Clone, Debug)]
struct Hand {
    kind: Kind,
    /// Its latest request for work.
    serial: u64,
    leases: Vec<LeaseRecord>,
}

#[derive(Clone, Debug)]
enum Letter {
    Node(Delivery),
    Failure(LeaseRecord, u32, FailureKind),
    Release(LeaseRecord),
    /// A request for work that waited in a connection which had died: nobody reads the reply.
    Ask(Asked),
}

/// How often things happened.
#[derive(Clone, Debug, Default)]
pub(super) struct Seen {
    pub(super) verdicts: u64,
    pub(super) disputes: u64,
    pub(super) quarantines: u64,
    pub(super) stops: u64,
    pub(super) reopened: u64,
    pub(super) lies_that_counted: u64,
    pub(super) poisoned: u64,
    /// Leases of chains that go on from something.
    pub(super) links: u64,
    /// Jobs that ended because their scene was called broken.
    pub(super) called_broken: u64,
    /// Failures that did not count, since another worker of the same principal had failed before.
    pub(super) repeated: u64,
    /// Requests for work that a later one had overtaken.
    pub(super) overtaken: u64,
    /// Jobs of which what failed was forgotten, so that it is tried again.
    pub(super) retried: u64,
    /// Workers that were drained.
    pub(super) drained: u64,
}

impl Seen {
    pub(super) fn add(&mut self, other: &Self) {
        self.verdicts += other.verdicts;
        self.disputes += other.disputes;
        self.quarantines += other.quarantines;
        self.stops += other.stops;
        self.reopened += other.reopened;
        self.lies_that_counted += other.lies_that_counted;
        self.poisoned += other.poisoned;
        self.links += other.links;
        self.called_broken += other.called_broken;
        self.repeated += other.repeated;
        self.overtaken += other.overtaken;
        self.retried += other.retried;
        self.drained += other.drained;
    }
}

pub(super) struct World {
    pub(super) random: Random,
    mode: Mode,
    config: SchedulerConfig,
    farm: Farm,
    rows: Rows,
    now: Millis,
    hands: BTreeMap<WorkerId, Hand>,
    guards: Vec<WorkerId>,
    dishonest: BTreeSet<WorkerId>,
    by_hand: BTreeSet<WorkerId>,
    post: Vec<Letter>,
    /// What leases of chains go on from, as their workers fetched it.
    fetched: BTreeMap<LeaseToken, u64>,
    /// What goes on from images that are not as they should be.
    after: BTreeMap<BlobHash, u64>,
    cursed: BTreeSet<(JobId, u32)>,
    highest_token: u64,
    names: u64,
    /// Whether the process may be killed.
    kills: bool,
    pub(super) seen: Seen,
}

impl World {
    pub(super) fn new(seed: u64, mode: Mode) -> Self {
        let mut random = Random(seed);
        let verify_until = match mode {
            Mode::Guarded => u32::MAX,
            _ => [0, 1, 3, u32::MAX][random.below(4) as usize],
        };
        let config = SchedulerConfig {
            verify_until,
            secret: NonceKey([seed as u8; 32]),
            ..SchedulerConfig::default()
        };
        let mut world = Self {
            random,
            mode,
            farm: Farm::restore(config.clone(), Snapshot::default(), 0),
            config,
            rows: Rows::default(),
            now: 10_000_000,
            hands: BTreeMap::new(),
            guards: Vec::new(),
            dishonest: BTreeSet::new(),
            by_hand: BTreeSet::new(),
            post: Vec::new(),
            fetched: BTreeMap::new(),
            after: BTreeMap::new(),
            cursed: BTreeSet::new(),
            highest_token: 0,
            names: 0,
            kills: false,
            seen: Seen::default(),
        };
        if mode == Mode::Guarded {
            world.guards = (0..2).filter_map(|_| world.hire(Kind::Honest, "1+a", true)).collect();
        }
        world.kills = true;
        for _ in 0..1 + world.random.below(3) {
            world.submit();
        }
        world
    }

    fn submit(&mut self) {
        let iterations = 1 + self.random.below(33) as u32;
        let mut schedule = Schedule {
            priority: 1 + self.random.below(20) as u32,
            ..Schedule::default()
        };
        if self.random.chance(25) {
            schedule.noise_target = Some([0.6, 0.36, 0.26, 0.01][self.random.below(4) as usize]);
        }
        if self.mode != Mode::Guarded && self.random.chance(15) {
            schedule.deadline_ms = Some(self.now + self.random.below(400_000));
        }
        if self.random.chance(15) {
            schedule.tags.insert("gpu".into());
        }
        let spec = JobSpec {
            scene: BlobHash([7; 32]),
            main: "scene.xml".into(),
            defines: Default::default(),
            sensor: None,
            integrator: match self.random.chance(30) {
                true => IntegratorSettings::Sppm(SppmSettings::default()).into(),
                false => IntegratorSettings::Path(PathSettings::default()).into(),
            },
            iterations,
            seed: 0,
            schedule,
            layers: Vec::new(),
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        let owner = if self.random.chance(50) { "ann" } else { "bob" };
        let decision = self.farm.submit(spec, owner.to_owned(), None, self.now);
        if let Some(job) = self.transact(decision)
            && self.random.chance(30)
        {
            let leaf = self.random.below(iterations.into()) as u32;
            self.cursed.insert((job, leaf));
        }
    }

    fn hire(&mut self, kind: Kind, renderer: &str, gpu: bool) -> Option<WorkerId> {
        self.names += 1;
        let name = if self.kills && self.random.chance(10) {
            0
        } else {
            self.names
        };
        let register = Register {
            name: format!("worker {name}"),
            renderer: renderer.into(),
            tags: if gpu {
                ["gpu".to_owned()].into()
            } else {
                Default::default()
            },
            ..introduction()
        };
        // Some machines register several workers with the token of a rack.
        let origin = match self.kills && self.random.chance(30) {
            true => Origin {
                token: "rack".into(),
                machine: format!("10.0.0.{}", self.random.below(2)),
            },
            false => Origin::default(),
        };
        let decision = self.farm.register(register, origin, self.now).unwrap();
        let worker = self.transact(decision)?;
        self.hands.insert(
            worker,
            Hand {
                kind,
                serial: 0,
                leases: Vec::new(),
            },
        );
        if kind == Kind::Liar {
            self.dishonest.insert(worker);
        }
        if self.farm.workers.get(worker).unwrap().is_held() {
            self.by_hand.insert(worker);
        }
        Some(worker)
    }

    /// Commits and applies; now and then the process is killed before or after the commit, and the reply is lost.
    fn transact<T>(&mut self, decision: Decision<T>) -> Option<T> {
        let killed = self.kills && self.random.chance(3);
        if killed && self.random.chance(50) {
            self.restart();
            return None;
        }
        for change in &decision.changes {
            self.check_change(change);
            self.rows.apply(change);
            self.farm.evolve(change, self.now);
        }
        if killed {
            self.restart();
            return None;
        }
        Some(decision.reply)
    }

    fn restart(&mut self) {
        if self.random.chance(20) {
            self.now -= self.random.below(self.now / 1_000);
        }
        self.farm = Farm::restore(self.config.clone(), self.rows.snapshot(), self.now);
        for change in self.farm.restarted().changes {
            self.rows.apply(&change);
            self.farm.evolve(&change, self.now);
        }
        self.fold_all();
    }

    fn fold_all(&mut self) {
        let jobs: Vec<JobId> = self.farm.jobs().map(Job::id).collect();
        jobs.into_iter().for_each(|job| self.fold(job));
    }

    /// What the clock makes happen.
    fn tick(&mut self) {
        self.transact(self.farm.expire(self.now));
        self.fold_all();
    }

    fn fold(&mut self, id: JobId) {
        loop {
            while let Some(node) = self.farm.job(id).and_then(Job::next_merge) {
                let job = self.farm.job(id).unwrap();
                let digest = added_up(job, node);
                let (last, of_last) = job.live_nodes().find(|(last, _)| last.end() == node.end()).unwrap();
                let after = self.statistics_after(id, last, of_last);
                self.after.insert(digest, after);
                if self.transact(self.farm.merge(id, node, digest)).is_none() {
                    return;
                }
            }
            let Some((node, _)) = self.farm.job(id).and_then(Job::due_checkpoint) else {
                break;
            };
            if self
                .transact(self.farm.checkpoint(id, node, Some(noise(node.level))))
                .is_none()
            {
                return;
            }
        }
        self.transact(self.farm.settle(id, self.now));
    }

    pub(super) fn step(&mut self) {
        self.now += if self.random.chance(4) {
            self.random.below(120_000)
        } else {
            self.random.below(2_000)
        };
        self.farm.pass_time(self.now);
        for guard in &self.guards {
            self.farm.seen(*guard, self.now).unwrap();
        }
        match self.random.below(24) {
            0 => self.hire_somebody(),
            1 => self.lose_somebody(),
            2 => self.restart(),
            3 | 4 => self.tick(),
            5..=9 => self.ask_for_work(),
            10..=15 => self.finish_work(),
            16 => self.steer(),
            17 => self.beat(),
            _ => self.carry_letter(),
        }
        if self.random.chance(10) {
            self.check();
        }
        if self.random.chance(2) {
            self.check_indexes();
        }
    }

    fn hire_somebody(&mut self) {
        let kind = match self.random.below(5) {
            _ if self.mode == Mode::Honest => Kind::Honest,
            0 | 1 => Kind::Liar,
            2 => Kind::Clumsy,
            _ => Kind::Honest,
        };
        let other = self.mode == Mode::Free && self.random.chance(10);
        let gpu = self.random.chance(50);
        self.hire(kind, if other { "1+b" } else { "1+a" }, gpu);
    }

    fn lose_somebody(&mut self) {
        let workers: Vec<WorkerId> = self
            .hands
            .keys()
            .copied()
            .filter(|id| !self.guards.contains(id))
            .collect();
        if self.random.chance(30)
            && let Some(lost) = self.random.pick(&workers).copied()
        {
            self.hands.remove(&lost);
            if self.random.chance(50) {
                self.transact(self.farm.leave(lost));
            }
        }
    }

    fn some_job(&mut self) -> Option<JobId> {
        let jobs: Vec<JobId> = self.rows.jobs.keys().copied().collect();
        self.random.pick(&jobs).copied()
    }

    /// Somebody at the command line.
    fn steer(&mut self) {
        let Some(job) = self.some_job() else { return };
        let ended = self
            .rows
            .jobs
            .get(&job)
            .filter(|record| record.ended_ms.is_some())
            .cloned();
        let decision = match self.random.below(12) {
            0 => return self.submit(),
            1 => self.farm.pause(job, true),
            2 | 3 => self.farm.pause(job, false),
            4 => self.farm.prioritize(job, 1 + self.random.below(100) as u32),
            5 | 6 => {
                let more = self.rows.jobs[&job].control.iterations + self.random.below(9) as u32;
                self.farm.extend(job, more, ended.as_ref())
            }
            7 if self.random.chance(30) => self.farm.cancel(job, self.now),
            8 if self.mode == Mode::Free => return self.quarantine_somebody(),
            9 => self.farm.retry(job, ended.as_ref()),
            10 if self.mode != Mode::Guarded => return self.drain_somebody(),
            _ => self.farm.pause(job, false),
        };
        match decision {
            Ok(decision) => _ = self.transact(decision),
            Err(Refusal::UnknownJob(_) | Refusal::JobEnded(_)) => {}
            Err(other) => panic!("{other}"),
        }
        self.fold(job);
    }

    fn quarantine_somebody(&mut self) {
        let Some(worker) = self.some_hand() else { return };
        let release = self.random.chance(50);
        let decision = match release {
            true => self.farm.release_worker(worker),
            false => self.farm.quarantine(worker, "by hand"),
        };
        if !release {
            self.by_hand.insert(worker);
        }
        if let Ok(decision) = decision {
            self.transact(decision);
        }
    }

    fn drain_somebody(&mut self) {
        let Some(worker) = self.some_hand() else { return };
        let drained = self.random.chance(50);
        if let Ok(decision) = self.farm.drain(worker, drained) {
            self.seen.drained += u64::from(drained);
            self.transact(decision);
        }
    }

    /// Three workers that work and are heard bring everything to its end.
    pub(super) fn bring_to_end(&mut self) {
        self.hands.clear();
        self.guards.clear();
        self.kills = false;
        self.post.clear();
        for job in self.farm.jobs().map(Job::id).collect::<Vec<_>>() {
            self.transact(self.farm.pause(job, false).unwrap());
        }
        let bound = self.farm.jobs().filter_map(|job| job.control.renderer.clone());
        let renderers: BTreeSet<String> = bound.chain(["1+a".to_owned()]).collect();
        for renderer in renderers {
            (0..3).for_each(|_| _ = self.hire(Kind::Honest, &renderer, true));
        }
        for _ in 0..2_000 {
            if self.farm.jobs().next().is_none() {
                return;
            }
            self.now += 3_000;
            let workers: Vec<WorkerId> = self.hands.keys().copied().collect();
            for worker in &workers {
                self.farm.seen(*worker, self.now).unwrap();
            }
            self.tick();
            for worker in workers {
                self.ask_for(worker);
                while !self.hands[&worker].leases.is_empty() {
                    self.finish(worker);
                }
            }
            for letter in std::mem::take(&mut self.post) {
                self.receive(letter);
            }
        }
        let left: Vec<_> = self
            .farm
            .jobs()
            .map(|job| (self.farm.status(job, self.now), &job.failures))
            .collect();
        panic!("no progress: {left:?}, {:?}", self.farm.workers);
    }
}
