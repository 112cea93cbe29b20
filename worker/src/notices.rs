//! When to say again that something goes on: soon, and then at ever longer intervals.

use std::time::{Duration, Instant};

/// The second notice comes so long after the first.
const SECOND: Duration = Duration::from_secs(2);
/// The longest time between two notices.
const LONGEST: Duration = Duration::from_secs(600);

/// Notices of one state of things, as long as it lasts.
#[derive(Debug)]
pub(crate) struct Notices {
    began: Instant,
    next: Instant,
    pause: Duration,
}

impl Notices {
    /// Of something that began at `now`; the first notice is due `first` later.
    pub(crate) fn from(now: Instant, first: Duration) -> Self {
        Self {
            began: now,
            next: now + first,
            pause: SECOND,
        }
    }

    /// Whether a notice is due at `now`; then the pause before the next one is twice as long.
    pub(crate) fn due(&mut self, now: Instant) -> bool {
        if now < self.next {
            return false;
        }
        self.next = now + self.pause;
        self.pause = (self.pause * 2).min(LONGEST);
        true
    }

    /// When the next notice is due.
    pub(crate) fn next(&self) -> Instant {
        self.next
    }

    /// Whole seconds since it began.
    pub(crate) fn seconds(&self, now: Instant) -> u64 {
        now.saturating_duration_since(self.began).as_secs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notices_come_at_ever_longer_intervals() {
        let began = Instant::now();
        let mut notices = Notices::from(began, Duration::ZERO);
        let due: Vec<u64> = (0..3600)
            .filter(|second| notices.due(began + Duration::from_secs(*second)))
            .collect();
        assert_eq!(due, [0, 2, 6, 14, 30, 62, 126, 254, 510, 1022, 1622, 2222, 2822, 3422]);
        assert_eq!(notices.seconds(began + Duration::from_secs(9)), 9);
        let mut later = Notices::from(began, Duration::from_secs(1));
        assert!(!later.due(began) && later.due(began + Duration::from_secs(1)));
    }
}
