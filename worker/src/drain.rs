//! How a worker ends: it takes no more work, after a while it gives up the iteration at hand, and at last it keeps on
//! disk what it could not deliver.

use crate::held::Held;
use crate::notices::Notices;
use crate::reach::Reach;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;

/// Share of the time that an iteration may take; the rest is for the delivery of what is done.
pub(crate) const RENDERING: f64 = 0.75;
/// How long a worker drains without a word.
const QUIET: Duration = Duration::from_secs(1);

/// The three steps of an end.
#[derive(Clone, Debug)]
pub(crate) struct Stop {
    /// No more work is taken; the iteration at hand comes to its end.
    pub(crate) drain: CancellationToken,
    /// The iteration at hand is given up.
    pub(crate) abandon: CancellationToken,
    /// What is not delivered yet will not be.
    pub(crate) give_up: CancellationToken,
}

impl Stop {
    /// With a token that begins it.
    pub(crate) fn by(drain: CancellationToken) -> Self {
        Self {
            drain,
            abandon: CancellationToken::new(),
            give_up: CancellationToken::new(),
        }
    }

    /// Waits for the first step, then says what the worker waits for, and takes the other steps when time is up.
    pub(crate) async fn watch(self, limit: Duration, held: Held, reach: Reach) {
        self.drain.cancelled().await;
        let began = Instant::now();
        let (abandon_at, give_up_at) = (began + limit.mul_f64(RENDERING), began + limit);
        let mut notices = Notices::from(began, QUIET);
        tracing::info!(
            "draining: no more work is taken, and what is done is delivered within {} s",
            limit.as_secs()
        );
        loop {
            let now = Instant::now();
            if now >= abandon_at && !self.abandon.is_cancelled() {
                tracing::info!(
                    "draining: an iteration that is not done yet is given up, so that the rest can be delivered"
                );
                self.abandon.cancel();
            }
            if now >= give_up_at {
                return self.give_up.cancel();
            }
            if notices.due(now)
                && let Some(left) = held.left_to_do()
            {
                let seconds = (give_up_at - now).as_secs();
                let obstacle = reach
                    .reason()
                    .map(|reason| format!("; the coordinator cannot be reached: {reason}"));
                tracing::info!(
                    "draining: waiting for {left}, {seconds} s at most{}",
                    obstacle.unwrap_or_default()
                );
            }
            let next = notices
                .next()
                .min(if now < abandon_at { abandon_at } else { give_up_at });
            tokio::time::sleep_until(next.into()).await;
        }
    }
}
