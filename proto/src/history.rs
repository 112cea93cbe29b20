//! What has happened to a job, for people who look at it: JSON messages of the public interface.

use crate::id::WorkerId;
use crate::job::Poisoned;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What has happened to a job, as far as the coordinator that answers has seen it since its start. It is kept in memory, and bounded:
/// of samples every second one goes when there are too many, of leases the oldest.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobHistory {
    /// How many iterations were in the image, and when.
    pub progress: Vec<ProgressSample>,
    /// The noise whenever it was measured: at checkpoints, and when somebody looked at the picture.
    pub noise: Vec<NoiseSample>,
    /// The latest leases, oldest first.
    pub leases: Vec<LeaseSpan>,
    /// Iterations at which attempts failed, all of them; these are kept with the job.
    pub failures: Vec<Poisoned>,
}

/// So many iterations were in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ProgressSample {
    /// When.
    #[serde(rename = "at", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub at_ms: u64,
    /// Iterations in the image.
    pub iterations: u64,
}

/// The image had so much noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct NoiseSample {
    /// When it was measured.
    #[serde(rename = "at", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub at_ms: u64,
    /// Iterations in that image.
    pub iterations: u64,
    /// Mean standard error of the pixels over mean luminance.
    pub noise: f64,
}

/// A lease, from when it was granted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LeaseSpan {
    /// Who held it.
    pub worker: WorkerId,
    /// Its name for people.
    pub name: String,
    /// The first of its iterations, from 1.
    pub first: u32,
    /// The last of them.
    pub last: u32,
    /// Counts the leases of these iterations, from 1.
    pub attempt: u32,
    /// Whether it repeats what others have rendered.
    pub verifies: bool,
    /// When it was granted.
    #[serde(rename = "from", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub from_ms: u64,
    /// When it ended; absent while it is held.
    #[serde(rename = "to", with = "crate::time::option", default)]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub to_ms: Option<u64>,
    /// What became of it.
    pub outcome: LeaseOutcome,
}

/// What became of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum LeaseOutcome {
    /// It is held.
    Held,
    /// All of its iterations arrived, from its worker or from others.
    Delivered,
    /// Its worker reported a failure.
    Failed,
    /// Its worker was heard of no more.
    Lost,
    /// It was given back or taken away, without blame.
    Ended,
}
