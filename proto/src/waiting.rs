//! Why a job does not go on.

use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// What keeps a job from going on. One holds at a time: what has to end first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Waiting {
    /// The job is paused.
    Paused,
    /// Another job is to be done first.
    After,
    /// A disk that the coordinator needs is full.
    DiskFull,
    /// A store that the coordinator needs fails or does not answer.
    StoreAway,
    /// A file of the job's scene is missing on the farm, or was damaged: it has to be sent again.
    Scene,
    /// No worker is connected.
    NoWorker,
    /// No connected worker has the tags that the job asks for.
    Tags,
    /// No connected worker has the renderer that the job is bound to.
    Renderer,
    /// No connected worker that could do it otherwise has the memory that the job needs.
    Memory,
    /// Every worker that could do it is in quarantine or drained.
    Quarantine,
    /// Every worker that could do it rests, or is in quarantine or drained.
    Resting,
    /// Workers disagree about a node, and another one has to decide.
    Dispute,
    /// A node waits for another worker to confirm it.
    Doubt,
    /// An iteration that failed rests before it is tried again.
    Rest,
    /// There is work, and workers are at other jobs.
    Turn,
    /// Everything was delivered, and is being added up.
    Merging,
}

impl Waiting {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::Paused,
        Self::After,
        Self::DiskFull,
        Self::StoreAway,
        Self::Scene,
        Self::NoWorker,
        Self::Tags,
        Self::Renderer,
        Self::Memory,
        Self::Quarantine,
        Self::Resting,
        Self::Dispute,
        Self::Doubt,
        Self::Rest,
        Self::Turn,
        Self::Merging,
    ];
}

impl fmt::Display for Waiting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}
