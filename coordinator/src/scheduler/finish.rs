//! Siblings become their parent; images are read; a job ends.

use super::SchedulerConfig;
use super::job::Job;
use super::record::{Change, Loss, Millis, NodeRecord};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::job::{Attempt, FailureKind, JobState, Totals};
use photonfarm_proto::node::NodeKey;

impl Job {
    /// The leftmost two siblings that both count: their parent is to be made.
    #[must_use]
    pub fn next_merge(&self) -> Option<NodeKey> {
        let waits = |node: NodeKey| self.is_in_doubt(node) || self.is_checkpoint(node);
        let ready = |left: &&NodeKey| {
            let right = left.sibling();
            left.index.is_multiple_of(2) && self.is_live(right) && !waits(**left) && !waits(right)
        };
        self.live.values().find(ready).map(|left| left.parent())
    }

    /// Replaces two siblings by their parent; `None` if they are not both there any more.
    #[must_use]
    pub fn merge(&self, parent: NodeKey, digest: BlobHash) -> Option<Vec<Change>> {
        let children = parent.children()?;
        let stay = |child: &NodeKey| !self.is_live(*child) || self.is_in_doubt(*child) || self.is_checkpoint(*child);
        if self.state.ended() || children.iter().any(stay) {
            return None;
        }
        let job = self.id();
        let mut changes: Vec<Change> = children.map(|node| Change::NodeMerged { job, node }).into();
        let mut totals: Option<Totals> = None;
        for took in children.iter().filter_map(|child| self.nodes[child].totals.as_ref()) {
            totals.get_or_insert_default().add(took);
        }
        changes.push(Change::NodeAdded {
            job,
            node: parent,
            record: NodeRecord {
                totals,
                ..NodeRecord::new(digest)
            },
            resolution: self.resolution?,
        });
        Some(changes)
    }

    /// The leftmost node of the image that no coordinator has read yet.
    #[must_use]
    pub fn next_unread(&self) -> Option<(NodeKey, BlobHash)> {
        let mut live = self.live.values().map(|key| (*key, &self.nodes[key]));
        live.find(|(_, record)| record.unread)
            .map(|(key, record)| (key, record.digest))
    }

    /// The image of a node was read, and is what it should be.
    #[must_use]
    pub fn check(&self, node: NodeKey) -> Option<Change> {
        let record = self.nodes.get(&node).filter(|record| record.live && record.unread)?;
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
        let record = &self.nodes[&node];
        if let (Some(worker), true, Ok(leaf)) = (record.worker, record.unread, u32::try_from(node.first())) {
            let attempt = Attempt {
                worker,
                kind: FailureKind::Render,
                message: format!("worker {worker} delivered node {node}, but {reason}"),
                at_ms: now,
            };
            changes.push(Change::LeafFailed { job, leaf, attempt });
        }
        changes
    }

    /// Ends the job once every leaf is in the tree's shape in the image, read by a coordinator, or given up.
    #[must_use]
    pub fn settle(&self, config: &SchedulerConfig, now: Millis) -> Option<Change> {
        if self.state.ended() || self.next_merge().is_some() || self.next_unread().is_some() {
            return None;
        }
        if self.nodes_in_doubt().next().is_some() || self.due_checkpoint().is_some() {
            return None;
        }
        let poisoned: Vec<_> = self.poisoned(config).collect();
        let leased = |leaf: u32| {
            self.leases
                .values()
                .any(|lease| lease.record.node.contains(NodeKey::leaf(leaf)))
        };
        if self.done() + poisoned.len() as u64 != self.leaves() || poisoned.iter().any(|(leaf, _)| leased(*leaf)) {
            return None;
        }
        let failure = poisoned.first().map(|(leaf, attempts)| {
            let reason = attempts.last().map_or("", |attempt| attempt.message.as_str());
            let (count, of) = (poisoned.len(), self.leaves());
            format!(
                "{count} of {of} iterations could not be rendered; iteration {}: {reason}",
                leaf + 1
            )
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
