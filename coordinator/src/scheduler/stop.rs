//! Jobs that end before their last iteration: at a noise target or at a deadline.
//!
//! A job stops by getting fewer iterations: those of a complete prefix. What lies beyond is left out, so that the image
//! is the one that a job of that many iterations gives, whoever did the work. The noise is tested at fixed prefixes
//! only, and each prefix is a node of the tree: it waits, unmerged, until it was looked at.

use super::record::{BlobName, Change, JobControl, Loss, Millis};
use super::{Decision, Farm, Job};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::schedule::{Checkpoint, FIRST_CHECKPOINT_LEVEL, Stop, StopReason};

impl Farm {
    /// The noise at a checkpoint was measured: the job goes on or stops. It goes on where the noise is unknown, since nothing
    /// was found yet.
    #[must_use]
    pub fn checkpoint(&self, job: JobId, node: NodeKey, noise: Option<f64>) -> Decision<()> {
        let due = self
            .jobs
            .get(&job)
            .filter(|job| job.due_checkpoint().is_some_and(|(due, _)| due == node));
        Decision::new((), due.map_or_else(Vec::new, |job| job.checkpoint(node, noise)))
    }
}

impl Job {
    /// The lowest level of a prefix that was not looked at.
    fn next_checkpoint_level(&self) -> u32 {
        let last = self.control.checkpoint.map(|checkpoint| checkpoint.iterations.ilog2());
        last.map_or(FIRST_CHECKPOINT_LEVEL, |level| level + 1)
    }

    /// Whether a node is a prefix at which the noise is to be tested.
    pub(super) fn is_checkpoint(&self, node: NodeKey) -> bool {
        let prefix = node.index == 0 && node.level >= self.next_checkpoint_level() && node.end() < self.leaves();
        prefix && self.control.schedule.noise_target.is_some()
    }

    /// The prefix whose noise is to be measured now.
    #[must_use]
    pub fn due_checkpoint(&self) -> Option<(NodeKey, BlobName)> {
        let (node, image) = self.live_images().next()?;
        let due = self.is_checkpoint(node) && node.level == self.next_checkpoint_level() && !self.is_in_doubt(node);
        due.then_some((node, image))
    }

    /// The highest level that a block may have which begins with the first leaf.
    pub(super) fn highest_first_level(&self) -> u32 {
        match self.control.schedule.noise_target {
            Some(_) => self.next_checkpoint_level(),
            None => NodeKey::MAX_LEVEL,
        }
    }

    fn checkpoint(&self, node: NodeKey, noise: Option<f64>) -> Vec<Change> {
        let iterations = node.end() as u32;
        let control = JobControl {
            checkpoint: Some(Checkpoint { iterations, noise }),
            ..self.control.clone()
        };
        let target = self.control.schedule.noise_target;
        match noise.zip(target) {
            Some((noise, target)) if noise <= target => self.stop(control, iterations, StopReason::Noise),
            _ => vec![Change::JobChanged {
                job: self.id(),
                control,
            }],
        }
    }

    /// Ends what goes on beyond the first `iterations`, which are complete, and leaves out what has arrived of it.
    fn stop(&self, control: JobControl, iterations: u32, reason: StopReason) -> Vec<Change> {
        let job = self.id();
        let asked = self.control.iterations;
        let loss = Loss::Left;
        let beyond = self
            .live_nodes()
            .filter(|(node, _)| node.first() >= u64::from(iterations));
        let mut changes: Vec<Change> = beyond.map(|(node, _)| Change::NodeLost { job, node, loss }).collect();
        let ended = self
            .leases
            .values()
            .filter(|lease| lease.record.node.end() > u64::from(iterations));
        changes.extend(ended.map(|lease| self.end_lease(lease.record.token)));
        let control = JobControl {
            iterations,
            stop: Some(Stop { reason, asked }),
            ..control
        };
        changes.push(Change::JobChanged { job, control });
        changes
    }

    /// Time until the deadline, if there is one.
    #[must_use]
    pub fn ms_left(&self, now: Millis) -> Option<Millis> {
        let deadline = self.control.schedule.deadline_ms;
        deadline.map(|deadline| deadline.saturating_sub(now))
    }

    /// Stops the job if its deadline has passed: with the iterations that are complete from the first on. Those of them
    /// that were to be repeated are accepted unverified, unless workers disagree about them.
    pub(super) fn meet_deadline(&self, now: Millis) -> Vec<Change> {
        if self.control.schedule.deadline_ms.is_none_or(|deadline| now < deadline) || self.control.stop.is_some() {
            return vec![];
        }
        let mut complete = 0;
        for (node, _) in self.live_nodes() {
            if node.first() != complete || self.is_disputed(node) {
                break;
            }
            complete = node.end();
        }
        let doubts = self.nodes_in_doubt().filter(|node| node.end() <= complete);
        let mut changes: Vec<Change> = doubts.flat_map(|node| self.accept(node)).collect();
        if complete == 0 {
            changes.push(Change::JobEnded {
                job: self.id(),
                state: JobState::Failed,
                failure: Some("the deadline passed before the first iteration was complete".into()),
                ended_ms: now,
            });
        } else if complete < self.leaves() {
            changes.extend(self.stop(self.control.clone(), complete as u32, StopReason::Deadline));
        }
        changes
    }
}
