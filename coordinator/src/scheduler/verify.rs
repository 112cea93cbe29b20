//! Spot verification: some nodes are rendered a second time by another worker, and the bits are compared.
//!
//! The rate is that of BOINC's adaptive replication: a worker's nodes are repeated always until some of them in a row
//! were confirmed, then with a probability that falls with their number, and always again once one was refuted. The
//! choice is a hash of the job, the node, the worker and a secret of the farm, so that a worker cannot foresee it.
//!
//! A node that was chosen is in doubt: it is in the image, but it is not merged, and its job does not end, until two
//! workers have given the same bits. Those who gave others go into quarantine. When no other worker is there to repeat
//! it, it is believed.

use super::record::{Change, LeaseRecord, Loss, Millis, NodeRecord, Opinion, Standing};
use super::{Decision, Delivered, Delivery, Farm, Job, Refusal, Worker};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::node::NodeKey;

/// Stands for the image of a node that a worker could not render.
const NO_IMAGE: BlobHash = BlobHash([0; 32]);

/// What became of a node about which somebody gave an opinion.
#[derive(Clone, Debug, Default)]
pub(super) struct Verdict {
    pub(super) changes: Vec<Change>,
    /// Workers that gave what two gave.
    confirmed: Vec<WorkerId>,
    /// Workers that gave other bits.
    refuted: Vec<WorkerId>,
    /// Workers that could not render what two could.
    at_fault: Vec<WorkerId>,
    /// The node that two workers agree about.
    pub(super) settled: Option<NodeKey>,
}

impl Job {
    /// Whether a node waits for others to repeat it.
    pub(super) fn is_in_doubt(&self, node: NodeKey) -> bool {
        self.nodes.get(&node).is_some_and(|record| !record.opinions.is_empty())
    }

    /// Whether workers disagree about a node.
    pub(super) fn is_disputed(&self, node: NodeKey) -> bool {
        let digests = self.nodes.get(&node).map(|record| &record.opinions);
        digests.is_some_and(|opinions| opinions.iter().any(|opinion| opinion.digest != opinions[0].digest))
    }

    /// The nodes that wait for others to repeat them, from left to right.
    pub(super) fn nodes_in_doubt(&self) -> impl Iterator<Item = NodeKey> + '_ {
        self.live_nodes()
            .map(|(node, _)| node)
            .filter(|node| self.is_in_doubt(*node))
    }

    /// The leases under which `node` is repeated.
    pub(super) fn verifiers(&self, node: NodeKey) -> impl Iterator<Item = &LeaseRecord> {
        let records = self.leases.values().map(|lease| &lease.record);
        records.filter(move |record| record.verifies && record.node == node)
    }

    /// Whether `worker` has said what it makes of `node`.
    pub(super) fn has_opinion(&self, node: NodeKey, worker: WorkerId) -> bool {
        let opinions = self.nodes.get(&node).map_or(&[][..], |record| &record.opinions);
        opinions.iter().any(|opinion| opinion.worker == worker)
    }

    /// Believes a node without waiting any longer.
    pub(super) fn believe(&self, node: NodeKey) -> Vec<Change> {
        let Some(record) = self.nodes.get(&node) else {
            return vec![];
        };
        let record = NodeRecord {
            opinions: vec![],
            ..record.clone()
        };
        let job = self.id();
        let mut changes = vec![Change::NodeJudged { job, node, record }];
        changes.extend(self.verifiers(node).map(|lease| self.end_lease(lease.token)));
        changes
    }

    /// A worker says what it makes of a node in doubt.
    pub(super) fn hear(&self, node: NodeKey, opinion: Opinion, delivery: Option<&Delivery>) -> Verdict {
        let Some(known) = self.nodes.get(&node) else {
            return Verdict::default();
        };
        let mut record = known.clone();
        if let (Some(worker), true) = (known.worker, known.opinions.is_empty()) {
            let digest = known.digest;
            record.opinions.push(Opinion { worker, digest });
        }
        record.opinions.push(opinion);
        let agree = |with: &Opinion| with.digest == opinion.digest;
        let job = self.id();
        if record.opinions.iter().filter(|other| agree(other)).count() < 2 {
            let changes = vec![Change::NodeJudged { job, node, record }];
            return Verdict {
                changes,
                ..Verdict::default()
            };
        }
        let mut verdict = Verdict {
            settled: Some(node),
            ..Verdict::default()
        };
        verdict.changes = if opinion.digest == NO_IMAGE {
            // Two that failed do not show that the third did wrong: it is rendered anew, and nobody is blamed.
            let loss = Loss::Untrusted;
            vec![Change::NodeLost { job, node, loss }]
        } else {
            for other in &record.opinions {
                let list = match agree(other) {
                    true => &mut verdict.confirmed,
                    false if other.digest == NO_IMAGE => &mut verdict.at_fault,
                    false => &mut verdict.refuted,
                };
                list.push(other.worker);
            }
            let first = record.opinions.iter().find(|other| agree(other));
            if known.digest != opinion.digest {
                record.totals = delivery.map(|delivery| delivery.totals);
                record.copy = delivery.map_or(0, |delivery| delivery.copy);
            }
            record.worker = first.map(|first| first.worker);
            record.digest = opinion.digest;
            record.verified = true;
            record.opinions.clear();
            match delivery
                .map(|delivery| delivery.resolution)
                .filter(|size| self.resolution() != Some(*size))
            {
                // It may have been the node that fixed the image size.
                Some(resolution) => vec![
                    Change::NodeLost {
                        job,
                        node,
                        loss: Loss::Untrusted,
                    },
                    Change::NodeAdded {
                        job,
                        node,
                        record,
                        resolution,
                    },
                ],
                None => vec![Change::NodeJudged { job, node, record }],
            }
        };
        let over = self.verifiers(node).map(|lease| self.end_lease(lease.token));
        verdict.changes.extend(over);
        if known.digest != opinion.digest {
            verdict.changes.extend(self.forsake(node.end()));
        }
        verdict
    }

    /// Gives up whatever rests on unconfirmed work of `worker`.
    fn distrust(&self, worker: WorkerId) -> Vec<Change> {
        let (job, loss) = (self.id(), Loss::Untrusted);
        let suspect = |record: &NodeRecord| record.worker == Some(worker) && !record.verified;
        let mut lost: Vec<NodeKey> = self
            .nodes
            .iter()
            .filter(|(_, record)| suspect(record))
            .filter_map(|(node, _)| self.covering(*node))
            .collect();
        lost.sort_unstable();
        lost.dedup();
        let mut changes = Vec::new();
        for node in self.nodes_in_doubt().filter(|node| !lost.contains(node)) {
            let mut record = self.nodes[&node].clone();
            let before = record.opinions.len();
            record.opinions.retain(|opinion| opinion.worker != worker);
            if record.opinions.len() < before {
                changes.push(Change::NodeJudged { job, node, record });
            }
        }
        if let (true, Some(first)) = (self.is_chain(), lost.iter().map(|node| node.first()).min()) {
            changes.extend(self.forsake(first));
            return changes;
        }
        for node in lost {
            changes.extend(self.verifiers(node).map(|lease| self.end_lease(lease.token)));
            changes.push(Change::NodeLost { job, node, loss });
        }
        changes
    }
}

impl Worker {
    /// Whether it may work on a job.
    pub(super) fn fits(&self, job: &Job) -> bool {
        let record = &self.record;
        let bound = job
            .control
            .renderer
            .as_ref()
            .is_none_or(|bound| *bound == record.renderer);
        bound && record.standing.quarantine.is_none() && job.control.schedule.tags.is_subset(&record.tags)
    }
}

impl Farm {
    /// The workers that were heard of lately and may work on a job.
    pub(super) fn workers_for<'a>(&'a self, job: &'a Job, now: Millis) -> impl Iterator<Item = WorkerId> + 'a {
        let lately = move |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) < self.config.lease_ttl_ms;
        let fitting = self.workers.values().filter(lately).filter(|worker| worker.fits(job));
        fitting.map(|worker| worker.record.id)
    }

    /// Whether a delivery is to be repeated by another worker.
    pub(super) fn is_chosen(&self, job: &Job, delivery: &Delivery, now: Millis) -> bool {
        let until = u64::from(self.config.verify_until);
        let Some(worker) = self.workers.get(&delivery.worker).filter(|_| until > 0) else {
            return false;
        };
        if !self.workers_for(job, now).any(|other| other != delivery.worker) {
            return false;
        }
        let in_a_row = u64::from(worker.record.standing.verified);
        let NodeKey { level, index } = delivery.node;
        let numbers = [
            self.config.verify_secret,
            delivery.job.0,
            u64::from(level) << 32 | u64::from(index),
            delivery.worker.0,
        ];
        in_a_row <= until || mix(numbers) % in_a_row < until
    }

    /// A worker delivers a node of a job that has not ended. For one that has, ask [`Job::deliver`].
    pub fn deliver(&self, delivery: &Delivery, now: Millis) -> Result<Decision<Delivered>, Refusal> {
        let job = self.live_job(delivery.job)?;
        let (worker, node) = (delivery.worker, delivery.node);
        let opinion = Opinion {
            worker,
            digest: delivery.digest,
        };
        if let Ok(lease) = job.lease(delivery.token, worker)
            && lease.record.verifies
        {
            if lease.record.node != node || job.has_opinion(node, worker) {
                return Ok(Decision::new(Delivered::Repeated, vec![]));
            }
            let mut changes = vec![job.end_lease(delivery.token)];
            let verdict = job.hear(node, opinion, Some(delivery));
            changes.extend(self.execute(job.id(), verdict, now));
            return Ok(Decision::new(Delivered::Repeated, changes));
        }
        let (reply, mut changes) = match job.deliver(delivery, self.is_chosen(job, delivery, now)) {
            Err(Refusal::Conflict { .. }) if self.may_dispute(job, delivery) => {
                let heard = job.hear(node, opinion, Some(delivery));
                return Ok(Decision::new(Delivered::Disputed, self.execute(job.id(), heard, now)));
            }
            other => other?,
        };
        if reply == Delivered::Counted && !changes.iter().any(leaves_doubt) {
            let at_fault = job.failed_within(node).filter(|failed| *failed != worker).collect();
            changes = self.blame(changes, at_fault, now);
        }
        Ok(Decision::new(reply, changes))
    }

    /// Whether what a worker says against a node is heard: the node stands on its own, and the worker in good standing. What
    /// was rendered of a chain under a lease that has ended may have gone on from a node that was given up.
    fn may_dispute(&self, job: &Job, delivery: &Delivery) -> bool {
        let (node, worker) = (delivery.node, delivery.worker);
        if job.is_chain() && job.lease(delivery.token, worker).is_err() {
            return false;
        }
        let Some(record) = job.nodes.get(&node).filter(|record| record.live && !record.verified) else {
            return false;
        };
        let heard = self.workers.get(&worker).is_some_and(|worker| worker.fits(job));
        heard && record.worker.is_some_and(|maker| maker != worker) && !job.has_opinion(node, worker)
    }

    /// A worker could not render a node that it was to repeat.
    pub(super) fn hear_failure(&self, job: &Job, lease: &LeaseRecord, now: Millis) -> Vec<Change> {
        let opinion = Opinion {
            worker: lease.worker,
            digest: NO_IMAGE,
        };
        let mut changes = vec![job.end_lease(lease.token)];
        let verdict = job.hear(lease.node, opinion, None);
        changes.extend(self.execute(job.id(), verdict, now));
        changes
    }

    /// What follows from a verdict for its workers.
    fn execute(&self, job: JobId, verdict: Verdict, now: Millis) -> Vec<Change> {
        let mut changes = verdict.changes;
        for worker in verdict.confirmed {
            if let Some(known) = self.workers.get(&worker) {
                let standing = Standing {
                    verified: known.record.standing.verified.saturating_add(1),
                    faults: 0,
                    quarantine: known.record.standing.quarantine.clone(),
                };
                changes.push(Change::WorkerJudged { worker, standing });
            }
        }
        changes = self.blame(changes, verdict.at_fault, now);
        for worker in verdict.refuted {
            let node = verdict.settled.map_or_else(String::new, |node| node.to_string());
            let reason = format!("two others agree about node {node} of job {job}, and not with it");
            changes = self.quarantine_after(changes, worker, &reason, now);
        }
        changes
    }

    /// Faults of workers; too many of them lead to quarantine.
    pub(super) fn blame(&self, mut changes: Vec<Change>, at_fault: Vec<WorkerId>, now: Millis) -> Vec<Change> {
        for worker in at_fault {
            let Some(known) = self.workers.get(&worker) else {
                continue;
            };
            let standing = Standing {
                faults: known.record.standing.faults.saturating_add(1),
                ..known.record.standing.clone()
            };
            let faults = standing.faults;
            changes.push(Change::WorkerJudged { worker, standing });
            if faults >= self.config.max_faults {
                let reason = format!("{faults} faults in a row");
                changes = self.quarantine_after(changes, worker, &reason, now);
            }
        }
        changes
    }

    /// Quarantine, once `changes` are applied.
    fn quarantine_after(&self, mut changes: Vec<Change>, worker: WorkerId, reason: &str, now: Millis) -> Vec<Change> {
        let mut next = self.clone();
        changes.iter().for_each(|change| next.evolve(change, now));
        if let Ok(decision) = next.quarantine(worker, reason) {
            changes.extend(decision.changes);
        }
        changes
    }

    /// Takes a worker's leases, gives it none, and gives up whatever rests on its unconfirmed work.
    pub fn quarantine(&self, worker: WorkerId, reason: &str) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        if known.record.standing.quarantine.is_some() {
            return Ok(Decision::new((), vec![]));
        }
        let standing = Standing {
            verified: 0,
            faults: known.record.standing.faults,
            quarantine: Some(reason.to_owned()),
        };
        let mut changes = vec![Change::WorkerJudged { worker, standing }];
        changes.extend(self.leases_of(worker).map(|lease| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        }));
        changes.extend(self.jobs.values().flat_map(|job| job.distrust(worker)));
        Ok(Decision::new((), changes))
    }

    /// Lets a worker, and those of its name, work again as if they were new.
    pub fn release_worker(&self, worker: WorkerId) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        let namesakes = self.workers.values().map(|worker| &worker.record);
        let held = namesakes.filter(|other| other.name == known.record.name && other.standing.quarantine.is_some());
        let change = |record: &super::record::WorkerRecord| Change::WorkerJudged {
            worker: record.id,
            standing: Standing::default(),
        };
        Ok(Decision::new((), held.map(change).collect()))
    }

    /// Believes the nodes in doubt that nobody is there to repeat.
    pub(super) fn waive(&self, job: &Job, now: Millis) -> Vec<Change> {
        let mut changes = Vec::new();
        for node in job.nodes_in_doubt().filter(|node| !job.is_disputed(*node)) {
            let somebody = self.workers_for(job, now).any(|worker| !job.has_opinion(node, worker));
            if !somebody && job.verifiers(node).next().is_none() {
                changes.extend(job.believe(node));
            }
        }
        changes
    }
}

fn leaves_doubt(change: &Change) -> bool {
    matches!(change, Change::NodeAdded { record, .. } if !record.opinions.is_empty())
}

/// Mixes numbers into one, by the finalizer of SplitMix64 (Steele, Lea and Flood 2014).
fn mix(numbers: [u64; 4]) -> u64 {
    numbers.into_iter().fold(0x9e37_79b9_7f4a_7c15, |state, number| {
        let z = state ^ number.wrapping_mul(0x2545_f491_4f6c_dd1d);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}
