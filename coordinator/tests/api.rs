//! The HTTP interface over a real connection: what clients and workers send right, wrong and twice.

use photonfarm_coordinator::{Config, Coordinator, StartError};
use photonfarm_core::film::Node;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::api::{BundleReply, JobPage, WorkerList};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::codec::{MESSAGE_MEDIA_TYPE, Message, decode, encode};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{JobState, JobStatus, Totals};
use photonfarm_proto::node::{NodeHeader, NodeKey, encode_node};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{
    Assignment, LeaseReply, LeaseRequest, NodeReply, NodeUpload, Register, Registered, frame_upload,
};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::net::TcpListener;

const SCENE: &[u8] = b"<scene/>";

struct Farm {
    _folder: TempDir,
    coordinator: Coordinator,
    http: reqwest::Client,
}

impl Farm {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::new(folder.path());
        config.limits.json_bytes = 4096;
        config.limits.pixels = 1000;
        config.limits.iterations = 100;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let coordinator = Coordinator::start(config, listener).await.unwrap();
        Self {
            _folder: folder,
            coordinator,
            http: reqwest::Client::builder().no_proxy().build().unwrap(),
        }
    }

    fn request(&self, method: Method, path: &str) -> reqwest::RequestBuilder {
        self.http
            .request(method, format!("{}/v1/{path}", self.coordinator.url()))
    }

    async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }

    async fn post_json(&self, path: &str, body: &Value) -> Response {
        self.request(Method::POST, path).json(body).send().await.unwrap()
    }

    async fn bundle(&self) -> BlobHash {
        let files = [("scene.xml".to_owned(), FileEntry::of(SCENE))].into();
        let manifest = serde_json::to_value(BundleManifest { files }).unwrap();
        let reply: BundleReply = self.post_json("bundles", &manifest).await.json().await.unwrap();
        for hash in reply.missing {
            let put = self
                .request(Method::PUT, &format!("blobs/{hash}"))
                .body(SCENE)
                .send()
                .await
                .unwrap();
            assert_eq!(put.status(), StatusCode::CREATED);
        }
        reply.bundle
    }

    async fn spec(&self, iterations: u32) -> Value {
        let scene = self.bundle().await;
        json!({"scene": scene, "main": "scene.xml", "integrator": {"type": "path"}, "iterations": iterations})
    }

    async fn submit(&self, iterations: u32) -> JobId {
        let reply = self.post_json("jobs", &self.spec(iterations).await).await;
        assert_eq!(reply.status(), StatusCode::CREATED);
        reply.json::<JobStatus>().await.unwrap().id
    }

    async fn status(&self, job: JobId) -> JobStatus {
        self.get(&format!("jobs/{job}")).await.json().await.unwrap()
    }

    async fn send(&self, path: &str, body: Vec<u8>) -> Response {
        let request = self.request(Method::POST, &format!("worker/{path}"));
        request
            .header("content-type", MESSAGE_MEDIA_TYPE)
            .body(body)
            .send()
            .await
            .unwrap()
    }

    async fn call<M: Message, R: Message>(&self, path: &str, message: &M) -> R {
        let reply = self.send(path, encode(message).unwrap()).await;
        assert_eq!(reply.status(), StatusCode::OK, "{path}");
        decode(&reply.bytes().await.unwrap()).unwrap()
    }

    async fn register(&self) -> WorkerId {
        let renderer = env!("CARGO_PKG_VERSION").to_owned();
        let register = Register {
            name: "test".into(),
            threads: 1,
            renderer,
        };
        self.call::<_, Registered>("register", &register).await.worker
    }

    async fn lease(&self, worker: WorkerId) -> Assignment {
        let request = LeaseRequest {
            worker,
            held: vec![],
            wait_ms: 10_000,
        };
        self.call::<_, LeaseReply>("lease", &request).await.assignment.unwrap()
    }
}

async fn expect_problem(reply: Response, code: ErrorCode) -> Problem {
    assert_eq!(reply.headers()["content-type"], "application/problem+json");
    let status = reply.status().as_u16();
    let problem: Problem = reply.json().await.unwrap();
    assert_eq!((problem.code, status), (code, code.status()), "{problem}");
    problem
}

fn leaf(index: u32, value: f32) -> Node {
    Node::leaf(index, 2, 2, &[Spectrum::splat(value); 4]).unwrap()
}

fn upload(assignment: &Assignment, node: &Node) -> (NodeUpload, Vec<u8>) {
    let image = encode_node(assignment.lease.job, node);
    let announcement = NodeUpload {
        token: assignment.lease.token,
        worker: assignment.lease.worker,
        job: assignment.lease.job,
        node: NodeKey {
            level: node.level,
            index: node.index,
        },
        width: node.width,
        height: node.height,
        digest: BlobHash::of(&image),
        totals: Totals::default(),
    };
    (announcement, image[NodeHeader::BYTES..].to_vec())
}

fn body((announcement, planes): &(NodeUpload, Vec<u8>)) -> Vec<u8> {
    [frame_upload(announcement).unwrap().as_slice(), planes].concat()
}

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
    for query in ["jobs?cursor=x", "jobs?limit=x", "jobs?colour=red"] {
        expect_problem(farm.get(query).await, ErrorCode::Malformed).await;
    }
}

#[tokio::test]
async fn bundles_take_what_they_name_and_nothing_else() {
    let farm = Farm::start().await;
    let bad_name = json!({"files": {"../a": {"hash": "0".repeat(64), "bytes": 1}}});
    let problem = expect_problem(farm.post_json("bundles", &bad_name).await, ErrorCode::Invalid).await;
    assert!(problem.detail.contains(".."));
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
async fn images_come_at_any_time_and_are_named_by_their_tag() {
    let farm = Farm::start().await;
    let job = farm.submit(3).await;
    expect_problem(farm.get(&format!("jobs/{job}/image.png")).await, ErrorCode::NoImageYet).await;
    expect_problem(farm.get("jobs/9/image.png").await, ErrorCode::NotFound).await;
    let worker = farm.register().await;
    let assignment = farm.lease(worker).await;
    let sent = farm.send("nodes", body(&upload(&assignment, &leaf(0, 0.5)))).await;
    assert_eq!(sent.status(), StatusCode::OK);
    for (name, magic) in [("image.exr", b"\x76\x2f\x31\x01"), ("image.png", b"\x89PNG")] {
        let path = format!("jobs/{job}/{name}");
        let reply = farm.get(&path).await;
        let tag = reply.headers()["etag"].clone();
        assert_eq!(reply.bytes().await.unwrap()[..4], magic[..]);
        let same = farm
            .request(Method::GET, &path)
            .header("if-none-match", &tag)
            .send()
            .await
            .unwrap();
        assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
        let other = farm
            .request(Method::GET, &path)
            .header("if-none-match", "\"x\"")
            .send()
            .await
            .unwrap();
        assert_eq!(other.status(), StatusCode::OK);
    }
}

#[tokio::test]
async fn nodes_count_once_and_stale_tokens_never() {
    let farm = Farm::start().await;
    let job = farm.submit(2).await;
    let worker = farm.register().await;
    let first = farm.lease(worker).await;
    assert_eq!(first.lease.node, NodeKey::leaf(0));
    let good = body(&upload(&first, &leaf(0, 0.5)));
    for duplicate in [false, true, true] {
        let reply = farm.send("nodes", good.clone()).await;
        assert_eq!(
            decode::<NodeReply>(&reply.bytes().await.unwrap()).unwrap(),
            NodeReply { duplicate }
        );
    }
    let other = body(&upload(&first, &leaf(0, 0.75)));
    expect_problem(farm.send("nodes", other).await, ErrorCode::ResultConflict).await;
    let second = farm.lease(worker).await;
    let (mut forged, planes) = upload(&second, &leaf(1, 0.5));
    forged.token = LeaseToken(second.lease.token.0 + 5);
    expect_problem(farm.send("nodes", body(&(forged, planes))).await, ErrorCode::StaleLease).await;
    assert_eq!(farm.status(job).await.iterations_done, 1);
    let last = body(&upload(&second, &leaf(1, 0.25)));
    assert_eq!(farm.send("nodes", last.clone()).await.status(), StatusCode::OK);
    while farm.status(job).await.state != JobState::Done {
        tokio::task::yield_now().await;
    }
    assert_eq!(
        farm.send("nodes", last).await.status(),
        StatusCode::OK,
        "a repeat after the end is known, too"
    );
    assert_eq!(farm.send("nodes", good).await.status(), StatusCode::OK);
}

#[tokio::test]
async fn damaged_nodes_are_refused_and_nothing_counts() {
    let farm = Farm::start().await;
    let job = farm.submit(2).await;
    let worker = farm.register().await;
    let lease = farm.lease(worker).await;
    let (good, planes) = upload(&lease, &leaf(0, 0.5));
    let send = async |change: &dyn Fn(&mut NodeUpload), planes: &[u8]| {
        let mut announcement = good.clone();
        change(&mut announcement);
        farm.send("nodes", body(&(announcement, planes.to_vec()))).await
    };
    expect_problem(farm.send("nodes", vec![]).await, ErrorCode::Malformed).await;
    expect_problem(farm.send("nodes", vec![0xff; 40]).await, ErrorCode::Malformed).await;
    expect_problem(send(&|_| {}, &planes[1..]).await, ErrorCode::Malformed).await;
    expect_problem(send(&|_| {}, &[&planes[..], &[0]].concat()).await, ErrorCode::Malformed).await;
    let mut flipped = planes.clone();
    flipped[5] ^= 1;
    expect_problem(send(&|_| {}, &flipped).await, ErrorCode::ContentMismatch).await;
    expect_problem(send(&|u| u.width = u32::MAX, &planes).await, ErrorCode::Limit).await;
    expect_problem(send(&|u| u.width = 0, &planes).await, ErrorCode::Invalid).await;
    expect_problem(
        send(&|u| u.node = NodeKey { level: 40, index: 0 }, &planes).await,
        ErrorCode::Invalid,
    )
    .await;
    expect_problem(send(&|u| u.node = NodeKey::leaf(2), &planes).await, ErrorCode::Invalid).await;
    expect_problem(send(&|u| u.job = JobId(77), &planes).await, ErrorCode::NotFound).await;
    expect_problem(
        send(&|u| u.totals.seconds.other = f64::NAN, &planes).await,
        ErrorCode::Invalid,
    )
    .await;
    let mut poisoned = leaf(0, 0.5);
    poisoned.sum[2] = f32::NAN;
    expect_problem(
        farm.send("nodes", body(&upload(&lease, &poisoned))).await,
        ErrorCode::Invalid,
    )
    .await;
    let whole = body(&(good.clone(), planes.clone()));
    for length in (4..whole.len()).step_by(7) {
        expect_problem(farm.send("nodes", whole[..length].to_vec()).await, ErrorCode::Malformed).await;
    }
    assert_eq!(farm.status(job).await.iterations_done, 0);
    assert_eq!(send(&|_| {}, &planes).await.status(), StatusCode::OK);
    let next = farm.lease(worker).await;
    let bigger = Node::leaf(1, 3, 2, &[Spectrum::ONE; 6]).unwrap();
    let problem = expect_problem(
        farm.send("nodes", body(&upload(&next, &bigger))).await,
        ErrorCode::Invalid,
    )
    .await;
    assert!(problem.detail.contains("3 x 2"), "{problem}");
    assert_eq!(farm.status(job).await.iterations_done, 1);
}

#[tokio::test]
async fn workers_of_another_version_and_garbage_are_refused() {
    let farm = Farm::start().await;
    let register = Register {
        name: "w".into(),
        threads: 1,
        renderer: "0.0.0-other".into(),
    };
    let mut frame = encode(&register).unwrap();
    expect_problem(farm.send("register", frame.clone()).await, ErrorCode::VersionMismatch).await;
    frame[4] = 99;
    let problem = expect_problem(farm.send("register", frame.clone()).await, ErrorCode::VersionMismatch).await;
    assert!(problem.detail.contains("99"), "{problem}");
    for path in ["register", "lease", "heartbeat", "failures", "release", "leave"] {
        expect_problem(farm.send(path, b"garbage!".to_vec()).await, ErrorCode::Malformed).await;
        expect_problem(farm.send(path, vec![]).await, ErrorCode::Malformed).await;
        let json = farm.post_json(&format!("worker/{path}"), &json!({})).await;
        expect_problem(json, ErrorCode::UnsupportedMediaType).await;
    }
    let request = LeaseRequest {
        worker: WorkerId(5),
        held: vec![],
        wait_ms: 0,
    };
    expect_problem(
        farm.send("lease", encode(&request).unwrap()).await,
        ErrorCode::UnknownWorker,
    )
    .await;
    assert!(
        farm.get("workers")
            .await
            .json::<WorkerList>()
            .await
            .unwrap()
            .workers
            .is_empty()
    );
    farm.register().await;
    let workers = farm.get("workers").await.json::<WorkerList>().await.unwrap().workers;
    assert_eq!((workers.len(), workers[0].name.as_str()), (1, "test"));
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
}

#[tokio::test]
async fn a_coordinator_stays_on_its_machine_and_alone_in_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let listener = async |address| TcpListener::bind(address).await.unwrap();
    let outside = Coordinator::start(Config::new(folder.path()), listener("0.0.0.0:0").await).await;
    assert!(matches!(outside, Err(StartError::NotLoopback(_))));
    let first = Coordinator::start(Config::new(folder.path()), listener("127.0.0.1:0").await)
        .await
        .unwrap();
    let second = Coordinator::start(Config::new(folder.path()), listener("127.0.0.1:0").await).await;
    assert!(matches!(second, Err(StartError::Store(_))));
    first.shutdown().await;
    let mut allowed = Config::new(folder.path());
    allowed.insecure_listen = true;
    Coordinator::start(allowed, listener("0.0.0.0:0").await)
        .await
        .unwrap()
        .shutdown()
        .await;
}
