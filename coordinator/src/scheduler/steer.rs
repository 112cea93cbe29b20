//! What people change about jobs: pause, resume, cancel, extend, retry, delete, priority. Everything may be repeated without harm.

use super::record::{Change, JobControl, JobRecord, Millis};
use super::{Decision, Farm, Job, Refusal};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;

impl Farm {
    /// Hands out no new work of a job, or goes on with it.
    pub fn pause(&self, job: JobId, paused: bool) -> Result<Decision<()>, Refusal> {
        self.change(job, |control| control.schedule.paused = paused)
    }

    /// Sets the weight of a job; the caller has checked it.
    pub fn prioritize(&self, job: JobId, priority: u32) -> Result<Decision<()>, Refusal> {
        self.change(job, |control| control.schedule.priority = priority)
    }

    fn change(&self, job: JobId, change: impl FnOnce(&mut JobControl)) -> Result<Decision<()>, Refusal> {
        let known = self.live_job(job)?.control();
        let mut control = known.clone();
        change(&mut control);
        let changes = match control == *known {
            true => vec![],
            false => vec![Change::JobChanged { job, control }],
        };
        Ok(Decision::new((), changes))
    }

    /// Cancels a job. What has arrived stays.
    pub fn cancel(&self, job: JobId, now: Millis) -> Result<Decision<()>, Refusal> {
        let job = self.live_job(job)?.id();
        let ended = Change::JobEnded {
            job,
            state: JobState::Cancelled,
            failure: None,
            ended_ms: now,
        };
        Ok(Decision::new((), vec![ended]))
    }

    /// Asks for more iterations of a job: of one that goes on, or of one that is done, as `ended` says. The iterations
    /// that are in the image stay there.
    pub fn extend(&self, id: JobId, iterations: u32, ended: Option<&JobRecord>) -> Result<Decision<()>, Refusal> {
        let (known, record) = match (self.job(id), ended) {
            (Some(job), _) => (job.control(), None),
            (None, Some(record)) => (&record.control, Some(record)),
            (None, None) => return Err(Refusal::UnknownJob(id)),
        };
        if iterations < known.iterations {
            let reason = format!(
                "job {id} has {} iterations: fewer cannot be asked for",
                known.iterations
            );
            return Err(Refusal::Invalid(reason));
        }
        if iterations == known.iterations {
            return Ok(Decision::new((), vec![]));
        }
        let mut control = JobControl {
            iterations,
            ..known.clone()
        };
        if known.stop.is_some() || record.is_some() {
            // Whoever asks for a number of iterations after a stop or an end wants that number.
            control.stop = None;
            control.schedule.deadline_ms = None;
            control.schedule.noise_target = None;
        }
        let Some(record) = record else {
            return Ok(Decision::new((), vec![Change::JobChanged { job: id, control }]));
        };
        let Some(ended_ms) = record.ended_ms.filter(|_| record.state == JobState::Done) else {
            return Err(Refusal::JobEnded(id));
        };
        control.schedule.paused = false;
        let record = Box::new(JobRecord {
            control,
            state: JobState::Running,
            ended_ms: None,
            ..record.clone()
        });
        Ok(Decision::new((), vec![Change::JobReopened { record, ended_ms }]))
    }

    /// Gives the iterations that were given up new attempts: of a job that goes on, or of one that failed, as `ended` says.
    pub fn retry(&self, id: JobId, ended: Option<&JobRecord>) -> Result<Decision<()>, Refusal> {
        let forgotten = Change::FailuresForgotten { job: id };
        if let Some(job) = self.job(id) {
            let changes = if job.given_up.is_empty() && !job.is_short() {
                vec![]
            } else {
                vec![forgotten]
            };
            return Ok(Decision::new((), changes));
        }
        let record = ended.ok_or(Refusal::UnknownJob(id))?;
        let Some(ended_ms) = record.ended_ms.filter(|_| record.state == JobState::Failed) else {
            return match record.state {
                JobState::Done => Ok(Decision::new((), vec![])),
                _ => Err(Refusal::JobEnded(id)),
            };
        };
        let mut control = record.control.clone();
        // It may have passed while nobody could do anything about it.
        control.schedule.deadline_ms = None;
        control.schedule.paused = false;
        let record = Box::new(JobRecord {
            control,
            state: JobState::Running,
            failure: None,
            ended_ms: None,
            failures: vec![],
            ..record.clone()
        });
        let reopened = Change::JobReopened { record, ended_ms };
        Ok(Decision::new((), vec![reopened, forgotten]))
    }

    /// Deletes a job that has ended, as `record` says.
    pub fn delete(&self, record: &JobRecord) -> Result<Decision<()>, Refusal> {
        let job = record.head.id;
        let Some(ended_ms) = record.ended_ms.filter(|_| self.job(job).is_none()) else {
            return Err(Refusal::JobGoesOn(job));
        };
        let deleted = Change::JobDeleted {
            job,
            ended_ms,
            owner: record.head.owner.clone(),
            iterations: record.control.iterations,
        };
        Ok(Decision::new((), vec![deleted]))
    }
}

impl Job {
    /// Whether nothing new of it is handed out: it is paused, or another one is to be done first.
    pub(super) fn is_paused(&self) -> bool {
        self.control.schedule.paused || self.control.after.is_some()
    }
}
