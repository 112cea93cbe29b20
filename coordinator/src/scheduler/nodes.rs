//! The nodes of a job as they are looked for: what is kept of each, and in which order they wait for what. Every change
//! of a node, of a lease on it, or of how the job goes on keeps this up to date, so that nothing is searched for.

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

    /// Whether a node counts on its own.
    pub(super) fn is_live(&self, node: NodeKey) -> bool {
        self.live.get(&node.first()) == Some(&node)
    }

    /// A node is kept from now on, and counts or not.
    pub(super) fn keep(&mut self, node: NodeKey, record: NodeRecord) {
        let live = record.live;
        self.all.insert(node, record);
        match live {
            true => self.live.insert(node.first(), node),
            false if self.is_live(node) => _ = self.live.remove(&node.first()),
            false => {}
        }
    }

    /// Takes a node that counts out of what nodes are found by; says whether it is `in_doubt`.
    pub(super) fn drop_live(&mut self, node: NodeKey, in_doubt: bool) {
        self.done -= node.leaves();
        self.unread.remove(&node.first());
        if in_doubt {
            let place = self.place_of_doubt(node);
            self.unrepeated.remove(&place);
            self.doubts.remove(&node.first());
        }
    }

    /// Puts a node that counts into what nodes are found by; says whether it is in doubt, and if so, whether it is
    /// repeated.
    pub(super) fn put_live(&mut self, node: NodeKey, repeated: Option<bool>) {
        self.done += node.leaves();
        self.unread.set(node.first(), self.all[&node].unread);
        if let Some(repeated) = repeated {
            self.doubts.insert(node.first(), node);
            let place = self.place_of_doubt(node);
            self.unrepeated.set(place, !repeated);
        }
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
        self.live.remove(&node.first());
    }
}
