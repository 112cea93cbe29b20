//! Jobs that are paused, extended and stopped, and a worker that lies, on a farm of real processes: the pictures are
//! those of one process that renders as many iterations.

mod checks;
mod commands;
mod pictures;
mod transfers;

use photonfarm_proto::api::WorkerList;
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::schedule::StopReason;
use photonfarm_tests::processes::{Coordinator, Process, get, http, jobs, photonfarm, printed, scene, wait_for};
use reqwest::Method;
use std::path::Path;

const SCENE: &str = "environment.xml";
const SETTINGS: [&str; 8] = [
    "--integrator",
    "pppm",
    "--seed",
    "5",
    "-D",
    "res=32",
    "--set",
    "samples=2",
];

/// The picture's file, by one process.
fn alone(folder: &Path, iterations: u64) -> Vec<u8> {
    let path = folder.join("alone.exr");
    let (scene, iterations) = (scene(SCENE), iterations.to_string());
    let mut arguments = vec!["render", scene.to_str().unwrap(), "-o", path.to_str().unwrap()];
    arguments.extend(["--threads", "1", "--iterations", &iterations]);
    arguments.extend(SETTINGS);
    printed(&photonfarm(&arguments));
    std::fs::read(path).unwrap()
}

/// Runs a command on the farm and returns what it prints.
fn command(coordinator: &Coordinator, arguments: &[&str]) -> String {
    let arguments = [arguments, &["--coordinator", &coordinator.url]].concat();
    printed(&photonfarm(&arguments))
}

/// Submits a job and returns its number.
fn submit(coordinator: &Coordinator, options: &[&str]) -> String {
    let scene = scene(SCENE);
    let arguments = [&["submit", scene.to_str().unwrap()], &SETTINGS[..], options].concat();
    command(coordinator, &arguments)
}

/// The job that was submitted last, once `condition` holds.
fn when(coordinator: &Coordinator, what: &str, condition: impl Fn(&JobStatus) -> bool) -> JobStatus {
    wait_for(what, || {
        jobs(&coordinator.url)?.into_iter().next().filter(|job| condition(job))
    })
}

fn picture(coordinator: &Coordinator, job: &str) -> Vec<u8> {
    let url = format!("{}/v1/jobs/{job}/image.exr", coordinator.url);
    let (status, bytes) = http(Method::GET, &url, Vec::new(), &[]).unwrap();
    assert_eq!(status, 200);
    bytes
}

fn worker(coordinator: &Coordinator, name: &str, tags: &[&str]) -> Process {
    let mut arguments = vec!["--coordinator", &coordinator.url, "--threads", "1", "--name", name];
    tags.iter().for_each(|tag| arguments.extend(["--tag", tag]));
    Process::start("photonfarm-worker", &arguments)
}

#[test]
fn a_job_is_paused_goes_on_and_is_extended_when_it_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let job = submit(
        &coordinator,
        &["--iterations", "5", "--tag", "gpu=no", "--priority", "20"],
    );
    assert!(command(&coordinator, &["pause", &job]).contains("paused"));
    let _idle = worker(&coordinator, "other", &[]);
    coordinator.wait_for_workers(1);
    let paused = when(&coordinator, "the pause", |job| job.spec.schedule.paused);
    assert_eq!(
        (paused.iterations_done, paused.waiting.as_deref()),
        (0, Some("it is paused"))
    );
    command(&coordinator, &["resume", &job]);
    when(&coordinator, "a missing tag", |job| {
        job.waiting.as_deref() == Some("no worker has the tags gpu=no")
    });
    let _worker = worker(&coordinator, "tagged", &["gpu=no", "site=here"]);
    let done = when(&coordinator, "the end", |job| job.state == JobState::Done);
    assert_eq!((done.iterations_done, done.spec.schedule.priority), (5, 20));
    assert!(picture(&coordinator, &job) == alone(folder.path(), 5));

    for _ in 0..2 {
        command(&coordinator, &["extend", &job, "11"]);
    }
    let done = when(&coordinator, "the end of more", |job| {
        job.state == JobState::Done && job.spec.iterations == 11
    });
    assert_eq!((done.iterations_done, done.totals.counts.light_paths % 11), (11, 0));
    assert!(
        picture(&coordinator, &job) == alone(folder.path(), 11),
        "it is not the picture of 11 iterations"
    );
    let fewer = photonfarm(&["extend", &job, "3", "--coordinator", &coordinator.url]);
    assert!(!fewer.status.success());
    assert!(String::from_utf8_lossy(&fewer.stderr).contains("has 11 iterations"));
    let listed = command(&coordinator, &["jobs"]);
    let words: Vec<&str> = listed.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(words[0], job, "{listed}");
    assert!(
        listed.contains("  done  ") && listed.contains("  11 of 11  "),
        "{listed}"
    );
}

#[test]
fn a_noise_target_stops_at_the_same_iteration_whoever_works() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let mut workers = vec![worker(&coordinator, "a", &[])];
    let mut stops = Vec::new();
    for _ in 0..2 {
        let job = submit(&coordinator, &["--iterations", "200", "--noise-target", "0.1"]);
        let done = when(&coordinator, "the end", |job| job.state.ended());
        assert_eq!(done.state, JobState::Done);
        let stop = done.stop.expect("it stops before 200 iterations");
        assert_eq!((stop.reason, stop.asked), (StopReason::Noise, 200));
        let checkpoint = done.checkpoint.unwrap();
        assert!(checkpoint.noise.unwrap() <= 0.1 && u64::from(checkpoint.iterations) == done.iterations_done);
        assert!(checkpoint.iterations.is_power_of_two());
        assert!(picture(&coordinator, &job) == alone(folder.path(), done.iterations_done));
        stops.push(checkpoint);
        workers.push(worker(&coordinator, "b", &[]));
        workers.push(worker(&coordinator, "c", &[]));
        coordinator.wait_for_workers(3);
    }
    assert_eq!(stops[0], stops[1]);
}

#[test]
fn a_worker_that_lies_is_found_out_and_leaves_no_trace() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start_with(&folder.path().join("farm"), &["--verify", "10"]);
    let cache = folder.path().join("cache");
    let _liar = Process::start("liar", &[&coordinator.url, "liar", cache.to_str().unwrap()]);
    coordinator.wait_for_workers(1);
    let job = submit(&coordinator, &["--iterations", "60"]);
    when(&coordinator, "the first lies", |job| job.iterations_done >= 2);
    command(&coordinator, &["pause", &job]);
    let _honest = ["a", "b"].map(|name| worker(&coordinator, name, &[]));
    coordinator.wait_for_workers(3);
    command(&coordinator, &["resume", &job]);
    let done = when(&coordinator, "the end", |job| job.state.ended());
    assert_eq!((done.state, done.iterations_done), (JobState::Done, 60));
    let list: WorkerList = get(&format!("{}/v1/workers", coordinator.url)).unwrap();
    for worker in &list.workers {
        assert_eq!(worker.quarantine.is_some(), worker.name == "liar", "{worker:?}");
    }
    assert!(
        picture(&coordinator, &job) == alone(folder.path(), 60),
        "lies are left in the picture"
    );
    assert!(command(&coordinator, &["workers"]).contains("two others agree"));
    let liar = list
        .workers
        .iter()
        .find(|worker| worker.name == "liar")
        .unwrap()
        .id
        .to_string();
    assert!(!command(&coordinator, &["workers", "release", &liar]).contains("quarantine"));
}

/// The scene's own integrator is `path` with edges up to 6, which the request over the network does not name.
#[test]
fn what_a_request_leaves_out_is_the_scenes_as_on_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let scene = scene("diffuse-box.xml");
    let scene = scene.to_str().unwrap();
    let _workers = ["a", "b"].map(|name| worker(&coordinator, name, &[]));
    let options = [
        "-D",
        "res=8",
        "--iterations",
        "6",
        "--integrator",
        "path",
        "--set",
        "samples=2",
    ];
    let job = command(&coordinator, &[&["submit", scene, "--wait"], &options[..]].concat());
    let sent = when(&coordinator, "the end", |job| job.state.ended()).spec;
    let request = serde_json::json!({
        "scene": sent.scene, "main": sent.main, "defines": sent.defines, "iterations": 6,
        "integrator": {"type": "path", "samples": 2},
    });
    let url = format!("{}/v1/jobs", coordinator.url);
    let json = [("content-type", "application/json")];
    let (status, _) = http(Method::POST, &url, request.to_string().into_bytes(), &json).unwrap();
    assert_eq!(status, 201);
    let done = when(&coordinator, "the end", |job| job.id.0 == 2 && job.state.ended());
    assert_eq!((done.state, done.failure), (JobState::Done, None));
    assert_eq!(
        serde_json::to_value(&done.spec.integrator).unwrap(),
        request["integrator"]
    );
    let resolved = serde_json::to_value(done.integrator.unwrap()).unwrap();
    assert_eq!(
        resolved,
        serde_json::json!({"type": "path", "samples": 2, "sampling": "sobol", "max_depth": 6})
    );
    let output = folder.path().join("a.exr");
    let rendered = photonfarm(&[&["render", scene, "-o", output.to_str().unwrap()], &options[..]].concat());
    assert!(rendered.status.success());
    let alone = std::fs::read(output).unwrap();
    assert!(picture(&coordinator, job.trim()) == alone && picture(&coordinator, "2") == alone);
}
