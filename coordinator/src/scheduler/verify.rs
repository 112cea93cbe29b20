//! Spot verification: some nodes are rendered a second time by another worker, and the bits are compared.
//!
//! The rate is that of BOINC's adaptive replication: a worker's nodes are repeated always until some of them in a row
//! were confirmed, then with a probability that falls with their number, and always again once one was refuted. The
//! choice is a hash of the job, the node, the worker and a secret of the farm, so that a worker cannot foresee it.
//!
//! A node that was chosen is in doubt: it is in the image, but it is not merged, and its job does not end, until two
//! principals ([`Principal`]: what several workers of one say counts once) have given the same bits. Those who gave others
//! go into quarantine. When no worker of another principal is there to repeat it, it is believed.

use super::record::{Change, LeaseRecord, Loss, Millis, NodeRecord, Opinion, Principal, Standing};
use super::{Decision, Delivered, Delivery, Farm, Job, Refusal, Worker};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeSet;

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

    /// Whether a worker of `principal` has said what it makes of `node`.
    pub(super) fn has_opinion(&self, node: NodeKey, principal: Principal) -> bool {
        let opinions = self.nodes.get(&node).map_or(&[][..], |record| &record.opinions);
        opinions.iter().any(|opinion| opinion.principal == principal)
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
            record.opinions.push(Opinion {
                worker,
                principal: known.principal,
                digest: known.digest,
            });
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
            record.principal = first.map_or_else(Principal::default, |first| first.principal);
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
            verdict.changes.extend(self.revoke_after(node.end()));
        }
        verdict
    }

    /// Gives up whatever rests on unconfirmed work of some workers.
    fn distrust(&self, workers: &BTreeSet<WorkerId>) -> Vec<Change> {
        let (job, loss) = (self.id(), Loss::Untrusted);
        let suspect =
            |record: &NodeRecord| record.worker.is_some_and(|worker| workers.contains(&worker)) && !record.verified;
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
            record.opinions.retain(|opinion| !workers.contains(&opinion.worker));
            if record.opinions.len() < before {
                changes.push(Change::NodeJudged { job, node, record });
            }
        }
        if let (true, Some(first)) = (self.is_chain(), lost.iter().map(|node| node.first()).min()) {
            changes.extend(self.revoke_after(first));
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
    pub(super) fn workers_for<'a>(&'a self, job: &'a Job, now: Millis) -> impl Iterator<Item = &'a Worker> + 'a {
        let lately = move |worker: &&Worker| now.saturating_sub(worker.last_seen_ms) < self.config.lease_ttl_ms;
        self.workers.values().filter(lately).filter(|worker| worker.fits(job))
    }

    /// Whether a delivery is to be repeated by a worker of another principal.
    pub(super) fn is_chosen(&self, job: &Job, delivery: &Delivery, now: Millis) -> bool {
        let until = u64::from(self.config.verify_until);
        let Some(worker) = self.workers.get(&delivery.worker).filter(|_| until > 0) else {
            return false;
        };
        if !self
            .workers_for(job, now)
            .any(|other| other.principal != worker.principal)
        {
            return false;
        }
        let in_a_row = u64::from(worker.record.standing.verified);
        let NodeKey { level, index } = delivery.node;
        let place = u64::from(level) << 32 | u64::from(index);
        let numbers = [delivery.job.0, place, delivery.worker.0];
        in_a_row <= until || self.config.secret.number(numbers) % in_a_row < until
    }

    /// A worker delivers a node of a job that has not ended. For one that has, ask [`Job::deliver`].
    pub fn deliver(&self, delivery: &Delivery, now: Millis) -> Result<Decision<Delivered>, Refusal> {
        let job = self.live_job(delivery.job)?;
        let (worker, node) = (delivery.worker, delivery.node);
        let delivery = &self.bounded(job, delivery, now);
        let principal = self.principal_of(worker);
        let opinion = Opinion {
            worker,
            principal,
            digest: delivery.digest,
        };
        if let Ok(lease) = job.lease(delivery.token, worker)
            && lease.record.verifies
        {
            if lease.record.node != node || job.has_opinion(node, principal) {
                return Ok(Decision::new(Delivered::Repeated, vec![]));
            }
            let mut changes = vec![job.end_lease(delivery.token)];
            let verdict = job.hear(node, opinion, Some(delivery));
            changes.extend(self.execute(job.id(), verdict, now));
            return Ok(Decision::new(Delivered::Repeated, changes));
        }
        let (reply, mut changes) = match job.deliver(delivery, principal, self.is_chosen(job, delivery, now)) {
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
        let Some(known) = self.workers.get(&worker).filter(|worker| worker.fits(job)) else {
            return false;
        };
        record.worker.is_some() && record.principal != known.principal && !job.has_opinion(node, known.principal)
    }

    /// A worker could not render a node that it was to repeat.
    pub(super) fn hear_failure(&self, job: &Job, lease: &LeaseRecord, now: Millis) -> Vec<Change> {
        let opinion = Opinion {
            worker: lease.worker,
            principal: self.principal_of(lease.worker),
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
            let Some(before) = self.standing_after(&changes, worker) else {
                continue;
            };
            let standing = Standing {
                faults: before.faults.saturating_add(1),
                ..before
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

    /// What is thought of a worker once `changes` are applied: others of its name may have been judged with it.
    fn standing_after(&self, changes: &[Change], worker: WorkerId) -> Option<Standing> {
        let judged = changes.iter().rev().find_map(|change| match change {
            Change::WorkerJudged {
                worker: other,
                standing,
            } if *other == worker => Some(standing.clone()),
            _ => None,
        });
        judged.or_else(|| Some(self.workers.get(&worker)?.record.standing.clone()))
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

    /// Takes the leases of a worker and of those of its name, gives them none, and gives up whatever rests on their
    /// unconfirmed work.
    pub fn quarantine(&self, worker: WorkerId, reason: &str) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        let free: Vec<&Worker> = self.namesakes(&known.record).filter(|other| !other.is_held()).collect();
        let judged = |other: &&Worker| Change::WorkerJudged {
            worker: other.record.id,
            standing: Standing {
                verified: 0,
                faults: other.record.standing.faults,
                quarantine: Some(reason.to_owned()),
            },
        };
        let mut changes: Vec<Change> = free.iter().map(judged).collect();
        let workers: BTreeSet<WorkerId> = free.iter().map(|other| other.record.id).collect();
        let leases = workers.iter().flat_map(|worker| self.leases_of(*worker));
        changes.extend(leases.map(|lease| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        }));
        if !workers.is_empty() {
            changes.extend(self.jobs.values().flat_map(|job| job.distrust(&workers)));
        }
        Ok(Decision::new((), changes))
    }

    /// Lets a worker, and those of its name, work again as if they were new.
    pub fn release_worker(&self, worker: WorkerId) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(&worker).ok_or(Refusal::UnknownWorker(worker))?;
        let held = self.namesakes(&known.record).filter(|other| other.is_held());
        let change = |other: &Worker| Change::WorkerJudged {
            worker: other.record.id,
            standing: Standing::default(),
        };
        Ok(Decision::new((), held.map(change).collect()))
    }

    /// Believes the nodes in doubt that nobody is there to repeat.
    pub(super) fn waive(&self, job: &Job, now: Millis) -> Vec<Change> {
        let mut changes = Vec::new();
        for node in job.nodes_in_doubt().filter(|node| !job.is_disputed(*node)) {
            let somebody = self
                .workers_for(job, now)
                .any(|worker| !job.has_opinion(node, worker.principal));
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
