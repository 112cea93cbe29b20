//! Scenes are checked beside whatever is rendered: with one thread of their own, one at a time.

use crate::block::panic_message;
use crate::cache::{BundleFiles, Cache, CacheError};
use crate::client::{Client, retry};
use crate::render::Renderer;
use photonfarm_proto::check::{
    CheckAnswer, CheckAssignment, CheckError, CheckFailure, CheckResult, CheckToken, Checking,
};
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::worker::Acknowledged;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// How long loading a scene may take. What takes longer is left to itself; nothing else is checked until it ends.
const LONGEST: Duration = Duration::from_secs(120);
/// How long the check before may take to end: it was answered already.
const PATIENCE: Duration = Duration::from_secs(5);
/// Attempts at a scene whose files are damaged in the cache.
const LOADS: usize = 3;

/// Checks scenes.
#[derive(Clone)]
pub(crate) struct Checker {
    client: Client,
    cache: Cache,
    renderer: Arc<dyn Renderer>,
    drain: CancellationToken,
    /// Whose permit is held from the beginning of a check to its end, and while a scene is loaded, however long that takes.
    loading: Arc<Semaphore>,
    /// What is checked.
    current: Arc<Mutex<Option<CheckToken>>>,
    tasks: Arc<Mutex<JoinSet<()>>>,
}

impl Checker {
    /// Checks nothing once `drain` is cancelled.
    pub(crate) fn new(client: Client, cache: Cache, renderer: Arc<dyn Renderer>, drain: CancellationToken) -> Self {
        Self {
            client,
            cache,
            renderer,
            drain,
            loading: Arc::new(Semaphore::new(1)),
            current: Arc::default(),
            tasks: Arc::default(),
        }
    }

    /// What a heartbeat says.
    pub(crate) fn checking(&self) -> Checking {
        let current = *self.current.lock().unwrap_or_else(PoisonError::into_inner);
        match current {
            Some(token) => Checking::At(token),
            None if self.drain.is_cancelled() || self.loading.available_permits() == 0 => Checking::Not,
            None => Checking::Ready,
        }
    }

    /// Begins a check. It goes back if another one does not end.
    pub(crate) fn begin(&self, worker: WorkerId, check: CheckAssignment) {
        let CheckAssignment { token, spec } = check;
        let checked = Checked {
            client: self.client.clone(),
            cache: self.cache.clone(),
            renderer: self.renderer.clone(),
            drain: self.drain.clone(),
        };
        let (current, loading) = (self.current.clone(), self.loading.clone());
        let at_work = move |at| *current.lock().unwrap_or_else(PoisonError::into_inner) = at;
        let task = async move {
            let Ok(Ok(permit)) = tokio::time::timeout(PATIENCE, loading.acquire_owned()).await else {
                let busy = CheckAnswer::Elsewhere(format!("worker {worker} is at another scene"));
                return checked.tell(token, worker, busy).await;
            };
            at_work(Some(token));
            tracing::info!(check = %token.id, main = spec.main, "checking a scene");
            let permit = Arc::new(permit);
            let answer = checked.answer(&spec.job(), &permit).await;
            checked.tell(token, worker, answer).await;
            at_work(None);
            drop(permit);
        };
        let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        while tasks.try_join_next().is_some() {}
        tasks.spawn(task);
    }
}

/// What a check takes.
struct Checked {
    client: Client,
    cache: Cache,
    renderer: Arc<dyn Renderer>,
    drain: CancellationToken,
}

impl Checked {
    async fn answer(&self, spec: &JobSpec, permit: &Arc<OwnedSemaphorePermit>) -> CheckAnswer {
        for _ in 0..LOADS {
            let files = match self.fetch(spec).await {
                Ok(files) => files,
                Err(error) => return CheckAnswer::Elsewhere(error.to_string()),
            };
            let answer = self.load(files.clone(), spec.clone(), permit.clone()).await;
            if !(files.is_damaged() && matches!(answer, CheckAnswer::Failure(_))) {
                return answer;
            }
        }
        CheckAnswer::Elsewhere("the worker's cache is damaged again and again".into())
    }

    async fn fetch(&self, spec: &JobSpec) -> Result<BundleFiles, CacheError> {
        let ask = || self.client.manifest(spec.scene);
        let manifest = retry(&self.drain, "the request for a manifest", ask).await?;
        self.cache.fetch(&self.client, manifest, &self.drain).await
    }

    /// Loads the scene with a thread that holds the permit until it ends.
    async fn load(&self, files: BundleFiles, spec: JobSpec, permit: Arc<OwnedSemaphorePermit>) -> CheckAnswer {
        let renderer = self.renderer.clone();
        let load = move || {
            let _permit = permit;
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
            let pool = pool.thread_name(|_| "check".into()).build();
            let pool =
                pool.map_err(|error| CheckAnswer::Elsewhere(format!("there is no thread to check with: {error}")));
            let check = || pool.map(|pool| pool.install(|| renderer.check(&files, &spec)));
            catch_unwind(AssertUnwindSafe(check)).unwrap_or_else(|panic| {
                let message = format!("loading the scene panicked: {}", panic_message(&*panic));
                Ok(CheckAnswer::Failure(CheckFailure::one(CheckError::of_request(
                    None, message,
                ))))
            })
        };
        match tokio::time::timeout(LONGEST, tokio::task::spawn_blocking(load)).await {
            Ok(Ok(answer)) => answer.unwrap_or_else(|error| error),
            Ok(Err(error)) => CheckAnswer::Elsewhere(error.to_string()),
            Err(_) => CheckAnswer::Never(format!("the scene was not loaded within {} s", LONGEST.as_secs())),
        }
    }

    /// Sends an answer, unless the worker is to stop: then the check goes back as it says goodbye.
    async fn tell(&self, token: CheckToken, worker: WorkerId, answer: CheckAnswer) {
        let answer = answer.bounded();
        let result = CheckResult { token, worker, answer };
        let told: Result<Acknowledged, _> = self.client.insist("worker/check", &result, &self.drain).await;
        if let Err(error) = told {
            tracing::debug!(check = %token.id, %error, "nobody waits for the answer to a check");
        }
    }
}
