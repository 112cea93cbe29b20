//! How far a job has come, and why nobody is at work on it.

use super::block::Taker;
use super::demand::Demand;
use super::record::{FailedAttempt, Millis, Principal};
use super::{Farm, Job};
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::job::{JobStatus, Poisoned};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::waiting::Waiting;
use std::collections::BTreeSet;

impl Job {
    /// Leaves rendered, delivered or not.
    #[must_use]
    pub fn rendered(&self) -> u64 {
        let undelivered = self.lent.blocks().map(|block| {
            let leases = self.lent.on(block).map(|token| self.leases[&token].leaves_done);
            leases
                .max()
                .unwrap_or(0)
                .min(block.leaves() - self.covered_within(block))
        });
        self.done() + undelivered.sum::<u64>()
    }

    /// Number of workers that hold leases of it.
    pub(super) fn workers(&self) -> usize {
        let workers = self.leases.values().map(|lease| lease.record.worker);
        workers.collect::<BTreeSet<_>>().len()
    }

    /// The iterations at which attempts failed, those among them that were rendered since.
    #[must_use]
    pub fn failed_attempts(&self) -> Vec<Poisoned> {
        let failures = self.failures.iter();
        failures.map(|(leaf, attempts)| poisoned(*leaf, attempts)).collect()
    }

    /// How far the job has come.
    #[must_use]
    pub fn status(&self) -> JobStatus {
        let poisoned = self.given_up().map(|(leaf, attempts)| poisoned(leaf, attempts));
        JobStatus {
            id: self.id(),
            state: self.state,
            spec: self.spec(),
            integrator: self.integrator().cloned(),
            warnings: self.control.warnings.clone(),
            owner: self.head.owner.clone(),
            created_ms: self.head.created_ms,
            ended_ms: self.ended_ms,
            iterations_done: self.done(),
            iterations_rendered: self.rendered(),
            poisoned: poisoned.collect(),
            failure: self.failure.clone(),
            resolution: self.picture_size(),
            totals: self.totals(),
            iterations_per_second: self.pace.iterations_per_second(),
            workers: self.workers() as u32,
            iterations_in_doubt: self.nodes_in_doubt().map(NodeKey::leaves).sum(),
            memory_mb: self.control.memory_mb,
            renderer: self.control.renderer.clone(),
            checkpoint: self.control.checkpoint,
            stop: self.control.stop,
            waiting: None,
            waiting_reason: None,
        }
    }
}

fn poisoned(leaf: u32, attempts: &[FailedAttempt]) -> Poisoned {
    Poisoned {
        iteration: leaf + 1,
        attempts: attempts.iter().map(|failed| failed.attempt.clone()).collect(),
    }
}

impl Farm {
    /// How far a job that has not ended has come.
    #[must_use]
    pub fn status(&self, job: &Job, now: Millis) -> JobStatus {
        let (waiting_reason, waiting) = self.waiting(job, now).unzip();
        JobStatus {
            waiting,
            waiting_reason,
            ..job.status()
        }
    }

    /// A worker's name for people.
    #[must_use]
    pub fn worker_name(&self, id: WorkerId) -> Option<&str> {
        Some(&self.workers.get(id)?.record.name)
    }

    /// A worker by number and, where it is known, by name.
    #[must_use]
    pub fn worker_named(&self, id: WorkerId) -> String {
        match self.workers.get(id) {
            Some(worker) => format!("worker {id} ({})", worker.record.name),
            None => format!("worker {id}"),
        }
    }

    /// Why nobody is at work on a job, while nobody is.
    pub(super) fn waiting(&self, job: &Job, now: Millis) -> Option<(Waiting, String)> {
        if !job.leases.is_empty() {
            return None;
        }
        let merging = || (Waiting::Merging, "its iterations are being added up".to_owned());
        if job.done() == job.leaves() && job.nodes.doubts.is_empty() {
            return Some(merging());
        }
        if job.control.schedule.paused {
            return Some((Waiting::Paused, "it is paused".into()));
        }
        if let Some(first) = job.control.after {
            return Some((Waiting::After, format!("job {first} is to be done first")));
        }
        if let Some(lack) = self.lack(&job.demand) {
            return Some((lack, self.what_lacks(lack, job)));
        }
        Some(self.nothing_for(job, now).unwrap_or_else(merging))
    }

    /// Which of a job's demands no connected worker meets.
    pub(super) fn lack(&self, demand: &Demand) -> Option<Waiting> {
        let crews = || self.workers.crews();
        let tagged = || crews().filter(|(skill, _)| demand.tags.is_subset(&skill.tags));
        let alike = || crews().filter(|(skill, _)| skill.meets_but_for_memory(demand));
        let met = || crews().filter(|(skill, _)| skill.meets(demand));
        match () {
            () if crews().next().is_none() => Some(Waiting::NoWorker),
            () if tagged().next().is_none() => Some(Waiting::Tags),
            () if alike().next().is_none() => Some(Waiting::Renderer),
            () if met().next().is_none() => Some(Waiting::Memory),
            () if met().any(|(_, crew)| crew.workers() > 0) => None,
            () if met().any(|(_, crew)| crew.resting > 0) => Some(Waiting::Resting),
            () => Some(Waiting::Quarantine),
        }
    }

    /// What a job lacks, in words.
    fn what_lacks(&self, lack: Waiting, job: &Job) -> String {
        let Demand { renderer, tags, .. } = &*job.demand;
        match lack {
            Waiting::Tags => {
                let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
                format!("no worker has the tags {}", tags.join(", "))
            }
            Waiting::Renderer => {
                let bound = renderer.as_deref().unwrap_or_default();
                let mut tagged = self.workers.crews().filter(|(skill, _)| tags.is_subset(&skill.tags));
                let found = tagged.next().map_or("", |(skill, _)| skill.renderer.as_str());
                format!(
                    "it is bound to renderer {bound}, and workers have others, such as {found}: start workers of that build, or have \
                     it rendered anew with `photonfarm resubmit {}`",
                    job.id()
                )
            }
            Waiting::Memory => self.what_is_too_small(job),
            Waiting::Resting => self.who_rests(job),
            Waiting::Quarantine => "every worker that could do it is in quarantine or drained".into(),
            _ => "no worker is connected".into(),
        }
    }

    /// Why none of the workers that could work on a job has work on it; nothing where there is none left.
    fn nothing_for(&self, job: &Job, now: Millis) -> Option<(Waiting, String)> {
        if self.somebody_could(job, now) {
            return Some((Waiting::Turn, "its turn has not come".into()));
        }
        let range = |node: NodeKey| format!("{} to {}", node.first() + 1, node.end());
        let staff = self.workers.staff_for(job);
        let known = |node: &NodeKey| staff.principals().all(|principal| job.has_opinion(*node, principal));
        let mut disputed = job.nodes_in_doubt().filter(|node| job.is_disputed(*node));
        if let Some(node) = disputed.find(known) {
            let detail = "and another worker is needed to decide";
            let detail = format!("workers disagree about iterations {}, {detail}", range(node));
            return Some((Waiting::Dispute, detail));
        }
        let covered = |leaf: u32| job.covering(NodeKey::leaf(leaf)).is_some();
        let open = |(leaf, _): &(&u32, &Vec<FailedAttempt>)| {
            u64::from(**leaf) < job.leaves() && !job.given_up.contains_key(leaf) && !covered(**leaf)
        };
        if let Some((leaf, attempts)) = job.failures.iter().find(open) {
            let times = attempts.len();
            let detail = format!(
                "iteration {} failed (attempts so far: {times}), and rests before it is tried again",
                leaf + 1
            );
            return Some((Waiting::Rest, detail));
        }
        let node = job.nodes_in_doubt().next()?;
        let detail = format!("iterations {} wait for another worker to confirm them", range(node));
        Some((Waiting::Doubt, detail))
    }

    /// Whether one of the workers that are heard of would be given something of a job, if its turn came. Workers differ
    /// only in what those who are behind them failed at and have said: those are asked, and one of the others.
    fn somebody_could(&self, job: &Job, now: Millis) -> bool {
        let staff = self.workers.staff_for(job);
        let failed = job.failures.values().flatten().map(|failed| failed.principal);
        let said = job.nodes.doubts.values().flat_map(|node| &job.nodes.all[node].opinions);
        let known: BTreeSet<Principal> = failed.chain(said.map(|opinion| opinion.principal)).collect();
        let other = staff.principals().find(|principal| !known.contains(principal));
        let here = known.iter().copied().filter(|known| staff.has(*known));
        other.into_iter().chain(here).any(|principal| {
            let taker = Taker {
                worker: WorkerId(0),
                principal,
                staff: &staff,
                now,
                config: &self.config,
            };
            job.next_doubt(&taker).or_else(|| job.next_block(&taker)).is_some()
        })
    }
}
