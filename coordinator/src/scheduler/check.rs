//! What the scheduler knows about checks: which workers may be given one, and why none is at one.

use super::Farm;
use super::demand::Demand;
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::waiting::Waiting;

impl Farm {
    /// Whether a worker may be given a check. A request for work that a later one has overtaken may not: its reply is read by
    /// nobody.
    #[must_use]
    pub fn may_check(&self, worker: WorkerId, serial: Option<u64>) -> bool {
        let known = self.workers.get(worker).filter(|known| known.may_work());
        known.is_some_and(|known| serial.is_none_or(|serial| serial >= known.serial))
    }

    /// Why no worker is at a check. Any of them may be.
    #[must_use]
    pub fn waiting_check(&self) -> (Waiting, String) {
        match self.lack(&Demand::default()) {
            Some(Waiting::Quarantine) => (Waiting::Quarantine, "every worker is in quarantine or drained".into()),
            Some(_) => (Waiting::NoWorker, "no worker is connected".into()),
            None => (Waiting::Turn, "its turn has not come".into()),
        }
    }
}
