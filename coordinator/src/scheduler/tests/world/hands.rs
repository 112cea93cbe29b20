//! Workers: what they ask for, render, and send through a network that loses and repeats.

use super::model::{honest, lie, links, mix, statistics, word};
use super::*;
use crate::scheduler::record::Principal;

impl World {
    pub(super) fn some_hand(&mut self) -> Option<WorkerId> {
        let workers: Vec<WorkerId> = self.hands.keys().copied().collect();
        self.random.pick(&workers).copied()
    }

    /// A worker is heard of: with some of its leases, or with none.
    pub(super) fn beat(&mut self) {
        let Some(worker) = self.some_hand() else { return };
        let leases = &self.hands[&worker].leases;
        let progress = leases.iter().map(|lease| LeaseProgress {
            token: lease.token,
            leaves_done: self.random.below(lease.node.leaves() + 1) as u32,
        });
        let progress: Vec<LeaseProgress> = progress.collect();
        match self.farm.heartbeat(worker, &progress, self.now) {
            Ok(lost) => {
                let hand = self.hands.get_mut(&worker).unwrap();
                hand.leases.retain(|lease| !lost.contains(&lease.token));
                self.transact(self.farm.reconnected(worker, self.now));
            }
            Err(_) => _ = self.hands.remove(&worker),
        }
    }

    pub(super) fn ask_for_work(&mut self) {
        if let Some(worker) = self.some_hand() {
            self.ask_for(worker);
        }
    }

    pub(super) fn ask_for(&mut self, worker: WorkerId) {
        let hand = self.hands.get_mut(&worker).unwrap();
        hand.serial += 1;
        let asked = Asked {
            worker,
            serial: hand.serial,
            held: hand.leases.iter().map(|lease| lease.token).collect(),
        };
        if self.kills && self.random.chance(15) {
            self.post.push(Letter::Ask(asked.clone()));
        }
        let _ = self.farm.asks(worker, asked.serial, self.now);
        let Ok(decision) = self.farm.lease(&asked, self.now) else {
            self.hands.remove(&worker);
            return;
        };
        let lost = self.kills && self.random.chance(15);
        if let Some(Some(lease)) = self.transact(decision)
            && !lost
        {
            if self.random.chance(50) {
                self.fetch(&lease);
            }
            self.hands.get_mut(&worker).unwrap().leases.push(lease);
        }
    }

    /// What goes on from the image of a node.
    pub(super) fn statistics_after(&self, job: JobId, node: NodeKey, digest: BlobHash) -> u64 {
        match digest == honest(job, node) {
            true => statistics(job, node.end()),
            false => self.after[&digest],
        }
    }

    /// A worker fetches what its lease goes on from; nothing if that was given up.
    fn fetch(&mut self, lease: &LeaseRecord) -> Option<u64> {
        let (job, token) = (lease.job, lease.token);
        if !self.rows.jobs[&job]
            .head
            .spec
            .integrator
            .with_defaults()
            .is_sequential()
            || lease.node.first() == 0
        {
            return Some(statistics(job, 0));
        }
        if let Some(known) = self.fetched.get(&token) {
            return Some(*known);
        }
        let (header, image) = self.farm.checkpoint_of(job, token, lease.worker).ok()?.reply?;
        let found = self.statistics_after(job, header.key, image.hash);
        self.fetched.insert(token, found);
        Some(found)
    }

    pub(super) fn finish_work(&mut self) {
        if let Some(worker) = self.some_hand() {
            self.finish(worker);
        }
    }

    /// A worker ends some lease: whole, in part, or with a failure; letters go into the post.
    pub(super) fn finish(&mut self, worker: WorkerId) {
        let hand = self.hands.get_mut(&worker).unwrap();
        if hand.leases.is_empty() {
            return;
        }
        let kind = hand.kind;
        let lease = hand.leases.remove(self.random.below(hand.leases.len() as u64) as usize);
        let Some(mut before) = self.fetch(&lease) else {
            return self.post.push(Letter::Release(lease));
        };
        let is_chain = self.rows.jobs[&lease.job]
            .head
            .spec
            .integrator
            .with_defaults()
            .is_sequential();
        let principal = self.farm.principal_of(worker);
        let lies = kind == Kind::Liar && self.random.chance(60);
        let cursed = |leaf: &u64| self.cursed.contains(&(lease.job, *leaf as u32));
        let mut bad = (lease.node.first()..lease.node.end()).find(cursed).filter(|_| !lies);
        if kind == Kind::Clumsy && self.random.chance(20) {
            bad = bad.or(Some(lease.node.first()));
        }
        let part = bad.or_else(|| {
            let drained = self.kills && self.random.chance(20);
            drained.then(|| lease.node.first() + self.random.below(lease.node.leaves()))
        });
        let after = &mut self.after;
        let mut render = |node: NodeKey| {
            let digest = match (lies, is_chain) {
                (true, _) => lie(principal, lease.job, node),
                (false, true) => links(lease.job, node, before).0,
                (false, false) => honest(lease.job, node),
            };
            before = match lies {
                true => mix(word(digest)),
                false => links(lease.job, node, before).1,
            };
            after.insert(digest, before);
            Letter::Node(Delivery {
                digest,
                ..delivery(&lease, node)
            })
        };
        let Some(stop) = part else {
            return self.post.push(render(lease.node));
        };
        let mut first = lease.node.first();
        while first < stop {
            let level = (stop - first).ilog2().min(first.trailing_zeros());
            let node = NodeKey {
                level,
                index: (first >> level) as u32,
            };
            self.post.push(render(node));
            first = node.end();
        }
        let kind = match self.random.chance(50) {
            _ if self.mode == Mode::Free && kind != Kind::Honest && self.random.chance(30) => FailureKind::Scene,
            true => FailureKind::Render,
            false => FailureKind::Panic,
        };
        let last = if bad.is_some() {
            Letter::Failure(lease, stop as u32, kind)
        } else {
            Letter::Release(lease)
        };
        self.post.push(last);
    }

    /// The network delivers any letter, perhaps not for the last time, or loses it.
    pub(super) fn carry_letter(&mut self) {
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

    /// A request that was on its way for long ends no lease that a later one was granted.
    fn receive_late(&mut self, asked: &Asked) {
        let Ok(decision) = self.farm.lease(asked, self.now) else {
            return;
        };
        let leases = self.farm.leases_of(asked.worker);
        let later: Vec<LeaseToken> = leases.filter(|l| l.serial >= asked.serial).map(|l| l.token).collect();
        for change in &decision.changes {
            assert!(!matches!(change, Change::LeaseEnded { token, .. } if later.contains(token)));
        }
        self.seen.overtaken += u64::from(decision.changes.is_empty() && !later.is_empty());
        self.transact(decision);
    }

    pub(super) fn receive(&mut self, letter: Letter) {
        let (job, decision) = match letter {
            Letter::Node(delivery) => {
                let decision = self.farm.deliver(&delivery, self.now);
                if let Err(Refusal::UnknownJob(_)) = decision {
                    let job = Job::from_record(self.rows.jobs[&delivery.job].clone(), &self.config);
                    let (reply, changes) = match job.deliver(&delivery, Principal::default(), false) {
                        Ok(found) => found,
                        Err(refusal) => return self.check_refusal(&refusal),
                    };
                    assert_eq!((reply, changes), (Delivered::Duplicate, vec![]));
                    return;
                }
                if let Ok(known) = &decision {
                    assert!(known.reply != Delivered::Disputed || self.mode != Mode::Honest);
                }
                (delivery.job, decision.map(|d| Decision::new((), d.changes)))
            }
            Letter::Failure(lease, leaf, kind) => {
                let attempt = Attempt {
                    worker: lease.worker,
                    kind,
                    message: format!("{kind:?}"),
                    at_ms: self.now,
                };
                let decision = self.farm.fail(lease.job, lease.token, leaf, attempt, self.now);
                (lease.job, decision)
            }
            Letter::Ask(asked) => return self.receive_late(&asked),
            Letter::Release(lease) => (lease.job, Ok(self.farm.release(lease.job, lease.token, lease.worker))),
        };
        match decision {
            Ok(decision) => _ = self.transact(decision),
            Err(refusal) => self.check_refusal(&refusal),
        }
        self.fold(job);
    }
}
