//! The nodes of a job as they are looked for: what is kept of each, and in which order they wait for what. Every change
//! of a node, of a lease on it, or of how the job goes on keeps this up to date, so that nothing is searched for.

use super::job::Job;
use super::record::{NodeRecord, Principal};
use super::table::{Set, Table};
use photonfarm_proto::node::NodeKey;
use std::ops::Bound::{Excluded, Unbounded};

/// The nodes of a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Nodes {
    /// All that are kept.
    pub(super) all: Table<NodeKey, NodeRecord>,
    /// Those that count, by first leaf.
    pub(super) live: Table<u64, NodeKey>,
    /// Leaves in those that count.
    pub(super) done: u64,
    /// Those that count and wait for others to repeat them, by first leaf.
    pub(super) doubts: Table<u64, NodeKey>,
    /// Of those, the ones that nobody is repeating: by the one principal that has spoken, if it is one, and by first
    /// leaf.
    unrepeated: Set<(Option<Principal>, u64)>,
    /// First leaves of those that count and no coordinator has read yet.
    pub(super) unread: Set<u64>,
    /// First leaf and level of nodes of which both children can be merged.
    pub(super) pairs: Set<(u64, u32)>,
}

impl Nodes {
    /// A node in doubt that nobody is repeating and that `principal` has said nothing about.
    ///
    /// Nodes that several have spoken about come first: they are disputed, and few.
    pub(super) fn to_repeat(&self, principal: Principal) -> impl Iterator<Item = NodeKey> + '_ {
        let disputed = self.unrepeated.range(..(Some(Principal(0)), 0));
        let disputed = disputed.filter(move |((_, first), ())| {
            let opinions = &self.all[&self.doubts[first]].opinions;
            opinions.iter().all(|opinion| opinion.principal != principal)
        });
        let before = self.unrepeated.range((Some(Principal(0)), 0)..(Some(principal), 0));
        let after = (Excluded((Some(principal), u64::MAX)), Unbounded);
        let found = disputed.chain(before).chain(self.unrepeated.range(after));
        found.map(|((_, first), ())| self.doubts[first])
    }

    /// Whether a node in doubt is repeated by nobody.
    pub(super) fn wants_repeats(&self) -> bool {
        !self.unrepeated.is_empty()
    }

    /// Under what a node is found that nobody repeats.
    fn place_of_doubt(&self, node: NodeKey) -> (Option<Principal>, u64) {
        let one = match self.all[&node].opinions.as_slice() {
            [opinion] => Some(opinion.principal),
            _ => None,
        };
        (one, node.first())
    }

    /// Forgets a node and all within it.
    pub(super) fn forget(&mut self, node: NodeKey) {
        for level in 0..=node.level {
            let key = |leaf: u64| NodeKey {
                level,
                index: (leaf >> level) as u32,
            };
            let within = self.all.range(key(node.first())..=key(node.end() - 1));
            let within: Vec<NodeKey> = within.map(|(key, _)| *key).collect();
            within.iter().for_each(|key| _ = self.all.remove(key));
        }
    }
}

impl Job {
    /// A node is kept from now on, and counts or not.
    pub(super) fn keep_node(&mut self, node: NodeKey, record: NodeRecord) {
        self.drop_from_indexes(node);
        let live = record.live;
        self.nodes.all.insert(node, record);
        match live {
            true => self.nodes.live.insert(node.first(), node),
            false if self.is_live(node) => _ = self.nodes.live.remove(&node.first()),
            false => {}
        }
        self.put_into_indexes(node);
    }

    /// A node and all within it are forgotten.
    pub(super) fn forget_node(&mut self, node: NodeKey) {
        self.drop_from_indexes(node);
        self.nodes.forget(node);
        self.nodes.live.remove(&node.first());
        self.update_pair(node);
        self.free_within(node);
    }

    /// Before a node that counts changes, or what it waits for.
    pub(super) fn drop_from_indexes(&mut self, node: NodeKey) {
        if !self.is_live(node) {
            return;
        }
        self.nodes.done -= node.leaves();
        self.nodes.unread.remove(&node.first());
        if self.is_in_doubt(node) {
            let place = self.nodes.place_of_doubt(node);
            self.nodes.unrepeated.remove(&place);
            self.nodes.doubts.remove(&node.first());
        }
    }

    /// After a node changed, or what it waits for.
    pub(super) fn put_into_indexes(&mut self, node: NodeKey) {
        self.update_pair(node);
        if !self.is_live(node) {
            return;
        }
        self.nodes.done += node.leaves();
        self.nodes.unread.set(node.first(), self.nodes.all[&node].unread);
        if self.is_in_doubt(node) {
            self.nodes.doubts.insert(node.first(), node);
            let place = self.nodes.place_of_doubt(node);
            self.nodes
                .unrepeated
                .set(place, self.repeated.on(node).next().is_none());
        }
    }

    /// A node changed: whether it and its sibling can be merged.
    pub(super) fn update_pair(&mut self, node: NodeKey) {
        if node.level == NodeKey::MAX_LEVEL {
            return;
        }
        let parent = node.parent();
        let ready = [node, node.sibling()]
            .into_iter()
            .all(|child| self.is_live(child) && !self.waits(child));
        self.nodes.pairs.set((parent.first(), parent.level), ready);
    }
}
