//! What must hold, whatever happens.

use super::model::{honest, noise};
use super::*;

impl World {
    pub(super) fn check_change(&mut self, change: &Change) {
        match change {
            Change::LeaseGranted(lease) => {
                assert!(lease.token.number > self.highest_token, "tokens rise");
                self.highest_token = lease.token.number;
                let job = self.farm.job(lease.job).unwrap();
                let worker = self.farm.workers.get(lease.worker).unwrap();
                assert!(worker.fits(job) && !job.is_paused() && lease.node.end() <= job.leaves());
                let first = lease.node.first();
                let next = first == job.complete() && job.nodes_in_doubt().all(|node| node.first() > first);
                assert!(
                    next || lease.verifies || !job.is_chain(),
                    "a link follows the one before"
                );
                self.seen.links += u64::from(job.is_chain() && lease.node.first() > 0);
            }
            Change::NodeAdded { job, node, record, .. } => {
                let job = self.farm.job(*job).unwrap();
                assert!(node.end() <= job.leaves());
                let wrong = record.digest != honest(job.id(), *node);
                self.seen.lies_that_counted += u64::from(wrong && record.worker.is_some());
            }
            Change::NodeMerged { job, node } => {
                let job = self.farm.job(*job).unwrap();
                assert!(job.is_live(*node) && !job.is_in_doubt(*node));
            }
            Change::NodeJudged { job, node, record } => {
                self.seen.verdicts += u64::from(record.verified);
                let disputed = record.opinions.iter().any(|other| other.digest != record.digest);
                self.seen.disputes += u64::from(disputed);
                assert!(!disputed || self.mode != Mode::Honest || self.is_cursed(*job, *node));
            }
            Change::WorkerJudged { worker, standing } => self.check_standing(*worker, standing),
            Change::JobChanged { control, .. } => self.seen.stops += u64::from(control.stop.is_some()),
            Change::JobReopened { .. } => self.seen.reopened += 1,
            Change::FailuresForgotten { .. } => self.seen.retried += 1,
            Change::LeafFailed { attempt, .. } => self.seen.repeated += u64::from(attempt.repeated),
            _ => {}
        }
    }

    pub(super) fn is_cursed(&self, job: JobId, node: NodeKey) -> bool {
        (node.first()..node.end()).any(|leaf| self.cursed.contains(&(job, leaf as u32)))
    }

    /// Nobody honest is refuted, and where honest workers decide nobody honest goes into quarantine.
    pub(super) fn check_standing(&mut self, worker: WorkerId, standing: &record::Standing) {
        let Some(reason) = &standing.quarantine else { return };
        self.seen.quarantines += 1;
        let refuted = reason.contains("two others agree");
        let mut namesakes = self.farm.namesakes(&self.farm.workers.get(worker).unwrap().record);
        let deserves = |worker: &WorkerId| self.dishonest.contains(worker) || self.by_hand.contains(worker);
        assert!(
            !refuted || namesakes.any(|other| deserves(&other.record.id)),
            "{worker}: {reason}"
        );
        assert!(self.mode != Mode::Guarded || !self.guards.contains(&worker), "{reason}");
    }

    /// What counts is disjoint and within the job; what two principals agreed about is right; what is remembered is kept.
    pub(in crate::scheduler::tests) fn check(&self) {
        let mut tokens = BTreeSet::new();
        for job in self.farm.jobs() {
            let mut end = 0;
            for (node, _) in job.live_nodes() {
                assert!(node.first() >= end && node.end() <= job.leaves());
                end = node.end();
            }
            for (node, record) in job.nodes.all.iter() {
                // Two that go on from one lie agree.
                let excused = job.is_chain() && self.mode == Mode::Free;
                assert!(
                    !record.verified || excused || record.digest == honest(job.id(), *node),
                    "{node} of {}",
                    job.id()
                );
                assert!(record.live == job.is_live(*node) && job.covering(*node).is_some());
            }
            assert!(
                job.leases.keys().all(|token| tokens.insert(*token)),
                "a token is held twice"
            );
            assert_eq!(as_record(job), sorted(self.rows.jobs[&job.id()].clone()));
        }
        let kept = self.rows.snapshot();
        assert_eq!(kept.jobs.len(), self.farm.jobs.len());
        assert_eq!(kept.counters, self.farm.counters);
        assert!(
            kept.workers
                .iter()
                .eq(self.farm.workers.values().map(|worker| &worker.record))
        );
    }

    /// The indexes hold what a look at everything finds.
    pub(in crate::scheduler::tests) fn check_indexes(&self) {
        let (mut index, mut held) = (JobIndex::default(), Held::default());
        index.serve(self.farm.counters.share);
        for job in self.farm.jobs() {
            let again = Job::from_record(as_record(job), &self.config);
            assert_eq!(job.nodes, again.nodes);
            assert_eq!((&job.lent, &job.repeated), (&again.lent, &again.repeated));
            assert_eq!((&job.given_up, &job.free), (&again.given_up, &again.free));
            assert_eq!(job.free.iter().collect::<Vec<_>>(), free_ranges(job, &self.config));
            assert_eq!(job.done(), job.live_nodes().map(|(node, _)| node.leaves()).sum::<u64>());
            let siblings = job.live_nodes().map(|(node, _)| node.parent());
            let ready: BTreeSet<(u64, u32)> = siblings
                .filter(|parent| {
                    let mut children = parent.children().into_iter().flatten();
                    children.all(|child| job.is_live(child) && !job.waits(child))
                })
                .map(|parent| (parent.first(), parent.level))
                .collect();
            assert!(job.nodes.pairs.keys().eq(&ready));
            index.insert(job.id(), &job.facts());
            job.leases
                .values()
                .for_each(|lease| held.insert(&lease.record, &self.config));
        }
        assert_eq!((&index, &held), (&self.farm.index, &self.farm.held));
        for (skill, crew) in self.farm.workers.crews() {
            let alike = self.farm.workers.values();
            let alike = alike.filter(|worker| **worker.skill() == *skill && !self.farm.is_silent(worker, self.now));
            let (held, free): (Vec<_>, Vec<_>) = alike.partition(|worker| !worker.may_work());
            assert_eq!((crew.held, crew.workers()), (held.len() as u64, free.len() as u64));
        }
    }

    pub(super) fn check_refusal(&self, refusal: &Refusal) {
        match refusal {
            Refusal::StaleLease(_) | Refusal::UnknownJob(_) | Refusal::JobEnded(_) => {}
            Refusal::Conflict { .. } if self.mode != Mode::Honest => {}
            // Beyond where the job stopped.
            Refusal::Invalid(reason) if reason.contains("lies beyond") => {}
            other => panic!("{other}"),
        }
    }

    pub(in crate::scheduler::tests) fn check_end(&mut self) {
        for record in self.rows.jobs.values() {
            let job = Job::from_record(record.clone(), &self.config);
            assert!(job.leases.is_empty());
            let status = job.status();
            if status.state == JobState::Cancelled {
                continue;
            }
            // Two lied, or one while nobody else was there.
            if status.failure.as_deref() == Some("Scene") {
                self.seen.called_broken += 1;
                continue;
            }
            let poisoned: BTreeSet<u64> = status.poisoned.iter().map(|p| u64::from(p.iteration) - 1).collect();
            self.seen.poisoned += poisoned.len() as u64;
            let mut counted = vec![0; job.leaves() as usize];
            for (node, _) in job.live_nodes() {
                (node.first()..node.end()).for_each(|leaf| counted[leaf as usize] += 1);
            }
            let late = status
                .failure
                .as_ref()
                .is_some_and(|failure| failure.contains("deadline"));
            for (leaf, count) in counted.iter().enumerate().filter(|_| !late) {
                let leaf = leaf as u64;
                let waits = job.is_chain() && poisoned.first().is_some_and(|first| leaf > *first);
                let expected = u32::from(!poisoned.contains(&leaf) && !waits);
                assert_eq!(*count, expected, "leaf {leaf} of {}", job.id());
            }
            match status.state {
                JobState::Done => assert!(poisoned.is_empty() && status.failure.is_none()),
                JobState::Failed => assert!((late || !poisoned.is_empty()) && status.failure.is_some()),
                other => panic!("{other:?}"),
            }
            assert!(late || job.next_merge().is_none());
            if self.mode != Mode::Free {
                assert!(job.live_nodes().all(|(node, digest)| digest == honest(job.id(), node)));
            }
            self.check_stop(&job);
        }
    }

    /// A job with a noise target stops at the first checkpoint that meets it, whoever did the work.
    fn check_stop(&self, job: &Job) {
        let Some(target) = job
            .control
            .schedule
            .noise_target
            .filter(|_| job.state == JobState::Done)
        else {
            return;
        };
        if job.control.schedule.deadline_ms.is_some() {
            return;
        }
        let asked = job.control.stop.map_or(job.control.iterations, |stop| stop.asked);
        let mut checkpoints = (2..6).filter(|level| 1 << level < asked);
        let expected = checkpoints
            .find(|level| noise(*level) <= target)
            .map_or(asked, |level| 1 << level);
        assert_eq!(job.control.iterations, expected, "target {target}, {asked} asked for");
    }
}

/// A job as it should be kept.
fn as_record(job: &Job) -> JobRecord {
    let nodes: Vec<(NodeKey, NodeRecord)> = job.nodes.all.iter().map(|(key, node)| (*key, node.clone())).collect();
    let failures = job.failures.iter();
    JobRecord {
        head: job.head.clone(),
        control: job.control.clone(),
        share_ms: job.charged_ms,
        state: job.state,
        failure: job.failure.clone(),
        ended_ms: job.ended_ms,
        resolution: job.resolution,
        totals: Totals::default(),
        nodes,
        leases: job.leases.values().map(|lease| lease.record.clone()).collect(),
        failures: failures
            .flat_map(|(leaf, attempts)| attempts.iter().map(|attempt| (*leaf, attempt.clone())))
            .collect(),
    }
}

fn sorted(mut record: JobRecord) -> JobRecord {
    record.failures.sort_by_key(|(leaf, _)| *leaf);
    record.leases.sort_by_key(|lease| lease.token);
    record
}

/// The leaves of a job that are neither in the image, nor lent, nor given up, found one by one.
fn free_ranges(job: &Job, config: &SchedulerConfig) -> Vec<(u64, u64)> {
    let lent = |leaf: u64| {
        let leases = job.leases.values().map(|lease| &lease.record);
        let mut lent = leases.filter(|lease| !lease.verifies).map(|lease| lease.node);
        lent.any(|node| node.first() <= leaf && leaf < node.end())
    };
    let mut ranges: Vec<(u64, u64)> = Vec::new();
    for leaf in 0..job.leaves() {
        let failed = job.failures.get(&(leaf as u32));
        if job.covering(NodeKey::leaf(leaf as u32)).is_some()
            || lent(leaf)
            || failed.is_some_and(|failed| config.gives_up(failed))
        {
            continue;
        }
        match ranges.last_mut().filter(|(_, end)| *end == leaf) {
            Some((_, end)) => *end += 1,
            None => ranges.push((leaf, leaf + 1)),
        }
    }
    ranges
}
