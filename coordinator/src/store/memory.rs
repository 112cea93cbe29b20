//! A store for tests: state in memory, which can be told to fail.

use super::{
    Announced, Commit, EndedJob, JobFilter, NoticeRecord, PictureRecord, Sequence, StateStore, StoreError, TokenRecord,
    image_bytes,
};
use crate::scheduler::record::{
    BlobName, Change, Counters, JobControl, JobHead, JobRecord, Millis, Snapshot, WorkerRecord,
};
use async_trait::async_trait;
use photonfarm_proto::api::{FarmIdentity, ListedState};
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::{JobState, Totals};
use photonfarm_proto::token::Usage;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};

/// Rows as a database would have them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    counters: Counters,
    workers: BTreeMap<WorkerId, WorkerRecord>,
    pub(crate) jobs: BTreeMap<JobId, JobRecord>,
    /// With the time at which each was last named.
    bundles: BTreeMap<BlobHash, (BundleManifest, Millis)>,
    owned: BTreeMap<(String, BlobHash), u64>,
    tokens: BTreeMap<String, TokenRecord>,
    pictures: BTreeMap<(JobId, &'static str), PictureRecord>,
    /// Iterations of deleted jobs, by owner.
    used: BTreeMap<String, u64>,
    notices: BTreeMap<String, NoticeRecord>,
}

impl Rows {
    pub(crate) fn snapshot(&self) -> Snapshot {
        Snapshot {
            counters: self.counters,
            workers: self.workers.values().cloned().collect(),
            jobs: self
                .jobs
                .values()
                .filter(|job| job.ended_ms.is_none())
                .cloned()
                .collect(),
        }
    }

    pub(crate) fn apply(&mut self, change: &Change) {
        match change {
            Change::WorkerRegistered(worker) => {
                self.counters.worker = self.counters.worker.max(worker.id.0);
                self.workers.insert(worker.id, worker.clone());
            }
            Change::WorkerJudged { worker, standing } => {
                if let Some(record) = self.workers.get_mut(worker) {
                    record.standing = standing.clone();
                }
            }
            Change::WorkerForgotten(worker) => _ = self.workers.remove(worker),
            Change::JobSubmitted(head) => {
                self.counters.job = self.counters.job.max(head.id.0);
                assert!(self.jobs.insert(head.id, new_job((**head).clone())).is_none());
            }
            Change::JobChanged { job, control } => self.job(*job).control = control.clone(),
            Change::JobReopened { record, ended_ms } => {
                self.pictures.retain(|(of, _), _| *of != record.head.id);
                let job = self.job(record.head.id);
                assert_eq!(job.ended_ms, Some(*ended_ms));
                *job = *record.clone();
            }
            Change::JobDeleted {
                job,
                ended_ms,
                owner,
                iterations,
            } => {
                assert_eq!(self.jobs.remove(job).unwrap().ended_ms, Some(*ended_ms));
                self.pictures.retain(|(of, _), _| of != job);
                *self.used.entry(owner.clone()).or_default() += u64::from(*iterations);
            }
            Change::LeaseGranted(lease) => {
                self.counters.token = self.counters.token.max(lease.token.number);
                self.counters.share = self.counters.share.max(lease.share[0]);
                let job = self.job(lease.job);
                job.share_ms = lease.share[1];
                job.state = JobState::Running;
                job.leases.push(lease.clone());
            }
            Change::LeaseEnded { job, token } => self.job(*job).leases.retain(|lease| lease.token != *token),
            Change::LeasesRenewed(renewals) => {
                for renewal in renewals {
                    let leases = self.job(renewal.job).leases.iter_mut();
                    for lease in leases.filter(|lease| lease.token == renewal.token) {
                        (lease.until_ms, lease.restarts) = (renewal.until_ms, renewal.restarts);
                    }
                }
            }
            Change::NodeAdded {
                job,
                node,
                record,
                resolution,
            } => {
                let job = self.job(*job);
                job.nodes.retain(|(key, _)| key != node);
                job.nodes.push((*node, record.clone()));
                job.nodes.sort_unstable_by_key(|(key, _)| *key);
                job.resolution = Some(*resolution);
            }
            Change::NodeJudged { job, node, record } => {
                for (_, known) in self.job(*job).nodes.iter_mut().filter(|(key, _)| key == node) {
                    *known = record.clone();
                }
            }
            Change::NodeMerged { job, node } => {
                for (_, record) in self.job(*job).nodes.iter_mut().filter(|(key, _)| key == node) {
                    (record.live, record.totals) = (false, None);
                }
            }
            Change::NodeLost { job, node, .. } => self.job(*job).nodes.retain(|(key, _)| !node.contains(*key)),
            Change::LeafFailed { job, leaf, attempt } => self.job(*job).failures.push((*leaf, attempt.clone())),
            Change::FailuresForgotten { job } => self.job(*job).failures.clear(),
            Change::JobEnded {
                job,
                state,
                failure,
                ended_ms,
            } => {
                let job = self.job(*job);
                job.leases.clear();
                (job.state, job.failure, job.ended_ms) = (*state, failure.clone(), Some(*ended_ms));
            }
            Change::NoticeAdded(notice) => {
                let record = NoticeRecord {
                    notice: notice.clone(),
                    attempts: 0,
                    due_ms: Some(notice.created_ms),
                    ended_ms: None,
                    error: None,
                };
                assert!(self.notices.insert(notice.id.clone(), record).is_none());
            }
        }
    }

    fn bundled_files(&self) -> BTreeSet<BlobHash> {
        let files = self.bundles.values().flat_map(|(bundle, _)| bundle.files.values());
        files.map(|file| file.hash).collect()
    }

    fn job(&mut self, id: JobId) -> &mut JobRecord {
        self.jobs.get_mut(&id).unwrap()
    }
}

fn owned_bytes(owned: &BTreeMap<(String, BlobHash), u64>, owner: &str) -> u64 {
    let mine = owned.iter().filter(|((name, _), _)| name == owner);
    mine.map(|(_, bytes)| bytes).sum()
}

fn admits(filter: &JobFilter, job: &JobRecord) -> bool {
    let JobHead {
        id,
        spec,
        owner,
        created_ms,
        ..
    } = &job.head;
    let state = ListedState::of(job.state, job.control.schedule.paused);
    let title = if spec.name.is_empty() { &spec.main } else { &spec.name };
    let labelled = |(name, value): &(String, Option<String>)| {
        let found = spec.labels.get(name);
        found.is_some_and(|found| value.as_ref().is_none_or(|value| found == value))
    };
    let behind = |last: JobId| if filter.oldest_first { *id > last } else { *id < last };
    (filter.states.is_empty() || filter.states.contains(&state))
        && filter.owner.as_ref().is_none_or(|wanted| owner == wanted)
        && filter.labels.iter().all(labelled)
        && filter.name.as_ref().is_none_or(|part| title.contains(part))
        && filter.created_after.is_none_or(|time| *created_ms > time)
        && filter.created_before.is_none_or(|time| *created_ms < time)
        && filter.behind.is_none_or(behind)
}

fn new_job(head: JobHead) -> JobRecord {
    JobRecord {
        control: JobControl::of(&head.spec),
        share_ms: 0,
        head,
        state: JobState::Queued,
        failure: None,
        ended_ms: None,
        resolution: None,
        totals: Totals::default(),
        nodes: Vec::new(),
        leases: Vec::new(),
        failures: Vec::new(),
    }
}

/// What happens to the next commit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum NextCommit {
    /// It succeeds.
    #[default]
    Succeeds,
    /// It fails and changes nothing.
    Fails,
    /// It is applied, but reported as failed.
    SucceedsUnnoticed,
    /// It is applied, and the task that asked for it panics.
    SucceedsAndPanics,
}

/// State in memory.
#[derive(Debug, Default)]
pub(crate) struct MemoryStore {
    rows: Mutex<Rows>,
    pub(crate) next: Mutex<NextCommit>,
    /// Whether tokens cannot be read.
    pub(crate) away: AtomicBool,
}

impl MemoryStore {
    pub(crate) fn rows(&self) -> MutexGuard<'_, Rows> {
        self.rows.lock().unwrap()
    }
}

#[async_trait]
impl StateStore for MemoryStore {
    fn identity(&self) -> FarmIdentity {
        FarmIdentity::default()
    }

    async fn load(&self) -> Result<(Sequence, Snapshot), StoreError> {
        Ok((0, self.rows().snapshot()))
    }

    async fn commit(&self, _expected: Sequence, changes: Vec<Change>) -> Result<Commit, StoreError> {
        let next = std::mem::take(&mut *self.next.lock().unwrap());
        if next != NextCommit::Fails {
            changes.iter().for_each(|change| self.rows().apply(change));
        }
        match next {
            NextCommit::Succeeds => Ok(Commit::Kept(0)),
            NextCommit::Fails | NextCommit::SucceedsUnnoticed => Err(StoreError::Stopped),
            NextCommit::SucceedsAndPanics => panic!("a panic between commit and apply, as a test asked for"),
        }
    }

    async fn close(&self) {}

    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError> {
        Ok(self.rows().jobs.get(&id).cloned())
    }

    async fn jobs(&self, filter: JobFilter, limit: u32) -> Result<Vec<JobRecord>, StoreError> {
        let rows = self.rows();
        let mut jobs: Vec<&JobRecord> = rows.jobs.values().filter(|job| admits(&filter, job)).collect();
        if !filter.oldest_first {
            jobs.reverse();
        }
        Ok(jobs.into_iter().take(limit as usize).cloned().collect())
    }

    async fn ended_jobs(&self) -> Result<Vec<EndedJob>, StoreError> {
        let rows = self.rows();
        let ended = rows.jobs.values().filter_map(|job| {
            let pictures = rows.pictures.iter().filter(|((of, _), _)| *of == job.head.id);
            let pictures: u64 = pictures.map(|(_, picture)| picture.bytes).sum();
            let live = job.nodes.iter().filter(|(_, node)| node.live).count() as u64;
            Some(EndedJob {
                id: job.head.id,
                ended_ms: job.ended_ms?,
                scene: job.head.spec.scene,
                bytes: live * image_bytes(&job.head.spec, job.resolution) + pictures,
            })
        });
        Ok(ended.collect())
    }

    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError> {
        Ok(self
            .rows()
            .jobs
            .values()
            .find(|job| job.head.key.as_ref() == Some(&key))
            .cloned())
    }

    async fn put_bundle(
        &self,
        manifest: BundleManifest,
        owner: String,
        most: u64,
        now: Millis,
    ) -> Result<Announced, StoreError> {
        let mut rows = self.rows();
        let known = rows.bundled_files();
        let blobs = manifest.blobs();
        let fresh = blobs.iter().map(|(blob, _)| *blob).filter(|blob| !known.contains(blob));
        let fresh = fresh.collect();
        let mut owned = rows.owned.clone();
        for (blob, bytes) in blobs {
            let most = owned.entry((owner.clone(), blob)).or_insert(0);
            *most = bytes.max(*most);
        }
        let used = owned_bytes(&owned, &owner);
        if used <= most {
            rows.bundles.insert(manifest.hash(), (manifest, now));
            rows.owned = owned;
        }
        Ok(Announced { used, fresh })
    }

    async fn name_bundle(&self, hash: BlobHash, now: Millis) -> Result<Option<BundleManifest>, StoreError> {
        let mut rows = self.rows();
        let known = rows.bundles.get_mut(&hash);
        Ok(known.map(|(manifest, named)| {
            *named = now.max(*named);
            manifest.clone()
        }))
    }

    async fn forget_bundles(&self, before: Millis) -> Result<usize, StoreError> {
        let rows = &mut *self.rows();
        let count = rows.bundles.len();
        let jobs = &rows.jobs;
        rows.bundles
            .retain(|hash, (_, named)| *named >= before || jobs.values().any(|job| job.head.spec.scene == *hash));
        let left = rows.bundled_files();
        rows.owned.retain(|(_, blob), _| left.contains(blob));
        Ok(count - rows.bundles.len())
    }

    async fn bundled_files(&self) -> Result<BTreeSet<BlobHash>, StoreError> {
        Ok(self.rows().bundled_files())
    }

    async fn usage(&self, owner: String) -> Result<Usage, StoreError> {
        let rows = self.rows();
        let jobs = rows.jobs.values().filter(|job| job.head.owner == owner);
        Ok(Usage {
            jobs: jobs.clone().filter(|job| job.ended_ms.is_none()).count() as u64,
            bundle_bytes: owned_bytes(&rows.owned, &owner),
            iterations: jobs.map(|job| u64::from(job.control.iterations)).sum::<u64>()
                + rows.used.get(&owner).copied().unwrap_or_default(),
        })
    }

    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError> {
        let mut rows = self.rows();
        let new = !rows.tokens.contains_key(&token.name);
        if new {
            rows.tokens.insert(token.name.clone(), token);
        }
        Ok(new)
    }

    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        match self.away.load(Ordering::Relaxed) {
            true => Err(StoreError::Stopped),
            false => Ok(self.rows().tokens.values().cloned().collect()),
        }
    }

    async fn remove_token(&self, name: String) -> Result<bool, StoreError> {
        Ok(self.rows().tokens.remove(&name).is_some())
    }

    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError> {
        Ok(self.rows().bundles.get(&hash).map(|(manifest, _)| manifest.clone()))
    }

    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError> {
        let rows = self.rows();
        let sizes = rows.bundles.values().flat_map(|(bundle, _)| bundle.files.values());
        Ok(sizes.filter(|file| file.hash == blob).map(|file| file.bytes).max())
    }

    async fn picture(&self, job: JobId, format: &'static str) -> Result<Option<PictureRecord>, StoreError> {
        Ok(self.rows().pictures.get(&(job, format)).cloned())
    }

    async fn put_picture(
        &self,
        job: JobId,
        ended_ms: Millis,
        format: &'static str,
        picture: PictureRecord,
    ) -> Result<Option<BlobName>, StoreError> {
        let mut rows = self.rows();
        let ended = rows.jobs.get(&job).and_then(|job| job.ended_ms);
        if ended != Some(ended_ms) {
            return Ok(Some(picture.image));
        }
        let replaced = rows.pictures.insert((job, format), picture);
        Ok(replaced.map(|picture| picture.image))
    }

    async fn pictures(&self, job: JobId) -> Result<Vec<BlobName>, StoreError> {
        let rows = self.rows();
        let pictures = rows.pictures.iter().filter(|((of, _), _)| *of == job);
        Ok(pictures.map(|(_, picture)| picture.image).collect())
    }

    async fn live_images(&self) -> Result<Vec<BlobName>, StoreError> {
        let rows = self.rows();
        let nodes = rows.jobs.values().flat_map(|job| &job.nodes);
        let nodes = nodes.filter(|(_, node)| node.live).map(|(_, node)| node.image());
        Ok(nodes
            .chain(rows.pictures.values().map(|picture| picture.image))
            .collect())
    }

    async fn due_notices(&self, now: Millis, limit: u32) -> Result<Vec<NoticeRecord>, StoreError> {
        let rows = self.rows();
        let due = rows
            .notices
            .values()
            .filter(|record| record.due_ms.is_some_and(|due| due <= now));
        let mut due: Vec<NoticeRecord> = due.cloned().collect();
        due.sort_by_key(|record| (!record.notice.trusted, record.due_ms));
        due.truncate(limit as usize);
        Ok(due)
    }

    async fn notices(
        &self,
        job: Option<JobId>,
        before: Option<String>,
        limit: u32,
    ) -> Result<Vec<NoticeRecord>, StoreError> {
        let rows = self.rows();
        let wanted = rows.notices.values().rev().filter(|NoticeRecord { notice, .. }| {
            job.is_none_or(|job| notice.job == job) && before.as_ref().is_none_or(|before| notice.id < *before)
        });
        Ok(wanted.take(limit as usize).cloned().collect())
    }

    async fn keep_attempt(&self, record: NoticeRecord) -> Result<(), StoreError> {
        let mut rows = self.rows();
        if let Some(known) = rows.notices.get_mut(&record.notice.id) {
            *known = record;
        }
        Ok(())
    }

    async fn forget_notices(&self, before: Millis) -> Result<u64, StoreError> {
        let notices = &mut self.rows().notices;
        let count = notices.len();
        notices.retain(|_, record| record.ended_ms.is_none_or(|ended| ended >= before));
        Ok((count - notices.len()) as u64)
    }
}
