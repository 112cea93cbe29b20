//! JSON messages of the public interface that are not types of their own.

use crate::id::{BlobHash, WorkerId};
use crate::job::JobStatus;
use crate::limits::Limits;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Header that makes the creation of a job repeatable: the same key and the same request give the same job.
pub const IDEMPOTENCY_KEY: &str = "idempotency-key";

/// Name of the server-sent event that carries a [`JobStatus`] while the job goes on.
pub const EVENT_STATUS: &str = "status";

/// Name of the last server-sent event, which carries the final [`JobStatus`].
pub const EVENT_END: &str = "end";

/// Reply to a manifest: what to upload before a job can name the bundle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BundleReply {
    /// The bundle's name for jobs.
    pub bundle: BlobHash,
    /// Contents that the farm lacks.
    pub missing: Vec<BlobHash>,
}

/// A page of jobs, newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobPage {
    /// The jobs.
    pub jobs: Vec<JobStatus>,
    /// Value of `cursor` for the next page; absent on the last.
    pub next: Option<String>,
}

/// A worker that was heard of lately.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WorkerStatus {
    /// The worker.
    pub id: WorkerId,
    /// Its name for people.
    pub name: String,
    /// Threads it renders with.
    pub threads: u32,
    /// Version of its renderer.
    pub renderer: String,
    /// Time since it was last heard of [ms].
    pub silent_ms: u64,
    /// Leases it holds.
    pub leases: u32,
}

/// The workers of the farm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct WorkerList {
    /// The workers, oldest first.
    pub workers: Vec<WorkerStatus>,
}

/// Reply of a healthy coordinator.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// `ok`.
    pub status: String,
    /// Version of the coordinator, and of the renderer that it accepts.
    pub version: String,
    /// What the farm accepts.
    pub limits: Limits,
}
