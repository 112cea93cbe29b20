//! The jobs of the farm as they are looked for: whom to serve next, what waits for the clock, what is to be merged, and
//! how many wait for what. All of it follows from a few facts of each job; when a job changes, the index takes the old
//! facts out and puts the new ones in.

use super::demand::Demand;
use super::job::Job;
use super::record::Millis;
use super::table::{Set, Table};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use std::sync::Arc;

/// What nobody at work on a job means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Waits {
    /// Somebody is at work.
    Not,
    /// It is paused.
    Paused,
    /// Its iterations are added up.
    ForMerges,
    /// Only for workers, whoever comes.
    ForWorkers,
    /// It depends on what failed, or what workers said.
    Otherwise,
}

/// What the index knows of a job.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Facts {
    demand: Arc<Demand>,
    owner: Arc<str>,
    /// Its weight among the jobs of its owner, while it is not paused.
    weight: Option<u64>,
    share_ms: Millis,
    /// Whether it has something to do that nobody does.
    open: bool,
    queued: bool,
    leased: bool,
    waits: Waits,
    deadline: Option<Millis>,
    /// The job that it waits for.
    after: Option<JobId>,
    in_doubt: bool,
    to_fold: bool,
    /// Whether it has nodes that others are to repeat, and nobody does.
    wants_repeats: bool,
    /// Iterations that are not in the image, of a job that is not paused.
    left: u64,
    /// Leases that these make while no speed is known.
    leases_left: u64,
}

impl Job {
    /// What the index is to know of it.
    pub(super) fn facts(&self) -> Facts {
        let paused = self.is_paused();
        let (left, leased) = (self.leaves() - self.done(), !self.leases.is_empty());
        let in_doubt = !self.nodes.doubts.is_empty();
        Facts {
            demand: self.demand.clone(),
            owner: self.owner.clone(),
            weight: (!paused).then(|| self.weight()),
            share_ms: self.share_ms(),
            open: !paused && (self.nodes.wants_repeats() || self.can_lend()),
            queued: self.state == JobState::Queued,
            leased,
            waits: match () {
                () if leased => Waits::Not,
                () if left == 0 && !in_doubt => Waits::ForMerges,
                () if self.control.schedule.paused => Waits::Paused,
                () if paused || in_doubt || !self.failures.is_empty() => Waits::Otherwise,
                () => Waits::ForWorkers,
            },
            deadline: self
                .control
                .schedule
                .deadline_ms
                .filter(|_| self.control.stop.is_none()),
            after: self.control.after,
            in_doubt,
            to_fold: self.is_to_be_folded(),
            wants_repeats: !paused && self.nodes.wants_repeats(),
            left: if paused { 0 } else { left },
            leases_left: match () {
                () if paused || leased => 0,
                () if self.is_chain() => left.min(1),
                () => left,
            },
        }
    }

    /// Its weight among the jobs of its owner.
    pub(super) fn weight(&self) -> u64 {
        u64::from(self.control.schedule.priority.max(1))
    }

    /// Whether there are leaves that nobody has, though they may have to rest. Nobody else could work on a chain
    /// meanwhile.
    fn can_lend(&self) -> bool {
        let waits = self.is_chain() && (!self.lent.is_empty() || !self.nodes.doubts.is_empty());
        self.free.leaves() > 0 && !waits
    }
}

/// Jobs that ask the same of their workers and have something to do that nobody does.
#[derive(Clone, Debug, Default, PartialEq)]
struct Queue {
    /// Those that had no more of the farm than the job served last, which none is to make up for.
    behind: Set<JobId>,
    /// The others, by what they had.
    ahead: Set<(Millis, JobId)>,
}

/// The index.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct JobIndex {
    /// What the job served last had had of the farm [weighted ms].
    served: Millis,
    queues: Table<Arc<Demand>, Queue>,
    /// Sum of the weights of an owner's jobs that are not paused.
    weights: Table<Arc<str>, u64>,
    /// Jobs under lease.
    pub(super) leased: Set<JobId>,
    /// Jobs by the time at which they end.
    pub(super) deadlines: Set<(Millis, JobId)>,
    /// Jobs by the one that is to be done first.
    pub(super) after: Set<(JobId, JobId)>,
    /// Jobs with nodes that are to be repeated.
    pub(super) in_doubt: Set<JobId>,
    /// Jobs with images to add up or to read, or that may be complete.
    pub(super) to_fold: Set<JobId>,
    /// Number of jobs with nodes that others are to repeat, and nobody does.
    pub(super) wants_repeats: u64,
    /// Number of jobs that only wait for workers, by what they ask of them.
    pub(super) waiting: Table<Arc<Demand>, u64>,
    /// Jobs that wait for something else.
    pub(super) waiting_otherwise: Set<JobId>,
    /// Jobs that wait for their iterations to be added up.
    pub(super) merging: u64,
    /// Jobs that are paused, and on which nobody is at work any more.
    pub(super) paused: u64,
    /// Jobs of which nothing was lent yet.
    pub(super) queued: u64,
    /// Iterations that are not in the image, of jobs that are not paused.
    pub(super) left: u64,
    /// Leases that they make where no speed is known: one each, and of a chain one in all.
    pub(super) leases_left: u64,
}

impl JobIndex {
    /// A job has come.
    pub(super) fn insert(&mut self, id: JobId, facts: &Facts) {
        self.put(id, facts, true);
    }

    /// A job has gone.
    pub(super) fn remove(&mut self, id: JobId, facts: &Facts) {
        self.put(id, facts, false);
    }

    /// A job has changed.
    pub(super) fn update(&mut self, id: JobId, before: &Facts, after: &Facts) {
        if before != after {
            self.remove(id, before);
            self.insert(id, after);
        }
    }

    fn put(&mut self, id: JobId, facts: &Facts, inside: bool) {
        if facts.open {
            let queue = self.queues.get_or_default(facts.demand.clone());
            match facts.share_ms <= self.served {
                true => queue.behind.set(id, inside),
                false => queue.ahead.set((facts.share_ms, id), inside),
            }
            if queue.behind.is_empty() && queue.ahead.is_empty() {
                self.queues.remove(&facts.demand);
            }
        }
        if let Some(weight) = facts.weight {
            count_at(&mut self.weights, &facts.owner, weight, inside);
        }
        if let Some(deadline) = facts.deadline {
            self.deadlines.set((deadline, id), inside);
        }
        if let Some(first) = facts.after {
            self.after.set((first, id), inside);
        }
        let sets = [
            (&mut self.leased, facts.leased),
            (&mut self.in_doubt, facts.in_doubt),
            (&mut self.to_fold, facts.to_fold),
            (&mut self.waiting_otherwise, facts.waits == Waits::Otherwise),
        ];
        for (set, _) in sets.into_iter().filter(|(_, belongs)| *belongs) {
            set.set(id, inside);
        }
        if facts.waits == Waits::ForWorkers {
            count_at(&mut self.waiting, &facts.demand, 1, inside);
        }
        count(&mut self.merging, (facts.waits == Waits::ForMerges).into(), inside);
        count(&mut self.paused, (facts.waits == Waits::Paused).into(), inside);
        count(&mut self.wants_repeats, facts.wants_repeats.into(), inside);
        count(&mut self.queued, facts.queued.into(), inside);
        count(&mut self.left, facts.left, inside);
        count(&mut self.leases_left, facts.leases_left, inside);
    }

    /// A job was served that had had `share_ms` of the farm.
    pub(super) fn serve(&mut self, share_ms: Millis) {
        if share_ms <= self.served {
            return;
        }
        self.served = share_ms;
        self.queues.for_each_mut(|queue| {
            while let Some((share, id)) = queue.ahead.first().map(|(key, ())| *key)
                && share <= share_ms
            {
                queue.ahead.remove(&(share, id));
                queue.behind.insert(id, ());
            }
        });
    }

    /// The jobs with something to do that nobody does, for workers of which `meets` says whether they meet a demand:
    /// the one that is to be served next comes first.
    pub(super) fn next_jobs(&self, meets: impl Fn(&Demand) -> bool) -> impl Iterator<Item = JobId> {
        let met = self.queues.iter().filter(move |(demand, _)| meets(demand));
        let mut queues: Vec<_> = met
            .map(|(_, queue)| {
                let behind = queue.behind.keys().map(|id| (self.served, *id));
                behind.chain(queue.ahead.keys().copied()).peekable()
            })
            .collect();
        std::iter::from_fn(move || {
            let heads = queues.iter_mut().filter_map(|queue| {
                let head = *queue.peek()?;
                Some((head, queue))
            });
            let (_, queue) = heads.min_by_key(|(head, _)| *head)?;
            queue.next().map(|(_, id)| id)
        })
    }

    /// The sum of the weights of an owner's jobs that are not paused.
    pub(super) fn weight_of(&self, owner: &str) -> u64 {
        self.weights.get(owner).copied().unwrap_or(0)
    }
}

fn count(number: &mut u64, more: u64, inside: bool) {
    match inside {
        true => *number += more,
        false => *number -= more,
    }
}

fn count_at<K: Ord + Clone>(numbers: &mut Table<K, u64>, key: &K, more: u64, inside: bool) {
    let number = numbers.get_or_default(key.clone());
    count(number, more, inside);
    if *number == 0 {
        numbers.remove(key);
    }
}
