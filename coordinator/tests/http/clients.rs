//! What clients send right, wrong and twice.

use crate::support::{Farm, SCENE, expect_problem};
use photonfarm_coordinator::{Config, Coordinator, StartError};
use photonfarm_proto::api::{BundleReply, JobPage};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::ErrorCode;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use tokio::net::TcpListener;

#[tokio::test]
async fn damaged_json_is_refused_with_its_place() {
    let farm = Farm::start().await;
    let post = async |text: &str| {
        let request = farm
            .request(Method::POST, "jobs")
            .header("content-type", "application/json");
        request.body(text.to_owned()).send().await.unwrap()
    };
    let hash = "0".repeat(64);
    let cut = expect_problem(post("{\n\"scene\": ").await, ErrorCode::Malformed).await;
    assert_eq!(cut.line, Some(2));
    expect_problem(post("").await, ErrorCode::Malformed).await;
    expect_problem(post("{} x").await, ErrorCode::Invalid).await;
    let field = expect_problem(post("{\"scene\":\n 3}").await, ErrorCode::Invalid).await;
    assert_eq!((field.field.as_deref(), field.line), (Some("scene"), Some(2)));
    let unknown = expect_problem(
        post(&format!("{{\"scene\": \"{hash}\", \"mian\": 1}}")).await,
        ErrorCode::Invalid,
    )
    .await;
    assert!(unknown.detail.contains("mian"), "{unknown}");
    let base = format!("\"scene\": \"{hash}\", \"main\": \"a\", \"integrator\": {{\"type\": \"path\"}}");
    for number in ["-1", "1.5", "1e30", "4294967296", "null", "\"8\""] {
        let text = format!("{{{base}, \"iterations\": {number}}}");
        let problem = expect_problem(post(&text).await, ErrorCode::Invalid).await;
        assert_eq!(problem.field.as_deref(), Some("iterations"), "{number}");
    }
    let text = format!("{{{base}, \"iterations\": 1}} trailing");
    expect_problem(post(&text).await, ErrorCode::Malformed).await;
    expect_problem(post(&"[".repeat(4000)).await, ErrorCode::Invalid).await;
    let deep = format!("{{\"integrator\": {{\"samples\": {}", "[".repeat(4000));
    expect_problem(post(&deep).await, ErrorCode::Malformed).await;
    assert_eq!(farm.get("healthz").await.status(), StatusCode::OK);
}

#[tokio::test]
async fn routes_methods_types_and_sizes_are_checked() {
    let farm = Farm::start().await;
    expect_problem(farm.get("nothing").await, ErrorCode::NotFound).await;
    expect_problem(farm.get("../x").await, ErrorCode::NotFound).await;
    for path in [
        "jobs/0",
        "jobs/x",
        "jobs/-1",
        "jobs/99999999999999999999",
        "jobs/%ff",
        "bundles/zz",
        "blobs/00",
    ] {
        expect_problem(farm.get(path).await, ErrorCode::NotFound).await;
    }
    let delete = farm.request(Method::DELETE, "jobs").send().await.unwrap();
    expect_problem(delete, ErrorCode::MethodNotAllowed).await;
    let text = farm.request(Method::POST, "jobs").body("{}").send().await.unwrap();
    expect_problem(text, ErrorCode::UnsupportedMediaType).await;
    let long = json!({"files": {"a": " ".repeat(5000)}});
    let problem = expect_problem(farm.post_json("bundles", &long).await, ErrorCode::Limit).await;
    assert!(problem.detail.contains("json_bytes"));
    let chunks = (0..10).map(|_| Ok::<_, std::io::Error>(vec![b' '; 1000]));
    let stream = reqwest::Body::wrap_stream(futures_util::stream::iter(chunks));
    let request = farm
        .request(Method::POST, "jobs")
        .header("content-type", "application/json");
    expect_problem(request.body(stream).send().await.unwrap(), ErrorCode::Limit).await;
    for query in ["jobs?limit=0", "jobs?limit=101"] {
        let problem = expect_problem(farm.get(query).await, ErrorCode::Invalid).await;
        assert_eq!(problem.field.as_deref(), Some("limit"));
    }
    for query in ["jobs?cursor=x", "jobs?limit=x", "jobs?colour=red"] {
        expect_problem(farm.get(query).await, ErrorCode::Malformed).await;
    }
}

#[tokio::test]
async fn bundles_take_what_they_name_and_nothing_else() {
    let farm = Farm::start().await;
    let bad_name = json!({"files": {"b/../a": {"hash": "0".repeat(64), "bytes": 1}}});
    let problem = expect_problem(farm.post_json("bundles", &bad_name).await, ErrorCode::Invalid).await;
    assert!(problem.detail.contains("plain form, here \"a\""), "{problem:?}");
    let huge = json!({"files": {"a": {"hash": "0".repeat(64), "bytes": u64::MAX}}});
    let problem = expect_problem(farm.post_json("bundles", &huge).await, ErrorCode::Limit).await;
    assert_eq!(problem.field.as_deref(), Some("file_bytes"));

    let put = async |hash: BlobHash, body: &'static [u8]| {
        farm.request(Method::PUT, &format!("blobs/{hash}"))
            .body(body)
            .send()
            .await
            .unwrap()
    };
    expect_problem(put(BlobHash::of(b"unnamed"), b"unnamed").await, ErrorCode::NotFound).await;

    let files = [
        ("scene.xml".to_owned(), FileEntry::of(SCENE)),
        ("b".to_owned(), FileEntry::of(SCENE)),
    ]
    .into();
    let manifest = serde_json::to_value(BundleManifest { files }).unwrap();
    let reply: BundleReply = farm.post_json("bundles", &manifest).await.json().await.unwrap();
    let hash = FileEntry::of(SCENE).hash;
    assert_eq!(reply.missing, [hash]);
    let job = json!({"scene": reply.bundle, "main": "b", "integrator": {"type": "path"}, "iterations": 1});
    expect_problem(farm.post_json("jobs", &job).await, ErrorCode::BundleIncomplete).await;
    expect_problem(put(hash, b"<scene?>").await, ErrorCode::ContentMismatch).await;
    expect_problem(put(hash, b"<scene/> and more").await, ErrorCode::ContentMismatch).await;
    expect_problem(put(hash, b"<s").await, ErrorCode::ContentMismatch).await;
    expect_problem(farm.get(&format!("blobs/{hash}")).await, ErrorCode::NotFound).await;
    assert_eq!(put(hash, SCENE).await.status(), StatusCode::CREATED);
    assert_eq!(put(hash, SCENE).await.status(), StatusCode::NO_CONTENT);
    assert_eq!(farm.get(&format!("blobs/{hash}")).await.bytes().await.unwrap(), SCENE);
    assert_eq!(
        farm.get(&format!("bundles/{}", reply.bundle))
            .await
            .json::<Value>()
            .await
            .unwrap(),
        manifest
    );
    assert_eq!(farm.post_json("jobs", &job).await.status(), StatusCode::CREATED);
}

#[tokio::test]
async fn jobs_that_cannot_be_are_refused_with_the_field() {
    let farm = Farm::start().await;
    let good = farm.spec(4).await;
    let cases = [
        ("scene", json!("0".repeat(64)), "scene", ErrorCode::Invalid),
        ("main", json!("other.xml"), "main", ErrorCode::Invalid),
        ("iterations", json!(0), "iterations", ErrorCode::Invalid),
        ("iterations", json!(101), "iterations", ErrorCode::Limit),
        (
            "integrator",
            json!({"type": "pppm", "alpha": 1.5}),
            "integrator.alpha",
            ErrorCode::Invalid,
        ),
        (
            "integrator",
            json!({"type": "pcf", "lookup_vertex": 0}),
            "integrator",
            ErrorCode::Invalid,
        ),
        (
            "integrator",
            json!({"type": "magic"}),
            "integrator.type",
            ErrorCode::Invalid,
        ),
    ];
    for (field, value, expected, code) in cases {
        let mut spec = good.clone();
        spec[field] = value;
        let problem = expect_problem(farm.post_json("jobs", &spec).await, code).await;
        assert_eq!(problem.field.as_deref(), Some(expected), "{problem}");
    }
    assert!(farm.get("jobs").await.json::<JobPage>().await.unwrap().jobs.is_empty());
}

#[tokio::test]
async fn a_key_makes_a_submission_repeatable() {
    let farm = Farm::start().await;
    let (four, five) = (farm.spec(4).await, farm.spec(5).await);
    let post = async |spec: &Value, key: &str| {
        farm.request(Method::POST, "jobs")
            .json(spec)
            .header("Idempotency-Key", key)
            .send()
            .await
            .unwrap()
    };
    let first = post(&four, "one").await;
    assert_eq!(first.status(), StatusCode::CREATED);
    assert_eq!(first.headers()["location"], "/v1/jobs/1");
    let again = post(&four, "one").await;
    assert_eq!(again.status(), StatusCode::OK);
    assert_eq!(again.json::<JobStatus>().await.unwrap().id, JobId(1));
    let mut named = four.clone();
    named["name"] = "ring".into();
    assert_eq!(
        post(&named, "one").await.status(),
        StatusCode::OK,
        "a name changes nothing"
    );
    expect_problem(post(&five, "one").await, ErrorCode::IdempotencyKeyReused).await;
    expect_problem(post(&five, &"k".repeat(256)).await, ErrorCode::Malformed).await;
    assert_eq!(post(&four, "two").await.json::<JobStatus>().await.unwrap().id, JobId(2));
}

#[tokio::test]
async fn pages_follow_one_another() {
    let farm = Farm::start().await;
    for _ in 0..5 {
        farm.submit(1).await;
    }
    let mut path = "jobs?limit=2".to_owned();
    let mut seen = Vec::new();
    loop {
        let page: JobPage = farm.get(&path).await.json().await.unwrap();
        assert!(page.jobs.len() <= 2);
        seen.extend(page.jobs.iter().map(|job| job.id.0));
        let Some(next) = page.next else { break };
        path = format!("jobs?limit=2&cursor={next}");
    }
    assert_eq!(seen, [5, 4, 3, 2, 1]);
}

#[tokio::test]
async fn the_interface_describes_itself() {
    let farm = Farm::start().await;
    let document: Value = farm.get("openapi.json").await.json().await.unwrap();
    let paths: Vec<&String> = document["paths"].as_object().unwrap().keys().collect();
    for path in [
        "/v1/jobs",
        "/v1/jobs/{id}",
        "/v1/jobs/{id}/image.exr",
        "/v1/bundles",
        "/v1/jobs/{id}/events",
    ] {
        assert!(paths.iter().any(|known| *known == path), "{path} in {paths:?}");
    }
    assert!(document["components"]["schemas"]["JobStatus"].is_object());
    let page = farm.get("docs").await;
    assert_eq!(page.headers()["content-type"], "text/html; charset=utf-8");
    assert!(page.text().await.unwrap().contains("create_job"));
}

#[tokio::test]
async fn requests_have_names() {
    let farm = Farm::start().await;
    let url = format!("{}/v1/jobs/99", farm.coordinator.url());
    let ask = async |name: &str| {
        let reply = farm.http.get(&url).header("x-request-id", name).send().await.unwrap();
        expect_problem(reply, ErrorCode::NotFound).await.request_id.unwrap()
    };
    assert_eq!(&*ask("proxy-7").await, "proxy-7");
    let (first, second) = (ask("a b").await, ask("a b").await);
    assert_eq!((first.len(), second.len()), (16, 16));
    assert_ne!(first, second);
}

#[tokio::test]
async fn a_coordinator_stays_on_its_machine_and_alone_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let listener = async |address| TcpListener::bind(address).await.unwrap();
    let outside = Coordinator::start(Config::new(folder.path()), listener("0.0.0.0:0").await).await;
    assert!(matches!(outside, Err(StartError::NoToken(_))));
    let first = Coordinator::start(Config::new(folder.path()), listener("127.0.0.1:0").await)
        .await
        .unwrap();
    let second = Coordinator::start(Config::new(folder.path()), listener("127.0.0.1:0").await).await;
    assert!(matches!(second, Err(StartError::Store(_))));
    first.shutdown().await;
}

/// A file that was cut short on the disk is asked for again, and a new one takes its place; so does one of other bytes.
#[tokio::test]
async fn damaged_files_are_repaired_by_sending_them_again() {
    let farm = Farm::start().await;
    let bundle = farm.bundle().await;
    let hash = BlobHash::of(SCENE);
    let digits = hash.to_string();
    let file = farm._folder.path().join("scenes").join(&digits[..2]).join(&digits[2..]);
    let manifest: Value = farm.get(&format!("bundles/{bundle}")).await.json().await.unwrap();
    for (damage, missing) in [(&SCENE[..3], vec![hash]), (b"<scene?>".as_slice(), vec![])] {
        std::fs::write(&file, damage).unwrap();
        let reply: BundleReply = farm.post_json("bundles", &manifest).await.json().await.unwrap();
        assert_eq!(reply.missing, missing);
        let put = farm.request(Method::PUT, &format!("blobs/{hash}")).body(SCENE);
        assert!(put.send().await.unwrap().status().is_success());
        assert_eq!(std::fs::read(&file).unwrap(), SCENE);
    }
    farm.submit(1).await;
}

#[tokio::test]
async fn event_streams_pass_proxies_and_go_on_where_they_broke() {
    let farm = Farm::start().await;
    let job = farm.submit(1).await;
    let path = format!("jobs/{job}/events");
    let mut first = farm.get(&path).await;
    assert_eq!(first.headers()["x-accel-buffering"], "no");
    assert_eq!(first.headers()["cache-control"], "no-cache");
    let event = first.chunk().await.unwrap().unwrap();
    let field = |text: &str, name: &str| {
        let mut lines = text.lines().filter_map(|line| line.strip_prefix(name));
        lines
            .next()
            .map(|value| value.trim_start_matches(':').trim().to_owned())
    };
    let event = String::from_utf8(event.into()).unwrap();
    assert_eq!(field(&event, "retry").as_deref(), Some("1000"));
    let id = field(&event, "id").unwrap();
    let ask = |id: String| farm.request(Method::GET, &path).header("last-event-id", id).send();
    let again = ask(id.clone()).await.unwrap();
    let cancel = farm.request(Method::POST, &format!("jobs/{job}/cancel")).send();
    assert_eq!(cancel.await.unwrap().status(), StatusCode::OK);
    let rest = again.text().await.unwrap();
    assert!(rest.starts_with("event: end"), "what came already came again: {rest}");
    let end = field(&rest, "id").unwrap();
    assert_eq!(ask(end).await.unwrap().status(), StatusCode::NO_CONTENT);
    let old = ask(id).await.unwrap().text().await.unwrap();
    assert!(old.starts_with("event: end"), "{old}");
}
