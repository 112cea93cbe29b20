//! A coordinator over a real connection.

use photonfarm_coordinator::{Config, Coordinator};
use photonfarm_proto::api::BundleReply;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::codec::{MESSAGE_MEDIA_TYPE, Message, decode, encode};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{Assignment, LeaseReply, LeaseRequest, Register, Registered};
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicU64, Ordering};
use tempfile::TempDir;
use tokio::net::TcpListener;

pub(crate) const SCENE: &[u8] = b"<scene/>";

pub(crate) struct Farm {
    pub(crate) _folder: TempDir,
    pub(crate) coordinator: Coordinator,
    pub(crate) http: reqwest::Client,
    /// Counts requests for work.
    serial: AtomicU64,
}

impl Farm {
    pub(crate) async fn start() -> Self {
        Self::start_with(|_| {}).await
    }

    pub(crate) async fn start_with(change: impl FnOnce(&mut Config)) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), change).await
    }

    /// Another coordinator goes on with what this one leaves.
    pub(crate) async fn restart_with(self, change: impl FnOnce(&mut Config)) -> Self {
        self.coordinator.shutdown().await;
        Self::start_in(self._folder, change).await
    }

    async fn start_in(folder: TempDir, change: impl FnOnce(&mut Config)) -> Self {
        let mut config = Config::new(folder.path());
        config.limits.json_bytes = 4096;
        config.limits.pixels = 1000;
        config.limits.iterations = 100;
        change(&mut config);
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let coordinator = Coordinator::start(config, listener).await.unwrap();
        Self {
            _folder: folder,
            coordinator,
            http: reqwest::Client::builder().no_proxy().build().unwrap(),
            serial: AtomicU64::new(1),
        }
    }

    pub(crate) fn request(&self, method: Method, path: &str) -> reqwest::RequestBuilder {
        self.http
            .request(method, format!("{}/v1/{path}", self.coordinator.url()))
    }

    pub(crate) async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path).send().await.unwrap()
    }

    pub(crate) async fn post_json(&self, path: &str, body: &Value) -> Response {
        self.request(Method::POST, path).json(body).send().await.unwrap()
    }

    pub(crate) async fn bundle(&self) -> BlobHash {
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

    pub(crate) async fn spec(&self, iterations: u32) -> Value {
        let scene = self.bundle().await;
        json!({"scene": scene, "main": "scene.xml", "integrator": {"type": "path"}, "iterations": iterations})
    }

    pub(crate) async fn submit(&self, iterations: u32) -> JobId {
        let reply = self.post_json("jobs", &self.spec(iterations).await).await;
        assert_eq!(reply.status(), StatusCode::CREATED);
        reply.json::<JobStatus>().await.unwrap().id
    }

    pub(crate) async fn status(&self, job: JobId) -> JobStatus {
        self.get(&format!("jobs/{job}")).await.json().await.unwrap()
    }

    pub(crate) async fn send(&self, path: &str, body: Vec<u8>) -> Response {
        let request = self.request(Method::POST, &format!("worker/{path}"));
        request
            .header("content-type", MESSAGE_MEDIA_TYPE)
            .body(body)
            .send()
            .await
            .unwrap()
    }

    pub(crate) async fn call<M: Message, R: Message>(&self, path: &str, message: &M) -> R {
        let reply = self.send(path, encode(message).unwrap()).await;
        assert_eq!(reply.status(), StatusCode::OK, "{path}");
        decode(&reply.bytes().await.unwrap()).unwrap()
    }

    pub(crate) async fn register(&self) -> WorkerId {
        let register = Register {
            name: "test".into(),
            threads: 1,
            renderer: photonfarm_proto::RENDERER.to_owned(),
            tags: Default::default(),
        };
        self.call::<_, Registered>("register", &register).await.worker
    }

    pub(crate) async fn lease(&self, worker: WorkerId) -> Assignment {
        let request = LeaseRequest {
            worker,
            serial: self.serial.fetch_add(1, Ordering::Relaxed),
            held: vec![],
            wait_ms: 10_000,
        };
        self.call::<_, LeaseReply>("lease", &request).await.assignment.unwrap()
    }
}

pub(crate) async fn expect_problem(reply: Response, code: ErrorCode) -> Problem {
    assert_eq!(reply.headers()["content-type"], "application/problem+json");
    let status = reply.status().as_u16();
    let name = reply
        .headers()
        .get("x-request-id")
        .map(|name| name.to_str().unwrap().to_owned());
    let problem: Problem = reply.json().await.unwrap();
    assert_eq!(problem.request_id.as_deref(), name.as_deref());
    assert_eq!((problem.code, status), (code, code.status()), "{problem}");
    problem
}
