//! Jobs that come after others: each begins once the other is done, and is cancelled where that fails or is cancelled.

use super::Farm;
use super::record::{Change, JobControl, Millis};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use std::collections::BTreeSet;

impl Farm {
    /// The changes, and what follows from them for jobs that come after those that end.
    #[must_use]
    pub fn with_successors(&self, mut changes: Vec<Change>, now: Millis) -> Vec<Change> {
        let end = |change: &Change| match change {
            Change::JobEnded { job, state, .. } => Some((*job, *state)),
            _ => None,
        };
        let mut ended: BTreeSet<JobId> = changes.iter().filter_map(end).map(|(job, _)| job).collect();
        let mut at = 0;
        while at < changes.len() {
            if let Some((first, state)) = end(&changes[at]) {
                let waiting = self.index.after.range((first, JobId(0))..=(first, JobId(u64::MAX)));
                for job in waiting.map(|((_, job), ())| *job) {
                    if ended.contains(&job) {
                        continue;
                    }
                    let change = self.follows(job, first, state, now);
                    ended.extend(end(&change).map(|(job, _)| job));
                    changes.push(change);
                }
            }
            at += 1;
        }
        changes
    }

    /// What becomes of a job once the one before it has ended.
    fn follows(&self, job: JobId, first: JobId, state: JobState, now: Millis) -> Change {
        let how = match state {
            JobState::Done => {
                let control = JobControl {
                    after: None,
                    ..self.jobs[&job].control.clone()
                };
                return Change::JobChanged { job, control };
            }
            JobState::Cancelled => "was cancelled",
            _ => "failed",
        };
        Change::JobEnded {
            job,
            state: JobState::Cancelled,
            failure: Some(format!("job {first}, which was to be done first, {how}")),
            ended_ms: now,
        }
    }
}
