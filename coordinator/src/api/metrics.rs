//! Figures of the farm in the text format of Prometheus, for dashboards and for scaling the number of workers.

use super::{ApiError, App};
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use photonfarm_proto::job::{JobState, JobStatus};
use std::fmt::Write;
use std::sync::atomic::Ordering;

/// The media type of the format.
const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The farm in figures.
pub(super) async fn metrics(State(service): State<App>) -> Result<impl IntoResponse, ApiError> {
    let jobs = service.live_statuses().await?;
    let workers = service.workers().await?;
    let target_s = service.lease_target_s().await?;
    let mut text = String::new();
    let mut gauge = |name: &str, help: &str, value: u64| {
        // Writing to a string does not fail.
        let _ = write!(
            text,
            "# HELP photonfarm_{name} {help}\n# TYPE photonfarm_{name} gauge\nphotonfarm_{name} {value}\n"
        );
    };
    let going_on = || jobs.iter().filter(|job| !job.spec.schedule.paused);
    let count = |state: JobState| jobs.iter().filter(|job| job.state == state).count() as u64;
    gauge(
        "jobs_queued",
        "Jobs of which nothing was handed out yet.",
        count(JobState::Queued),
    );
    gauge(
        "jobs_running",
        "Jobs of which work was handed out.",
        count(JobState::Running),
    );
    gauge("workers", "Workers heard of lately.", workers.len() as u64);
    gauge(
        "leases",
        "Leases held.",
        workers.iter().map(|worker| u64::from(worker.leases)).sum(),
    );
    gauge(
        "pending_iterations",
        "Iterations of jobs that are not paused and that nobody has rendered yet.",
        going_on().map(pending_iterations).sum(),
    );
    gauge(
        "pending_leases",
        "Leases of the usual length that the pending iterations make.",
        going_on().map(|job| pending_leases(job, target_s)).sum(),
    );
    let refused = service.refused_connections.load(Ordering::Relaxed);
    let _ = write!(
        text,
        "# HELP photonfarm_connections_refused_total Connections closed at once, since their address had too many.\n\
         # TYPE photonfarm_connections_refused_total counter\nphotonfarm_connections_refused_total {refused}\n"
    );
    Ok(([(header::CONTENT_TYPE, MEDIA_TYPE)], text))
}

fn pending_iterations(job: &JobStatus) -> u64 {
    u64::from(job.spec.iterations).saturating_sub(job.iterations_rendered)
}

/// A lease is as many iterations as a worker renders in `target_s` seconds; one, until a speed is known. A chain is worked on by one
/// worker at a time.
fn pending_leases(job: &JobStatus, target_s: f64) -> u64 {
    let speed = job.iterations_per_second.unwrap_or(0.0) / f64::from(job.workers.max(1));
    let iterations = (speed * target_s).max(1.0);
    let leases = (pending_iterations(job) as f64 / iterations).ceil() as u64;
    match job.spec.integrator.with_defaults().is_sequential() {
        true => leases.min(1),
        false => leases,
    }
}
