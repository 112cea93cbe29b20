//! How a job keeps its nodes: before one of them changes, or what it waits for, it is taken out of what nodes are found
//! by, and put there again afterwards.

use super::job::Job;
use super::record::NodeRecord;
use photonfarm_proto::node::NodeKey;

impl Job {
    /// A node is kept from now on, and counts or not.
    pub(super) fn keep_node(&mut self, node: NodeKey, record: NodeRecord) {
        self.drop_from_indexes(node);
        self.nodes.keep(node, record);
        self.put_into_indexes(node);
    }

    /// A node and all within it are forgotten.
    pub(super) fn forget_node(&mut self, node: NodeKey) {
        self.drop_from_indexes(node);
        self.nodes.forget(node);
        self.update_pair(node);
        self.free_within(node);
    }

    /// Before a node that counts changes, or what it waits for.
    pub(super) fn drop_from_indexes(&mut self, node: NodeKey) {
        if self.is_live(node) {
            self.nodes.drop_live(node, self.is_in_doubt(node));
        }
    }

    /// After a node changed, or what it waits for.
    pub(super) fn put_into_indexes(&mut self, node: NodeKey) {
        self.update_pair(node);
        if self.is_live(node) {
            let repeated = || self.repeated.on(node).next().is_some();
            self.nodes.put_live(node, self.is_in_doubt(node).then(repeated));
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
