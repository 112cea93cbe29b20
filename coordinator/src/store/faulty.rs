//! Stores for tests that fail or wait at the very step that a test names, around stores of any kind.

use super::*;
use bytes::Bytes;
use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::Semaphore;

/// A step at which something may happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Before a part of a blob is written.
    Write,
    /// Before a blob becomes visible.
    Publish,
    /// After it has.
    Published,
    /// Before a blob is read.
    Read,
    /// Before a blob is removed.
    Remove,
    /// Before a commit.
    Commit,
    /// After it.
    Committed,
}

/// Where something waits until the test lets it go on.
#[derive(Debug)]
pub(crate) struct Gate {
    reached: Semaphore,
    open: Semaphore,
}

impl Gate {
    /// Returns once something waits here.
    pub(crate) async fn reached(&self) {
        self.reached.acquire().await.unwrap().forget();
    }

    /// Lets it go on.
    pub(crate) fn open(&self) {
        self.open.add_permits(1);
    }
}

/// A store that counts the calls of it.
pub(crate) struct Counted<S: ?Sized> {
    store: Arc<S>,
    calls: AtomicU64,
}

impl<S: ?Sized> Counted<S> {
    /// So many calls there were.
    pub(crate) fn calls(&self) -> u64 {
        self.calls.load(Ordering::Relaxed)
    }
}

impl<S: ?Sized> From<Arc<S>> for Counted<S> {
    fn from(store: Arc<S>) -> Self {
        let calls = AtomicU64::new(0);
        Self { store, calls }
    }
}

impl<S: ?Sized> Deref for Counted<S> {
    type Target = S;

    fn deref(&self) -> &S {
        self.calls.fetch_add(1, Ordering::Relaxed);
        &self.store
    }
}

enum Fault {
    Fails,
    Waits(Arc<Gate>),
}

/// What is to happen, each thing once.
#[derive(Default)]
pub(crate) struct Faults(Mutex<Vec<(Step, Fault)>>);

impl Faults {
    /// The next call fails at this step.
    pub(crate) fn fail(&self, step: Step) {
        self.0.lock().unwrap().push((step, Fault::Fails));
    }

    /// The next call waits at this step.
    pub(crate) fn wait(&self, step: Step) -> Arc<Gate> {
        let gate = Arc::new(Gate {
            reached: Semaphore::new(0),
            open: Semaphore::new(0),
        });
        self.0.lock().unwrap().push((step, Fault::Waits(gate.clone())));
        gate
    }

    async fn at(&self, step: Step) -> Result<(), StoreError> {
        let fault = {
            let mut faults = self.0.lock().unwrap();
            let next = faults.iter().position(|(at, _)| *at == step);
            next.map(|next| faults.remove(next).1)
        };
        match fault {
            None => Ok(()),
            Some(Fault::Fails) => Err(StoreError::Stopped),
            Some(Fault::Waits(gate)) => {
                gate.reached.add_permits(1);
                gate.open.acquire().await.unwrap().forget();
                Ok(())
            }
        }
    }
}

/// A blob store with faults.
pub(crate) struct FaultyBlobs {
    pub(crate) inner: Counted<dyn BlobStore>,
    pub(crate) faults: Arc<Faults>,
}

#[async_trait]
impl BlobStore for FaultyBlobs {
    async fn stage(&self, name: BlobName) -> Result<Box<dyn StagedBlob>, StoreError> {
        let (inner, faults) = (self.inner.stage(name).await?, self.faults.clone());
        Ok(Box::new(FaultyStage { inner, faults }))
    }

    async fn read(&self, name: BlobName, most: u64) -> Result<Vec<u8>, StoreError> {
        self.faults.at(Step::Read).await?;
        self.inner.read(name, most).await
    }

    async fn open_at(&self, name: BlobName, start: u64) -> Result<(u64, BlobReader), StoreError> {
        self.faults.at(Step::Read).await?;
        self.inner.open_at(name, start).await
    }

    async fn size(&self, name: BlobName) -> Result<Option<u64>, StoreError> {
        self.inner.size(name).await
    }

    async fn remove(&self, name: BlobName) -> Result<(), StoreError> {
        self.faults.at(Step::Remove).await?;
        self.inner.remove(name).await
    }

    async fn list(&self) -> Result<Vec<(BlobName, Duration)>, StoreError> {
        self.inner.list().await
    }

    fn signs(&self) -> bool {
        self.inner.signs()
    }

    async fn read_url(&self, name: BlobName) -> Result<Option<String>, StoreError> {
        self.inner.read_url(name).await
    }

    async fn write_url(&self, place: &str) -> Result<Option<String>, StoreError> {
        self.inner.write_url(place).await
    }

    async fn adopt(&self, place: &str, name: BlobName, bytes: u64) -> Result<(), StoreError> {
        self.faults.at(Step::Publish).await?;
        self.inner.adopt(place, name, bytes).await?;
        self.faults.at(Step::Published).await
    }

    async fn discard(&self, place: &str) -> Result<(), StoreError> {
        self.inner.discard(place).await
    }

    async fn tidy(&self, age: Duration) -> Result<(), StoreError> {
        self.inner.tidy(age).await
    }
}

struct FaultyStage {
    inner: Box<dyn StagedBlob>,
    faults: Arc<Faults>,
}

#[async_trait]
impl StagedBlob for FaultyStage {
    async fn write_pieces(&mut self, pieces: Vec<Bytes>) -> Result<(), StoreError> {
        self.faults.at(Step::Write).await?;
        self.inner.write_pieces(pieces).await
    }

    fn trust(&mut self) {
        self.inner.trust();
    }

    fn hash(&self) -> BlobHash {
        self.inner.hash()
    }

    async fn publish(self: Box<Self>) -> Result<(), StoreError> {
        self.faults.at(Step::Publish).await?;
        self.inner.publish().await?;
        self.faults.at(Step::Published).await
    }
}

/// A state store with faults.
pub(crate) struct FaultyState {
    pub(crate) inner: Counted<dyn StateStore>,
    pub(crate) faults: Arc<Faults>,
}

#[async_trait]
impl StateStore for FaultyState {
    // It is known once the store is open.
    fn identity(&self) -> FarmIdentity {
        self.inner.store.identity()
    }

    async fn load(&self) -> Result<(Sequence, Snapshot), StoreError> {
        self.inner.load().await
    }

    async fn commit(&self, expected: Sequence, changes: Vec<Change>) -> Result<Commit, StoreError> {
        self.faults.at(Step::Commit).await?;
        let kept = self.inner.commit(expected, changes).await?;
        self.faults.at(Step::Committed).await?;
        Ok(kept)
    }

    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError> {
        self.inner.job(id).await
    }

    async fn jobs(&self, filter: JobFilter, limit: u32) -> Result<Vec<JobRecord>, StoreError> {
        self.inner.jobs(filter, limit).await
    }

    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError> {
        self.inner.job_by_key(key).await
    }

    async fn ended_jobs(&self) -> Result<Vec<EndedJob>, StoreError> {
        self.inner.ended_jobs().await
    }

    async fn put_bundle(
        &self,
        manifest: BundleManifest,
        owner: String,
        most: u64,
        now: Millis,
    ) -> Result<Announced, StoreError> {
        self.inner.put_bundle(manifest, owner, most, now).await
    }

    async fn name_bundle(&self, hash: BlobHash, now: Millis) -> Result<Option<BundleManifest>, StoreError> {
        self.inner.name_bundle(hash, now).await
    }

    async fn forget_bundles(&self, before: Millis) -> Result<usize, StoreError> {
        self.inner.forget_bundles(before).await
    }

    async fn bundled_files(&self) -> Result<BTreeSet<BlobHash>, StoreError> {
        self.inner.bundled_files().await
    }

    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError> {
        self.inner.bundle(hash).await
    }

    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError> {
        self.inner.bundled_size(blob).await
    }

    async fn usage(&self, owner: String) -> Result<Usage, StoreError> {
        self.inner.usage(owner).await
    }

    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError> {
        self.inner.put_token(token).await
    }

    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        self.inner.tokens().await
    }

    async fn remove_token(&self, name: String) -> Result<bool, StoreError> {
        self.inner.remove_token(name).await
    }

    async fn close(&self) {
        self.inner.close().await;
    }

    async fn picture(&self, job: JobId, format: &'static str) -> Result<Option<PictureRecord>, StoreError> {
        self.inner.picture(job, format).await
    }

    async fn put_picture(
        &self,
        job: JobId,
        ended_ms: Millis,
        format: &'static str,
        picture: PictureRecord,
    ) -> Result<Option<BlobName>, StoreError> {
        self.inner.put_picture(job, ended_ms, format, picture).await
    }

    async fn pictures(&self, job: JobId) -> Result<Vec<BlobName>, StoreError> {
        self.inner.pictures(job).await
    }

    async fn live_images(&self) -> Result<Vec<BlobName>, StoreError> {
        self.inner.live_images().await
    }

    async fn due_notices(&self, now: Millis, limit: u32) -> Result<Vec<NoticeRecord>, StoreError> {
        self.inner.due_notices(now, limit).await
    }

    async fn notices(
        &self,
        job: Option<JobId>,
        before: Option<String>,
        limit: u32,
    ) -> Result<Vec<NoticeRecord>, StoreError> {
        self.inner.notices(job, before, limit).await
    }

    async fn keep_attempt(&self, record: NoticeRecord) -> Result<(), StoreError> {
        self.inner.keep_attempt(record).await
    }

    async fn forget_notices(&self, before: Millis) -> Result<u64, StoreError> {
        self.inner.forget_notices(before).await
    }

    fn is_shared(&self) -> bool {
        self.inner.is_shared()
    }

    async fn news(&self, since: Sequence) -> Result<News, StoreError> {
        self.inner.news(since).await
    }

    async fn wait_for_news(&self, since: Sequence) {
        self.inner.wait_for_news(since).await;
    }

    async fn share_beats(&self, heard: Vec<Beat>) -> Result<Vec<Beat>, StoreError> {
        self.inner.share_beats(heard).await
    }

    async fn leads(&self) -> Result<bool, StoreError> {
        self.inner.leads().await
    }

    async fn time_ms(&self) -> Result<Option<Millis>, StoreError> {
        self.inner.time_ms().await
    }
}
