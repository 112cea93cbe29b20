//! What commands say of a farm, and what they make jobs of.

use crate::{command, picture, scene, submit, worker};
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_tests::processes::{Coordinator, Launch, get, jobs, photonfarm, printed, wait_for};
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// A scene that is rendered in no time.
const QUICK: [&str; 6] = ["--iterations", "2", "--integrator", "path", "-D", "res=8"];

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Runs a command on the farm.
fn run(coordinator: &Coordinator, arguments: &[&str]) -> Output {
    photonfarm(&[arguments, &["--coordinator", &coordinator.url]].concat())
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn job(coordinator: &Coordinator, id: u64) -> JobStatus {
    let url = format!("{}/v1/jobs/{id}", coordinator.url);
    // A connection to a coordinator that was killed is of no use any more.
    wait_for("a job", || get(&url))
}

#[test]
fn a_job_is_watched_listed_and_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let options = [
        "--iterations",
        "3",
        "--label",
        "shot=a 1",
        "--label",
        "draft=",
        "--json",
    ];
    let sent: Value = serde_json::from_str(&submit(&coordinator, &options)).unwrap();
    assert_eq!(
        (&sent["id"], &sent["spec"]["labels"]["shot"]),
        (&1.into(), &"a 1".into())
    );
    submit(&coordinator, &["--iterations", "5", "--name", "another"]);
    let listed = |options: &[&str]| {
        let json = command(&coordinator, &[&["jobs", "--json"], options].concat());
        let jobs: Vec<JobStatus> = serde_json::from_str(&json).unwrap();
        jobs.into_iter().map(|job| job.id.0).collect::<Vec<_>>()
    };
    assert_eq!(listed(&[]), [2, 1]);
    assert_eq!(listed(&["--reverse"]), [1, 2]);
    assert_eq!(listed(&["--sort", "name"]), [2, 1]);
    assert_eq!(listed(&["--label", "shot=a 1", "--label", "draft"]), [1]);
    assert!(listed(&["--label", "shot=b"]).is_empty());
    assert!(command(&coordinator, &["jobs"]).contains("draft=,shot=a 1"));

    let watching = ["watch", "1", "--json", "--coordinator", &coordinator.url];
    let watched = photonfarm_tests::processes::Process::start("photonfarm", &watching);
    let _worker = worker(&coordinator, "anvil", &[]);
    let (status, output, _) = watched.finish();
    assert!(status.success());
    let last: JobStatus = serde_json::from_str(output.lines().last().unwrap()).unwrap();
    assert_eq!((last.state, last.iterations_done), (JobState::Done, 3));
    assert!(command(&coordinator, &["watch", "2"]).contains("another  done"));

    let log = command(&coordinator, &["logs", "1"]);
    let told: Vec<&str> = log.lines().map(|line| &line[22..]).collect();
    assert_eq!(told[0], "somebody submitted it, with 3 iterations", "{log}");
    let begun = told.iter().find(|text| text.contains("it began")).unwrap();
    assert!(begun.contains("anvil) was lent iterations 1 to"), "{log}");
    assert_eq!(*told.last().unwrap(), "it is done", "{log}");

    submit(&coordinator, &["--tag", "none"]);
    command(&coordinator, &["cancel", "3"]);
    let cancelled = run(&coordinator, &["watch", "3"]);
    assert_eq!(cancelled.status.code(), Some(4), "{}", errors(&cancelled));
    assert_eq!(run(&coordinator, &["logs", "9"]).status.code(), Some(6));
    let doctor = command(&coordinator, &["doctor", "--data", text(folder.path())]);
    for line in [
        "ok     coordinator",
        "ok     version",
        "ok     clock",
        "ok     token",
        "ok     build",
        "ok     storing",
    ] {
        assert!(doctor.contains(line), "no `{line}` in:\n{doctor}");
    }
}

#[test]
fn a_deployment_that_is_ill_is_told_so() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("farm");
    let made = photonfarm(&["token", "create", "boss", "--role", "admin", "--data", text(&data)]);
    let token = folder.path().join("token");
    fs::write(&token, printed(&made)).unwrap();
    let mut coordinator = Coordinator::start(&data);
    let stranger = run(&coordinator, &["doctor", "--json"]);
    assert_eq!(stranger.status.code(), Some(1), "{}", errors(&stranger));
    let found: Vec<Value> = serde_json::from_slice(&stranger.stdout).unwrap();
    let wrong = found.iter().find(|finding| finding["grade"] == "error").unwrap();
    assert_eq!(wrong["what"], "token");
    assert!(wrong["advice"].as_str().unwrap().contains("--token-file"));
    let known = command(&coordinator, &["doctor", "--token-file", text(&token)]);
    assert!(known.contains("warn   workers      none is connected"), "{known}");
    assert!(known.contains("with the role `admin`"), "{known}");
    coordinator.kill();
    let away = run(&coordinator, &["doctor"]);
    assert_eq!(away.status.code(), Some(5), "{}", errors(&away));
}

#[test]
fn folders_archives_and_standard_input_are_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let inner = folder.path().join("sent/kitchen");
    fs::create_dir_all(&inner).unwrap();
    fs::copy(scene("constant.xml"), inner.join("scene.xml")).unwrap();
    let archive = folder.path().join("kitchen.tar.gz");
    let packed = Command::new("tar")
        .args([
            "-czf",
            text(&archive),
            "-C",
            text(&folder.path().join("sent")),
            "kitchen",
        ])
        .status();
    assert!(packed.unwrap().success());
    let sent = folder.path().join("sent");
    for place in [&sent, &archive] {
        command(&coordinator, &[&["submit", text(place)], &QUICK[..]].concat());
    }
    let mut piped = Launch::default().command("photonfarm", &[&["submit", "-"], &QUICK[..]].concat());
    piped
        .args(["--coordinator", &coordinator.url])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped());
    let mut piped = piped.stderr(Stdio::piped()).spawn().unwrap();
    let content = fs::read(scene("constant.xml")).unwrap();
    piped.stdin.take().unwrap().write_all(&content).unwrap();
    assert_eq!(printed(&piped.wait_with_output().unwrap()), "3");
    let found = jobs(&coordinator.url).unwrap();
    let names: Vec<&str> = found.iter().map(|job| job.spec.name.as_str()).collect();
    assert_eq!(names, ["stdin", "kitchen", "kitchen"]);
    assert_eq!(found[1].spec.scene, found[2].spec.scene, "the files are the same");

    fs::copy(inner.join("scene.xml"), inner.join("other.xml")).unwrap();
    let several = run(&coordinator, &["submit", text(&sent)]);
    assert!(
        errors(&several).contains("2 scenes, name one of them"),
        "{}",
        errors(&several)
    );
}

#[test]
fn frames_become_jobs_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let path = folder.path().join("moving.xml");
    let content = fs::read_to_string(scene("constant.xml")).unwrap();
    let first = content.find("<scene").unwrap();
    let end = first + content[first..].find('>').unwrap() + 1;
    fs::write(
        &path,
        format!(
            "{}<default name=\"frame\" value=\"0\"/>{}",
            &content[..end],
            &content[end..]
        ),
    )
    .unwrap();
    let _worker = worker(&coordinator, "a", &[]);
    let output = folder.path().join("out.exr");
    let frames = ["--frames", "3,7-8", "--name", "ring", "--wait", "-o", text(&output)];
    let sent = command(
        &coordinator,
        &[&["submit", text(&path)], &QUICK[..], &frames[..]].concat(),
    );
    assert_eq!(sent, "1\n2\n3");
    for (id, frame) in [(1, "3"), (2, "7"), (3, "8")] {
        let job = job(&coordinator, id);
        assert_eq!(
            (job.spec.defines["frame"].as_str(), job.spec.labels["frame"].as_str()),
            (frame, frame)
        );
        assert_eq!(job.spec.name, format!("ring 000{frame}"));
        let file = folder.path().join(format!("out.000{frame}.exr"));
        assert!(fs::read(file).unwrap() == picture(&coordinator, &id.to_string()));
    }
}

#[test]
fn a_job_comes_after_another_across_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let mut coordinator = Coordinator::start(&folder.path().join("farm"));
    submit(&coordinator, &["--iterations", "2", "--tag", "late"]);
    submit(&coordinator, &["--iterations", "2", "--after", "1"]);
    submit(&coordinator, &["--iterations", "2", "--tag", "none"]);
    submit(&coordinator, &["--iterations", "2", "--after", "3"]);
    let _worker = worker(&coordinator, "a", &[]);
    coordinator.wait_for_workers(1);
    coordinator.kill();
    coordinator.restart();
    let waits = "job 1 is to be done first";
    assert_eq!(job(&coordinator, 2).waiting.as_deref(), Some(waits));
    assert!(command(&coordinator, &["jobs", "2"]).contains(waits));
    let _late = worker(&coordinator, "b", &["late"]);
    let second = wait_for("the end of both", || {
        Some(job(&coordinator, 2)).filter(|job| job.state == JobState::Done)
    });
    let first = job(&coordinator, 1);
    assert!(first.state == JobState::Done && first.ended_ms <= second.ended_ms);
    command(&coordinator, &["submit", text(&scene("constant.xml")), "--after", "1"]);

    command(&coordinator, &["cancel", "3"]);
    let cancelled = run(&coordinator, &["wait", "4"]);
    assert_eq!(cancelled.status.code(), Some(4));
    let reason = "job 3, which was to be done first, was cancelled";
    assert!(errors(&cancelled).contains(reason), "{}", errors(&cancelled));
    let refused = run(&coordinator, &["submit", text(&scene("constant.xml")), "--after", "3"]);
    assert_eq!(refused.status.code(), Some(6));
    assert!(errors(&refused).contains("job 3 was cancelled"), "{}", errors(&refused));
}
