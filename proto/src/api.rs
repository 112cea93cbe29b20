//! JSON messages of the public interface that are not types of their own.

use crate::id::{BlobHash, JobId, WorkerId};
use crate::job::{JobState, JobStatus};
use crate::limits::Limits;
use crate::rest::Resting;
use crate::token::Role;
use crate::waiting::Waiting;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// Header that makes the creation of a job repeatable: the same key and the same request give the same job.
pub const IDEMPOTENCY_KEY: &str = "idempotency-key";

/// Header of every answer: digits of the farm that gives it ([`FarmIdentity::farm`]), so that whoever asked for something there
/// notices when another farm answers.
pub const FARM: &str = "photonfarm-farm";

/// Name of the server-sent event that carries a [`JobStatus`] while the job goes on.
pub const EVENT_STATUS: &str = "status";

/// Name of the last server-sent event, which carries the final [`JobStatus`].
pub const EVENT_END: &str = "end";

/// Name of the server-sent events of a whole farm, which carry a [`FarmNews`].
pub const EVENT_FARM: &str = "farm";

/// Reply to a manifest: what to upload before a job can name the bundle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BundleReply {
    /// The bundle's name for jobs.
    pub bundle: BlobHash,
    /// Contents that the farm lacks.
    pub missing: Vec<BlobHash>,
}

/// Name of the header that says where a part of an upload begins [bytes from the start of the file].
pub const UPLOAD_OFFSET: &str = "upload-offset";

/// Name of the header that says whether the file ends with this part of it: `?1`, or `?0` if more is to come.
pub const UPLOAD_COMPLETE: &str = "upload-complete";

/// How far the upload of a file has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UploadState {
    /// Bytes that are kept: the upload goes on from here.
    pub offset: u64,
    /// The farm has the whole file from this upload.
    pub complete: bool,
}

/// Which farm it is, and how often it was restored.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FarmIdentity {
    /// Digits that no other farm has.
    pub farm: String,
    /// Rises whenever the farm is found to have been restored from a backup, or copied.
    pub epoch: u64,
}

/// A page of jobs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobPage {
    /// The jobs.
    pub jobs: Vec<JobStatus>,
    /// Value of `cursor` for the next page; absent on the last.
    pub next: Option<String>,
}

/// A state that jobs are listed by: that of the job, but that a job which goes on and is paused is `paused`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum ListedState {
    /// Nothing of it has been handed out.
    Queued,
    /// Workers are at it, or were.
    Running,
    /// It goes on, and nothing of it is handed out.
    Paused,
    /// Every iteration is in the image.
    Done,
    /// It ended without all of its iterations.
    Failed,
    /// It was cancelled.
    Cancelled,
}

impl ListedState {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 6] = [
        ("queued", Self::Queued),
        ("running", Self::Running),
        ("paused", Self::Paused),
        ("done", Self::Done),
        ("failed", Self::Failed),
        ("cancelled", Self::Cancelled),
    ];

    /// The state of a job.
    #[must_use]
    pub fn of(state: JobState, paused: bool) -> Self {
        match state {
            JobState::Queued | JobState::Running if paused => Self::Paused,
            JobState::Queued => Self::Queued,
            JobState::Running => Self::Running,
            JobState::Done => Self::Done,
            JobState::Failed => Self::Failed,
            JobState::Cancelled => Self::Cancelled,
        }
    }
}

/// A worker that was heard of lately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WorkerStatus {
    /// The worker.
    pub id: WorkerId,
    /// Its name for people.
    pub name: String,
    /// Threads it renders with.
    pub threads: u32,
    /// Name of its renderer.
    pub renderer: String,
    /// What it has: jobs may ask for it.
    #[serde(default)]
    pub tags: BTreeSet<String>,
    /// Memory that jobs may take of it, if it is known (MiB).
    #[serde(default)]
    pub memory_mb: Option<u32>,
    /// Name of the token that it registered with; empty without tokens.
    #[serde(default)]
    pub token: String,
    /// Address that it registered from; of IPv6 the network. Together with the token it tells who is behind the worker.
    #[serde(default)]
    pub machine: String,
    /// Nodes of its that another worker confirmed since one was last refuted.
    #[serde(default)]
    pub verified: u32,
    /// Faults that count against it: what it could not render but others could, and images that cannot be.
    #[serde(default)]
    pub faults: u32,
    /// Why it gets no work, if it is in quarantine.
    #[serde(default)]
    pub quarantine: Option<String>,
    /// Whether it is drained: it finishes what it holds and gets no more.
    #[serde(default)]
    pub drained: bool,
    /// Set while it takes no work of its own accord.
    #[serde(default)]
    pub rest: Option<Resting>,
    /// Time since it was last heard of (ms).
    pub silent_ms: u64,
    /// Leases it holds.
    pub leases: u32,
    /// The jobs that it is at work on.
    #[serde(default)]
    pub jobs: BTreeSet<JobId>,
    /// Its speed on these, lately; absent while it is at work on none, or none of theirs has arrived.
    #[serde(default)]
    pub iterations_per_second: Option<f64>,
}

/// The workers of the farm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WorkerList {
    /// The workers, oldest first.
    pub workers: Vec<WorkerStatus>,
}

/// What changed of a farm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FarmNews {
    /// Whether this is all that there is, and what was told before counts no more.
    pub whole: bool,
    /// Jobs that are new or changed.
    pub jobs: Vec<JobStatus>,
    /// Jobs that were deleted, or are no longer among the newest.
    pub gone: Vec<JobId>,
    /// All workers, if something changed.
    pub workers: Option<Vec<WorkerStatus>>,
    /// The farm in figures.
    #[serde(default)]
    pub figures: FarmFigures,
    /// What keeps the whole farm from going on.
    #[serde(default)]
    pub obstacles: Vec<Obstacle>,
}

/// A farm in figures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FarmFigures {
    /// Jobs of which nothing was handed out yet.
    pub jobs_queued: u64,
    /// Jobs of which work was handed out, and that have not ended.
    pub jobs_running: u64,
    /// Workers heard of lately.
    pub workers: u64,
    /// Those of them that hold leases.
    pub workers_at_work: u64,
    /// Iterations of all jobs that are not paused and that nobody has rendered yet.
    pub pending_iterations: u64,
    /// Iterations per second of wall-clock time of all workers, lately.
    pub iterations_per_second: f64,
    /// Bytes of the images and pictures of all jobs, as of ten seconds ago, or longer where counting takes long; absent until they were counted.
    #[serde(default)]
    pub job_bytes: Option<u64>,
    /// Room in the stores.
    #[serde(default)]
    pub stores: Vec<StoreRoom>,
}

/// Room in a part of the farm's stores. That of an object store or a database server is not known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StoreRoom {
    /// What is stored there: `state`, `images` or `scenes`.
    pub part: String,
    /// Bytes that its disk still takes, where that is known.
    #[serde(default)]
    pub free_bytes: Option<u64>,
    /// Bytes of its disk in all, where that is known.
    #[serde(default)]
    pub total_bytes: Option<u64>,
    /// Whether so little is left that somebody should see to it.
    #[serde(default)]
    pub low: bool,
}

impl StoreRoom {
    /// Room on a disk that is warned about (bytes).
    pub const WARNED: u64 = 10 << 30;
    /// Room on a disk that a farm does not work with for long (bytes).
    pub const WRONG: u64 = 1 << 30;

    /// A part of which free and all bytes are known, or not.
    #[must_use]
    pub fn new(part: &str, room: Option<[u64; 2]>) -> Self {
        Self {
            part: part.to_owned(),
            free_bytes: room.map(|[free, _]| free),
            total_bytes: room.map(|[_, total]| total),
            low: room.is_some_and(|[free, _]| free < Self::WARNED),
        }
    }
}

/// What happened to a job, oldest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobLog {
    /// What happened. Submission, attempts that failed and the end are kept for as long as the job is; the rest is what this
    /// coordinator remembers since its start, the latest of it.
    pub entries: Vec<JobLogEntry>,
}

/// Something that happened to a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobLogEntry {
    /// When.
    #[serde(rename = "at", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub at_ms: u64,
    /// What, for people.
    pub text: String,
}

/// Who the farm takes somebody for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Session {
    /// Name of the token; empty on a farm without tokens.
    pub name: String,
    /// What it allows.
    pub role: Role,
}

/// Asks for more iterations of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Extend {
    /// The number of iterations from now on; those that are done are not rendered again.
    pub iterations: u32,
}

/// Sets the priority of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SetPriority {
    /// Weight among the jobs of its owner, from 1 to 100.
    pub priority: u32,
}

/// Puts a worker into quarantine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Quarantine {
    /// Why, for people.
    pub reason: String,
}

/// What keeps the whole farm from going on, or from taking new jobs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Obstacle {
    /// What is affected: `state`, `images` or `scenes`.
    pub part: String,
    /// What is the matter.
    pub reason: Waiting,
    /// The same for people.
    pub detail: String,
}

/// How a coordinator is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// `ok`, or `failing` where there is an obstacle.
    pub status: String,
    /// What keeps the whole farm from going on.
    #[serde(default)]
    pub obstacles: Vec<Obstacle>,
    /// How many jobs nobody is at work on, by the reason, as of a few seconds ago.
    #[serde(default)]
    #[schema(value_type = Object)]
    pub waiting: BTreeMap<Waiting, u64>,
    /// Version of the coordinator, and of the renderer that it accepts.
    pub version: String,
    /// What the farm accepts.
    pub limits: Limits,
    /// Which farm it is.
    #[serde(default)]
    pub farm: FarmIdentity,
}
