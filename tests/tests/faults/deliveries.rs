//! Messages that arrive twice, and a scene that cannot be rendered.

use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Request, State};
use axum::response::Response;
use photonfarm_core::picture::{DecodedExr, decode_exr};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::codec;
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::worker::NodeReply;
use photonfarm_tests::processes::{Coordinator, Process, http, jobs, photonfarm, printed, scene, wait_for};
use reqwest::Method;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

const ITERATIONS: u64 = 24;

/// Options of every job here: files beside the scene, a definition, a seed, a setting.
const JOB: [&str; 8] = [
    "--iterations",
    "24",
    "--seed",
    "11",
    "-D",
    "res=64",
    "--set",
    "samples=4",
];

/// The picture and its pixels' bits, by one process with one thread.
fn alone(folder: &Path, integrator: &str) -> Vec<u8> {
    let path = folder.join("alone.exr");
    let scene = scene("environment.xml");
    let mut arguments = vec![
        "render",
        scene.to_str().unwrap(),
        "-o",
        path.to_str().unwrap(),
        "--threads",
        "1",
    ];
    arguments.extend(JOB);
    arguments.extend(["--integrator", integrator]);
    printed(&photonfarm(&arguments));
    std::fs::read(path).unwrap()
}

fn submit(coordinator: &str, output: &Path, integrator: &str) -> Process {
    let scene = scene("environment.xml");
    let mut arguments = vec![
        "submit",
        scene.to_str().unwrap(),
        "--coordinator",
        coordinator,
        "--wait",
    ];
    arguments.extend(["-o", output.to_str().unwrap(), "--integrator", integrator]);
    arguments.extend(JOB);
    Process::start("photonfarm", &arguments)
}

/// The only job, once `condition` holds.
fn when(coordinator: &str, what: &str, condition: impl Fn(&JobStatus) -> bool) -> JobStatus {
    wait_for(what, || {
        jobs(coordinator)?.into_iter().next().filter(|job| condition(job))
    })
}

fn assert_same_picture(farm: &[u8], alone: &[u8]) {
    let bits = |picture: &DecodedExr| -> Vec<[u32; 3]> {
        picture
            .pixels
            .iter()
            .map(|pixel| pixel.to_rgb().map(f32::to_bits))
            .collect()
    };
    let (farm_picture, alone_picture) = (decode_exr(farm, 1 << 20).unwrap(), decode_exr(alone, 1 << 20).unwrap());
    assert!(
        alone_picture.pixels.iter().any(|pixel| !pixel.is_black()),
        "the picture is black"
    );
    assert_eq!(farm_picture.metadata, alone_picture.metadata);
    assert!(bits(&farm_picture) == bits(&alone_picture), "pixels differ");
    assert!(farm == alone, "the pixels are the same, but the files differ");
}

/// Passes requests on; what brings a node's image is sent twice.
#[derive(Clone)]
struct Echo {
    target: String,
    http: reqwest::Client,
    duplicates: Arc<AtomicU32>,
}

async fn pass_on(State(echo): State<Echo>, request: Request) -> Response {
    let (parts, body) = request.into_parts();
    let body: Bytes = to_bytes(body, 1 << 28).await.unwrap();
    let url = format!("{}{}", echo.target, parts.uri);
    let send = || {
        let mut headers = parts.headers.clone();
        headers.remove("host");
        headers.remove("transfer-encoding");
        headers.remove("content-length");
        echo.http
            .request(parts.method.clone(), &url)
            .headers(headers)
            .body(body.clone())
            .send()
    };
    if parts.uri.path() == "/v1/worker/nodes" {
        let first = send().await.unwrap();
        assert!(first.status().is_success(), "{}", first.status());
        first.bytes().await.unwrap();
    }
    let answer = send().await.unwrap();
    let status = answer.status();
    let mut response = Response::builder().status(status);
    for (name, value) in answer.headers() {
        if name != "transfer-encoding" && name != "content-length" {
            response = response.header(name, value);
        }
    }
    let bytes = answer.bytes().await.unwrap();
    if parts.uri.path() == "/v1/worker/nodes" {
        assert!(status.is_success(), "the second delivery was answered {status}");
        let reply: NodeReply = codec::decode(&bytes).unwrap();
        assert!(reply.duplicate, "the second delivery was counted as a new one");
        echo.duplicates.fetch_add(1, Ordering::Relaxed);
    }
    response.body(Body::from(bytes)).unwrap()
}

#[test]
fn iterations_delivered_twice_count_once() {
    let folder = tempfile::tempdir().unwrap();
    let reference = alone(folder.path(), "pppm");
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let echo = Echo {
        target: coordinator.url.clone(),
        http: reqwest::Client::builder().no_proxy().build().unwrap(),
        duplicates: Arc::new(AtomicU32::new(0)),
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let service = axum::Router::new().fallback(pass_on).with_state(echo.clone());
    let server = runtime.spawn(async move { axum::serve(listener, service).await });

    let workers = [(); 2].map(|()| Process::start("photonfarm-worker", &["--coordinator", &address, "--threads", "1"]));
    let path = folder.path().join("farm.exr");
    let (status, _, errors) = submit(&coordinator.url, &path, "pppm").finish();
    assert!(status.success(), "{errors}");
    assert!(
        echo.duplicates.load(Ordering::Relaxed) > 0,
        "nothing was delivered twice"
    );
    assert!(!server.is_finished());
    let job = when(&coordinator.url, "the job's end", |job| job.state.ended());
    assert_eq!(job.iterations_done, ITERATIONS);
    drop(workers);
    assert_same_picture(&std::fs::read(path).unwrap(), &reference);
}

#[test]
fn a_broken_scene_ends_its_job_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let coordinator = Coordinator::start(&folder.path().join("farm"));
    let mut worker = coordinator.worker();
    let post = |path: &str, body: String| {
        let url = format!("{}/v1/{path}", coordinator.url);
        http(
            Method::POST,
            &url,
            body.into_bytes(),
            &[("content-type", "application/json")],
        )
        .unwrap()
    };
    // The command line would not send this scene, so it is sent by hand.
    let content = b"<scene version=\"3.0.0\">\n<shape type=\"teapot\"/>\n</scene>";
    let manifest = BundleManifest {
        files: [("scene.xml".to_owned(), FileEntry::of(content))].into(),
    };
    assert_eq!(post("bundles", serde_json::to_string(&manifest).unwrap()).0, 200);
    let blob = format!("{}/v1/blobs/{}", coordinator.url, FileEntry::of(content).hash);
    assert_eq!(http(Method::PUT, &blob, content.to_vec(), &[]).unwrap().0, 201);
    let job = serde_json::json!({
        "scene": manifest.hash(), "main": "scene.xml", "integrator": {"type": "path"}, "iterations": 4,
    });
    assert_eq!(post("jobs", job.to_string()).0, 201);
    let job = when(&coordinator.url, "the job's end", |job| job.state.ended());
    assert_eq!((job.state, job.iterations_done), (JobState::Failed, 0));
    let failure = job.failure.unwrap();
    assert!(failure.contains("scene.xml:"), "{failure}");

    let path = folder.path().join("farm.exr");
    let (status, _, errors) = submit(&coordinator.url, &path, "path").finish();
    assert!(status.success(), "{errors}");
    assert!(worker.is_running(), "the worker ended by itself");
}
