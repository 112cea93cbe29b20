//! A farm in one process, with a renderer whose pixels are known and which can be held, broken and watched.

use futures_util::StreamExt;
use photonfarm_coordinator::store::ObjectBlobs;
use photonfarm_coordinator::{Config, Coordinator, open_stores};
use photonfarm_core::film::{Image, Node};
use photonfarm_core::integrator::{Counts, Iteration, Observer, Phase, RenderError};
use photonfarm_core::picture::{DecodedExr, decode_exr};
use photonfarm_core::scene::Wishes;
use photonfarm_core::settings::{IntegratorSettings, PppmSettings, STATISTICS_PER_PIXEL, SppmSettings};
use photonfarm_core::spectrum::Spectrum;
use photonfarm_core::tree::Average;
use photonfarm_proto::api::BundleReply;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::{BandwidthRange, JobSpec, JobState, JobStatus};
use photonfarm_test_servers::S3;
use photonfarm_worker::{BundleFiles, CancellationToken, LoadedScene, Renderer, Worker, WorkerConfig, WorkerError};
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;

pub(crate) const SIZE: [u32; 2] = [8, 4];
pub(crate) const SEED: u64 = 7;
const LONG_LEASE_MS: u64 = 3_600_000;
const SHORT_LEASE_MS: u64 = 1_500;

/// What goes wrong with an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    Panics,
    IsNotFinite,
}

/// Control over all renderers of a test.
#[derive(Default)]
pub(crate) struct Stage {
    held: Mutex<BTreeSet<u32>>,
    released: Condvar,
    pub(crate) faults: Mutex<BTreeMap<u32, Fault>>,
    /// Every iteration that was begun, in order.
    pub(crate) begun: watch::Sender<Vec<u32>>,
    pub(crate) completed: Mutex<Vec<u32>>,
}

impl Stage {
    pub(crate) fn hold(&self, iteration: u32) {
        self.held.lock().unwrap().insert(iteration);
    }

    pub(crate) fn release(&self, iteration: u32) {
        self.held.lock().unwrap().remove(&iteration);
        self.released.notify_all();
    }

    /// Waits until an iteration was rendered.
    pub(crate) async fn until_completed(&self, iteration: u32) {
        while !self.completed.lock().unwrap().contains(&iteration) {
            tokio::task::yield_now().await;
        }
    }

    /// Waits until `iteration` was begun `times` times.
    pub(crate) async fn until_begun(&self, iteration: u32, times: usize) {
        let count = |begun: &Vec<u32>| begun.iter().filter(|i| **i == iteration).count() >= times;
        self.begun.subscribe().wait_for(count).await.unwrap();
    }

    fn pass(&self, iteration: u32, observer: &dyn Observer) -> Result<(), RenderError> {
        let mut held = self.held.lock().unwrap();
        while held.contains(&iteration) {
            if observer.cancelled() {
                return Err(RenderError::Cancelled);
            }
            held = self.released.wait_timeout(held, Duration::from_millis(10)).unwrap().0;
        }
        Ok(())
    }
}

/// Values whose sum depends on the order of additions.
pub(crate) fn pixels(seed: u64, iteration: u32) -> Vec<Spectrum> {
    let value = |n: u64| {
        let mixed = (seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (u64::from(iteration) << 32 | n);
        let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed >> 40) as f32 * 1e-5
    };
    let count = u64::from(SIZE[0] * SIZE[1]);
    (0..count)
        .map(|p| Spectrum::from_rgb([value(3 * p), value(3 * p + 1), value(3 * p + 2)]))
        .collect()
}

/// What an iteration of a sequential integrator leaves.
fn statistics(iteration: u32) -> Vec<f32> {
    let values = SIZE[0] as usize * SIZE[1] as usize * STATISTICS_PER_PIXEL;
    (0..values).map(|n| iteration as f32 + n as f32 * 1e-3).collect()
}

/// What one process and one thread would give.
pub(crate) fn reference(seed: u64, iterations: impl IntoIterator<Item = u32>) -> Image {
    let mut average = Average::default();
    for iteration in iterations {
        average
            .push(Node::leaf(iteration - 1, SIZE[0], SIZE[1], &pixels(seed, iteration)).unwrap())
            .unwrap();
    }
    average.finish().unwrap()
}

struct Double(Arc<Stage>);

impl Renderer for Double {
    fn load(&self, files: &BundleFiles, spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String> {
        let main = &spec.main;
        let content = files.bytes(main).map_err(|error| error.to_string())?;
        match content.strip_prefix(b"broken ") {
            Some(reason) => Err(format!("{main}:1: {}", String::from_utf8_lossy(reason))),
            None => Ok(Arc::new(DoubleScene(self.0.clone()))),
        }
    }
}

struct DoubleScene(Arc<Stage>);

impl LoadedScene for DoubleScene {
    fn resolution(&self) -> [u32; 2] {
        SIZE
    }

    fn wishes(&self) -> Wishes {
        Wishes::default()
    }

    fn bandwidth(&self, _: &IntegratorSettings, iteration: u32, _: &[f32]) -> Option<BandwidthRange> {
        Some(BandwidthRange::one(1.0 / iteration as f32, None))
    }

    fn render(
        &self,
        settings: &IntegratorSettings,
        seed: u64,
        iteration: u32,
        before: &[f32],
        observer: &dyn Observer,
    ) -> Result<Iteration, RenderError> {
        let goes_on = settings.is_sequential() && iteration > 1;
        let expected = if goes_on { statistics(iteration - 1) } else { vec![] };
        assert_eq!(before, expected, "iteration {iteration} goes on from another one");
        self.0.begun.send_modify(|begun| begun.push(iteration));
        observer.phase(Phase::TraceCamera);
        self.0.pass(iteration, observer)?;
        observer.phase(Phase::Done);
        let mut pixels = pixels(seed, iteration);
        let fault = self.0.faults.lock().unwrap().get(&iteration).copied();
        match fault {
            Some(Fault::Panics) => panic!("iteration {iteration} went wrong"),
            Some(Fault::IsNotFinite) => pixels[3] = Spectrum::splat(f32::NAN),
            None => {}
        }
        self.0.completed.lock().unwrap().push(iteration);
        let counts = Counts {
            rays: 10,
            light_paths: 1,
            ..Counts::default()
        };
        let statistics = match settings.is_sequential() {
            true => statistics(iteration),
            false => vec![],
        };
        Ok(Iteration {
            pixels,
            counts,
            statistics,
        })
    }
}

/// The files in a folder and in the folders in it.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = entries.flat_map(|path| match path.is_dir() {
        true => files_below(&path),
        false => vec![path],
    });
    files.collect()
}

/// A coordinator that can be restarted on the same address and data, and its workers.
pub(crate) struct Farm {
    pub(crate) stage: Arc<Stage>,
    folder: TempDir,
    address: SocketAddr,
    coordinator: Option<Coordinator>,
    /// How long a lease lasts without a sign of life [ms].
    lease_ms: u64,
    /// Where bytes are, if not in a folder.
    pub(crate) s3: Option<S3>,
    pub(crate) http: reqwest::Client,
}

impl Farm {
    /// A farm whose leases outlast every test, however slow its machine is.
    pub(crate) async fn start() -> Self {
        Self::start_with(LONG_LEASE_MS, None).await
    }

    /// A farm that soon notices when a worker is gone, and tells workers soon what is no longer wanted.
    pub(crate) async fn start_with_short_leases() -> Self {
        Self::start_with(SHORT_LEASE_MS, None).await
    }

    /// A farm whose bytes are objects.
    pub(crate) async fn start_on(s3: Option<S3>) -> Self {
        Self::start_with(LONG_LEASE_MS, s3).await
    }

    async fn start_with(lease_ms: u64, s3: Option<S3>) -> Self {
        let mut farm = Self {
            stage: Arc::default(),
            folder: tempfile::tempdir().unwrap(),
            address: SocketAddr::from(([127, 0, 0, 1], 0)),
            coordinator: None,
            lease_ms,
            s3,
            http: reqwest::Client::builder().no_proxy().build().unwrap(),
        };
        farm.resume().await;
        farm
    }

    /// The files with the images of nodes.
    pub(crate) fn node_files(&self) -> Vec<PathBuf> {
        files_below(&self.folder.path().join("data/nodes"))
    }

    /// Other bytes take the place of a scene's file, as many of them.
    pub(crate) fn damage_scene(&self, content: &[u8]) {
        let folder = match &self.s3 {
            Some(s3) => s3.file("scenes"),
            None => self.folder.path().join("data/scenes"),
        };
        let found = files_below(&folder).into_iter();
        let scenes = found.filter(|path| std::fs::read(path).unwrap() == content);
        let damaged = scenes.map(|path| std::fs::write(path, vec![b'?'; content.len()]).unwrap());
        assert_eq!(damaged.count(), 1);
    }

    pub(crate) fn config(&self) -> Config {
        let mut config = Config::new(self.folder.path().join("data"));
        config.scheduler.lease_ttl_ms = self.lease_ms;
        config.scheduler.reconnect_ms = LONG_LEASE_MS;
        config.scheduler.retry_ms = 10;
        config
    }

    /// Starts the coordinator where it was.
    pub(crate) async fn resume(&mut self) {
        let listener = TcpListener::bind(self.address).await.unwrap();
        self.address = listener.local_addr().unwrap();
        let config = self.config();
        let mut stores = open_stores(&config).await.unwrap();
        if let Some(s3) = &self.s3 {
            let variables = s3.environment().map(|(name, value)| (name.to_owned(), value));
            let objects = ObjectBlobs::open_with("farm", "", variables.into_iter()).await.unwrap();
            (stores.scenes, stores.nodes) = (Arc::new(objects.below("scenes")), Arc::new(objects.below("nodes")));
        }
        self.coordinator = Some(Coordinator::start_with(config, stores, listener).await.unwrap());
    }

    /// Files of finished work that a worker has kept.
    pub(crate) fn kept_by(&self, name: &str) -> usize {
        let files = std::fs::read_dir(self.folder.path().join(name)).unwrap();
        files
            .filter(|file| {
                file.as_ref()
                    .unwrap()
                    .file_name()
                    .to_string_lossy()
                    .starts_with("unsent-")
            })
            .count()
    }

    pub(crate) async fn stop(&mut self) {
        self.coordinator.take().unwrap().shutdown().await;
    }

    pub(crate) fn worker(&self, name: &str) -> TestWorker {
        self.worker_that_drains(name, Duration::from_secs(100))
    }

    /// A worker that may go on for so long when it is told to stop. Its cache is that of other workers of its name.
    pub(crate) fn worker_that_drains(&self, name: &str, limit: Duration) -> TestWorker {
        let mut config = WorkerConfig::new(format!("http://{}", self.address), self.folder.path().join(name));
        config.name = name.into();
        config.threads = 1;
        config.renderer = Arc::new(Double(self.stage.clone()));
        config.drain = limit;
        let drain = CancellationToken::new();
        let task = tokio::spawn(Worker::new(config).unwrap().run(drain.clone()));
        TestWorker { drain, task }
    }

    /// A first worker is told to stop while it renders `iteration` of the job that is submitted; it delivers what it has.
    pub(crate) async fn drain_during(&self, iteration: u32, submission: impl Future<Output = JobId>) -> JobId {
        self.stage.hold(iteration);
        let first = self.worker("first");
        let job = submission.await;
        self.stage.until_begun(iteration, 1).await;
        first.drain.cancel();
        self.stage.release(iteration);
        first.task.await.unwrap().unwrap();
        job
    }

    /// A worker is lost while it renders iteration 4 of the 9 of the job that is submitted, and another one does its work.
    pub(crate) async fn lose_a_worker(&self, submission: impl Future<Output = JobId>) {
        self.stage.hold(4);
        let lost = self.worker("lost");
        let job = submission.await;
        self.stage.until_begun(4, 1).await;
        lost.kill().await;
        let other = self.worker("other");
        self.stage.until_begun(4, 2).await;
        self.stage.release(4);
        assert_eq!(self.until_ended(job).await.state, JobState::Done);
        self.check_image(job, 1..=9).await;
        other.drain().await;
    }

    pub(crate) fn url(&self, path: &str) -> String {
        format!("http://{}/v1/{path}", self.address)
    }

    pub(crate) async fn submit(&self, scene: &[u8], iterations: u32) -> JobId {
        let integrator = IntegratorSettings::Pppm(PppmSettings::default());
        self.submit_with(integrator, scene, iterations).await
    }

    /// Submits a job of which every iteration goes on from the one before.
    pub(crate) async fn submit_chain(&self, iterations: u32) -> JobId {
        let integrator = IntegratorSettings::Sppm(SppmSettings::default());
        self.submit_with(integrator, b"good", iterations).await
    }

    async fn submit_with(&self, integrator: IntegratorSettings, scene: &[u8], iterations: u32) -> JobId {
        let files = [("scene.xml".to_owned(), FileEntry::of(scene))].into();
        let bundle = self
            .http
            .post(self.url("bundles"))
            .json(&BundleManifest { files })
            .send()
            .await
            .unwrap();
        let BundleReply { bundle, missing } = bundle.json().await.unwrap();
        for hash in missing {
            assert_eq!(hash, BlobHash::of(scene));
            let put = self
                .http
                .put(self.url(&format!("blobs/{hash}")))
                .body(scene.to_vec())
                .send()
                .await
                .unwrap();
            assert_eq!(put.status(), 201);
        }
        let spec = JobSpec {
            scene: bundle,
            main: "scene.xml".into(),
            defines: BTreeMap::new(),
            sensor: None,
            integrator: integrator.into(),
            iterations,
            seed: SEED,
            schedule: Default::default(),
            layers: Vec::new(),
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        let reply = self.http.post(self.url("jobs")).json(&spec).send().await.unwrap();
        assert_eq!(reply.status(), 201);
        reply.json::<JobStatus>().await.unwrap().id
    }

    pub(crate) async fn status(&self, job: JobId) -> JobStatus {
        self.http
            .get(self.url(&format!("jobs/{job}")))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap()
    }

    /// Follows the job's events until one satisfies the condition.
    pub(crate) async fn until(&self, job: JobId, condition: impl Fn(&JobStatus) -> bool) -> JobStatus {
        let reply = self
            .http
            .get(self.url(&format!("jobs/{job}/events")))
            .send()
            .await
            .unwrap();
        assert_eq!(reply.status(), 200);
        let mut stream = reply.bytes_stream();
        let mut text = String::new();
        loop {
            let piece = stream
                .next()
                .await
                .expect("the events end before the condition")
                .unwrap();
            text.push_str(std::str::from_utf8(&piece).unwrap());
            while let Some((event, rest)) = text.split_once("\n\n") {
                let data = event.lines().find_map(|line| line.strip_prefix("data: "));
                let status = data.map(|data| serde_json::from_str::<JobStatus>(data).unwrap());
                text = rest.to_owned();
                if let Some(status) = status.filter(&condition) {
                    return status;
                }
            }
        }
    }

    pub(crate) async fn until_ended(&self, job: JobId) -> JobStatus {
        self.until(job, |status| status.state.ended()).await
    }

    pub(crate) async fn image(&self, job: JobId) -> DecodedExr {
        let reply = self
            .http
            .get(self.url(&format!("jobs/{job}/image.exr")))
            .send()
            .await
            .unwrap();
        assert_eq!(reply.status(), 200);
        decode_exr(&reply.bytes().await.unwrap(), 1000).unwrap()
    }

    /// The job's picture has the same bits as that of one process.
    pub(crate) async fn check_image(&self, job: JobId, iterations: impl IntoIterator<Item = u32>) {
        let (image, expected) = (self.image(job).await, reference(SEED, iterations));
        assert_eq!(bits(&image.pixels), bits(&expected.pixels));
        assert_eq!(image.standard_error, expected.standard_error);
        assert_eq!(image.metadata.unwrap().iterations, expected.iterations);
    }
}

pub(crate) fn bits(pixels: &[Spectrum]) -> Vec<[u32; 3]> {
    pixels.iter().map(|pixel| pixel.to_rgb().map(f32::to_bits)).collect()
}

pub(crate) struct TestWorker {
    pub(crate) drain: CancellationToken,
    pub(crate) task: JoinHandle<Result<(), WorkerError>>,
}

impl TestWorker {
    /// Ends as by SIGTERM.
    pub(crate) async fn drain(self) {
        self.drain.cancel();
        self.task.await.unwrap().unwrap();
    }

    /// Ends without a word.
    pub(crate) async fn kill(self) {
        self.task.abort();
        let _ = self.task.await;
    }
}
