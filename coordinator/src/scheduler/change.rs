//! Changes of the farm's state.

use super::record::{
    FailedAttempt, JobControl, JobHead, JobRecord, LeaseRecord, Millis, NodeRecord, Notice, Renewal, Standing,
    WorkerRecord,
};
use photonfarm_proto::id::{JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::JobState;
use photonfarm_proto::node::NodeKey;
use serde::{Deserialize, Serialize};

/// One change of the farm's state. A decision is a list of them; a store commits the list whole or not at all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Change {
    /// A worker introduced itself.
    WorkerRegistered(WorkerRecord),
    /// What is thought of a worker changed.
    WorkerJudged {
        /// The worker.
        worker: WorkerId,
        /// What is thought of it from now on.
        standing: Standing,
    },
    /// A worker was silent for long and holds nothing.
    WorkerForgotten(WorkerId),
    /// A job was submitted.
    JobSubmitted(Box<JobHead>),
    /// How a job goes on changed.
    JobChanged {
        /// The job.
        job: JobId,
        /// How it goes on.
        control: JobControl,
    },
    /// A job that had ended goes on.
    JobReopened {
        /// The job as it goes on.
        record: Box<JobRecord>,
        /// When it had ended. Nothing is committed if it ended at another time: somebody else was faster.
        ended_ms: Millis,
    },
    /// A job that had ended is deleted, with all that is kept of it.
    JobDeleted {
        /// The job.
        job: JobId,
        /// When it had ended. Nothing is committed if it ended at another time: somebody else was faster.
        ended_ms: Millis,
        /// Name of the token that it was submitted with: what it used of its quota stays used.
        owner: String,
        /// Iterations that it asked for.
        iterations: u32,
    },
    /// A lease was granted.
    LeaseGranted(LeaseRecord),
    /// A lease ended, for whichever reason.
    LeaseEnded {
        /// The job.
        job: JobId,
        /// The lease.
        token: LeaseToken,
    },
    /// Leases last until another time.
    LeasesRenewed(Vec<Renewal>),
    /// A node counts.
    NodeAdded {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
        /// What is kept of it.
        record: NodeRecord,
        /// The job's image size, fixed by its first node.
        resolution: [u32; 2],
    },
    /// What is kept of a node that counts changed.
    NodeJudged {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
        /// What is kept of it from now on.
        record: NodeRecord,
    },
    /// A node is part of a greater one now: it counts no more on its own, and what it took is forgotten.
    NodeMerged {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
    },
    /// A node counts no more. It and all nodes within it are forgotten.
    NodeLost {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
        /// Why.
        loss: Loss,
    },
    /// An attempt at a leaf failed.
    LeafFailed {
        /// The job.
        job: JobId,
        /// The leaf.
        leaf: u32,
        /// How it failed.
        attempt: FailedAttempt,
    },
    /// What failed so far of a job is forgotten: iterations that were given up are tried again.
    FailuresForgotten {
        /// The job.
        job: JobId,
    },
    /// The job ended; its leases with it.
    JobEnded {
        /// The job.
        job: JobId,
        /// Done, failed or cancelled.
        state: JobState,
        /// Why it failed.
        failure: Option<String>,
        /// When.
        ended_ms: Millis,
    },
    /// Somebody is to be told of what changed with it.
    NoticeAdded(Notice),
}

/// Why a node counts no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Loss {
    /// Its image is missing or damaged: its leaves are to be rendered again.
    Damaged,
    /// A worker in quarantine had a part in it: its leaves are to be rendered again.
    Untrusted,
    /// The job stopped before it.
    Left,
    /// A node that contains it was delivered whole.
    Replaced,
}
