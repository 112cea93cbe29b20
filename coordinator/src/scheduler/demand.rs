//! What jobs ask of workers.

use super::record::JobControl;
use std::collections::BTreeSet;

/// What a job asks of its workers.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Demand {
    /// The renderer that it is bound to.
    pub(super) renderer: Option<String>,
    /// What they are to have.
    pub(super) tags: BTreeSet<String>,
}

impl Demand {
    /// What a job asks that goes on like this.
    pub(super) fn of(control: &JobControl) -> Self {
        Self {
            renderer: control.renderer.clone(),
            tags: control.schedule.tags.clone(),
        }
    }

    /// Whether a worker with this renderer and these tags meets it.
    pub(super) fn is_met_by(&self, renderer: &str, tags: &BTreeSet<String>) -> bool {
        self.renderer.as_ref().is_none_or(|bound| bound == renderer) && self.tags.is_subset(tags)
    }
}
