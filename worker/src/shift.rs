//! One stretch of work: it ends when the worker is to stop, and when it is to rest.

use crate::drain::{RENDERING, Stop};
use photonfarm_proto::rest::Resting;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::task::AbortOnDropHandle;

/// A worker's rests, as whoever starts it decides.
#[derive(Clone, Debug)]
pub(crate) struct Rests(pub(crate) watch::Receiver<Option<Resting>>);

impl Rests {
    /// Whether it is to rest now.
    pub(crate) fn now(&self) -> Option<Resting> {
        *self.0.borrow()
    }

    /// Waits until that satisfies a condition; for ever where nobody decides any more.
    async fn until(&mut self, condition: impl Fn(&Option<Resting>) -> bool) -> Option<Resting> {
        let found = self.0.wait_for(|rest| condition(rest)).await.map(|rest| *rest);
        match found {
            Ok(rest) => rest,
            Err(_) => std::future::pending().await,
        }
    }

    /// Waits until it is to do otherwise than `known`.
    pub(crate) async fn change_from(&mut self, known: Option<Resting>) {
        self.until(|rest| *rest != known).await;
    }
}

/// A stretch of work, until the worker is to rest: then the iteration at hand comes to its end, but after three quarters
/// of `limit` it is given up.
pub(crate) struct Shift {
    pub(crate) stop: Stop,
    _end: AbortOnDropHandle<()>,
}

impl Shift {
    /// Begins; the worker's own end ends it as well.
    pub(crate) fn begin(worker: &Stop, mut rests: Rests, limit: Duration) -> Self {
        let stop = Stop {
            drain: worker.drain.child_token(),
            abandon: worker.abandon.child_token(),
            give_up: worker.give_up.clone(),
        };
        let (drain, abandon) = (stop.drain.clone(), stop.abandon.clone());
        let end = async move {
            rests.until(Option::is_some).await;
            drain.cancel();
            tokio::time::sleep(limit.mul_f64(RENDERING)).await;
            abandon.cancel();
        };
        Self {
            stop,
            _end: AbortOnDropHandle::new(tokio::spawn(end)),
        }
    }
}
