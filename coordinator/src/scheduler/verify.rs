//! Spot verification: some nodes are rendered a second time by another worker, and the bits are compared.
//!
//! The rate is that of BOINC's adaptive replication: a worker's nodes are repeated always until some of them in a row
//! were confirmed, then with a probability that falls with their number, and always again once one was refuted. The
//! choice is a hash of the job, the node, the worker and a secret of the farm, so that a worker cannot foresee it.
//!
//! A node that was chosen is in doubt: it is in the image, but it is not merged, and its job does not end, until two
//! principals ([`Principal`]: what several workers of one say counts once) have given the same bits. Those who gave others
//! go into quarantine. When no worker of another principal is there to repeat it, it is accepted unverified.

use super::record::{Change, LeaseRecord, Loss, Millis, NodeRecord, Opinion, Principal, Standing};
use super::roster::Worker;
use super::{Decision, Delivered, Delivery, Farm, Job, Refusal};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::node::NodeKey;
use std::collections::{BTreeMap, BTreeSet};

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
        self.nodes
            .all
            .get(&node)
            .is_some_and(|record| !record.opinions.is_empty())
    }

    /// Whether workers disagree about a node.
    pub(super) fn is_disputed(&self, node: NodeKey) -> bool {
        let digests = self.nodes.all.get(&node).map(|record| &record.opinions);
        digests.is_some_and(|opinions| opinions.iter().any(|opinion| opinion.digest != opinions[0].digest))
    }

    /// The nodes that wait for others to repeat them, from left to right.
    pub(super) fn nodes_in_doubt(&self) -> impl Iterator<Item = NodeKey> + '_ {
        self.nodes.doubts.values().copied()
    }

    /// The leases under which `node` is repeated.
    pub(super) fn verifiers(&self, node: NodeKey) -> impl Iterator<Item = &LeaseRecord> {
        self.repeated.on(node).map(|token| &self.leases[&token].record)
    }

    /// Whether a worker of `principal` has said what it makes of `node`.
    pub(super) fn has_opinion(&self, node: NodeKey, principal: Principal) -> bool {
        let opinions = self.nodes.all.get(&node).map_or(&[][..], |record| &record.opinions);
        opinions.iter().any(|opinion| opinion.principal == principal)
    }

    /// Accepts a node unverified, without waiting any longer.
    pub(super) fn accept(&self, node: NodeKey) -> Vec<Change> {
        let Some(record) = self.nodes.all.get(&node) else {
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
        let Some(known) = self.nodes.all.get(&node) else {
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
            .all
            .iter()
            .filter(|(_, record)| suspect(record))
            .filter_map(|(node, _)| self.covering(*node))
            .collect();
        lost.sort_unstable();
        lost.dedup();
        let mut changes = Vec::new();
        for node in self.nodes_in_doubt().filter(|node| !lost.contains(node)) {
            let mut record = self.nodes.all[&node].clone();
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

impl Farm {
    /// Whether a delivery is to be repeated by a worker of another principal.
    pub(super) fn is_chosen(&self, job: &Job, delivery: &Delivery) -> bool {
        let until = u64::from(self.config.verify_until);
        let Some(worker) = self.workers.get(delivery.worker).filter(|_| until > 0) else {
            return false;
        };
        let mut others = self.workers.staff_for(job).principals();
        if others.all(|other| other == worker.principal) {
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
            changes.extend(self.execute(job, verdict));
            return Ok(Decision::new(Delivered::Repeated, changes));
        }
        let (reply, mut changes) = match job.deliver(delivery, principal, self.is_chosen(job, delivery)) {
            Err(Refusal::Conflict { .. }) if self.may_dispute(job, delivery) => {
                let heard = job.hear(node, opinion, Some(delivery));
                return Ok(Decision::new(Delivered::Disputed, self.execute(job, heard)));
            }
            other => other?,
        };
        if reply == Delivered::Counted && !changes.iter().any(leaves_doubt) {
            let at_fault = job.failed_within(node).filter(|failed| *failed != worker).collect();
            changes = self.blame(job, changes, at_fault, vec![]);
        }
        if reply == Delivered::Counted {
            changes.extend(job.measured(delivery.memory_mb));
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
        let Some(record) = job
            .nodes
            .all
            .get(&node)
            .filter(|record| record.live && !record.verified)
        else {
            return false;
        };
        let Some(known) = self.workers.get(worker).filter(|worker| worker.fits(job)) else {
            return false;
        };
        record.worker.is_some() && record.principal != known.principal && !job.has_opinion(node, known.principal)
    }

    /// A worker could not render a node that it was to repeat.
    pub(super) fn hear_failure(&self, job: &Job, lease: &LeaseRecord) -> Vec<Change> {
        let opinion = Opinion {
            worker: lease.worker,
            principal: self.principal_of(lease.worker),
            digest: NO_IMAGE,
        };
        let mut changes = vec![job.end_lease(lease.token)];
        let verdict = job.hear(lease.node, opinion, None);
        changes.extend(self.execute(job, verdict));
        changes
    }

    /// What follows from a verdict for its workers.
    fn execute(&self, job: &Job, verdict: Verdict) -> Vec<Change> {
        let mut changes = verdict.changes;
        for worker in verdict.confirmed {
            if let Some(known) = self.workers.get(worker) {
                let standing = Standing {
                    verified: known.record.standing.verified.saturating_add(1),
                    faults: 0,
                    ..known.record.standing.clone()
                };
                changes.push(Change::WorkerJudged { worker, standing });
            }
        }
        let refuted = verdict.refuted.into_iter().map(|worker| {
            let node = verdict.settled.map_or_else(String::new, |node| node.to_string());
            let reason = format!(
                "two others agree about node {node} of job {}, and not with it",
                job.id()
            );
            (worker, reason)
        });
        self.blame(job, changes, verdict.at_fault, refuted.collect())
    }

    /// What follows for workers that were at fault, and for those that go into quarantine, of which the reasons are
    /// given. Too many faults lead to quarantine, too.
    fn blame(
        &self,
        job: &Job,
        mut changes: Vec<Change>,
        at_fault: Vec<WorkerId>,
        mut to_hold: Vec<(WorkerId, String)>,
    ) -> Vec<Change> {
        for worker in at_fault {
            let Some(before) = self.standing_after(&changes, worker) else {
                continue;
            };
            let standing = Standing {
                faults: before.faults.saturating_add(1),
                ..before
            };
            if standing.faults >= self.config.max_faults {
                to_hold.push((worker, format!("{} faults in a row", standing.faults)));
            }
            changes.push(Change::WorkerJudged { worker, standing });
        }
        if !to_hold.is_empty() {
            let mut next = job.clone();
            changes.iter().for_each(|change| next.evolve(change, 0, &self.config));
            let more = self.hold(&to_hold, &changes, Some(&next));
            changes.extend(more);
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
        judged.or_else(|| Some(self.workers.get(worker)?.record.standing.clone()))
    }

    /// Takes the leases of a worker and of those of its name, gives them none, and gives up whatever rests on their
    /// unconfirmed work.
    pub fn quarantine(&self, worker: WorkerId, reason: &str) -> Result<Decision<()>, Refusal> {
        if !self.knows(worker) {
            return Err(Refusal::UnknownWorker(worker));
        }
        let changes = self.hold(&[(worker, reason.to_owned())], &[], None);
        Ok(Decision::new((), changes))
    }

    /// Quarantine of workers, for these reasons, after `changes` of one job, which is as `changed` then.
    fn hold(&self, to_hold: &[(WorkerId, String)], changes: &[Change], changed: Option<&Job>) -> Vec<Change> {
        let mut free: BTreeMap<WorkerId, Standing> = BTreeMap::new();
        for (worker, reason) in to_hold {
            let known = self.workers.get(*worker).into_iter();
            for other in known.flat_map(|known| self.namesakes(&known.record)) {
                let standing = self.standing_after(changes, other.id()).unwrap_or_default();
                if standing.quarantine.is_none() {
                    free.entry(other.id()).or_insert_with(|| Standing {
                        verified: 0,
                        faults: standing.faults,
                        quarantine: Some(reason.clone()),
                        drained: standing.drained,
                        rest: standing.rest,
                    });
                }
            }
        }
        if free.is_empty() {
            return vec![];
        }
        let as_it_is_then = |id: JobId| changed.filter(|job| job.id() == id).unwrap_or(&self.jobs[&id]);
        let workers: BTreeSet<WorkerId> = free.keys().copied().collect();
        let judged = free.into_iter();
        let mut more: Vec<Change> = judged
            .map(|(worker, standing)| Change::WorkerJudged { worker, standing })
            .collect();
        let leases = workers.iter().flat_map(|worker| self.leases_of(*worker));
        let held = leases.filter(|lease| as_it_is_then(lease.job).leases.contains_key(&lease.token));
        more.extend(held.map(|lease| Change::LeaseEnded {
            job: lease.job,
            token: lease.token,
        }));
        more.extend(self.jobs.keys().flat_map(|id| as_it_is_then(*id).distrust(&workers)));
        more
    }

    /// Lets a worker, and those of its name, work again as if they were new.
    pub fn release_worker(&self, worker: WorkerId) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(worker).ok_or(Refusal::UnknownWorker(worker))?;
        let held = self.namesakes(&known.record).filter(|other| other.is_held());
        let change = |other: &Worker| Change::WorkerJudged {
            worker: other.record.id,
            standing: Standing {
                drained: other.record.standing.drained,
                rest: other.record.standing.rest,
                ..Standing::default()
            },
        };
        Ok(Decision::new((), held.map(change).collect()))
    }

    /// Accepts the nodes in doubt that nobody is there to repeat.
    pub(super) fn accept_lonely(&self, job: &Job) -> Vec<Change> {
        let staff = self.workers.staff_for(job);
        let mut changes = Vec::new();
        for node in job.nodes_in_doubt().filter(|node| !job.is_disputed(*node)) {
            let somebody = staff.principals().any(|principal| !job.has_opinion(node, principal));
            if !somebody && job.verifiers(node).next().is_none() {
                changes.extend(job.accept(node));
            }
        }
        changes
    }
}

fn leaves_doubt(change: &Change) -> bool {
    matches!(change, Change::NodeAdded { record, .. } if !record.opinions.is_empty())
}
