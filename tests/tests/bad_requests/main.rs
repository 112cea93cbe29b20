//! Broken requests against a running coordinator: each gets its error, none ends the service or fills its memory.

mod bodies;
mod messages;

use photonfarm_proto::api::BundleReply;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::codec::{self, MESSAGE_MEDIA_TYPE};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_tests::processes::{Coordinator, http};
use reqwest::Method;
use serde_json::{Value, json};

const JSON: &str = "application/json";
/// Memory that a coordinator without images may use at most [bytes].
const MEMORY: u64 = 512 << 20;

/// A coordinator under attack; dropping the value without [`Target::finish`] proves nothing.
struct Target {
    coordinator: Coordinator,
    _folder: tempfile::TempDir,
}

impl Target {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self {
            coordinator: Coordinator::start(&folder.path().join("farm")),
            _folder: folder,
        }
    }

    fn send(&self, method: Method, path: &str, kind: &str, body: &[u8]) -> (u16, Vec<u8>) {
        let url = format!("{}{path}", self.coordinator.url);
        http(method, &url, body.to_vec(), &[("content-type", kind)]).unwrap_or_else(|| panic!("no answer to {path}"))
    }

    /// The problem that a request is answered with.
    fn refused(&self, method: Method, path: &str, kind: &str, body: &[u8]) -> Problem {
        let (status, answer) = self.send(method, path, kind, body);
        let shown = String::from_utf8_lossy(&body[..body.len().min(200)]).into_owned();
        assert!((400..500).contains(&status), "{path} answered {status} to {shown:?}");
        let problem: Problem = serde_json::from_slice(&answer).unwrap_or_else(|e| panic!("{path}: {e}: {answer:?}"));
        assert_eq!(problem.status, status);
        assert!(!problem.detail.is_empty());
        problem
    }

    fn refused_json(&self, path: &str, body: &[u8]) -> Problem {
        self.refused(Method::POST, path, JSON, body)
    }

    fn refused_message(&self, path: &str, body: &[u8]) -> Problem {
        self.refused(Method::POST, path, MESSAGE_MEDIA_TYPE, body)
    }

    fn ask<M: codec::Message, R: codec::Message>(&self, path: &str, message: &M) -> R {
        let (status, answer) = self.send(Method::POST, path, MESSAGE_MEDIA_TYPE, &codec::encode(message).unwrap());
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&answer));
        codec::decode(&answer).unwrap()
    }

    /// The service goes on, and has not used much memory.
    fn finish(mut self) {
        assert_eq!(self.send(Method::GET, "/v1/healthz", JSON, b"").0, 200);
        assert!(self.coordinator.is_running());
        if let Some(memory) = self.coordinator.peak_memory() {
            assert!(memory < MEMORY, "the coordinator used {memory} bytes");
        }
    }

    /// Submits a bundle of one file and a job on it.
    fn submit(&self, iterations: u32) -> JobId {
        let content = b"<scene version=\"3.0.0\"/>";
        let manifest = BundleManifest {
            files: [("scene.xml".to_owned(), FileEntry::of(content))].into(),
        };
        let (_, reply) = self.send(
            Method::POST,
            "/v1/bundles",
            JSON,
            &serde_json::to_vec(&manifest).unwrap(),
        );
        let reply: BundleReply = serde_json::from_slice(&reply).unwrap();
        for hash in reply.missing {
            let (status, _) = self.send(
                Method::PUT,
                &format!("/v1/blobs/{hash}"),
                "application/octet-stream",
                content,
            );
            assert_eq!(status, 201);
        }
        let mut job = valid_job();
        job["scene"] = json!(reply.bundle);
        job["iterations"] = json!(iterations);
        let (status, reply) = self.send(Method::POST, "/v1/jobs", JSON, job.to_string().as_bytes());
        assert_eq!(status, 201, "{}", String::from_utf8_lossy(&reply));
        serde_json::from_slice::<JobStatus>(&reply).unwrap().id
    }
}

fn valid_job() -> Value {
    json!({
        "scene": BlobHash::of(b"").to_string(), "main": "scene.xml", "defines": {"a": "b"}, "iterations": 4, "seed": 1,
        "integrator": {"type": "pcf", "photons": 10, "samplers": ["bsdf"], "lookup_vertex": "auto"},
    })
}

#[test]
fn broken_json() {
    let target = Target::start();
    let valid = valid_job().to_string();
    for end in 0..valid.len() {
        target.refused_json("/v1/jobs", &valid.as_bytes()[..end]);
    }
    let deep = [vec![b'['; 100_000], vec![b']'; 100_000]].concat();
    let trailing = format!("{valid} {{}}");
    let bodies: [&[u8]; 9] = [
        b"",
        b"null",
        b"[]",
        b"\"\xff\xfe\"",
        b"\xff\xfe{\0}\0",
        b"{\"iterations\": NaN}",
        b"nul",
        &deep,
        trailing.as_bytes(),
    ];
    for path in ["/v1/jobs", "/v1/bundles"] {
        for body in bodies {
            target.refused_json(path, body);
        }
    }
    let mut job = valid_job();
    job["schedule"] = json!([20, false, null, null, []]);
    let problem = target.refused_json("/v1/jobs", job.to_string().as_bytes());
    assert_eq!(
        (problem.code, problem.field.as_deref()),
        (ErrorCode::Invalid, Some("schedule"))
    );
    let file = json!({"files": {"a": [BlobHash::of(b"").to_string(), 0]}});
    let problem = target.refused_json("/v1/bundles", file.to_string().as_bytes());
    assert_eq!(problem.field.as_deref(), Some("files.a"));
    let problem = target.refused(Method::POST, "/v1/jobs", "text/plain", valid.as_bytes());
    assert_eq!(problem.code, ErrorCode::UnsupportedMediaType);
    target.finish();
}

#[test]
fn jobs_that_cannot_be() {
    let target = Target::start();
    target.submit(1);
    for (field, values) in [
        (
            "/iterations",
            vec![
                json!(0),
                json!(-1),
                json!(1.5),
                json!(1e300),
                json!(4_294_967_296_u64),
                json!("4"),
            ],
        ),
        ("/seed", vec![json!(-1), json!(1e30), json!(null)]),
        (
            "/scene",
            vec![
                json!(""),
                json!("ff"),
                json!("é".repeat(32)),
                json!(0),
                json!(BlobHash::of(b"?")),
            ],
        ),
        (
            "/main",
            vec![json!(""), json!("../scene.xml"), json!(3), json!("x".repeat(1 << 16))],
        ),
        (
            "/defines",
            vec![json!([]), json!({"a": 1}), json!({"a": "x".repeat(1 << 16)})],
        ),
        ("/integrator/type", vec![json!("erpt"), json!(null), json!(1)]),
        (
            "/integrator/photons",
            vec![json!(0), json!(-1), json!(u64::MAX), json!("many")],
        ),
        ("/integrator/alpha", vec![json!(0), json!(1), json!(-1), json!(1e300)]),
        (
            "/integrator/samplers",
            vec![json!([]), json!(["moon"]), json!(["bsdf", "bsdf"])],
        ),
        ("/integrator/lookup_vertex", vec![json!(0), json!("later"), json!({})]),
        ("/integrator/theta1", vec![json!(0), json!(-5), json!(1e30)]),
        ("/integrator/sigma", vec![json!(1)]),
        ("/priority", vec![json!(1)]),
    ] {
        for value in values {
            let mut job = valid_job();
            let (parent, name) = field.rsplit_once('/').unwrap();
            job.pointer_mut(parent).unwrap()[name] = value;
            target.refused_json("/v1/jobs", job.to_string().as_bytes());
        }
    }
    target.finish();
}

#[test]
fn bundles_that_cannot_be() {
    let target = Target::start();
    let entry = |bytes: u64| json!({"hash": BlobHash::of(b"x"), "bytes": bytes});
    for name in [
        "",
        "..",
        "/../etc/passwd",
        "http://x",
        "a//b",
        "a/../b",
        "a\\b",
        "a\0b",
        &"x".repeat(300),
    ] {
        target.refused_json("/v1/bundles", json!({"files": {name: entry(1)}}).to_string().as_bytes());
    }
    let many: serde_json::Map<String, Value> = (0..5000).map(|i| (i.to_string(), entry(1))).collect();
    for files in [json!({}), json!([]), json!({"a": entry(u64::MAX)}), Value::Object(many)] {
        target.refused_json("/v1/bundles", json!({"files": files}).to_string().as_bytes());
    }
    let manifest = json!({"files": {"a": entry(1)}}).to_string();
    assert_eq!(
        target.send(Method::POST, "/v1/bundles", JSON, manifest.as_bytes()).0,
        200
    );
    let path = format!("/v1/blobs/{}", BlobHash::of(b"x"));
    for content in [&b""[..], b"y", b"xx"] {
        let problem = target.refused(Method::PUT, &path, "application/octet-stream", content);
        assert_eq!(problem.code, ErrorCode::ContentMismatch);
    }
    for path in [
        format!("/v1/blobs/{}", BlobHash::of(b"unknown")),
        "/v1/blobs/..%2f..%2fetc%2fpasswd".into(),
    ] {
        assert_eq!(target.refused(Method::PUT, &path, JSON, b"x").code, ErrorCode::NotFound);
        assert_eq!(target.refused(Method::GET, &path, JSON, b"").code, ErrorCode::NotFound);
    }
    target.finish();
}

#[test]
fn paths_that_lead_nowhere() {
    let target = Target::start();
    for id in ["0", "7", "-1", "x", "99999999999999999999", "%00", "%ff"] {
        for path in ["", "/events", "/image.exr", "/image.png", "/image.jpg"] {
            target.refused(Method::GET, &format!("/v1/jobs/{id}{path}"), JSON, b"");
        }
    }
    for path in [
        "/page/none.js",
        "/v1",
        "/v2/jobs",
        "/v1/jobs?cursor=x",
        "/v1/jobs?limit=-1",
        "/v1/jobs?limit=x",
        "/v1/jobs?y=1",
    ] {
        target.refused(Method::GET, path, JSON, b"");
    }
    assert_eq!(
        target.refused(Method::PATCH, "/v1/jobs", JSON, b"").code,
        ErrorCode::MethodNotAllowed
    );
    target.finish();
}
