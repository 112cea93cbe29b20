//! Figures of the farm in the text format of Prometheus, for dashboards and for scaling the number of workers.

use super::App;
use crate::service::{CheckFigures, Durations, LEASE_SECONDS, Part, ServiceError, VERSION};
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use photonfarm_proto::RENDERER;
use photonfarm_proto::api::StoreRoom;
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
    figure_of_build(&mut text);
    figures_of_stores(&mut text, &service);
    figures_of_room(&mut text, &service);
    figures_since_start(&mut text, &service);
    figures_of_checks(&mut text, &service);
    ([(header::CONTENT_TYPE, MEDIA_TYPE)], text)
}

/// Which build this is: always 1, for joining with other figures.
fn figure_of_build(text: &mut String) {
    let labels = format!("version=\"{VERSION}\",renderer=\"{RENDERER}\"");
    let help = "The build of this coordinator, and the renderer whose bits its jobs have.";
    family(text, ("build_info", "gauge"), help, &[(labels, 1)]);
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
        "workers_resting",
        "Workers that take no work of their own accord: outside their hours, or since others use their machines.",
        workers.iter().filter(|worker| worker.rest.is_some()).count() as u64,
    );
    let memory = workers.iter().filter_map(|worker| worker.memory_mb);
    gauge(
        "largest_worker_memory_bytes",
        "Memory that jobs may take of the largest worker; 0 where none says.",
        u64::from(memory.max().unwrap_or(0)) << 20,
    );
    gauge(
        "largest_job_memory_bytes",
        "Most memory that one of the jobs at work was measured to take.",
        u64::from(figures.memory_mb) << 20,
    );
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

/// Room in the stores, of those that lie on disks of which it is known, and what jobs hold.
fn figures_of_room(text: &mut String, service: &App) {
    let (rooms, job_bytes) = service.room();
    let values = |value: fn(&StoreRoom) -> Option<u64>| -> Vec<(String, u64)> {
        let known = rooms
            .iter()
            .filter_map(|room| Some((format!("part=\"{}\"", room.part), value(room)?)));
        known.collect()
    };
    let free = values(|room| room.free_bytes);
    if !free.is_empty() {
        let help = "Bytes that the disk of a part of the stores still takes.";
        family(text, ("store_free_bytes", "gauge"), help, &free);
        let help = "Bytes in all of the disk of a part of the stores.";
        family(
            text,
            ("store_total_bytes", "gauge"),
            help,
            &values(|room| room.total_bytes),
        );
    }
    if let Some(bytes) = job_bytes {
        let help = "Bytes of the images and pictures of all jobs.";
        single(text, ("job_bytes", "gauge"), help, bytes);
    }
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
    counter(
        "audit_lines_lost_total",
        "Lines that could not be written to the audit log.",
        service.audit_lost.load(Ordering::Relaxed),
    );
    let [nodes, iterations] = service.counts.committed();
    counter("nodes_committed_total", "Nodes that came to count.", nodes);
    counter(
        "iterations_committed_total",
        "Iterations in nodes that came to count; what is rendered again counts again.",
        iterations,
    );
    counter(
        "nodes_merged_total",
        "Nodes that were merged into greater ones.",
        service.counts.nodes_merged(),
    );
    counter(
        "nodes_lost_total",
        "Nodes that counted and do so no more: damaged, untrusted, left or replaced.",
        service.counts.nodes_lost(),
    );
    let ended = service.counts.jobs_ended();
    let ended = ended.map(|(state, count)| (format!("state=\"{state}\""), count));
    family(text, ("jobs_ended_total", "counter"), "Jobs that ended.", &ended);
    durations(text, &service.counts.lease_durations());
    let failed = service.counts.failed_attempts();
    let failed = failed.map(|(kind, count)| (format!("kind=\"{kind}\""), count));
    let help = "Attempts at iterations that failed; those of the kind `lost` are leases that expired.";
    family(text, ("failed_attempts_total", "counter"), help, &failed);
    let deliveries = service.counts.deliveries();
    let deliveries = deliveries.map(|(state, count)| (format!("outcome=\"{state}\""), count));
    let help = "Attempts to tell a webhook of the end of a job; one that is given up is not tried again.";
    family(text, ("webhook_attempts_total", "counter"), help, &deliveries);
}

/// Checks of scenes, which this coordinator alone knows.
fn figures_of_checks(text: &mut String, service: &App) {
    let CheckFigures { waiting, lent, ended } = service.check_figures();
    let open = [("waiting", waiting), ("checking", lent)].map(|(state, count)| (format!("state=\"{state}\""), count));
    let help = "Checks of scenes that wait for a worker, and that one is at.";
    family(text, ("checks", "gauge"), help, &open);
    let ended = ended.map(|(outcome, count)| (format!("outcome=\"{outcome}\""), count));
    let help = "Checks of scenes that ended: with a report, with what is wrong, since no worker could answer, or forgotten before one did.";
    family(text, ("checks_ended_total", "counter"), help, &ended);
}

/// How long leases took, as a histogram.
fn durations(text: &mut String, leases: &Durations) {
    let name = "lease_duration_seconds";
    head(text, (name, "histogram"), "Time from the grant of a lease to its end.");
    for (bound, count) in LEASE_SECONDS.iter().zip(leases.at_most) {
        let _ = writeln!(text, "photonfarm_{name}_bucket{{le=\"{bound}\"}} {count}");
    }
    let Durations { count, sum, .. } = leases;
    let _ = writeln!(
        text,
        "photonfarm_{name}_bucket{{le=\"+Inf\"}} {count}\nphotonfarm_{name}_sum {sum}\nphotonfarm_{name}_count {count}"
    );
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
