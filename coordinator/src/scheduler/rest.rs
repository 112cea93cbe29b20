//! Workers that rest: they say so, and get no work until they ask for it again.

use super::grant::Asked;
use super::record::{Change, Standing};
use super::roster::Worker;
use super::{Decision, Farm, Job, Refusal};
use photonfarm_proto::rest::Resting;
use photonfarm_proto::time::rfc3339;

impl Farm {
    /// A worker rests. Its leases that it does not name end, as if it had asked for work.
    pub fn rest(&self, asked: &Asked, resting: Resting) -> Result<Decision<()>, Refusal> {
        let known = self.workers.get(asked.worker);
        let known = known.ok_or(Refusal::UnknownWorker(asked.worker))?;
        if self.is_overtaken(known, asked) {
            return Ok(Decision::new((), vec![]));
        }
        let mut changes = self.unnamed(asked);
        changes.extend(self.rests(known, Some(resting)));
        Ok(Decision::new((), changes))
    }

    /// What is the matter where the workers that could do a job rest.
    pub(super) fn who_rests(&self, job: &Job) -> String {
        let fit = self.workers.values().filter(|worker| worker.skill().meets(&job.demand));
        let ends = fit.filter_map(|worker| worker.record.standing.rest?.until_ms);
        let first = ends
            .min()
            .map(|until_ms| format!(", the first until {}", rfc3339(until_ms)));
        format!(
            "the workers that could do it rest, outside their hours or since others use their machines{}",
            first.unwrap_or_default()
        )
    }

    /// The change that a worker rests, or does no more; none if that is known.
    pub(super) fn rests(&self, known: &Worker, rest: Option<Resting>) -> Option<Change> {
        let before = &known.record.standing;
        (before.rest != rest).then(|| Change::WorkerJudged {
            worker: known.id(),
            standing: Standing { rest, ..before.clone() },
        })
    }
}
