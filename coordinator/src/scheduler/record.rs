//! What is kept of the farm's state: the records that its changes leave.

pub use super::change::{Change, Loss};

use photonfarm_core::picture::SceneFacts;
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_proto::id::{BlobHash, HashError, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, JobSpec, JobState, Totals};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::rest::Resting;
use photonfarm_proto::schedule::{Checkpoint, Schedule, Stop};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Time in milliseconds since 1970, UTC; never runs backwards within a process.
pub type Millis = u64;

/// Who is behind a worker, as far as the coordinator can tell: what several workers of one principal say counts once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Principal(pub u64);

/// Where a worker registered from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Origin {
    /// Name of the token that it showed; empty where the farm asks for none.
    pub token: String,
    /// The address that it came from: of IPv6, the network.
    pub machine: String,
}

impl Origin {
    /// Who is behind a worker of this name: the bearer of the token at this machine. A farm without tokens is used from its own
    /// machine only, so that names tell its workers apart.
    #[must_use]
    pub fn principal(&self, name: &str) -> Principal {
        let second = if self.token.is_empty() { name } else { &self.machine };
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(self.token.len() as u64).to_le_bytes());
        hasher.update(self.token.as_bytes()).update(second.as_bytes());
        let mut number = [0; 8];
        hasher.finalize_xof().fill(&mut number);
        Principal(u64::from_le_bytes(number))
    }
}

/// An attempt at a leaf that failed, and who is behind it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailedAttempt {
    /// What is shown of it.
    #[serde(flatten)]
    pub attempt: Attempt,
    /// Who is behind its worker.
    #[serde(default)]
    pub principal: Principal,
    /// Whether the same principal had failed at the leaf before, while others were there to try: it does not count again.
    #[serde(default)]
    pub repeated: bool,
    /// Of a worker that ran out of memory: the memory that it has, if that is known \[MiB\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_mb: Option<u32>,
}

/// A worker.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerRecord {
    /// The worker.
    pub id: WorkerId,
    /// Its name for people.
    pub name: String,
    /// Threads it renders with.
    pub threads: u32,
    /// Name of its renderer.
    pub renderer: String,
    /// What it has.
    #[serde(default)]
    pub tags: BTreeSet<String>,
    /// Memory that jobs may take of it, if it is known \[MiB\].
    #[serde(default)]
    pub memory_mb: Option<u32>,
    /// Where it registered from.
    #[serde(default)]
    pub origin: Origin,
    /// What is thought of it.
    #[serde(default)]
    pub standing: Standing,
}

impl WorkerRecord {
    /// Who is behind it.
    #[must_use]
    pub fn principal(&self) -> Principal {
        self.origin.principal(&self.name)
    }

    /// Whether quarantine of one holds for the other: it holds for a name, as used with one token.
    #[must_use]
    pub fn is_namesake(&self, other: &Self) -> bool {
        self.name == other.name && self.origin.token == other.origin.token
    }
}

/// What is thought of a worker.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Standing {
    /// Nodes of its that another worker confirmed since one was last refuted.
    pub verified: u32,
    /// Faults since then.
    pub faults: u32,
    /// Why it gets no work.
    pub quarantine: Option<String>,
    /// Whether somebody wants it to finish what it holds and get no more.
    pub drained: bool,
    /// Set while it takes no work of its own accord.
    pub rest: Option<Resting>,
}

/// What of a job never changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

/// How a job goes on: what of it can be steered, and what was found out on the way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobControl {
    /// Iterations to average.
    pub iterations: u32,
    /// When and where it is worked on.
    pub schedule: Schedule,
    /// The renderer that it is bound to.
    #[serde(default)]
    pub renderer: Option<String>,
    /// The last checkpoint that was looked at.
    #[serde(default)]
    pub checkpoint: Option<Checkpoint>,
    /// Set once it stopped before its last iteration.
    #[serde(default)]
    pub stop: Option<Stop>,
    /// All settings, as the scene decided over those that the job leaves to it.
    #[serde(default)]
    pub integrator: Option<IntegratorSettings>,
    /// What the scene was warned about.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// What the picture's file says of the scene.
    #[serde(default, skip_serializing_if = "SceneFacts::is_empty")]
    pub facts: SceneFacts,
    /// The job that is to be done first, until it is.
    #[serde(default)]
    pub after: Option<JobId>,
    /// Most memory that a worker was measured to hold while it worked on it \[MiB\].
    #[serde(default)]
    pub memory_mb: Option<u32>,
}

impl JobControl {
    /// As the job was submitted.
    #[must_use]
    pub fn of(spec: &JobSpec) -> Self {
        Self {
            iterations: spec.iterations,
            schedule: spec.schedule.clone(),
            renderer: None,
            checkpoint: None,
            stop: None,
            integrator: None,
            warnings: Vec::new(),
            facts: SceneFacts::default(),
            after: spec.after,
            memory_mb: None,
        }
    }
}

/// A lease.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeaseRecord {
    /// Fencing token.
    pub token: LeaseToken,
    /// The job.
    pub job: JobId,
    /// The block of leaves.
    pub node: NodeKey,
    /// The worker.
    pub worker: WorkerId,
    /// Which of its worker's requests it was granted to.
    #[serde(default)]
    pub serial: u64,
    /// Counts the leases of these leaves, from 1.
    pub attempt: u32,
    /// When it was granted.
    pub granted_ms: Millis,
    /// How long it should take.
    pub expected_ms: Option<Millis>,
    /// Whether a node that counts is to be rendered once more, to be compared.
    #[serde(default)]
    pub verifies: bool,
    /// What the job has had of the farm before this lease and with it [weighted ms].
    #[serde(default)]
    pub share: [Millis; 2],
    /// When it ends unless renewed; of use only while nobody remembers a heartbeat.
    #[serde(default)]
    pub until_ms: Millis,
    /// Starts of the coordinator since the last heartbeat.
    #[serde(default)]
    pub restarts: u32,
}

/// A lease lasts until another time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Renewal {
    /// The job.
    pub job: JobId,
    /// The lease.
    pub token: LeaseToken,
    /// When it ends unless renewed.
    pub until_ms: Millis,
    /// Starts of the coordinator since the last heartbeat.
    pub restarts: u32,
}

/// The name of bytes in a store: their hash, and which copy of them it is.
///
/// Every upload and every merge of a node's image makes a copy with a number of its own. So a name is never used twice,
/// and whoever removes what no row names any more can never remove what somebody else has just published. Files of
/// scenes have the one copy 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BlobName {
    /// Hash of the bytes.
    pub hash: BlobHash,
    /// Which copy.
    pub copy: u64,
}

impl From<BlobHash> for BlobName {
    fn from(hash: BlobHash) -> Self {
        Self { hash, copy: 0 }
    }
}

impl std::fmt::Display for BlobName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.copy {
            0 => self.hash.fmt(f),
            copy => write!(f, "{}-{copy:016x}", self.hash),
        }
    }
}

impl std::str::FromStr for BlobName {
    type Err = HashError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let Some((hash, copy)) = text.split_once('-') else {
            return Ok(text.parse::<BlobHash>()?.into());
        };
        let name = Self {
            hash: hash.parse()?,
            copy: u64::from_str_radix(copy, 16).unwrap_or_default(),
        };
        // A name is written in one way only.
        if name.to_string() == text {
            Ok(name)
        } else {
            Err(HashError)
        }
    }
}

/// A node that counts, or is part of one that does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NodeRecord {
    /// Hash of its image.
    pub digest: BlobHash,
    /// Which copy of its image the store keeps.
    #[serde(default)]
    pub copy: u64,
    /// Whether it counts on its own: not part of a greater node.
    pub live: bool,
    /// Who delivered it; nobody if it was merged from others.
    #[serde(default)]
    pub worker: Option<WorkerId>,
    /// Who is behind that worker.
    #[serde(default)]
    pub principal: Principal,
    /// Whether two principals gave the same bits.
    #[serde(default)]
    pub verified: bool,
    /// While it is to be repeated by others: the results so far, the first one that which counts.
    #[serde(default)]
    pub opinions: Vec<Opinion>,
    /// What it took; unknown once it was merged.
    #[serde(default)]
    pub totals: Option<Totals>,
    /// Whether its worker stored the image and no coordinator has read it yet: the digest is what the worker says.
    #[serde(default)]
    pub unread: bool,
}

impl NodeRecord {
    /// A node of which nothing but its image is known.
    #[must_use]
    pub fn new(image: impl Into<BlobName>) -> Self {
        let image = image.into();
        Self {
            digest: image.hash,
            copy: image.copy,
            live: true,
            worker: None,
            principal: Principal::default(),
            verified: false,
            opinions: Vec::new(),
            totals: None,
            unread: false,
        }
    }

    /// The name of its image in the store.
    #[must_use]
    pub fn image(&self) -> BlobName {
        BlobName {
            hash: self.digest,
            copy: self.copy,
        }
    }
}

/// A result for a node that is in doubt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Opinion {
    /// Whose.
    pub worker: WorkerId,
    /// Who is behind that worker.
    #[serde(default)]
    pub principal: Principal,
    /// Hash of the image.
    pub digest: BlobHash,
}

/// All that is kept of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRecord {
    /// What never changes.
    pub head: JobHead,
    /// How it goes on.
    pub control: JobControl,
    /// What it has had of the farm [weighted ms].
    pub share_ms: Millis,
    /// Where it stands.
    pub state: JobState,
    /// Why it failed.
    pub failure: Option<String>,
    /// When it ended.
    pub ended_ms: Option<Millis>,
    /// Image size, once known.
    pub resolution: Option<[u32; 2]>,
    /// What nodes took that do not know it themselves: none, but in farms of the first version.
    pub totals: Totals,
    /// Nodes that count, and what they were merged from.
    pub nodes: Vec<(NodeKey, NodeRecord)>,
    /// Leases held.
    pub leases: Vec<LeaseRecord>,
    /// Failed attempts by leaf, in their order.
    pub failures: Vec<(u32, FailedAttempt)>,
}

/// The farm as it was left: what a restart begins with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The numbers to give next.
    pub counters: Counters,
    /// Workers.
    pub workers: Vec<WorkerRecord>,
    /// Jobs that have not ended.
    pub jobs: Vec<JobRecord>,
}

/// The highest numbers given so far. They never fall, so that a token or an id is never used twice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Highest job.
    pub job: u64,
    /// Highest worker.
    pub worker: u64,
    /// Highest fencing token.
    pub token: u64,
    /// What the job served last had had of the farm [weighted ms].
    #[serde(default)]
    pub share: Millis,
}

/// Something that a URL is to be told once. It is part of the commit that makes it true.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notice {
    /// Names the delivery. Names of later notices are greater.
    pub id: String,
    /// The job that it is about.
    pub job: JobId,
    /// Where it goes.
    pub url: String,
    /// Whether the operator of the farm has named the URL, and not who submitted the job.
    pub trusted: bool,
    /// What is sent, the same at every attempt.
    pub body: String,
    /// When it was made.
    pub created_ms: Millis,
}
