//! Bundles and jobs as clients submit them.

use super::partial::too_long;
use super::upload::next_piece;
use super::{Service, ServiceError};
use crate::access::Caller;
use crate::scheduler::record::Millis;
use crate::scheduler::{Decision, Farm, Figures, Job, Refusal};
use crate::store::{JobFilter, StoreError};
use axum::body::Bytes;
use futures_util::Stream;
use photonfarm_proto::api::{BundleReply, JobPage, WorkerStatus};
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::{JobSpec, JobState, JobStatus};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::schedule::check_priority;
use std::sync::Arc;

/// Most jobs, or deliveries, on a page.
pub(crate) const PAGE: u32 = 100;
/// Jobs on a page if the client does not say.
const DEFAULT_PAGE: u32 = 20;
/// What cursors begin with, by the order of the page.
const NEWEST: char = 'n';
const OLDEST: char = 'o';
/// How often a submission looks anew at the job that it is to come after, which may end meanwhile.
const ATTEMPTS: usize = 8;

impl Service {
    /// Keeps a manifest and names what is missing of it.
    pub async fn submit_bundle(&self, manifest: BundleManifest, caller: &Caller) -> Result<BundleReply, ServiceError> {
        self.limits.check_bundle(&manifest)?;
        let bundle = manifest.hash();
        let most = caller.quota.bundle_bytes.unwrap_or(u64::MAX);
        let (blobs, now) = (manifest.blobs(), self.clock.now());
        let _no_removal = self.naming.read().await;
        let state = &self.stores.state;
        let announced = state.put_bundle(manifest, caller.name.clone(), most, now).await?;
        caller.within("bundle_bytes", announced.used, Some(most))?;
        let mut missing = Vec::new();
        for (blob, bytes) in blobs {
            // One that was cut short, as by a disk that failed, is missing as well; and so is one that is about to be
            // removed.
            let there = !announced.fresh.contains(&blob) && self.stores.scenes.size(blob.into()).await? == Some(bytes);
            if !there && missing.last() != Some(&blob) {
                missing.push(blob);
            }
        }
        Ok(BundleReply { bundle, missing })
    }

    /// The manifest of a bundle.
    pub async fn bundle(&self, hash: BlobHash) -> Result<BundleManifest, ServiceError> {
        let found = self.stores.state.bundle(hash).await?;
        Ok(found.ok_or_else(|| Problem::new(ErrorCode::NotFound, format!("there is no bundle {hash}")))?)
    }

    /// Receives a file that some bundle names, and puts it in the place of what is there, which may be damaged. Returns
    /// whether it was missing or cut short.
    pub async fn put_blob<S, E>(&self, hash: BlobHash, mut body: S) -> Result<bool, ServiceError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin,
        E: std::fmt::Display,
    {
        let limit = self.announced_size(hash).await?;
        let known = self.stores.scenes.size(hash.into()).await?;
        let mut staged = self.stores.scenes.stage(hash.into()).await?;
        let mut received = 0;
        while let Some(piece) = next_piece(&mut body).await? {
            received += piece.len() as u64;
            if received > limit {
                return Err(too_long(limit));
            }
            staged.write_pieces(vec![piece]).await?;
        }
        let placing = self.missing_files.placing().await;
        staged.publish().await?;
        drop(placing);
        self.note_sent(hash);
        Ok(known != Some(received))
    }

    /// Submits a job; with a key, once only. Returns whether it is new.
    pub async fn submit_job(
        self: &Arc<Self>,
        spec: JobSpec,
        key: Option<String>,
        caller: &Caller,
    ) -> Result<(JobStatus, bool), ServiceError> {
        let _one_at_a_time = self.submitting.lock().await;
        let key = key.map(|key| caller.own_key(&key));
        if let Some(key) = &key
            && let Some(known) = self.stores.state.job_by_key(key.clone()).await?
        {
            // Names and labels change nothing: the same scene in another folder is the same job.
            let (name, labels) = (known.head.spec.name.clone(), known.head.spec.labels.clone());
            if known.head.spec != (JobSpec { name, labels, ..spec }) {
                let detail = format!(
                    "the key belongs to job {}, which asks for something else",
                    known.head.id
                );
                return Err(Problem::new(ErrorCode::IdempotencyKeyReused, detail).into());
            }
            return Ok((self.status(known.head.id).await?, false));
        }
        self.check_job(&spec).await?;
        self.check_quota(caller, 1, spec.iterations.into()).await?;
        for attempt in 0.. {
            let done = self.is_done(spec.after).await?;
            let (asked, owner, key) = (spec.clone(), caller.name.clone(), key.clone());
            let submit = move |farm: &Farm, now| match asked.after {
                Some(first) if !done && farm.job(first).is_none() => Err(Refusal::UnknownJob(first)),
                _ => Ok(farm.submit(asked.clone(), owner.clone(), key.clone(), now)),
            };
            match self.transact(submit).await {
                // The job before it has just ended: how, the store knows.
                Err(ServiceError::Refusal(Refusal::UnknownJob(_))) if !done && attempt < ATTEMPTS => {}
                id => return Ok((self.status(id?).await?, true)),
            }
        }
        Err(ServiceError::Stopping)
    }

    /// Whether the job that another is to come after is done already; refused where it will never be.
    async fn is_done(&self, first: Option<JobId>) -> Result<bool, ServiceError> {
        let Some(first) = first else { return Ok(true) };
        let refused = |detail: String| Problem::new(ErrorCode::Invalid, detail).at("after", None);
        let record = self.stores.state.job(first).await?;
        let record = record.ok_or_else(|| refused(format!("after: there is no job {first}")))?;
        let how = match record.state {
            JobState::Queued | JobState::Running => return Ok(false),
            JobState::Done => return Ok(true),
            JobState::Failed => "failed",
            JobState::Cancelled => "was cancelled",
        };
        let detail =
            format!("after: job {first} {how}: nothing can come after it until it is submitted again and done");
        Err(refused(detail).into())
    }

    /// Refuses so many more jobs and iterations if the caller's quota does not allow them.
    pub(crate) async fn check_quota(&self, caller: &Caller, jobs: u64, iterations: u64) -> Result<(), ServiceError> {
        if caller.quota.jobs.is_none() && caller.quota.iterations.is_none() {
            return Ok(());
        }
        let usage = self.stores.state.usage(caller.name.clone()).await?;
        caller.within("jobs", usage.jobs + jobs, caller.quota.jobs)?;
        caller.within("iterations", usage.iterations + iterations, caller.quota.iterations)?;
        Ok(())
    }

    pub(super) async fn check_job(&self, spec: &JobSpec) -> Result<(), ServiceError> {
        // It stays for a while from now on, until the job that names it is there.
        let Some(manifest) = self.stores.state.name_bundle(spec.scene, self.clock.now()).await? else {
            let detail = format!("scene: there is no bundle {}", spec.scene);
            return Err(Problem::new(ErrorCode::Invalid, detail).at("scene", None).into());
        };
        spec.check(&self.limits, &manifest)?;
        self.check_webhook(spec)?;
        if let Err(error) = spec.integrator.with_defaults().validate() {
            let field = format!("integrator.{}", error.name);
            return Err(Problem::new(ErrorCode::Invalid, error.to_string())
                .at(field, None)
                .into());
        }
        for (name, file) in &manifest.files {
            match self.stores.scenes.size(file.hash.into()).await? {
                Some(bytes) if bytes == file.bytes => {}
                Some(bytes) => {
                    let detail = format!("{name:?} has {bytes} bytes, the manifest says {}", file.bytes);
                    return Err(Problem::new(ErrorCode::ContentMismatch, detail)
                        .at("scene", None)
                        .into());
                }
                None => {
                    let detail = format!("{name:?} ({}) was not uploaded", file.hash);
                    return Err(Problem::new(ErrorCode::BundleIncomplete, detail)
                        .at("scene", None)
                        .into());
                }
            }
        }
        Ok(())
    }

    /// Cancels a job. Cancelling one that has ended changes nothing.
    pub async fn cancel_job(self: &Arc<Self>, id: JobId) -> Result<JobStatus, ServiceError> {
        match self.transact(move |farm, now| farm.cancel(id, now)).await {
            Ok(()) | Err(ServiceError::Refusal(Refusal::UnknownJob(_))) => self.status(id).await,
            Err(error) => Err(error),
        }
    }

    /// Deletes a job that has ended, and what is kept of it alone. Its number is never used again.
    pub async fn delete_job(self: &Arc<Self>, id: JobId) -> Result<(), ServiceError> {
        loop {
            let record = self.stores.state.job(id).await?.ok_or(Refusal::UnknownJob(id))?;
            let pictures = self.stores.state.pictures(id).await?;
            let known = record.clone();
            match self.transact(move |farm, _| farm.delete(&known)).await {
                // It was extended, or deleted: what is kept of it now decides.
                Err(ServiceError::Store(StoreError::TooLate)) => {}
                Err(error) => return Err(error),
                Ok(()) => {
                    let live = record.nodes.iter().filter(|(_, node)| node.live);
                    let images = live.map(|(_, node)| node.image()).chain(pictures).collect();
                    let service = self.clone();
                    let removal = tokio::spawn(async move { service.remove_all(images).await });
                    return removal.await.map_err(|_| ServiceError::Stopping);
                }
            }
        }
    }

    /// Name of the token that the job was submitted with.
    pub async fn owner(self: &Arc<Self>, id: JobId) -> Result<String, ServiceError> {
        self.with_job(id, |job| job.head().owner.clone()).await
    }

    /// The jobs that have not ended, in figures.
    pub(crate) async fn figures(self: &Arc<Self>) -> Result<Figures, ServiceError> {
        let now = self.clock.now();
        let cell = self.fresh_farm().await?;
        Ok(self.all_held_up(&cell.farm, now))
    }

    /// Hands out no new work of a job, or goes on with it.
    pub async fn pause_job(self: &Arc<Self>, id: JobId, paused: bool) -> Result<JobStatus, ServiceError> {
        self.steer(id, move |farm, _| farm.pause(id, paused)).await
    }

    /// Sets the weight of a job.
    pub async fn prioritize_job(self: &Arc<Self>, id: JobId, priority: u32) -> Result<JobStatus, ServiceError> {
        check_priority(priority, "priority")?;
        self.steer(id, move |farm, _| farm.prioritize(id, priority)).await
    }

    /// Changes a job that goes on; one that has ended is refused.
    async fn steer(
        self: &Arc<Self>,
        id: JobId,
        decide: impl Fn(&Farm, Millis) -> Result<Decision<()>, Refusal> + Send + 'static,
    ) -> Result<JobStatus, ServiceError> {
        match self.transact(decide).await {
            Ok(()) => self.status(id).await,
            Err(ServiceError::Refusal(Refusal::UnknownJob(_))) => {
                self.with_job(id, |_| ()).await?;
                Err(Refusal::JobEnded(id).into())
            }
            Err(error) => Err(error),
        }
    }

    /// Asks for more iterations of a job that goes on or is done.
    pub(crate) async fn extend_job(
        self: &Arc<Self>,
        id: JobId,
        iterations: u32,
        caller: &Caller,
    ) -> Result<JobStatus, ServiceError> {
        self.limits.check_iterations(iterations)?;
        let _one_at_a_time = self.submitting.lock().await;
        let record = self.stores.state.job(id).await?.ok_or(Refusal::UnknownJob(id))?;
        let ended = Some(record).filter(|record| record.ended_ms.is_some());
        let status = self.status(id).await?;
        let more = u64::from(iterations.saturating_sub(status.spec.iterations));
        if more > 0 {
            self.check_quota(caller, u64::from(ended.is_some()), more).await?;
        }
        let pictures = self.stores.state.pictures(id).await?;
        self.transact(move |farm, _| farm.extend(id, iterations, ended.as_ref()))
            .await?;
        if more > 0 {
            self.collect(pictures);
        }
        self.status(id).await
    }

    /// Gives the iterations of a job that were given up new attempts.
    pub(crate) async fn retry_job(self: &Arc<Self>, id: JobId, caller: &Caller) -> Result<JobStatus, ServiceError> {
        let _one_at_a_time = self.submitting.lock().await;
        let record = self.stores.state.job(id).await?.ok_or(Refusal::UnknownJob(id))?;
        let ended = Some(record).filter(|record| record.ended_ms.is_some());
        let reopens = ended.as_ref().is_some_and(|record| record.state == JobState::Failed);
        if reopens {
            self.check_quota(caller, 1, 0).await?;
        }
        let pictures = self.stores.state.pictures(id).await?;
        self.transact(move |farm, _| farm.retry(id, ended.as_ref())).await?;
        if reopens {
            self.collect(pictures);
        }
        self.status(id).await
    }

    /// Gives a worker no new work, or work again.
    pub(crate) async fn drain_worker(
        self: &Arc<Self>,
        worker: WorkerId,
        drained: bool,
    ) -> Result<WorkerStatus, ServiceError> {
        self.transact(move |farm, _| farm.drain(worker, drained)).await?;
        self.worker(worker).await
    }

    /// Puts a worker into quarantine.
    pub async fn quarantine(self: &Arc<Self>, worker: WorkerId, reason: String) -> Result<WorkerStatus, ServiceError> {
        let reason = photonfarm_proto::worker::cut_text(reason);
        self.transact(move |farm, _| farm.quarantine(worker, &reason)).await?;
        self.worker(worker).await
    }

    /// Lets a worker out of quarantine.
    pub async fn release_worker(self: &Arc<Self>, worker: WorkerId) -> Result<WorkerStatus, ServiceError> {
        self.transact(move |farm, _| farm.release_worker(worker)).await?;
        self.worker(worker).await
    }

    async fn worker(self: &Arc<Self>, id: WorkerId) -> Result<WorkerStatus, ServiceError> {
        let mut workers = self.workers().await?.into_iter();
        Ok(workers
            .find(|worker| worker.id == id)
            .ok_or(Refusal::UnknownWorker(id))?)
    }

    /// A page of jobs.
    pub(crate) async fn list_jobs(
        self: &Arc<Self>,
        filter: JobFilter,
        limit: Option<u32>,
    ) -> Result<JobPage, ServiceError> {
        let oldest_first = filter.oldest_first;
        let limit = limit.unwrap_or(DEFAULT_PAGE).clamp(1, PAGE);
        let mut records = self.stores.state.jobs(filter, limit + 1).await?;
        let more = records.len() > limit as usize;
        records.truncate(limit as usize);
        let cell = self.fresh_farm().await?;
        let (config, now) = (cell.farm.config(), self.clock.now());
        let jobs: Vec<JobStatus> = records
            .into_iter()
            .map(|record| match cell.farm.job(record.head.id) {
                Some(job) => self.held_up(cell.farm.status(job, now)),
                None => Job::from_record(record, config).status(),
            })
            .collect();
        let next = jobs.last().filter(|_| more).map(|job| cursor(job.id, oldest_first));
        Ok(JobPage { jobs, next })
    }
}

/// Where a page of jobs ends. Jobs keep their numbers and are given ever greater ones, so that the next page goes on right there, whatever
/// comes or goes meanwhile.
fn cursor(last: JobId, oldest_first: bool) -> String {
    format!("{}{last}", if oldest_first { OLDEST } else { NEWEST })
}

/// The job at which a page ended.
///
/// # Errors
/// No cursor, or one of the other order.
pub(crate) fn read_cursor(text: &str, oldest_first: bool) -> Result<JobId, Problem> {
    let refused = |detail: &str| Problem::new(ErrorCode::Malformed, format!("cursor: {detail}")).at("cursor", None);
    let given = |order: char| text.strip_prefix(order).and_then(|job| job.parse().ok());
    let (asked, other) = if oldest_first {
        (OLDEST, NEWEST)
    } else {
        (NEWEST, OLDEST)
    };
    match (given(asked), given(other)) {
        (Some(job), _) => Ok(job),
        (None, Some(JobId(_))) => Err(refused("it is of a page in the other order")),
        (None, None) => Err(refused("not one that this service gave")),
    }
}
