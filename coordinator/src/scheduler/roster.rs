//! The workers that are registered, and those of them that are heard of, by what they can do.

use super::demand::Demand;
use super::job::Job;
use super::record::{Millis, Principal, Standing, WorkerRecord};
use super::table::{Set, Table};
use photonfarm_proto::id::WorkerId;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A registered worker.
#[derive(Clone, Debug)]
pub(super) struct Worker {
    pub(super) record: WorkerRecord,
    /// Who is behind it.
    pub(super) principal: Principal,
    pub(super) last_seen_ms: Millis,
    /// The latest of its requests for work.
    pub(super) serial: u64,
    skill: Arc<Skill>,
    /// Whether it counts among those that are heard of.
    connected: bool,
}

impl Worker {
    fn new(record: WorkerRecord, now: Millis) -> Self {
        Self {
            principal: record.principal(),
            skill: Arc::new(Skill {
                renderer: record.renderer.clone(),
                tags: record.tags.clone(),
                memory_mb: record.memory_mb,
            }),
            record,
            last_seen_ms: now,
            serial: 0,
            connected: true,
        }
    }

    pub(super) fn id(&self) -> WorkerId {
        self.record.id
    }

    /// Whether it is in quarantine.
    pub(super) fn is_held(&self) -> bool {
        self.record.standing.quarantine.is_some()
    }

    /// Whether it may be given work.
    pub(super) fn may_work(&self) -> bool {
        let standing = &self.record.standing;
        !self.is_held() && !standing.drained && standing.rest.is_none()
    }

    /// Whether nothing but its rest keeps it from work.
    fn only_rests(&self) -> bool {
        let standing = &self.record.standing;
        !self.is_held() && !standing.drained && standing.rest.is_some()
    }

    /// What it can do.
    pub(super) fn skill(&self) -> &Arc<Skill> {
        &self.skill
    }

    /// Whether it may work on a job.
    pub(super) fn fits(&self, job: &Job) -> bool {
        self.skill.meets(&job.demand) && self.may_work()
    }
}

/// What workers can do: those that are alike in it may work on the same jobs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Skill {
    /// Name of their renderer.
    pub renderer: String,
    /// What they have.
    pub tags: BTreeSet<String>,
    /// Memory that jobs may take of them, if it is known \[MiB\].
    pub memory_mb: Option<u32>,
}

impl Skill {
    pub(super) fn meets(&self, demand: &Demand) -> bool {
        self.meets_but_for_memory(demand) && self.memory_mb.is_none_or(|memory| memory >= demand.memory_mb)
    }

    /// Whether they could work on jobs that ask this, if they had the memory.
    pub(super) fn meets_but_for_memory(&self, demand: &Demand) -> bool {
        demand.is_met_by(&self.renderer, &self.tags)
    }
}

/// Workers that are heard of and can do the same.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Crew {
    /// Those that may work, by who is behind them.
    principals: Table<Principal, u64>,
    workers: u64,
    /// Number of those that may not: they are in quarantine or drained, or rest.
    pub(super) held: u64,
    /// Number of those among them that only rest.
    pub(super) resting: u64,
}

impl Crew {
    fn count(&mut self, worker: &Worker, inside: bool) {
        if !worker.may_work() {
            let resting = u64::from(worker.only_rests());
            match inside {
                true => (self.held, self.resting) = (self.held + 1, self.resting + resting),
                false => (self.held, self.resting) = (self.held - 1, self.resting - resting),
            }
            return;
        }
        let of_principal = self.principals.get_or_default(worker.principal);
        match inside {
            true => (*of_principal, self.workers) = (*of_principal + 1, self.workers + 1),
            false => (*of_principal, self.workers) = (*of_principal - 1, self.workers - 1),
        }
        if *of_principal == 0 {
            self.principals.remove(&worker.principal);
        }
    }

    /// Number of those that may work.
    pub(super) fn workers(&self) -> u64 {
        self.workers
    }
}

/// The workers that are heard of and may work on a job.
#[derive(Clone, Debug)]
pub(super) struct Staff<'a> {
    crews: Vec<&'a Crew>,
}

impl<'a> Staff<'a> {
    /// Their number.
    pub(super) fn workers(&self) -> u64 {
        self.crews.iter().map(|crew| crew.workers).sum()
    }

    /// Whether one of them is of `principal`.
    pub(super) fn has(&self, principal: Principal) -> bool {
        self.crews.iter().any(|crew| crew.principals.contains_key(&principal))
    }

    /// Who is behind them; perhaps more than once.
    pub(super) fn principals(&self) -> impl Iterator<Item = Principal> + use<'a> {
        let crews = self.crews.clone();
        crews.into_iter().flat_map(|crew| crew.principals.keys().copied())
    }
}

/// The workers.
#[derive(Clone, Debug, Default)]
pub(super) struct Roster {
    workers: Table<WorkerId, Worker>,
    /// Those that are heard of, by when they were last.
    heard: Set<(Millis, WorkerId)>,
    crews: Table<Arc<Skill>, Crew>,
}

impl Roster {
    pub(super) fn get(&self, id: WorkerId) -> Option<&Worker> {
        self.workers.get(&id)
    }

    pub(super) fn values(&self) -> impl Iterator<Item = &Worker> {
        self.workers.values()
    }

    /// The workers that are heard of, by what they can do.
    pub(super) fn crews(&self) -> impl Iterator<Item = (&Skill, &Crew)> + Clone {
        self.crews.iter().map(|(skill, crew)| (&**skill, crew))
    }

    /// The workers that are heard of and may work on a job.
    pub(super) fn staff_for(&self, job: &Job) -> Staff<'_> {
        let fit = self.crews().filter(|(skill, _)| skill.meets(&job.demand));
        Staff {
            crews: fit.map(|(_, crew)| crew).collect(),
        }
    }

    /// A worker is registered, and so heard of.
    pub(super) fn register(&mut self, record: WorkerRecord, now: Millis) {
        let id = record.id;
        self.forget(id);
        self.workers.insert(id, Worker::new(record, now));
        self.count(id, true);
    }

    pub(super) fn forget(&mut self, id: WorkerId) {
        self.count(id, false);
        self.workers.remove(&id);
    }

    /// What is thought of a worker changed.
    pub(super) fn judge(&mut self, id: WorkerId, standing: &Standing) {
        self.change(id, |worker| worker.record.standing = standing.clone());
    }

    /// A worker was heard of. Replies whether it is registered.
    pub(super) fn hear(&mut self, id: WorkerId, serial: u64, now: Millis) -> bool {
        self.change(id, |worker| {
            worker.last_seen_ms = worker.last_seen_ms.max(now);
            worker.serial = worker.serial.max(serial);
            worker.connected = true;
        })
    }

    /// As if the latest request for work of a worker had been this one.
    #[cfg(test)]
    pub(super) fn set_serial(&mut self, id: WorkerId, serial: u64) {
        self.change(id, |worker| worker.serial = serial);
    }

    /// Those that were silent since `since` are heard of no more.
    pub(super) fn miss(&mut self, since: Millis) {
        while let Some((last_seen, id)) = self.heard.first().map(|(key, ())| *key)
            && last_seen <= since
        {
            self.change(id, |worker| worker.connected = false);
        }
    }

    /// Changes what is known of a worker, if it is known. Its renderer, its tags and who is behind it never change.
    fn change(&mut self, id: WorkerId, change: impl FnOnce(&mut Worker)) -> bool {
        self.count(id, false);
        let known = self.workers.get_mut(&id).map(change).is_some();
        self.count(id, true);
        known
    }

    /// Counts a worker among those that are heard of, if it is, or no more.
    fn count(&mut self, id: WorkerId, inside: bool) {
        if let Some(worker) = self.workers.get(&id).filter(|worker| worker.connected) {
            self.heard.set((worker.last_seen_ms, id), inside);
            let crew = self.crews.get_or_default(worker.skill.clone());
            crew.count(worker, inside);
            if crew.workers + crew.held == 0 {
                self.crews.remove(&worker.skill);
            }
        }
    }
}
