//! When and where a job is worked on, and when it stops. Nothing here changes a bit of any iteration.

use crate::limits::LimitError;
use crate::memory::check_memory;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use utoipa::ToSchema;

/// Most tags of a job or a worker.
pub const TAGS: usize = 32;
/// Most bytes of a tag.
pub const TAG_BYTES: usize = 64;
/// Highest priority; the lowest is 1.
pub const HIGHEST_PRIORITY: u32 = 100;
/// Priority unless the job says otherwise.
pub const PRIORITY: u32 = 10;
/// The first checkpoint of a noise target is at two to this power iterations; the others are at twice the one before.
pub const FIRST_CHECKPOINT_LEVEL: u32 = 2;

/// How a job is scheduled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// Weight among the jobs of its owner, from 1 to 100; owners share the farm evenly.
    pub priority: u32,
    /// No new work is handed out; what is at work goes on to its end.
    pub paused: bool,
    /// When the job ends at the latest, with its complete iterations from the first on.
    #[serde(rename = "deadline", alias = "deadline_ms", with = "crate::time::option", default)]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub deadline_ms: Option<u64>,
    /// The job ends at the first of 4, 8, 16, ... iterations at which the noise is at most this: the mean of the pixels'
    /// standard errors of luminance over the mean luminance, without the hundredth of the pixels with the largest errors.
    pub noise_target: Option<f64>,
    /// Tags that a worker must have.
    pub tags: BTreeSet<String>,
    /// Memory that a worker must have (MiB), until the job's own was measured.
    #[schema(minimum = 1, maximum = 16_777_216)]
    pub memory_mb: Option<u32>,
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            priority: PRIORITY,
            paused: false,
            deadline_ms: None,
            noise_target: None,
            tags: BTreeSet::new(),
            memory_mb: None,
        }
    }
}

impl Schedule {
    /// Whether nothing is asked for but the usual.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Checks every field.
    pub fn check(&self) -> Result<(), LimitError> {
        check_priority(self.priority, "schedule.priority")?;
        if let Some(target) = self.noise_target
            && !(target > 0.0 && target.is_finite())
        {
            let reason = format!("{target} is no noise: it takes a positive number such as 0.01");
            return Err(LimitError::invalid("schedule.noise_target", reason));
        }
        if let Some(memory_mb) = self.memory_mb {
            check_memory(memory_mb, "schedule.memory_mb")?;
        }
        check_tags(&self.tags, "schedule.tags")
    }
}

/// Checks a priority; `field` names it in the error.
pub fn check_priority(priority: u32, field: &str) -> Result<(), LimitError> {
    if (1..=HIGHEST_PRIORITY).contains(&priority) {
        return Ok(());
    }
    let reason = format!("{priority} is no priority: it is from 1 to {HIGHEST_PRIORITY}");
    Err(LimitError::invalid(field, reason))
}

/// Checks tags: few, short, and of letters, digits and `. _ - = : /`; `field` names them in the error.
pub fn check_tags(tags: &BTreeSet<String>, field: &str) -> Result<(), LimitError> {
    if tags.len() > TAGS {
        let reason = format!("{} tags, more than {TAGS}", tags.len());
        return Err(LimitError::invalid(field, reason));
    }
    let allowed = |c: char| c.is_ascii_alphanumeric() || "._-=:/".contains(c);
    match tags
        .iter()
        .find(|tag| tag.is_empty() || tag.len() > TAG_BYTES || !tag.chars().all(allowed))
    {
        Some(bad) => {
            let reason = format!("{bad:?}: a tag has 1 to {TAG_BYTES} of the characters A-Z a-z 0-9 . _ - = : /");
            Err(LimitError::invalid(field, reason))
        }
        None => Ok(()),
    }
}

/// The noise after some iterations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Checkpoint {
    /// Iterations, from the first on, without a gap.
    pub iterations: u32,
    /// Mean of the pixels' standard errors of luminance over the mean luminance, without the hundredth of the pixels with the
    /// largest errors. Absent while all pixels are black: nothing was found yet.
    pub noise: Option<f64>,
}

impl fmt::Display for Checkpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let iterations = self.iterations;
        match self.noise {
            Some(noise) => write!(f, "noise is {noise:.4} at {iterations} iterations"),
            None => write!(f, "noise is unknown at {iterations} iterations: all is black so far"),
        }
    }
}

/// Why a job ended before its last iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum StopReason {
    /// The noise target was met.
    Noise,
    /// The deadline passed.
    Deadline,
}

/// A job that ended before its last iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Stop {
    /// Why.
    pub reason: StopReason,
    /// Iterations that had been asked for.
    pub asked: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl FnOnce(&mut Schedule)) -> String {
        let mut schedule = Schedule::default();
        assert_eq!(schedule.check(), Ok(()));
        change(&mut schedule);
        schedule.check().unwrap_err().to_string()
    }

    #[test]
    fn what_cannot_be_scheduled_is_refused_by_its_field() {
        assert!(refused(|s| s.priority = 0).contains("schedule.priority"));
        assert!(refused(|s| s.priority = 101).contains("1 to 100"));
        for target in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(refused(|s| s.noise_target = Some(target)).contains("schedule.noise_target"));
        }
        assert!(refused(|s| s.memory_mb = Some(0)).contains("schedule.memory_mb"));
        for tag in ["", "a b", "ü", &"x".repeat(65)] {
            assert!(refused(|s| _ = s.tags.insert(tag.into())).contains("schedule.tags"));
        }
        let many = (0..33).map(|i| i.to_string()).collect();
        assert!(refused(|s| s.tags = many).contains("33 tags"));
    }

    #[test]
    fn usual_tags_are_accepted() {
        let tags = ["gpu=no", "site:berlin", "linux/amd64", "big_memory", "v1.2-x"].map(str::to_owned);
        assert_eq!(check_tags(&tags.into(), "tags"), Ok(()));
    }
}
