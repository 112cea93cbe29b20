//! Which leases are on which leaves: blocks are nodes of the tree, so that those which share leaves with one either
//! contain it or lie within it.

use super::table::Table;
use photonfarm_proto::id::LeaseToken;
use photonfarm_proto::node::NodeKey;
use std::collections::BTreeSet;

/// Leases by their blocks.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Lent {
    /// By first leaf and level.
    blocks: Table<(u64, u32), BTreeSet<LeaseToken>>,
}

impl Lent {
    pub(super) fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    pub(super) fn insert(&mut self, block: NodeKey, token: LeaseToken) {
        self.blocks.get_or_default(place(block)).insert(token);
    }

    pub(super) fn remove(&mut self, block: NodeKey, token: LeaseToken) {
        let tokens = self.blocks.get_or_default(place(block));
        tokens.remove(&token);
        if tokens.is_empty() {
            self.blocks.remove(&place(block));
        }
    }

    /// All blocks, from left to right.
    pub(super) fn blocks(&self) -> impl Iterator<Item = NodeKey> + '_ {
        self.blocks.keys().map(|place| block(*place))
    }

    /// The leases on exactly this block.
    pub(super) fn on(&self, block: NodeKey) -> impl Iterator<Item = LeaseToken> + '_ {
        self.blocks.get(&place(block)).into_iter().flatten().copied()
    }

    /// The blocks that contain `node` or are it.
    pub(super) fn around(&self, node: NodeKey) -> impl Iterator<Item = NodeKey> + '_ {
        let above = (node.level..=NodeKey::MAX_LEVEL).map(move |level| NodeKey {
            level,
            index: (node.first() >> level) as u32,
        });
        above.filter(|block| self.blocks.contains_key(&place(*block)))
    }

    /// The blocks that lie within `node`, itself left out, from left to right.
    pub(super) fn inside(&self, node: NodeKey) -> impl Iterator<Item = NodeKey> + '_ {
        let range = self.blocks.range((node.first(), 0)..(node.end(), 0));
        let blocks = range.map(|(place, _)| block(*place));
        blocks.filter(move |block| block.level < node.level)
    }

    /// The leases whose blocks share leaves with `node`.
    pub(super) fn sharing(&self, node: NodeKey) -> impl Iterator<Item = LeaseToken> + '_ {
        let blocks = self.around(node).chain(self.inside(node));
        blocks.flat_map(|block| self.on(block))
    }
}

fn place(block: NodeKey) -> (u64, u32) {
    (block.first(), block.level)
}

fn block((first, level): (u64, u32)) -> NodeKey {
    NodeKey {
        level,
        index: (first >> level) as u32,
    }
}
