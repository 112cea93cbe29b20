//! The time of the farm.

use crate::scheduler::record::Millis;
use crate::store::{StateStore, StoreError};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// Corrections backwards of up to so much make the clock stand still instead \[ms\].
const SMALL_STEP: u64 = 1000;

/// Longest measurement that is believed \[ms\].
const SLOWEST: Millis = 1000;

/// Milliseconds since 1970 by the clock that all coordinators of the farm share.
///
/// Between two measurements of that clock it follows one of this machine that nobody sets, and that goes on while the
/// machine is suspended. It never runs backwards, but where the shared clock was set back by more than a second.
#[derive(Debug)]
pub(super) struct Clock {
    /// What to add to the machine's steady clock.
    ahead: AtomicI64,
    /// The latest time that was told.
    told: AtomicU64,
    /// Time in which the machine was suspended, when that was last asked.
    suspended: AtomicI64,
}

/// Milliseconds by a clock that nobody sets and that counts the time of suspension as well.
#[cfg(target_os = "linux")]
fn steady_ms() -> i64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    time.tv_sec * 1000 + time.tv_nsec / 1_000_000
}

/// Milliseconds since its start in which the machine was suspended.
#[cfg(target_os = "linux")]
fn suspended_ms() -> i64 {
    let awake = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    steady_ms() - (awake.tv_sec * 1000 + awake.tv_nsec / 1_000_000)
}

/// Nothing is known of suspension.
#[cfg(not(target_os = "linux"))]
fn suspended_ms() -> i64 {
    0
}

/// Milliseconds by a clock that nobody sets.
#[cfg(not(target_os = "linux"))]
fn steady_ms() -> i64 {
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_millis() as i64
}

impl Clock {
    /// A clock that shows this machine's time.
    pub(super) fn new() -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            ahead: AtomicI64::new(since_1970.as_millis() as i64 - steady_ms()),
            told: AtomicU64::new(0),
            suspended: AtomicI64::new(suspended_ms()),
        }
    }

    /// The time.
    pub(super) fn now(&self) -> Millis {
        let now = steady_ms() + self.ahead.load(Ordering::Relaxed);
        let now = Millis::try_from(now).unwrap_or_default();
        now.max(self.told.fetch_max(now, Ordering::Relaxed))
    }

    /// How long the machine was suspended since this was last asked \[ms\].
    pub(super) fn suspended(&self) -> i64 {
        let now = suspended_ms();
        now - self.suspended.swap(now, Ordering::Relaxed)
    }

    /// The machine was suspended for so long.
    #[cfg(test)]
    pub(super) fn suspend(&self, ms: i64) {
        self.ahead.fetch_add(ms, Ordering::Relaxed);
        self.suspended.fetch_sub(ms, Ordering::Relaxed);
    }

    /// Measures the clock that all coordinators share, if there is one, and follows it. Returns by how much this one
    /// went ahead \[ms\].
    pub(super) async fn measure(&self, state: &dyn StateStore) -> Result<i64, StoreError> {
        let before = self.now();
        let shared = state.time_ms().await?;
        let after = self.now();
        Ok(match shared {
            // What took long tells little.
            Some(shared) if after - before <= SLOWEST => self.set(before, shared, after),
            _ => 0,
        })
    }

    /// Sets the clock by a measurement of the shared one, which was read between two readings of this one. Returns by
    /// how much it went ahead \[ms\].
    pub(super) fn set(&self, before: Millis, shared: Millis, after: Millis) -> i64 {
        let middle = before + (after - before) / 2;
        let step = shared as i64 - middle as i64;
        self.ahead.fetch_add(step, Ordering::Relaxed);
        if step < 0 && step.unsigned_abs() > SMALL_STEP {
            self.told.store(0, Ordering::Relaxed);
        }
        step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_follows_the_one_that_is_shared_and_does_not_run_backwards_for_a_trifle() {
        let clock = Clock::new();
        let began = clock.now();
        assert_eq!(clock.set(began, began + 7_200_000, began), 7_200_000);
        let later = clock.now();
        assert!(later >= began + 7_200_000);
        clock.set(later, later - 900, later);
        assert!(clock.now() >= later, "it stands still");
        assert_eq!(clock.set(later, later - 3_600_000, later), -3_600_000);
        assert!(clock.now() < later, "it was set back");
    }
}
