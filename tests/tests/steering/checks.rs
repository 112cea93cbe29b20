//! Real workers check real scenes, before there is a job; one is killed while it has a check.

use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::check::{CheckState, CheckStatus};
use photonfarm_tests::farm::Client;
use photonfarm_tests::processes::{Coordinator, Process, scene, wait_for};
use reqwest::Method;
use serde_json::json;

const JSON: [(&str, &str); 1] = [("content-type", "application/json")];

/// Sends a scene of one file and asks for a check.
fn ask(client: &Client, content: &[u8]) -> CheckStatus {
    let entry = FileEntry::of(content);
    let manifest = BundleManifest {
        files: [("scene.xml".to_owned(), entry)].into(),
    };
    let post = |path: &str, body: serde_json::Value| {
        let sent = client.send(Method::POST, path, &JSON, body.to_string().into_bytes());
        sent.expect("an answer")
    };
    assert_eq!(post("bundles", json!(manifest)).0, 200);
    let put = client.send(Method::PUT, &format!("blobs/{}", entry.hash), &[], content.to_vec());
    assert!(put.is_some_and(|(status, _)| [200, 201, 204].contains(&status)));
    let spec = json!({"scene": manifest.hash(), "main": "scene.xml", "integrator": {"type": "pcf", "photons": 1234}});
    let (status, body) = post("checks", spec);
    assert_eq!(status, 202);
    serde_json::from_slice(&body).unwrap()
}

fn until(client: &Client, asked: &CheckStatus, state: CheckState) -> CheckStatus {
    wait_for("a check", || {
        let status: Option<CheckStatus> = client.get(&format!("checks/{}?wait_ms=100", asked.id));
        status.filter(|status| status.state == state)
    })
}

#[test]
fn workers_check_scenes_and_one_that_is_killed_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("data"));
    let client = Client::new(&coordinator.url);
    let worker = |name: &str| {
        let cache = folder.path().join(name);
        let cache = cache.to_str().unwrap();
        Process::start(
            "photonfarm-worker",
            &["--coordinator", &coordinator.url, "--threads", "1", "--cache", cache],
        )
    };
    let good = std::fs::read(scene("diffuse-box.xml")).unwrap();
    let broken = String::from_utf8(good.clone())
        .unwrap()
        .replace("\"rectangle\"", "\"rectangel\"");
    let first = worker("first");
    let report = until(&client, &ask(&client, &good), CheckState::Done).report.unwrap();
    assert_eq!((report.format.as_str(), report.warnings.len()), ("Mitsuba XML", 0));
    assert!(
        report.shapes["rectangle"] > 0 && report.bounds.is_some() && !report.lamps.is_empty(),
        "{report:?}"
    );
    assert_eq!(serde_json::to_value(&report.integrator).unwrap()["photons"], 1234);
    let failure = until(&client, &ask(&client, broken.as_bytes()), CheckState::Done)
        .failure
        .unwrap();
    let error = &failure.errors[0];
    let line = 1 + broken.lines().position(|line| line.contains("rectangel")).unwrap();
    assert_eq!(
        (error.file.as_deref(), error.line),
        (Some("scene.xml"), Some(line as u32))
    );
    assert!(error.message.contains("did you mean `rectangle`?"), "{error:?}");

    // Stopped while it waits for work, it is lent the check and never knows.
    first.signal("STOP");
    let asked = ask(&client, &good);
    until(&client, &asked, CheckState::Checking);
    first.kill();
    let _second = worker("second");
    assert_eq!(until(&client, &asked, CheckState::Done).report, Some(report));
    let jobs: photonfarm_proto::api::JobPage = client.get("jobs").unwrap();
    assert_eq!(jobs.jobs, []);
}
