//! The worker protocol, from the worker's side, without a renderer.

use anyhow::{Context, Result, bail, ensure};
use axum::body::Bytes;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::check::Checking;
use photonfarm_proto::codec::{self, MESSAGE_MEDIA_TYPE, Message};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::{JobStatus, Totals};
use photonfarm_proto::node::NodeHeader;
use photonfarm_proto::worker::{
    Assignment, Heartbeat, HeartbeatReply, Lease, LeaseProgress, LeaseReply, LeaseRequest, NodeReply, NodeUpload,
    Register, Registered, frame_upload,
};
use reqwest::{Body, Response};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A coordinator.
#[derive(Clone)]
pub(crate) struct Farm {
    http: reqwest::Client,
    url: String,
    /// Counts requests for work, of all workers together.
    serial: Arc<AtomicU64>,
}

/// The pixels that every node is said to have.
#[derive(Clone)]
pub(crate) struct Planes {
    pub(crate) width: u32,
    pub(crate) height: u32,
    bytes: Bytes,
}

impl Planes {
    /// Made-up sums that pass every check.
    pub(crate) fn new(width: u32, height: u32) -> Self {
        let values = width as usize * height as usize * 4;
        let bytes: Vec<u8> = (0..values)
            .flat_map(|i| (0.25 + (i % 251) as f32 / 251.0).to_le_bytes())
            .collect();
        Self {
            width,
            height,
            bytes: bytes.into(),
        }
    }

    pub(crate) fn bytes(&self) -> &Bytes {
        &self.bytes
    }
}

impl Farm {
    pub(crate) fn new(url: &str) -> Result<Self> {
        let http = reqwest::Client::builder().no_proxy().build()?;
        Ok(Self {
            http,
            url: url.trim_end_matches('/').to_owned(),
            serial: Arc::new(AtomicU64::new(1)),
        })
    }

    /// Submits a job of which nothing is ever rendered.
    pub(crate) async fn submit(&self, iterations: u32) -> Result<JobId> {
        let scene = b"<scene version=\"3.0.0\"/>";
        let manifest = BundleManifest {
            files: [("scene.xml".to_owned(), FileEntry::of(scene))].into(),
        };
        succeed(self.http.post(self.path("bundles")).json(&manifest).send().await?).await?;
        let blob = self.path(&format!("blobs/{}", FileEntry::of(scene).hash));
        succeed(self.http.put(blob).body(scene.to_vec()).send().await?).await?;
        let job = serde_json::json!({
            "scene": manifest.hash(), "main": "scene.xml", "integrator": {"type": "path"}, "iterations": iterations,
        });
        let answer = succeed(self.http.post(self.path("jobs")).json(&job).send().await?).await?;
        let status: JobStatus = answer.json().await.context("the coordinator's answer to a job")?;
        Ok(status.id)
    }

    pub(crate) async fn status(&self, job: JobId) -> Result<JobStatus> {
        let answer = self.http.get(self.path(&format!("jobs/{job}"))).send().await?;
        Ok(succeed(answer).await?.json().await?)
    }

    /// Registers a worker that says to have the coordinator's renderer.
    pub(crate) async fn register(&self, name: String) -> Result<Registered> {
        let register = Register {
            name,
            threads: 1,
            renderer: photonfarm_proto::RENDERER.to_owned(),
            tags: BTreeSet::new(),
            memory_mb: None,
        };
        let registered: Registered = self.call("register", &register).await?;
        ensure!(
            !registered.stores,
            "this coordinator has workers put nodes into an object store: not simulated"
        );
        Ok(registered)
    }

    /// Asks for work, and waits for it.
    pub(crate) async fn lease(&self, worker: WorkerId, wait_ms: u64) -> Result<Option<Lease>> {
        let request = LeaseRequest {
            worker,
            serial: self.serial.fetch_add(1, Ordering::Relaxed),
            held: Vec::new(),
            wait_ms,
        };
        let reply: LeaseReply = self.call("lease", &request).await?;
        Ok(reply.assignment.map(|Assignment { lease, .. }| lease))
    }

    /// A sign of life; whether the lease is still held.
    pub(crate) async fn heartbeat(&self, lease: &Lease) -> Result<bool> {
        let progress = LeaseProgress {
            token: lease.token,
            leaves_done: 0,
        };
        let heartbeat = Heartbeat {
            worker: lease.worker,
            leases: vec![progress],
            checking: Checking::Not,
        };
        let reply: HeartbeatReply = self.call("heartbeat", &heartbeat).await?;
        Ok(reply.lost.is_empty())
    }

    /// Delivers the lease's node, of which each iteration is said to have taken `seconds`. Returns whether it counted before.
    pub(crate) async fn deliver(&self, lease: &Lease, planes: &Planes, seconds: f64) -> Result<bool> {
        let header = NodeHeader {
            job: lease.job,
            key: lease.node,
            width: planes.width,
            height: planes.height,
            statistics: 0,
        };
        let bytes = planes.bytes.clone();
        let digest = tokio::task::spawn_blocking(move || {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&header.to_bytes()).update(&bytes);
            BlobHash::from(hasher.finalize())
        })
        .await?;
        let mut totals = Totals::default();
        totals.seconds.other = seconds * lease.node.leaves() as f64;
        let upload = NodeUpload {
            token: lease.token,
            worker: lease.worker,
            job: lease.job,
            node: lease.node,
            width: planes.width,
            height: planes.height,
            digest,
            totals,
            memory_mb: None,
        };
        let parts: [Result<Bytes, std::io::Error>; 2] = [Ok(frame_upload(&upload)?.into()), Ok(planes.bytes.clone())];
        let body = Body::wrap_stream(futures_util::stream::iter(parts));
        let reply: NodeReply = self.post("nodes", body).await?;
        Ok(reply.duplicate)
    }

    async fn call<M: Message, R: Message>(&self, what: &str, message: &M) -> Result<R> {
        self.post(what, codec::encode(message)?.into()).await
    }

    async fn post<R: Message>(&self, what: &str, body: Body) -> Result<R> {
        let url = self.path(&format!("worker/{what}"));
        let request = self
            .http
            .post(url)
            .header("content-type", MESSAGE_MEDIA_TYPE)
            .body(body);
        let answer = succeed(request.send().await?).await?;
        Ok(codec::decode(&answer.bytes().await?)?)
    }

    fn path(&self, path: &str) -> String {
        format!("{}/v1/{path}", self.url)
    }
}

async fn succeed(answer: Response) -> Result<Response> {
    if answer.status().is_success() {
        return Ok(answer);
    }
    let (url, status) = (answer.url().clone(), answer.status());
    bail!("{url}: {status}: {}", answer.text().await.unwrap_or_default())
}
