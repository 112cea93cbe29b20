//! Memory of machines and of jobs, in mebibytes (2^20 bytes).

use crate::limits::LimitError;
use serde::{Deserialize, Serialize};

/// The most that is told of memory \[MiB\]: 16 TiB.
pub const MOST_MEMORY_MB: u32 = 1 << 24;

/// Checks an amount of memory; `field` names it in the error.
pub fn check_memory(memory_mb: u32, field: &str) -> Result<(), LimitError> {
    if (1..=MOST_MEMORY_MB).contains(&memory_mb) {
        return Ok(());
    }
    let reason = format!("{memory_mb} MiB of memory: it is from 1 to {MOST_MEMORY_MB}");
    Err(LimitError::invalid(field, reason))
}

/// Distance of the steps at an amount: a sixteenth of the power of two below it. What is measured is rounded to steps,
/// so that machines of a kind are alike in it, and so are jobs.
fn step(memory_mb: u32) -> u32 {
    1 << memory_mb.max(1).ilog2().saturating_sub(4)
}

/// The next step from an amount up \[MiB\].
#[must_use]
pub fn step_up(memory_mb: u32) -> u32 {
    let memory_mb = memory_mb.min(MOST_MEMORY_MB);
    memory_mb.next_multiple_of(step(memory_mb))
}

/// The next step from an amount down \[MiB\].
#[must_use]
pub fn step_down(memory_mb: u32) -> u32 {
    memory_mb - memory_mb % step(memory_mb)
}

/// What a worker's process had when it ran out of memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shortage {
    /// Memory that it held when that was looked at last \[MiB\].
    pub held_mb: Option<u32>,
    /// Memory that it had said it has \[MiB\].
    pub has_mb: Option<u32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_a_sixteenth_apart_and_keep_their_order() {
        assert_eq!([1, 15, 31].map(step_up), [1, 15, 31]);
        assert_eq!([33, 64, 65, 1000, 2049].map(step_up), [34, 64, 68, 1024, 2176]);
        assert_eq!([33, 64, 67, 1000, 2047].map(step_down), [32, 64, 64, 992, 1984]);
        for memory in 1..5000 {
            assert!(step_down(memory) <= memory && memory <= step_up(memory));
            assert!(step_up(memory) <= step_up(memory + 1) && step_down(memory) <= step_down(memory + 1));
            assert!(16 * (step_up(memory) - memory) <= memory, "{memory}");
        }
        assert_eq!([u32::MAX, MOST_MEMORY_MB].map(step_up), [MOST_MEMORY_MB; 2]);
    }

    #[test]
    fn amounts_that_no_machine_has_are_refused_by_their_field() {
        assert_eq!(check_memory(1, "a"), Ok(()));
        for bad in [0, MOST_MEMORY_MB + 1] {
            let error = check_memory(bad, "schedule.memory_mb").unwrap_err().to_string();
            assert!(
                error.contains("schedule.memory_mb") && error.contains("from 1 to"),
                "{error}"
            );
        }
    }
}
