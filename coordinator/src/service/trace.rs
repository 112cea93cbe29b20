//! Spans of what the coordinator does for a job, for whoever collects them.
//!
//! The submission is the root of a job's trace. Leases, merges and the job as a whole lie below it; what a worker does lies below its
//! lease, and the commit of a node below the worker's upload.

use super::Service;
use super::history::outcome;
use crate::scheduler::record::{Change, LeaseRecord, Millis};
use crate::scheduler::{Delivery, Farm, Job};
use photonfarm_proto::history::LeaseOutcome;
use photonfarm_proto::id::{JobId, LeaseToken};
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::trace::{Context, Open, Span, now_ns};

/// Milliseconds as nanoseconds.
fn ns(ms: Millis) -> u64 {
    ms.saturating_mul(1_000_000)
}

impl Service {
    /// The root of a job's trace.
    pub(super) fn trace_of(&self, job: JobId) -> Context {
        Context::of_job(&self.identity().farm, job)
    }

    /// Begins the span of a part of the work on a job that is no lease's.
    pub(super) fn begin_for(&self, job: JobId, name: &'static str) -> Open {
        match self.tracer.is_on() {
            true => self.tracer.begin(self.trace_of(job), name),
            false => Open::default(),
        }
    }

    /// Begins the span of the commit of a node: within the span of its worker that asks for it, else within its lease.
    pub(super) fn begin_commit(&self, delivery: &Delivery, asked_by: Option<Context>) -> Open {
        if !self.tracer.is_on() {
            return Open::default();
        }
        let job = self.trace_of(delivery.job);
        let asked_by = asked_by.filter(|context| context.trace == job.trace);
        let mut span = self
            .tracer
            .begin(asked_by.unwrap_or(job.lease(delivery.token)), "commit");
        span.fact("node", || delivery.node.to_string());
        span
    }

    /// Notes a submission that began at `start_ns`. The request may belong to a trace of its sender.
    pub(crate) fn trace_submission(&self, status: &JobStatus, start_ns: u64, asked_by: Option<Context>) {
        if !self.tracer.is_on() {
            return;
        }
        self.tracer.put(Span {
            context: self.trace_of(status.id),
            parent: None,
            link: asked_by,
            name: "submit",
            start_ns,
            end_ns: now_ns(),
            facts: vec![
                ("job", status.id.0.into()),
                ("job.name", status.spec.name.clone().into()),
                ("iterations", u64::from(status.spec.iterations).into()),
            ],
            error: None,
        });
    }

    /// Notes what ends with changes that are about to be applied.
    pub(super) fn trace_changes(&self, farm: &Farm, changes: &[Change], now: Millis) {
        if !self.tracer.is_on() {
            return;
        }
        for change in changes {
            match change {
                Change::LeaseEnded { job, token } => {
                    if let Some(job) = farm.job(*job) {
                        self.trace_lease(farm, job, *token, changes, now);
                    }
                }
                Change::JobEnded {
                    job,
                    state,
                    failure,
                    ended_ms,
                } => {
                    let Some(job) = farm.job(*job) else { continue };
                    // Their ends are no changes of their own.
                    let held: Vec<LeaseToken> = job.lease_tokens().collect();
                    let told = |token: &LeaseToken| {
                        let ends = |change: &Change| matches!(change, Change::LeaseEnded { token: ended, .. } if ended == token);
                        changes.iter().any(ends)
                    };
                    for token in held.into_iter().filter(|token| !told(token)) {
                        self.trace_lease(farm, job, token, changes, *ended_ms);
                    }
                    self.trace_end(job, *state, failure.clone(), *ended_ms);
                }
                _ => {}
            }
        }
    }

    fn trace_lease(&self, farm: &Farm, job: &Job, token: LeaseToken, changes: &[Change], now: Millis) {
        let Some(lease) = job.lease_record(token) else { return };
        let submission = self.trace_of(job.id());
        let LeaseRecord { worker, node, .. } = *lease;
        let outcome = outcome(job, token, changes);
        let error = match outcome {
            LeaseOutcome::Lost => Some("the worker was lost"),
            LeaseOutcome::Failed => Some("an iteration failed"),
            _ => None,
        };
        self.tracer.put(Span {
            context: submission.lease(token),
            parent: Some(submission.span),
            link: None,
            name: "lease",
            start_ns: ns(lease.granted_ms),
            end_ns: ns(now.max(lease.granted_ms)),
            facts: vec![
                ("worker", worker.0.into()),
                (
                    "worker.name",
                    farm.worker_name(worker).unwrap_or_default().to_owned().into(),
                ),
                ("node", node.to_string().into()),
                ("iterations", node.leaves().into()),
                ("attempt", u64::from(lease.attempt).into()),
                ("outcome", format!("{outcome:?}").to_lowercase().into()),
            ],
            error: error.map(str::to_owned),
        });
    }

    /// A job ends; one that goes on later ends once more, with another span.
    fn trace_end(&self, job: &Job, state: JobState, failure: Option<String>, ended_ms: Millis) {
        let submission = self.trace_of(job.id());
        let created_ms = job.head().created_ms;
        self.tracer.put(Span {
            context: submission.child("job", ended_ms),
            parent: Some(submission.span),
            link: None,
            name: "job",
            start_ns: ns(created_ms),
            end_ns: ns(ended_ms.max(created_ms)),
            facts: vec![
                ("state", format!("{state:?}").to_lowercase().into()),
                ("iterations", job.done().into()),
            ],
            error: failure,
        });
    }
}
