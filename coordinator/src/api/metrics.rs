//! Figures of the farm in the text format of Prometheus, for dashboards and for scaling the number of workers.

use super::App;
use crate::service::{Part, ServiceError};
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use photonfarm_proto::waiting::Waiting;
use std::fmt::Write;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// The media type of the format.
const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// How long the state may take to be counted: half of what Prometheus waits for figures, unless it is told otherwise.
const PATIENCE: Duration = Duration::from_secs(5);

/// The farm in figures. While the state is away those of jobs and workers are missing, and the others tell why.
pub(super) async fn metrics(State(service): State<App>) -> impl IntoResponse {
    let state = tokio::time::timeout(PATIENCE, figures_of_state(&service)).await;
    let mut text = state.ok().and_then(Result::ok).unwrap_or_default();
    figures_of_stores(&mut text, &service);
    figures_since_start(&mut text, &service);
    ([(header::CONTENT_TYPE, MEDIA_TYPE)], text)
}

/// Jobs and workers.
async fn figures_of_state(service: &App) -> Result<String, ServiceError> {
    let figures = service.figures().await?;
    let workers = service.workers().await?;
    let mut text = String::new();
    let mut gauge = |name: &str, help: &str, value: u64| single(&mut text, (name, "gauge"), help, value);
    gauge(
        "jobs_queued",
        "Jobs of which nothing was handed out yet.",
        figures.queued,
    );
    gauge(
        "jobs_running",
        "Jobs of which work was handed out.",
        figures.jobs - figures.queued,
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
        figures.pending_iterations,
    );
    gauge(
        "pending_leases",
        "Leases of the usual length that the pending iterations make.",
        figures.pending_leases,
    );
    let waits = |reason: Waiting| figures.waiting.get(&reason).copied().unwrap_or(0);
    let waiting = Waiting::ALL.map(|reason| (format!("reason=\"{reason}\""), waits(reason)));
    let help = "Jobs that nobody is at work on, by the reason.";
    family(&mut text, ("jobs_waiting", "gauge"), help, &waiting);
    Ok(text)
}

/// What became of the uses of the stores.
fn figures_of_stores(text: &mut String, service: &App) {
    let failing: Vec<Part> = service.found_obstacles().into_iter().map(|(part, _)| part).collect();
    let stores = Part::ALL.map(|part| (format!("part=\"{}\"", part.name()), failing.contains(&part).into()));
    let help = "Whether a part of the stores fails now.";
    family(text, ("store_failing", "gauge"), help, &stores);
    let failures = Part::ALL.map(|part| {
        let [full, away] = service.failures(part);
        let label = |reason: Waiting| format!("part=\"{}\",reason=\"{reason}\"", part.name());
        [(label(Waiting::DiskFull), full), (label(Waiting::StoreAway), away)]
    });
    let help = "Failures of the stores since the start.";
    let failures = failures.as_flattened();
    family(text, ("store_failures_total", "counter"), help, failures);
}

/// What this coordinator has counted since its start.
fn figures_since_start(text: &mut String, service: &App) {
    let mut counter = |name: &str, help: &str, value: u64| single(text, (name, "counter"), help, value);
    counter(
        "workers_registered_total",
        "Workers that were registered: a worker that lost its place counts again.",
        service.counts.workers_registered(),
    );
    counter(
        "leases_granted_total",
        "Leases that were granted.",
        service.counts.leases_granted(),
    );
    counter(
        "connections_refused_total",
        "Connections closed at once, since their address had too many.",
        service.refused_connections.load(Ordering::Relaxed),
    );
    let failed = service.counts.failed_attempts();
    let failed = failed.map(|(kind, count)| (format!("kind=\"{kind}\""), count));
    let help = "Attempts at iterations that failed; those of the kind `lost` are leases that expired.";
    family(text, ("failed_attempts_total", "counter"), help, &failed);
}

/// A figure of its own, by its name and its kind.
fn single(text: &mut String, (name, kind): (&str, &str), help: &str, value: u64) {
    head(text, (name, kind), help);
    let _ = writeln!(text, "photonfarm_{name} {value}");
}

/// Figures of one name that differ by their labels.
fn family(text: &mut String, (name, kind): (&str, &str), help: &str, figures: &[(String, u64)]) {
    head(text, (name, kind), help);
    for (labels, value) in figures {
        let _ = writeln!(text, "photonfarm_{name}{{{labels}}} {value}");
    }
}

// Writing to a string does not fail.
fn head(text: &mut String, (name, kind): (&str, &str), help: &str) {
    let _ = writeln!(text, "# HELP photonfarm_{name} {help}\n# TYPE photonfarm_{name} {kind}");
}
