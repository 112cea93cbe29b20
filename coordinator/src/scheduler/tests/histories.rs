//! Random histories: messages lost, repeated and reordered, workers lost, commits failed, restarts at any moment.
//!
//! Whatever happens, every leaf counts once or is reported, tokens rise, what is remembered equals what is kept, and
//! one worker that lives brings every job to its end. Seeds are fixed.

use super::*;
use crate::store::memory::Rows;
use std::collections::BTreeSet;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    fn chance(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }

    fn pick<'a, T>(&mut self, items: &'a [T]) -> Option<&'a T> {
        let n = items.len() as u64;
        (n > 0).then(|| &items[self.below(n) as usize])
    }
}

#[derive(Clone, Debug)]
enum Letter {
    Node(Delivery),
    Failure(LeaseRecord, u32, FailureKind),
    Release(LeaseRecord),
}

/// A farm, its store, a network that loses and repeats, and workers that come and go.
struct World {
    random: Random,
    config: SchedulerConfig,
    farm: Farm,
    rows: Rows,
    now: Millis,
    workers: BTreeMap<WorkerId, Vec<LeaseRecord>>,
    post: Vec<Letter>,
    cursed: BTreeSet<(JobId, u32)>,
    highest_token: u64,
    made: BTreeSet<(JobId, NodeKey)>,
    /// Whether the process may be killed.
    kills: bool,
}

impl World {
    fn new(seed: u64) -> Self {
        let config = SchedulerConfig::default();
        Self {
            random: Random(seed),
            farm: Farm::restore(config.clone(), Snapshot::default(), 0),
            config,
            rows: Rows::default(),
            now: 1,
            workers: BTreeMap::new(),
            post: Vec::new(),
            cursed: BTreeSet::new(),
            highest_token: 0,
            made: BTreeSet::new(),
            kills: true,
        }
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
        self.farm = Farm::restore(self.config.clone(), self.rows.snapshot(), self.now);
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

    fn check_change(&mut self, change: &Change) {
        match change {
            Change::LeaseGranted(lease) => {
                assert!(lease.token.0 > self.highest_token, "tokens rise");
                self.highest_token = lease.token.0;
            }
            Change::NodeAdded { job, node, .. } => {
                assert!(self.made.insert((*job, *node)), "{node} of job {job} is made once");
            }
            Change::NodeMerged { job, node } => {
                assert!(
                    self.farm.job(*job).unwrap().is_live(*node),
                    "only what counts is merged"
                );
            }
            _ => {}
        }
    }

    /// What counts is disjoint and within the job; what is remembered is what is kept.
    fn check(&self) {
        for job in self.farm.jobs() {
            let mut end = 0;
            for (node, hash) in job.live_nodes() {
                assert!(node.first() >= end && node.end() <= job.leaves());
                assert_eq!(hash, digest(job.id(), node));
                end = node.end();
            }
            let kept = Job::from_record(self.rows.jobs[&job.id()].clone(), 0);
            assert!(kept.live_nodes().eq(job.live_nodes()));
            assert!(kept.leases.keys().eq(job.leases.keys()));
            assert_eq!(kept.failures, job.failures);
            assert_eq!(kept.state, job.state);
        }
    }

    fn fold(&mut self, job: JobId) {
        while let Some(parent) = self.farm.job(job).and_then(Job::next_merge) {
            if self
                .transact(self.farm.merge(job, parent, digest(job, parent)))
                .is_none()
            {
                return;
            }
        }
        self.transact(self.farm.settle(job, self.now));
    }

    fn step(&mut self) {
        self.now += if self.random.chance(4) {
            self.random.below(120_000)
        } else {
            self.random.below(2_000)
        };
        match self.random.below(20) {
            0 => {
                let decision = self.farm.register(introduction());
                if let Some(worker) = self.transact(decision) {
                    self.workers.insert(worker, Vec::new());
                }
            }
            1 => {
                let workers: Vec<WorkerId> = self.workers.keys().copied().collect();
                if self.random.chance(30)
                    && let Some(lost) = self.random.pick(&workers)
                {
                    self.workers.remove(lost);
                }
            }
            2 => self.restart(),
            3 | 4 => self.tick(),
            5..=9 => self.ask_for_work(),
            10..=14 => self.finish_work(),
            _ => self.carry_letter(),
        }
        if self.random.chance(10) {
            self.check();
        }
    }

    fn some_worker(&mut self) -> Option<WorkerId> {
        let workers: Vec<WorkerId> = self.workers.keys().copied().collect();
        self.random.pick(&workers).copied()
    }

    fn ask_for_work(&mut self) {
        let Some(worker) = self.some_worker() else { return };
        let held: Vec<LeaseToken> = self.workers[&worker].iter().map(|lease| lease.token).collect();
        let _ = self.farm.seen(worker, self.now);
        let Ok(decision) = self.farm.lease(worker, &held, self.now) else {
            self.workers.remove(&worker);
            return;
        };
        let lost = self.random.chance(15);
        if let Some(Some(lease)) = self.transact(decision)
            && !lost
        {
            self.workers.get_mut(&worker).unwrap().push(lease);
        }
    }

    /// A worker ends some lease: whole, in part, or with a failure; letters go into the post.
    fn finish_work(&mut self) {
        let Some(worker) = self.some_worker() else { return };
        let leases = self.workers.get_mut(&worker).unwrap();
        if leases.is_empty() {
            return;
        }
        let lease = leases.remove(self.random.below(leases.len() as u64) as usize);
        let bad = (lease.node.first()..lease.node.end()).find(|leaf| self.cursed.contains(&(lease.job, *leaf as u32)));
        let part = bad.or_else(|| {
            self.random
                .chance(20)
                .then(|| lease.node.first() + self.random.below(lease.node.leaves()))
        });
        let Some(stop) = part else {
            return self.post.push(Letter::Node(delivery(&lease, lease.node)));
        };
        let mut first = lease.node.first();
        while first < stop {
            let level = (stop - first).ilog2().min(first.trailing_zeros());
            let node = NodeKey {
                level,
                index: (first >> level) as u32,
            };
            self.post.push(Letter::Node(delivery(&lease, node)));
            first = node.end();
        }
        let kind = if self.random.chance(50) {
            FailureKind::Render
        } else {
            FailureKind::Panic
        };
        let last = if bad.is_some() {
            Letter::Failure(lease, stop as u32, kind)
        } else {
            Letter::Release(lease)
        };
        self.post.push(last);
    }

    /// The network delivers any letter, perhaps not for the last time, or loses it.
    fn carry_letter(&mut self) {
        if self.post.is_empty() {
            return;
        }
        let index = self.random.below(self.post.len() as u64) as usize;
        let letter = if self.random.chance(25) {
            self.post[index].clone()
        } else {
            self.post.swap_remove(index)
        };
        if self.random.chance(85) {
            self.receive(letter);
        }
    }

    fn receive(&mut self, letter: Letter) {
        let (job, decision) = match letter {
            Letter::Node(delivery) => {
                let decision = self.farm.deliver(&delivery).map(|d| Decision::new((), d.changes));
                if decision.is_ok() {
                    self.farm.observe(&delivery, self.now);
                }
                (delivery.job, decision)
            }
            Letter::Failure(lease, leaf, kind) => {
                let attempt = Attempt {
                    worker: lease.worker,
                    kind,
                    message: "cursed".into(),
                    at_ms: 0,
                };
                (
                    lease.job,
                    self.farm.fail(lease.job, lease.token, leaf, attempt, self.now),
                )
            }
            Letter::Release(lease) => (lease.job, Ok(self.farm.release(lease.job, lease.token, lease.worker))),
        };
        match decision {
            Ok(decision) => _ = self.transact(decision),
            Err(Refusal::StaleLease(_) | Refusal::UnknownJob(_)) => {}
            Err(other) => panic!("{other}"),
        }
        self.fold(job);
    }

    /// One worker that works and is heard brings everything to its end.
    fn bring_to_end(&mut self) {
        self.workers.clear();
        self.kills = false;
        for _ in 0..2_000 {
            if self.farm.jobs().next().is_none() {
                return;
            }
            self.now += 1_000;
            self.tick();
            if self.workers.is_empty() {
                let decision = self.farm.register(introduction());
                if let Some(worker) = self.transact(decision) {
                    self.workers.insert(worker, Vec::new());
                }
            }
            self.ask_for_work();
            while self.workers.values().any(|leases| !leases.is_empty()) {
                self.finish_work();
            }
            for letter in std::mem::take(&mut self.post) {
                self.receive(letter);
            }
        }
        panic!("no progress");
    }

    fn check_end(&self) {
        for record in self.rows.jobs.values() {
            let job = Job::from_record(record.clone(), 0);
            let status = job.status(&self.config);
            let poisoned: BTreeSet<u64> = status.poisoned.iter().map(|p| u64::from(p.iteration) - 1).collect();
            let mut counted = vec![0; job.leaves() as usize];
            for (node, _) in job.live_nodes() {
                (node.first()..node.end()).for_each(|leaf| counted[leaf as usize] += 1);
            }
            for (leaf, count) in counted.iter().enumerate() {
                assert_eq!(
                    *count,
                    u32::from(!poisoned.contains(&(leaf as u64))),
                    "leaf {leaf} of {}",
                    job.id()
                );
            }
            assert_eq!(job.next_merge(), None);
            assert!(job.leases.is_empty());
            match status.state {
                JobState::Done => assert!(poisoned.is_empty() && status.failure.is_none()),
                JobState::Failed => assert!(!poisoned.is_empty() && status.failure.is_some()),
                other => panic!("{other:?}"),
            }
        }
    }
}

#[test]
fn random_histories_count_every_leaf_once_or_report_it() {
    for seed in 0..5000 {
        let mut world = World::new(seed);
        for _ in 0..1 + world.random.below(3) {
            let iterations = 1 + world.random.below(33) as u32;
            let decision = world.farm.submit(spec(iterations), String::new(), None, world.now);
            if let Some(job) = world.transact(decision)
                && world.random.chance(30)
            {
                let leaf = world.random.below(iterations.into()) as u32;
                world.cursed.insert((job, leaf));
            }
        }
        for _ in 0..150 {
            world.step();
        }
        world.check();
        world.bring_to_end();
        world.check_end();
    }
}
