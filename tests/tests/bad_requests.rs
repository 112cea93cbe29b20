//! Broken requests against a running coordinator: each gets its error, none ends the service or fills its memory.

use photonfarm_core::film::Node;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::api::BundleReply;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::codec::{self, MESSAGE_MEDIA_TYPE};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{FailureKind, JobStatus, Totals};
use photonfarm_proto::node::{NodeHeader, NodeKey, encode_node};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{
    FailureReport, Heartbeat, LeaseProgress, LeaseReply, LeaseRequest, NodeReply, NodeUpload, Register, Registered,
    Release, frame_upload,
};
use photonfarm_tests::processes::{Coordinator, http};
use reqwest::Method;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

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
        ("/integrator/type", vec![json!("bdpt"), json!(null), json!(1)]),
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
        "../x",
        "/etc/passwd",
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
        "/",
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

/// Every worker message, valid in form.
fn messages() -> Vec<(&'static str, Vec<u8>)> {
    let (worker, token, job) = (WorkerId(1), LeaseToken(1), JobId(1));
    let leases = vec![LeaseProgress { token, leaves_done: 0 }];
    let report = FailureReport {
        token,
        worker,
        job,
        leaf: 0,
        kind: FailureKind::Render,
        message: "m".into(),
    };
    let register = Register {
        name: "a".into(),
        threads: 1,
        renderer: "0".into(),
        tags: Default::default(),
    };
    vec![
        ("/v1/worker/register", codec::encode(&register).unwrap()),
        (
            "/v1/worker/lease",
            codec::encode(&LeaseRequest {
                worker,
                wait_ms: 0,
                held: Vec::new(),
            })
            .unwrap(),
        ),
        (
            "/v1/worker/heartbeat",
            codec::encode(&Heartbeat { worker, leases }).unwrap(),
        ),
        (
            "/v1/worker/nodes",
            frame_upload(&upload(worker, token, job, NodeKey::leaf(0))).unwrap(),
        ),
        ("/v1/worker/failures", codec::encode(&report).unwrap()),
        (
            "/v1/worker/release",
            codec::encode(&Release { token, worker, job }).unwrap(),
        ),
    ]
}

fn upload(worker: WorkerId, token: LeaseToken, job: JobId, node: NodeKey) -> NodeUpload {
    let (digest, totals) = (BlobHash::of(b""), Totals::default());
    NodeUpload {
        token,
        worker,
        job,
        node,
        width: 2,
        height: 2,
        digest,
        totals,
    }
}

#[test]
fn damaged_worker_messages() {
    let target = Target::start();
    for (path, valid) in messages() {
        for end in 0..valid.len() {
            target.refused_message(path, &valid[..end]);
        }
        for bit in 0..valid.len() * 8 {
            let mut damaged = valid.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            // Some of these are valid requests, which may be granted; none is a fault of the service.
            let (status, _) = target.send(Method::POST, path, MESSAGE_MEDIA_TYPE, &damaged);
            assert!(status < 500, "{path} answered {status} with bit {bit} flipped");
        }
        // From the eighth byte on there are counts and lengths: all of them huge.
        let huge = [&valid[..8.min(valid.len())], &[0xff; 64]].concat();
        target.refused_message(path, &huge);
        target.refused_message(path, &[valid.as_slice(), &[0]].concat());
        target.refused_message(path, &[0; 4096]);
        let problem = target.refused(Method::POST, path, JSON, &valid);
        assert_eq!(problem.code, ErrorCode::UnsupportedMediaType);
    }
    target.finish();
}

fn planes(job: JobId, node: &Node) -> Vec<u8> {
    encode_node(job, node)[NodeHeader::BYTES..].to_vec()
}

fn image(value: f32) -> Node {
    Node::leaf(0, 2, 2, &[Spectrum::splat(value); 4]).unwrap()
}

#[test]
fn uploads_that_must_not_count() {
    let target = Target::start();
    let job = target.submit(4);
    let register = Register {
        name: "test".into(),
        threads: 1,
        renderer: photonfarm_proto::RENDERER.to_owned(),
        tags: Default::default(),
    };
    let Registered { worker, .. } = target.ask("/v1/worker/register", &register);
    let request = LeaseRequest {
        worker,
        wait_ms: 0,
        held: Vec::new(),
    };
    let LeaseReply { assignment } = target.ask("/v1/worker/lease", &request);
    let lease = assignment.unwrap().lease;
    let good = image(0.5);
    let digest = BlobHash::of(&encode_node(job, &good));
    let valid = NodeUpload {
        digest,
        ..upload(worker, lease.token, job, NodeKey::leaf(0))
    };
    let body = |upload: &NodeUpload, planes: &[u8]| [frame_upload(upload).unwrap(), planes.to_vec()].concat();
    let good_planes = planes(job, &good);

    let mut bad_totals = valid.clone();
    bad_totals.totals.seconds.other = f64::NAN;
    for (what, body) in [
        ("no planes", body(&valid, b"")),
        ("short planes", body(&valid, &good_planes[..good_planes.len() - 1])),
        ("long planes", body(&valid, &[good_planes.as_slice(), &[0]].concat())),
        (
            "another hash",
            body(
                &NodeUpload {
                    digest: BlobHash::of(b"?"),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a huge image",
            body(
                &NodeUpload {
                    width: u32::MAX,
                    height: u32::MAX,
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "no pixels",
            body(
                &NodeUpload {
                    width: 0,
                    ..valid.clone()
                },
                b"",
            ),
        ),
        (
            "a node beyond the job",
            body(
                &NodeUpload {
                    node: NodeKey::leaf(4),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a level beyond all",
            body(
                &NodeUpload {
                    node: NodeKey { level: 63, index: 0 },
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "an unknown job",
            body(
                &NodeUpload {
                    job: JobId(99),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a lease never given",
            body(
                &NodeUpload {
                    token: LeaseToken(u64::MAX),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        ("bad totals", body(&bad_totals, &good_planes)),
    ] {
        let problem = target.refused_message("/v1/worker/nodes", &body);
        assert_ne!(problem.code, ErrorCode::Internal, "{what}");
    }
    let (_, answer) = target.send(Method::GET, &format!("/v1/jobs/{job}"), JSON, b"");
    assert_eq!(serde_json::from_slice::<JobStatus>(&answer).unwrap().iterations_done, 0);

    for duplicate in [false, true] {
        let (status, answer) = target.send(
            Method::POST,
            "/v1/worker/nodes",
            MESSAGE_MEDIA_TYPE,
            &body(&valid, &good_planes),
        );
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&answer));
        assert_eq!(codec::decode::<NodeReply>(&answer).unwrap(), NodeReply { duplicate });
    }
    let other = image(0.25);
    let conflict = NodeUpload {
        digest: BlobHash::of(&encode_node(job, &other)),
        ..valid
    };
    let problem = target.refused_message("/v1/worker/nodes", &body(&conflict, &planes(job, &other)));
    assert_eq!(problem.code, ErrorCode::ResultConflict);

    let LeaseReply { assignment } = target.ask("/v1/worker/lease", &request);
    let lease = assignment.unwrap().lease;
    let mut bad_pixel = Node::leaf(lease.node.index, 2, 2, &[Spectrum::splat(0.5); 4]).unwrap();
    bad_pixel.sum[3] = f32::NAN;
    let of_bad_pixel = NodeUpload {
        digest: BlobHash::of(&encode_node(job, &bad_pixel)),
        ..upload(worker, lease.token, job, lease.node)
    };
    let of_bad_pixel = body(&of_bad_pixel, &planes(job, &bad_pixel));
    for code in [ErrorCode::Invalid, ErrorCode::StaleLease] {
        let problem = target.refused_message("/v1/worker/nodes", &of_bad_pixel);
        assert_eq!(problem.code, code, "a failure ends the lease");
    }
    target.finish();
}

/// Sends raw bytes, then `filler` again and again until the service answers or hangs up; returns what it answered.
fn raw(target: &Target, head: &[u8], filler: &[u8]) -> String {
    let address = target.coordinator.url.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let mut reader = stream.try_clone().unwrap();
    let answer = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        let length = reader.read(&mut bytes).unwrap_or(0);
        String::from_utf8_lossy(&bytes[..length]).into_owned()
    });
    let mut sent = stream.write_all(head);
    while sent.is_ok() && !filler.is_empty() && !answer.is_finished() {
        sent = stream.write_all(filler);
    }
    answer.join().unwrap()
}

#[test]
fn huge_and_endless_bodies() {
    let target = Target::start();
    let post = |path: &str, kind: &str, length: &str| {
        format!("POST {path} HTTP/1.1\r\nhost: farm\r\ncontent-type: {kind}\r\n{length}\r\n\r\n").into_bytes()
    };
    let chunk = [b"10000\r\n".as_slice(), &[b' '; 0x10000], b"\r\n"].concat();
    for (path, kind) in [
        ("/v1/jobs", JSON),
        ("/v1/bundles", JSON),
        ("/v1/worker/lease", MESSAGE_MEDIA_TYPE),
    ] {
        let announced = raw(&target, &post(path, kind, "content-length: 1000000000000"), b"");
        assert!(announced.starts_with("HTTP/1.1 413"), "{path}: {announced:?}");
        let endless = raw(&target, &post(path, kind, "transfer-encoding: chunked"), &chunk);
        assert!(endless.starts_with("HTTP/1.1 413"), "{path}: {endless:?}");
    }
    let endless = raw(
        &target,
        &post("/v1/worker/nodes", MESSAGE_MEDIA_TYPE, "transfer-encoding: chunked"),
        &chunk,
    );
    assert!(endless.starts_with("HTTP/1.1 4"), "{endless:?}");
    target.finish();
}

#[test]
fn what_is_not_http() {
    let target = Target::start();
    for head in [
        &b"\0\0\0\0\r\n\r\n"[..],
        b"GET / HTTP/9.9\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET",
    ] {
        let address = target.coordinator.url.trim_start_matches("http://");
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(head).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let _ = stream.read_to_end(&mut Vec::new());
    }
    let endless = raw(&target, b"GET /v1/jobs HTTP/1.1\r\nx: ", &[b'y'; 4096]);
    assert!(endless.is_empty() || endless.starts_with("HTTP/1.1 4"), "{endless:?}");
    target.finish();
}
