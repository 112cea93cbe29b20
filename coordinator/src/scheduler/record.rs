//! What is kept: changes to the farm's state, and the records that they leave.

use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, JobSpec, JobState, Totals};
use photonfarm_proto::node::NodeKey;

/// Time in milliseconds since 1970, UTC; never runs backwards within a process.
pub type Millis = u64;

/// One change of the farm's state. A decision is a list of them; a store commits the list whole or not at all.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// A worker introduced itself.
    WorkerRegistered(WorkerRecord),
    /// A worker was silent for long and holds nothing.
    WorkerForgotten(WorkerId),
    /// A job was submitted.
    JobSubmitted(JobHead),
    /// A lease was granted.
    LeaseGranted(LeaseRecord),
    /// A lease ended, for whichever reason.
    LeaseEnded {
        /// The job.
        job: JobId,
        /// The lease.
        token: LeaseToken,
    },
    /// A node counts.
    NodeAdded {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
        /// Hash of its image.
        digest: BlobHash,
        /// The job's image size, fixed by its first node.
        resolution: [u32; 2],
        /// The job's totals from now on.
        totals: Totals,
    },
    /// A node is part of a greater one now: it counts no more on its own.
    NodeMerged {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
    },
    /// The image of a node is missing or damaged: its leaves are to be rendered again.
    NodeLost {
        /// The job.
        job: JobId,
        /// The node.
        node: NodeKey,
    },
    /// An attempt at a leaf failed.
    LeafFailed {
        /// The job.
        job: JobId,
        /// The leaf.
        leaf: u32,
        /// How it failed.
        attempt: Attempt,
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
}

/// A worker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerRecord {
    /// The worker.
    pub id: WorkerId,
    /// Its name for people.
    pub name: String,
    /// Threads it renders with.
    pub threads: u32,
    /// Version of its renderer.
    pub renderer: String,
}

/// What of a job never changes.
#[derive(Clone, Debug, PartialEq)]
pub struct JobHead {
    /// The job.
    pub id: JobId,
    /// What is asked for.
    pub spec: JobSpec,
    /// Name of the token that it was submitted with; empty where the farm asked for none.
    pub owner: String,
    /// Idempotency key of the submission.
    pub key: Option<String>,
    /// When it was submitted.
    pub created_ms: Millis,
}

/// A lease.
#[derive(Clone, Debug, PartialEq)]
pub struct LeaseRecord {
    /// Fencing token.
    pub token: LeaseToken,
    /// The job.
    pub job: JobId,
    /// The block of leaves.
    pub node: NodeKey,
    /// The worker.
    pub worker: WorkerId,
    /// Counts the leases of these leaves, from 1.
    pub attempt: u32,
    /// When it was granted.
    pub granted_ms: Millis,
    /// How long it should take.
    pub expected_ms: Option<Millis>,
}

/// A node that was counted once, and perhaps still is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeRecord {
    /// Hash of its image.
    pub digest: BlobHash,
    /// Whether it counts on its own: not part of a greater node.
    pub live: bool,
}

/// All that is kept of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobRecord {
    /// What never changes.
    pub head: JobHead,
    /// Where it stands.
    pub state: JobState,
    /// Why it failed.
    pub failure: Option<String>,
    /// When it ended.
    pub ended_ms: Option<Millis>,
    /// Image size, once known.
    pub resolution: Option<[u32; 2]>,
    /// What the iterations in the image took.
    pub totals: Totals,
    /// Nodes that were counted.
    pub nodes: Vec<(NodeKey, NodeRecord)>,
    /// Leases held.
    pub leases: Vec<LeaseRecord>,
    /// Failed attempts by leaf, in their order.
    pub failures: Vec<(u32, Attempt)>,
}

/// The farm as it was left: what a restart begins with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// The numbers to give next.
    pub counters: Counters,
    /// Workers.
    pub workers: Vec<WorkerRecord>,
    /// Jobs that have not ended.
    pub jobs: Vec<JobRecord>,
}

/// The highest numbers given so far. They never fall, so that a token or an id is never used twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Highest job.
    pub job: u64,
    /// Highest worker.
    pub worker: u64,
    /// Highest fencing token.
    pub token: u64,
}
