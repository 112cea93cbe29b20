//! Lists of jobs and workers for people: a line each, in columns.

use crate::steer_args::SortField;
use comfy_table::{ContentArrangement, Table, presets};
use indicatif::HumanDuration;
use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::schedule::StopReason;
use std::time::Duration;

/// The longest text in a column, in characters: `jobs ID` and `--json` have all of it.
const LONGEST: usize = 60;

/// A table of jobs at the time `now_ms` [milliseconds since 1970, UTC].
pub(crate) fn jobs(jobs: &[JobStatus], now_ms: u64) -> String {
    let head = [
        "JOB",
        "NAME",
        "STATE",
        "ITERATIONS",
        "AGE",
        "LEFT",
        "WORKERS",
        "MEMORY",
        "OWNER",
        "LABELS",
        "NOTE",
    ];
    let rows = jobs.iter().map(|job| {
        let left = match job.state {
            JobState::Running => time_left(job).map_or(String::new(), short),
            _ => String::new(),
        };
        let workers = match job.state.ended() {
            true => String::new(),
            false => job.workers.to_string(),
        };
        [
            job.id.to_string(),
            name(job),
            state(job).to_owned(),
            format!("{} of {}", job.iterations_done, job.spec.iterations),
            short(Duration::from_millis(now_ms.saturating_sub(job.created_ms))),
            left,
            workers,
            job.memory_mb.map_or(String::new(), memory),
            job.owner.clone(),
            joined(job.spec.labels.iter().map(|(name, value)| format!("{name}={value}"))),
            note(job),
        ]
    });
    aligned(&head, rows)
}

/// Sorts jobs: names from A to Z, of numbers the largest first; what is not known comes last.
pub(crate) fn sort(jobs: &mut [JobStatus], field: SortField) {
    let number = |job: &JobStatus| -> Option<f64> {
        match field {
            SortField::Done => Some(job.iterations_done as f64 / f64::from(job.spec.iterations.max(1))),
            SortField::Age => Some(-(job.created_ms as f64)),
            SortField::Left => time_left(job)
                .filter(|_| job.state == JobState::Running)
                .map(|left| left.as_secs_f64()),
            SortField::Speed => job.iterations_per_second.filter(|_| !job.state.ended()),
            SortField::Workers => Some(job.workers.into()),
            SortField::Priority => Some(job.spec.schedule.priority.into()),
            SortField::Name | SortField::State | SortField::Owner => None,
        }
    };
    let order = ["running", "queued", "paused", "failed", "cancelled", "done"];
    let place = |job: &JobStatus| order.iter().position(|name| *name == state(job));
    jobs.sort_by(|a, b| match field {
        SortField::Name => name(a).cmp(&name(b)),
        SortField::State => place(a).cmp(&place(b)),
        SortField::Owner => a.owner.cmp(&b.owner),
        _ => match (number(a), number(b)) {
            (Some(a), Some(b)) => b.total_cmp(&a),
            (a, b) => b.is_some().cmp(&a.is_some()),
        },
    });
}

/// A table of workers.
pub(crate) fn workers(workers: &[WorkerStatus]) -> String {
    let head = [
        "WORKER",
        "NAME",
        "STATE",
        "JOBS",
        "SPEED",
        "THREADS",
        "MEMORY",
        "HEARD",
        "FROM",
        "CONFIRMED",
        "FAULTS",
        "TAGS",
        "RENDERER",
        "NOTE",
    ];
    let rows = workers.iter().map(|worker| {
        let state = match (&worker.quarantine, worker.leases) {
            (Some(_), _) => "quarantine",
            (None, 0) if worker.drained => "drained",
            (None, 0) if worker.rest.is_some() => "resting",
            (None, _) if worker.drained || worker.rest.is_some() => "draining",
            (None, 0) => "idle",
            (None, _) => "working",
        };
        let from = match (worker.token.as_str(), worker.machine.as_str()) {
            ("", machine) => machine.to_owned(),
            (token, machine) => format!("{token}@{machine}"),
        };
        [
            worker.id.to_string(),
            worker.name.clone(),
            state.to_owned(),
            joined(worker.jobs.iter().map(ToString::to_string)),
            worker.iterations_per_second.map_or(String::new(), speed),
            worker.threads.to_string(),
            worker.memory_mb.map_or(String::new(), memory),
            format!("{} ago", short(Duration::from_millis(worker.silent_ms))),
            from,
            worker.verified.to_string(),
            worker.faults.to_string(),
            joined(worker.tags.iter().cloned()),
            worker.renderer.clone(),
            worker_note(worker),
        ]
    });
    aligned(&head, rows)
}

/// Why a worker gets no work.
fn worker_note(worker: &WorkerStatus) -> String {
    let rest = || worker.rest.map(|rest| rest.to_string());
    worker.quarantine.clone().or_else(rest).unwrap_or_default()
}

/// What a job is called: by whoever sent it, or as its scene file.
pub(crate) fn name(job: &JobStatus) -> String {
    match job.spec.name.as_str() {
        "" => job.spec.main.clone(),
        name => name.to_owned(),
    }
}

/// Where a job stands, in a word.
pub(crate) fn state(job: &JobStatus) -> &'static str {
    match job.state {
        _ if job.spec.schedule.paused && !job.state.ended() => "paused",
        JobState::Queued => "queued",
        JobState::Running => "running",
        JobState::Done => "done",
        JobState::Failed => "failed",
        JobState::Cancelled => "cancelled",
    }
}

/// Why it stopped, failed, or does not go on.
pub(crate) fn note(job: &JobStatus) -> String {
    let stop = job.stop.map(|stop| {
        let reason = match stop.reason {
            StopReason::Noise => "noise target",
            StopReason::Deadline => "deadline",
        };
        format!("stopped by its {reason}, of {}", stop.asked)
    });
    let paused = job.spec.schedule.paused;
    let waiting = job.waiting.as_ref().filter(|_| !paused);
    let waiting = waiting.map(|reason| format!("waits: {reason}"));
    stop.or(waiting).or_else(|| job.failure.clone()).unwrap_or_default()
}

/// Time until a job is done, at its pace of the last half minute.
fn time_left(job: &JobStatus) -> Option<Duration> {
    let left = u64::from(job.spec.iterations).saturating_sub(job.iterations_rendered) as f64;
    let pace = job.iterations_per_second.filter(|pace| *pace > 0.0)?;
    Duration::try_from_secs_f64(left / pace).ok()
}

fn short(time: Duration) -> String {
    format!("{:#}", HumanDuration(time))
}

fn speed(iterations_per_second: f64) -> String {
    match iterations_per_second >= 1.0 {
        true => format!("{iterations_per_second:.1}/s"),
        false => format!("{:.1}/min", 60.0 * iterations_per_second),
    }
}

/// An amount of memory \[MiB\].
pub(crate) fn memory(mebibytes: u32) -> String {
    match mebibytes >= 10_240 {
        true => format!("{:.1} GiB", f64::from(mebibytes) / 1024.0),
        false => format!("{mebibytes} MiB"),
    }
}

fn joined(parts: impl Iterator<Item = String>) -> String {
    parts.collect::<Vec<_>>().join(",")
}

/// Columns without a content are left out.
fn aligned<const N: usize>(head: &[&str; N], rows: impl Iterator<Item = [String; N]>) -> String {
    let rows: Vec<[String; N]> = rows.collect();
    let kept: Vec<usize> = (0..N)
        .filter(|column| rows.iter().any(|row| !row[*column].is_empty()))
        .collect();
    let mut table = Table::new();
    table
        .load_preset(presets::NOTHING)
        .set_content_arrangement(ContentArrangement::Disabled)
        .set_header(kept.iter().map(|column| head[*column]));
    for row in &rows {
        table.add_row(kept.iter().map(|column| one_line(&row[*column])));
    }
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table.trim_fmt()
}

/// A text that fits a line: cut where it is long, and without what would move the cursor.
fn one_line(text: &str) -> String {
    let plain = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    match text.chars().count() > LONGEST {
        true => plain.take(LONGEST - 1).chain(['…']).collect(),
        false => plain.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::job::Totals;

    fn job(change: impl FnOnce(&mut JobStatus)) -> JobStatus {
        let mut job = serde_json::from_value(serde_json::json!({
            "id": 7, "created_ms": 1000, "state": "running", "iterations_done": 4, "iterations_rendered": 4,
            "poisoned": [], "totals": Totals::default(), "workers": 2, "iterations_per_second": 0.5, "spec": {
                "scene": "0".repeat(64), "main": "scene.xml", "iterations": 64, "integrator": {"type": "path"}}}))
        .unwrap();
        change(&mut job);
        job
    }

    #[test]
    fn jobs_are_told_with_age_and_time_left() {
        let running = job(|job| job.spec.name = "a ring".into());
        let failed = job(|job| {
            job.state = JobState::Failed;
            job.failure = Some(format!("line one\nline two {}", "x".repeat(100)));
        });
        let text = jobs(&[running, failed], 1000 + 3_600_000 * 3);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3, "{text}");
        assert_eq!(
            lines[0].split_whitespace().collect::<Vec<_>>(),
            ["JOB", "NAME", "STATE", "ITERATIONS", "AGE", "LEFT", "WORKERS", "NOTE"]
        );
        let words: Vec<&str> = lines[1]
            .split("  ")
            .map(str::trim)
            .filter(|word| !word.is_empty())
            .collect();
        assert_eq!(words, ["7", "a ring", "running", "4 of 64", "3h", "2m", "2"]);
        assert!(
            lines[2].contains("scene.xml") && lines[2].contains("line one line two"),
            "{text}"
        );
        assert!(lines[2].ends_with('…') && lines[2].starts_with("7 "), "{text}");
    }

    #[test]
    fn workers_that_rest_say_until_when_and_memory_has_units() {
        let list: Vec<WorkerStatus> = serde_json::from_value(serde_json::json!([
            {"id": 1, "name": "desk", "threads": 8, "renderer": "1", "silent_ms": 0, "leases": 0, "memory_mb": 64_000,
             "rest": {"reason": "hours", "until": "2026-11-30T19:00:00.000Z"}},
            {"id": 2, "name": "rack", "threads": 8, "renderer": "1", "silent_ms": 0, "leases": 1, "memory_mb": 2048,
             "rest": {"reason": "busy", "until": null}}]))
        .unwrap();
        let text = workers(&list);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[1].contains("resting") && lines[1].contains("62.5 GiB"), "{text}");
        assert!(
            lines[1].ends_with("resting until 2026-11-30T19:00:00.000Z: outside its hours"),
            "{text}"
        );
        assert!(lines[2].contains("draining") && lines[2].contains("2048 MiB"), "{text}");
        assert!(lines[2].ends_with("somebody else uses its machine"), "{text}");
    }

    #[test]
    fn jobs_are_sorted_by_what_is_asked_for() {
        let named = |id: u64, text: &str, pace: Option<f64>| {
            job(|job| {
                job.id.0 = id;
                job.spec.name = text.into();
                job.iterations_per_second = pace;
                job.created_ms = 100 - id;
            })
        };
        let list = [named(1, "b", None), named(2, "c", Some(2.0)), named(3, "a", Some(0.5))];
        let sorted = |field| {
            let mut list = list.clone();
            sort(&mut list, field);
            list.map(|job| job.id.0)
        };
        assert_eq!(sorted(SortField::Name), [3, 1, 2]);
        assert_eq!(sorted(SortField::Speed), [2, 3, 1]);
        assert_eq!(sorted(SortField::Left), [3, 2, 1]);
        assert_eq!(sorted(SortField::Age), [3, 2, 1]);
        assert_eq!(sorted(SortField::Priority), [1, 2, 3]);
    }

    #[test]
    fn an_empty_list_has_no_columns() {
        assert_eq!(jobs(&[], 0), "");
    }
}
