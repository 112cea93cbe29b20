//! Nodes become one; images are read; a job ends.

use super::job::Job;
use super::record::{BlobName, Change, FailedAttempt, Loss, Millis, NodeRecord};
use photonfarm_proto::job::{Attempt, FailureKind, JobState, Totals};
use photonfarm_proto::node::NodeKey;

/// Most nodes that become one at a time. The more, the fewer times an image is written and read again where nodes arrive
/// faster than they are merged.
const MERGED_AT_ONCE: usize = 8;

impl Job {
    /// The node that is to be made next: of the leftmost two siblings that both count, and of as many of the nodes about
    /// them as are there and make up a node with them.
    #[must_use]
    pub fn next_merge(&self) -> Option<NodeKey> {
        let ready = |node: &NodeKey| self.parts(*node).is_some();
        let ((first, level), ()) = self.nodes.pairs.first()?;
        let mut node = NodeKey {
            level: *level,
            index: (first >> level) as u32,
        };
        while ready(&node.parent()) {
            node = node.parent();
        }
        Some(node)
    }

    /// The nodes of the image that make up another one, from left to right; `None` if leaves of it are missing, or wait.
    #[must_use]
    pub fn parts(&self, node: NodeKey) -> Option<Vec<NodeKey>> {
        let mut parts = Vec::new();
        (node.fits(self.control.iterations) && self.add_parts_below(node, &mut parts)).then_some(parts)
    }

    fn add_parts_below(&self, node: NodeKey, parts: &mut Vec<NodeKey>) -> bool {
        node.children().is_some_and(|children| {
            children.into_iter().all(|child| {
                if self.waits(child) || parts.len() == MERGED_AT_ONCE {
                    return false;
                }
                if self.is_live(child) {
                    parts.push(child);
                    return true;
                }
                self.add_parts_below(child, parts)
            })
        })
    }

    /// Whether a node is not to be merged yet: others are to repeat it, or its noise is to be measured.
    pub(super) fn waits(&self, node: NodeKey) -> bool {
        self.is_in_doubt(node) || self.is_checkpoint(node)
    }

    /// Replaces the parts of a node by the node; `None` if they are not all there any more.
    #[must_use]
    pub fn merge(&self, node: NodeKey, image: BlobName) -> Option<Vec<Change>> {
        let parts = self.parts(node).filter(|_| !self.state.ended())?;
        let job = self.id();
        let mut totals: Option<Totals> = None;
        for took in parts.iter().filter_map(|part| self.nodes.all[part].totals.as_ref()) {
            totals.get_or_insert_default().add(took);
        }
        let mut changes: Vec<Change> = parts.into_iter().map(|node| Change::NodeMerged { job, node }).collect();
        changes.push(Change::NodeAdded {
            job,
            node,
            record: NodeRecord {
                totals,
                ..NodeRecord::new(image)
            },
            resolution: self.resolution?,
        });
        Some(changes)
    }

    /// The leftmost node of the image that no coordinator has read yet.
    #[must_use]
    pub fn next_unread(&self) -> Option<(NodeKey, BlobName)> {
        let (first, ()) = self.nodes.unread.first()?;
        let node = self.nodes.live[first];
        Some((node, self.nodes.all[&node].image()))
    }

    /// The image of a node was read, and is what it should be.
    #[must_use]
    pub fn check(&self, node: NodeKey) -> Option<Change> {
        let record = self
            .nodes
            .all
            .get(&node)
            .filter(|record| record.live && record.unread)?;
        Some(Change::NodeJudged {
            job: self.id(),
            node,
            record: NodeRecord {
                unread: false,
                ..record.clone()
            },
        })
    }

    /// Gives up a node whose image is missing or damaged. If it never was as its worker said, that is the worker's
    /// failure.
    #[must_use]
    pub fn lose(&self, node: NodeKey, reason: &str, now: Millis) -> Vec<Change> {
        let (job, loss) = (self.id(), Loss::Damaged);
        if !self.is_live(node) || self.state.ended() {
            return Vec::new();
        }
        let mut changes = vec![Change::NodeLost { job, node, loss }];
        let record = &self.nodes.all[&node];
        if let (Some(worker), true, Ok(leaf)) = (record.worker, record.unread, u32::try_from(node.first())) {
            let attempt = Attempt {
                worker,
                kind: FailureKind::Render,
                message: format!("worker {worker} delivered node {node}, but {reason}"),
                at_ms: now,
            };
            let attempt = FailedAttempt {
                attempt,
                principal: record.principal,
                repeated: false,
                memory_mb: None,
            };
            changes.push(Change::LeafFailed { job, leaf, attempt });
        }
        changes
    }

    /// Whether there is something to add up, to measure or to read, or the job may be complete.
    pub(super) fn is_to_be_folded(&self) -> bool {
        let complete = self.done() + self.given_up.len() as u64 >= self.leaves();
        let broken = self.is_chain() && !self.given_up.is_empty();
        let waits = !self.nodes.pairs.is_empty() || !self.nodes.unread.is_empty();
        waits || complete || broken || self.due_checkpoint().is_some()
    }

    /// Ends the job once every leaf is in the tree's shape in the image, read by a coordinator, or given up.
    #[must_use]
    pub fn settle(&self, now: Millis) -> Option<Change> {
        if self.state.ended() || !self.is_to_be_folded() || self.next_merge().is_some() || self.next_unread().is_some()
        {
            return None;
        }
        if self.nodes_in_doubt().any(|node| self.can_be_repeated(node)) || self.due_checkpoint().is_some() {
            return None;
        }
        let broken = self.broken_link();
        let given_up: Vec<_> = match broken {
            Some(link) => vec![link],
            None => self.given_up().collect(),
        };
        let leased = |leaf: u32| self.lent.around(NodeKey::leaf(leaf)).next().is_some();
        let reached = broken.is_some() || self.done() + given_up.len() as u64 == self.leaves();
        if !reached || given_up.iter().any(|(leaf, _)| leased(*leaf)) {
            return None;
        }
        let failure = given_up.first().map(|(leaf, attempts)| {
            let reason = attempts.last().map_or("", |failed| failed.attempt.message.as_str());
            let (count, of, iteration) = (given_up.len(), self.leaves(), leaf + 1);
            match self.is_chain() {
                true => {
                    format!("iteration {iteration} could not be rendered, and those after it go on from it: {reason}")
                }
                false => format!("{count} of {of} iterations could not be rendered; iteration {iteration}: {reason}"),
            }
        });
        let state = if failure.is_some() {
            JobState::Failed
        } else {
            JobState::Done
        };
        Some(Change::JobEnded {
            job: self.id(),
            state,
            failure,
            ended_ms: now,
        })
    }
}
