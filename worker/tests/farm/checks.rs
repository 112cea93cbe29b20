//! Scenes are checked before jobs are made of them: by idle workers and by busy ones, and again where one is lost.

use crate::support::{Farm, SIZE};
use photonfarm_proto::check::{CheckAnswer, CheckError, CheckFailure, CheckReport, CheckState, CheckStatus};
use photonfarm_proto::job::{JobSpec, JobState};
use photonfarm_proto::waiting::Waiting;
use photonfarm_worker::{BundleFiles, Renderer};
use reqwest::Response;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Condvar, Mutex};
use std::time::Duration;
use tokio::sync::watch;

/// The longest that a check waits: a test that fails does not hang.
const LONGEST: Duration = Duration::from_secs(60);

/// Control over all checks of a test.
#[derive(Default)]
pub(crate) struct CheckStage {
    held: Mutex<bool>,
    released: Condvar,
    /// How many were begun.
    begun: watch::Sender<usize>,
}

impl CheckStage {
    /// Has checks wait from now on, or go on.
    fn hold(&self, held: bool) {
        *self.held.lock().unwrap() = held;
        self.released.notify_all();
    }

    /// Waits until so many were begun.
    async fn until_begun(&self, count: usize) {
        let mut begun = self.begun.subscribe();
        begun.wait_for(|begun| *begun >= count).await.unwrap();
    }

    /// What a worker says of a scene.
    pub(crate) fn answer(&self, renderer: &dyn Renderer, files: &BundleFiles, spec: &JobSpec) -> CheckAnswer {
        self.begun.send_modify(|begun| *begun += 1);
        let held = self.held.lock().unwrap();
        drop(self.released.wait_timeout_while(held, LONGEST, |held| *held).unwrap());
        if files.bytes(&spec.main).unwrap() == b"panics" {
            panic!("it went wrong");
        }
        match renderer.load(files, spec) {
            Ok(scene) => CheckAnswer::Report(Box::new(report(spec, scene.resolution()))),
            Err(message) => CheckAnswer::Failure(CheckFailure::one(CheckError {
                message,
                file: Some(spec.main.clone()),
                line: Some(1),
                field: None,
            })),
        }
    }
}

fn report(spec: &JobSpec, resolution: [u32; 2]) -> CheckReport {
    CheckReport {
        scene: spec.main.clone(),
        format: "test".into(),
        shapes: BTreeMap::new(),
        lights: BTreeMap::new(),
        materials: BTreeMap::new(),
        textures: BTreeMap::new(),
        triangles: 0,
        vertices: 0,
        texels: 0,
        lamps: BTreeSet::new(),
        resolution,
        bounds: None,
        integrator: spec.integrator.with_defaults().clone(),
        warnings: Vec::new(),
        notes: Vec::new(),
    }
}

impl Farm {
    async fn post_check(&self, scene: &[u8], main: &str) -> Response {
        let spec = json!({"scene": self.send(scene).await, "main": main, "integrator": {"type": "pppm"}});
        let request = self.http.post(self.url("checks")).json(&spec);
        request.send().await.unwrap()
    }

    async fn ask_check(&self, scene: &[u8]) -> CheckStatus {
        let reply = self.post_check(scene, "scene.xml").await;
        assert_eq!(reply.status(), 202);
        let place = reply.headers()["location"].to_str().unwrap().to_owned();
        let status: CheckStatus = reply.json().await.unwrap();
        assert_eq!(place, format!("/v1/checks/{}", status.id));
        status
    }

    async fn check(&self, asked: &CheckStatus, wait_ms: u64) -> CheckStatus {
        let path = format!("checks/{}?wait_ms={wait_ms}", asked.id);
        let reply = self.http.get(self.url(&path)).send().await.unwrap();
        reply.json().await.unwrap()
    }

    async fn until_checked(&self, asked: &CheckStatus) -> CheckStatus {
        loop {
            let status = self.check(asked, 10_000).await;
            if matches!(status.state, CheckState::Done | CheckState::Failed) {
                return status;
            }
        }
    }

    /// The check of a good scene is done, and says what the renderer does.
    async fn expect_good(&self, asked: &CheckStatus) {
        let status = self.until_checked(asked).await;
        assert_eq!(status.state, CheckState::Done, "{status:?}");
        assert_eq!(status.report.unwrap().resolution, SIZE);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_scene_is_checked_before_there_is_a_job() {
    let farm = Farm::start().await;
    let early = farm.ask_check(b"good").await;
    assert_eq!(early.state, CheckState::Waiting);
    assert_eq!(early.waiting_reason, Some(Waiting::NoWorker));
    assert_eq!(early.waiting.as_deref(), Some("no worker is connected"));
    let worker = farm.worker("a");
    farm.expect_good(&early).await;
    let broken = farm.ask_check(b"broken no such shape").await;
    let status = farm.until_checked(&broken).await;
    assert_eq!((status.state, &status.report), (CheckState::Done, &None));
    let error = &status.failure.unwrap().errors[0];
    assert_eq!((error.file.as_deref(), error.line), (Some("scene.xml"), Some(1)));
    assert_eq!(error.message, "scene.xml:1: no such shape");
    let panicked = farm.until_checked(&farm.ask_check(b"panics").await).await;
    let error = &panicked.failure.unwrap().errors[0];
    assert_eq!(error.message, "loading the scene panicked: it went wrong");
    let jobs: serde_json::Value = farm
        .http
        .get(farm.url("jobs"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(jobs["jobs"], json!([]), "no job was made");
    worker.drain().await;
}

/// A worker that renders loads a scene beside it, and what it renders has the same bits.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_busy_worker_checks_a_scene_beside_what_it_renders() {
    let farm = Farm::start_with_short_leases().await;
    farm.stage.hold(3);
    let worker = farm.worker("a");
    let job = farm.submit(b"good", 5).await;
    farm.stage.until_begun(3, 1).await;
    farm.expect_good(&farm.ask_check(b"good").await).await;
    assert!(!farm.status(job).await.state.ended());
    farm.stage.release(3);
    assert_eq!(farm.until_ended(job).await.state, JobState::Done);
    farm.check_image(job, 1..=5).await;
    worker.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_check_of_a_lost_worker_is_done_by_another() {
    let farm = Farm::start_with_short_leases().await;
    farm.stage.checks.hold(true);
    let lost = farm.worker("lost");
    let asked = farm.ask_check(b"good").await;
    farm.stage.checks.until_begun(1).await;
    assert_eq!(farm.check(&asked, 0).await.state, CheckState::Checking);
    lost.kill().await;
    let other = farm.worker("other");
    farm.stage.checks.until_begun(2).await;
    farm.stage.checks.hold(false);
    farm.expect_good(&asked).await;
    other.drain().await;
}

/// A scene at which every worker is lost is given to three of them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_at_which_workers_are_lost_is_given_up() {
    let farm = Farm::start_with_short_leases().await;
    farm.stage.checks.hold(true);
    let asked = farm.ask_check(b"good").await;
    for attempt in 1..=3 {
        let lost = farm.worker("lost");
        farm.stage.checks.until_begun(attempt).await;
        lost.kill().await;
    }
    let status = farm.until_checked(&asked).await;
    assert_eq!((status.state, &status.failure), (CheckState::Failed, &None));
    let reason = status.reason.unwrap();
    assert!(reason.contains("3 times") && reason.contains("was lost"), "{reason}");
    farm.stage.checks.hold(false);
}

/// A worker that is told to stop gives a check back at once, with long leases as well.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_draining_worker_gives_a_check_back() {
    let farm = Farm::start().await;
    farm.stage.checks.hold(true);
    let first = farm.worker("first");
    let asked = farm.ask_check(b"good").await;
    farm.stage.checks.until_begun(1).await;
    first.drain().await;
    let second = farm.worker("second");
    farm.stage.checks.until_begun(2).await;
    farm.stage.checks.hold(false);
    farm.expect_good(&asked).await;
    second.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_is_lost_when_the_coordinator_starts_and_bad_ones_are_refused() {
    let mut farm = Farm::start().await;
    let asked = farm.ask_check(b"good").await;
    assert_eq!(farm.post_check(b"good", "other.xml").await.status(), 422);
    farm.stop().await;
    farm.resume().await;
    let path = format!("checks/{}", asked.id);
    let reply = farm.http.get(farm.url(&path)).send().await.unwrap();
    assert_eq!(reply.status(), 404);
    assert!(reply.text().await.unwrap().contains("ask again"));
    let worker = farm.worker("a");
    farm.expect_good(&farm.ask_check(b"good").await).await;
    worker.drain().await;
}
