//! Figures of the farm in the text format of Prometheus, for dashboards and for scaling the number of workers.

use super::{ApiError, App};
use crate::service::Part;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::waiting::Waiting;
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
    let waits = |reason: Waiting| jobs.iter().filter(|job| job.waiting_reason == Some(reason)).count();
    let waiting = Waiting::ALL.map(|reason| (format!("reason=\"{reason}\""), waits(reason) as u64));
    let name = "jobs_waiting";
    family(
        &mut text,
        name,
        "gauge",
        "Jobs that nobody is at work on, by the reason.",
        &waiting,
    );
    let failing: Vec<Part> = service.found_obstacles().into_iter().map(|(part, _)| part).collect();
    let stores = Part::ALL.map(|part| (format!("part=\"{}\"", part.name()), failing.contains(&part).into()));
    family(
        &mut text,
        "store_failing",
        "gauge",
        "Whether a part of the stores fails now.",
        &stores,
    );
    let failures = Part::ALL.map(|part| {
        let [full, away] = service.failures(part);
        let label = |reason: Waiting| format!("part=\"{}\",reason=\"{reason}\"", part.name());
        [(label(Waiting::DiskFull), full), (label(Waiting::StoreAway), away)]
    });
    let help = "Failures of the stores since the start.";
    family(
        &mut text,
        "store_failures_total",
        "counter",
        help,
        failures.as_flattened(),
    );
    let refused = service.refused_connections.load(Ordering::Relaxed);
    let _ = write!(
        text,
        "# HELP photonfarm_connections_refused_total Connections closed at once, since their address had too many.\n\
         # TYPE photonfarm_connections_refused_total counter\nphotonfarm_connections_refused_total {refused}\n"
    );
    Ok(([(header::CONTENT_TYPE, MEDIA_TYPE)], text))
}

/// Figures of one name that differ by their labels.
fn family(text: &mut String, name: &str, kind: &str, help: &str, figures: &[(String, u64)]) {
    // Writing to a string does not fail.
    let _ = write!(
        text,
        "# HELP photonfarm_{name} {help}\n# TYPE photonfarm_{name} {kind}\n"
    );
    for (labels, value) in figures {
        let _ = writeln!(text, "photonfarm_{name}{{{labels}}} {value}");
    }
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
