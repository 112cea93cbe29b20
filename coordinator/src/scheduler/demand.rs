//! What jobs ask of workers.

use super::memory;
use super::record::{FailedAttempt, JobControl};
use super::table::Table;
use std::collections::BTreeSet;

/// What a job asks of its workers.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Demand {
    /// The renderer that it is bound to.
    pub(super) renderer: Option<String>,
    /// What they are to have.
    pub(super) tags: BTreeSet<String>,
    /// Memory that they are to have \[MiB\].
    pub(super) memory_mb: u32,
}

impl Demand {
    /// What a job asks that goes on like this and failed so far like that.
    pub(super) fn of(control: &JobControl, failures: &Table<u32, Vec<FailedAttempt>>) -> Self {
        Self {
            renderer: control.renderer.clone(),
            tags: control.schedule.tags.clone(),
            memory_mb: memory::needed(control, failures),
        }
    }

    /// Whether a worker with this renderer and these tags meets it.
    pub(super) fn is_met_by(&self, renderer: &str, tags: &BTreeSet<String>) -> bool {
        self.renderer.as_ref().is_none_or(|bound| bound == renderer) && self.tags.is_subset(tags)
    }
}
