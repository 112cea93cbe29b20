//! The worker's life: register, lease, render, deliver; reconnect; drain.

mod prepare;

use crate::backoff::Backoff;
use crate::block::{Deadline, Ending, Task, render_block};
use crate::cache::Cache;
use crate::check::Checker;
use crate::client::{Client, ClientError, retry};
use crate::config::{WorkerConfig, WorkerError};
use crate::drain::Stop;
use crate::held::{Abandon, Held, LeaseState};
use crate::memory::Gauge;
use crate::notices::Notices;
use crate::outbox::{Courier, LeftOnDisk};
use crate::parcel::{self, Farewell, Parcel, Upload};
use crate::render::LoadedScene;
use crate::shift::{Rests, Shift};
use crate::witness::{self, Bench, Witness};
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use photonfarm_proto::check::Checking;
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::job::{FailureKind, JobSpec};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::rest::{Rest, Resting};
use photonfarm_proto::worker::{
    Acknowledged, Assignment, FailureReport, Heartbeat, HeartbeatReply, Lease, LeaseReply, LeaseRequest, Leave,
    Register, Registered, cut_text,
};
use prepare::{LoadError, SceneKey, scene_key};
use rayon::ThreadPool;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

/// How long a request for work waits at the coordinator.
const POLL: Duration = Duration::from_secs(20);
/// Finished leases that may wait for delivery while the next is rendered.
const OUTBOX: usize = 2;
/// How long an iteration that is given up may take to notice.
const NOTICE: Duration = Duration::from_secs(5);
/// How long a first answer may take before that is said.
const SILENCE: Duration = Duration::from_secs(2);

/// A worker, ready to run.
pub struct Worker {
    config: WorkerConfig,
    client: Client,
    cache: Cache,
    pool: Arc<ThreadPool>,
    held: Held,
    /// Counts the requests for work.
    serial: AtomicU64,
    loaded: Option<(SceneKey, Arc<dyn LoadedScene>)>,
}

/// The coordinator's terms, as of the last registration.
#[derive(Clone, Copy)]
struct Terms {
    worker: WorkerId,
    heartbeat: Duration,
    stores: bool,
}

impl Worker {
    /// Opens the cache and makes the threads; nothing is sent yet.
    pub fn new(config: WorkerConfig) -> Result<Self, WorkerError> {
        let client = Client::new(&config.coordinator, config.credentials.clone(), config.tracer.clone());
        let client = client.map_err(WorkerError::Url)?;
        let cache = Cache::open(&config.cache, config.cache_bytes).map_err(|source| WorkerError::Cache {
            path: config.cache.clone(),
            source,
        })?;
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(config.threads)
            .thread_name(|index| format!("render-{index}"))
            .build()?;
        Ok(Self {
            config,
            client,
            cache,
            pool: Arc::new(pool),
            held: Held::default(),
            serial: AtomicU64::new(0),
            loaded: None,
        })
    }

    /// Works until `drain`: then ends the iteration at hand, delivers what is done, gives the rest back, and returns.
    /// Dropping the future gives up at once; the coordinator notices by the missing heartbeats.
    ///
    /// # Errors
    /// The coordinator refuses this worker, as one of another version.
    pub fn run(self, drain: CancellationToken) -> BoxFuture<'static, Result<(), WorkerError>> {
        // Boxed, so that its code is compiled once, here, and not again in every program.
        self.work(drain).boxed()
    }

    async fn work(mut self, drain: CancellationToken) -> Result<(), WorkerError> {
        let stop = Stop::by(drain);
        let _watch = detached(
            stop.clone()
                .watch(self.config.drain, self.held.clone(), self.client.reach.clone()),
        );
        let mut terms = match self.register(&stop.drain).await {
            Err(WorkerError::Refused(ClientError::Stopping)) => return Ok(()),
            other => other?,
        };
        if self.config.watches_memory {
            witness::report_killed(&self.client, &self.cache, &stop.drain).await;
        }
        let (announce, announced) = watch::channel(terms);
        let _abandon_when_dropped = Abandon(self.held.clone());
        let renderer = self.config.renderer.clone();
        let checker = Checker::new(self.client.clone(), self.cache.clone(), renderer, stop.drain.clone());
        let _heart = detached(beat(self.client.clone(), self.held.clone(), checker.clone(), announced));
        let (outbox, parcels) = mpsc::channel(OUTBOX);
        let courier = Courier {
            client: self.client.clone(),
            held: self.held.clone(),
            cache: self.cache.clone(),
            give_up: stop.give_up.clone(),
        };
        let courier = detached(courier.carry(parcels));
        let (mut backoff, mut notices) = (Backoff::default(), None);
        while !stop.drain.is_cancelled() {
            let rests = Rests(self.config.rest.clone());
            let shift = Shift::begin(&stop, rests.clone(), self.config.drain);
            let asked = match rests.now() {
                Some(resting) => self.rest(terms.worker, resting, rests, &stop.drain).await,
                None => self.next_assignment(terms.worker, &checker, &shift.stop.drain).await,
            };
            match asked {
                Ok(Some(assignment)) => {
                    let (parcel, smooth) = self.work_on(assignment, terms.stores, &shift.stop).await;
                    if outbox.send(parcel).await.is_err() {
                        break;
                    }
                    if smooth {
                        backoff = Backoff::default();
                    } else {
                        pause(&mut backoff, &stop.drain).await;
                    }
                    notices = None;
                }
                Ok(None) => notices = None,
                Err(error) if error.code() == Some(ErrorCode::UnknownWorker) => {
                    self.held.lose(&self.held.tokens());
                    terms = match self.register(&stop.drain).await {
                        Err(WorkerError::Refused(ClientError::Stopping)) => break,
                        other => other?,
                    };
                    announce.send_replace(terms);
                }
                Err(ClientError::Stopping) => {}
                Err(error) => {
                    let now = Instant::now();
                    let notices = notices.get_or_insert_with(|| Notices::from(now, Duration::ZERO));
                    if notices.due(now) {
                        tracing::warn!(%error, "no work");
                    }
                    pause(&mut backoff, &stop.drain).await;
                }
            }
        }
        drop(outbox);
        // Leases of which work is kept on disk go on, so that it may count when it is delivered.
        if matches!(courier.await, Ok(LeftOnDisk::Nothing)) {
            self.leave(terms.worker).await;
        }
        Ok(())
    }

    async fn leave(&self, worker: WorkerId) {
        let leave = Leave { worker };
        let left = self
            .client
            .call::<_, Acknowledged>("worker/leave", &leave, Duration::ZERO);
        if let Err(error) = left.await {
            tracing::info!("left without a word: {error}");
        }
    }

    async fn register(&self, drain: &CancellationToken) -> Result<Terms, WorkerError> {
        let register = Register {
            name: self.config.name.clone(),
            threads: self.pool.current_num_threads() as u32,
            renderer: self.config.build.clone(),
            tags: self.config.tags.clone(),
            memory_mb: self.config.memory_mb,
        };
        let mut reply = pin!(self.client.insist("worker/register", &register, drain));
        let reply = match tokio::time::timeout(SILENCE, &mut reply).await {
            Ok(reply) => reply,
            Err(_) => {
                if self.client.reach.reason().is_none() {
                    tracing::warn!("no answer yet from the coordinator at {}", self.client.coordinator());
                }
                reply.await
            }
        };
        let Registered {
            worker,
            heartbeat_ms,
            stores,
        } = reply.map_err(WorkerError::Refused)?;
        tracing::info!(%worker, coordinator = self.config.coordinator, "registered");
        Ok(Terms {
            worker,
            heartbeat: Duration::from_millis(heartbeat_ms.clamp(10, 60_000)),
            stores,
        })
    }

    async fn next_assignment(
        &self,
        worker: WorkerId,
        checker: &Checker,
        drain: &CancellationToken,
    ) -> Result<Option<Assignment>, ClientError> {
        let ask = || async {
            let held = self.held.tokens();
            let request = LeaseRequest {
                worker,
                serial: 1 + self.serial.fetch_add(1, Ordering::Relaxed),
                held,
                wait_ms: POLL.as_millis() as u64,
            };
            let reply: LeaseReply = self.client.call("worker/lease", &request, POLL).await?;
            if let Some(check) = reply.check {
                checker.begin(worker, check);
            }
            Ok(reply.assignment)
        };
        retry(drain, "the request for work", ask).await
    }

    /// Says that no work is taken, and waits until that changes or is to be said again.
    async fn rest(
        &self,
        worker: WorkerId,
        resting: Resting,
        mut rests: Rests,
        drain: &CancellationToken,
    ) -> Result<Option<Assignment>, ClientError> {
        let say = || async {
            let rest = Rest {
                worker,
                serial: 1 + self.serial.fetch_add(1, Ordering::Relaxed),
                held: self.held.tokens(),
                reason: resting.reason,
                until_ms: resting.until_ms,
            };
            self.client.call("worker/rest", &rest, Duration::ZERO).await
        };
        let Acknowledged = retry(drain, "the word that this worker rests", say).await?;
        tracing::debug!("{resting}");
        tokio::select! {
            () = rests.change_from(Some(resting)) => {}
            () = tokio::time::sleep(POLL) => {}
            () = drain.cancelled() => {}
        }
        Ok(None)
    }

    /// Renders a lease. The flag says whether the worker is fit for the next one at once.
    async fn work_on(&mut self, assignment: Assignment, stores: bool, stop: &Stop) -> (Parcel, bool) {
        let Assignment { lease, mut spec } = assignment;
        let ends = lease.ends_in_ms.map(|ms| Instant::now() + Duration::from_millis(ms));
        let state = self.held.add(&lease);
        tracing::info!(job = %lease.job, node = %lease.node, token = %lease.token, attempt = lease.attempt, "working");
        let key = scene_key(&spec);
        if self.loaded.as_ref().is_some_and(|(loaded, _)| *loaded != key) {
            // So that its memory is not taken for that of this job.
            self.loaded = None;
        }
        let gauge = self.config.watches_memory.then(Gauge::begin);
        let _witness = gauge.and_then(|gauge| self.witness(&lease, &state, gauge));
        let prepare = async {
            let scene = self.load(&spec, lease.trace, &stop.drain).await?;
            spec.integrator = self.resolve(&*scene, &spec, &lease, &stop.drain).await?.into();
            let before = self.statistics(&*scene, &spec, &lease, &stop.drain).await?;
            Ok((scene, before))
        };
        let loaded = tokio::select! {
            loaded = prepare => loaded,
            () = stop.drain.cancelled() => Err(LoadError::Elsewhere("the worker is to stop".into())),
        };
        let (uploads, farewell, smooth) = match loaded {
            Ok((scene, before)) => {
                self.render(scene, spec, lease, before, (state.clone(), ends, gauge), stop)
                    .await
            }
            Err(LoadError::Scene(kind, message)) => {
                tracing::warn!(job = %lease.job, message, "the scene cannot be rendered");
                (vec![], failure(&lease, lease.node.first() as u32, kind, message), true)
            }
            Err(LoadError::Elsewhere(error)) => {
                tracing::warn!(job = %lease.job, error, "what the work begins with is not at hand: the lease goes back");
                (vec![], Farewell::Release, false)
            }
        };
        state.set_rendered();
        (
            Parcel {
                lease,
                state,
                uploads,
                farewell,
                stores,
            },
            smooth,
        )
    }

    /// Says on disk that a lease is worked on. Without that, a kill for lack of memory looks like any other.
    fn witness(&self, lease: &Lease, state: &Arc<LeaseState>, gauge: Gauge) -> Option<Witness> {
        let bench = Bench {
            coordinator: self.client.coordinator(),
            name: &self.config.name,
            memory_mb: self.config.memory_mb,
            gauge,
        };
        let witness = self.cache.witness(bench, *lease, state.clone());
        witness
            .inspect_err(|error| tracing::debug!(%error, "what is worked on cannot be written down"))
            .ok()
    }

    async fn render(
        &self,
        scene: Arc<dyn LoadedScene>,
        spec: JobSpec,
        lease: Lease,
        before: Vec<f32>,
        (state, ends, gauge): (Arc<LeaseState>, Option<Instant>, Option<Gauge>),
        stop: &Stop,
    ) -> (Vec<Upload>, Farewell, bool) {
        let (pool, steps, tracer) = (self.pool.clone(), stop.clone(), self.config.tracer.clone());
        let work = move || {
            let deadline = Deadline::new(ends, Instant::now());
            let task = Task {
                scene: &*scene,
                spec: &spec,
                lease: &lease,
                tracer: &tracer,
            };
            let render = || render_block(&task, before, &state, &steps, deadline);
            let (sums, ending) = pool.install(render);
            let mut uploads = parcel::encode(lease.worker, &lease, sums);
            let memory_mb = gauge.and_then(|gauge| gauge.peak_mb());
            uploads
                .iter_mut()
                .for_each(|upload| upload.announced.memory_mb = memory_mb);
            (uploads, ending)
        };
        let rendered = tokio::select! {
            rendered = tokio::task::spawn_blocking(work) => rendered,
            () = async {
                stop.give_up.cancelled().await;
                tokio::time::sleep(NOTICE).await;
            } => return (vec![], Farewell::Release, false),
        };
        let (uploads, ending) = match rendered {
            Ok((uploads, ending)) => (uploads, ending),
            Err(error) => {
                let message = format!("the worker failed: {error}");
                return (
                    vec![],
                    failure(&lease, lease.node.first() as u32, FailureKind::Panic, message),
                    false,
                );
            }
        };
        match ending {
            Ending::Complete => (uploads, Farewell::Nothing, true),
            Ending::Drained => (uploads, Farewell::Release, true),
            Ending::Lost => {
                tracing::info!(job = %lease.job, node = %lease.node, token = %lease.token, "the lease is lost");
                (vec![], Farewell::Nothing, true)
            }
            Ending::Failed { leaf, kind, message } => {
                tracing::warn!(job = %lease.job, iteration = leaf + 1, message, "the iteration failed");
                (uploads, failure(&lease, leaf, kind, message), true)
            }
        }
    }
}

fn failure(lease: &Lease, leaf: u32, kind: FailureKind, message: String) -> Farewell {
    let Lease { token, worker, job, .. } = *lease;
    Farewell::Failure(FailureReport {
        token,
        worker,
        job,
        leaf,
        kind,
        message: cut_text(message),
        shortage: None,
    })
}

async fn pause(backoff: &mut Backoff, drain: &CancellationToken) {
    tokio::select! {
        () = tokio::time::sleep(backoff.next()) => {}
        () = drain.cancelled() => {}
    }
}

/// A task that ends with whoever holds it.
fn detached<T: Send + 'static>(task: impl Future<Output = T> + Send + 'static) -> AbortOnDropHandle<T> {
    AbortOnDropHandle::new(tokio::spawn(task))
}

/// Sends heartbeats for the leases held, and for a scene that is checked.
async fn beat(client: Client, held: Held, checker: Checker, terms: watch::Receiver<Terms>) {
    loop {
        let Terms { worker, heartbeat, .. } = *terms.borrow();
        tokio::time::sleep(heartbeat).await;
        let (leases, checking) = (held.progress(), checker.checking());
        if leases.is_empty() && !matches!(checking, Checking::At(_)) {
            continue;
        }
        let message = Heartbeat {
            worker,
            leases,
            checking,
        };
        let reply = client
            .call::<_, HeartbeatReply>("worker/heartbeat", &message, Duration::ZERO)
            .await;
        match reply {
            Ok(HeartbeatReply { lost, check }) => {
                held.lose(&lost);
                if let Some(check) = check {
                    checker.begin(worker, check);
                }
            }
            Err(error) if error.code() == Some(ErrorCode::UnknownWorker) => held.lose(&held.tokens()),
            Err(error) => tracing::debug!(%error, "a heartbeat was missed"),
        }
    }
}
