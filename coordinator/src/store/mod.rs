//! Where the farm's truth is kept: state in a [`StateStore`], bytes in a [`BlobStore`].
//!
//! Bytes are published before the row that names them is committed, and removed after the row that named them is gone.
//! A crash in between leaves bytes without a row, which the next start removes; never a row without bytes.

mod backup;
mod blob;
#[cfg(test)]
mod blob_tests;
#[cfg(test)]
mod deletion_tests;
mod error;
#[cfg(test)]
pub(crate) mod faulty;
mod filter;
#[cfg(test)]
mod filter_tests;
mod folder;
#[cfg(test)]
pub(crate) mod memory;
#[cfg(test)]
mod notice_tests;
mod object;
mod place;
mod postgres;
mod postgres_connection;
mod postgres_schema;
mod postgres_session;
#[cfg(test)]
mod postgres_tests;
mod postgres_tls;
mod room;
mod sql;
mod sql_bundles;
mod sql_changes;
mod sql_farm;
mod sql_jobs;
mod sql_notices;
mod sql_pictures;
mod sql_tokens;
mod sqlite;
mod sqlite_schema;
#[cfg(test)]
mod tests;
mod token;

pub use backup::{Backup, BackupError, back_up};
pub(crate) use blob::hash_of;
pub use blob::{BlobReader, BlobStore, StagedBlob, new_copy, put};
pub use error::StoreError;
pub use filter::JobFilter;
pub use folder::FolderStore;
pub use object::ObjectBlobs;
pub use place::{BlobPlace, PlaceError, StatePlace};
pub use postgres::PostgresStore;
pub use room::Room;
pub use sqlite::SqliteStore;
pub use token::TokenRecord;

use crate::scheduler::record::{BlobName, Change, JobRecord, Millis, Notice, Snapshot};
use async_trait::async_trait;
use error::{check_file, check_folder, not_writable};
use photonfarm_proto::api::FarmIdentity;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::node::{NodeHeader, NodeKey};
use photonfarm_proto::token::Usage;
use photonfarm_proto::worker::LeaseProgress;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The farm's place in the order of commits: every commit raises it by one. Stores with one user leave it at zero.
pub type Sequence = u64;

/// What became of a commit.
#[derive(Clone, Debug, PartialEq)]
pub enum Commit {
    /// All changes are kept, and the farm stands here.
    Kept(Sequence),
    /// Another coordinator was first: nothing was kept. Learn its changes ([`StateStore::news`]) and decide again.
    Behind,
}

/// What other coordinators changed.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// These changes, in their order, lead here. There may be none.
    Changes(Sequence, Vec<Change>),
    /// The store does not remember so far back: [`StateStore::load`] tells.
    Forgotten,
}

/// The picture of a job that has ended, as a file in the store of nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PictureRecord {
    /// Names what the picture shows.
    pub etag: String,
    /// The name of the file.
    pub image: BlobName,
    /// Its length.
    pub bytes: u64,
}

/// A job that has ended, and the room that it takes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndedJob {
    /// The job.
    pub id: JobId,
    /// When it ended.
    pub ended_ms: Millis,
    /// The bundle that it names.
    pub scene: BlobHash,
    /// Bytes of its images and pictures.
    pub bytes: u64,
}

/// Something that a URL is to be told, and what became of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NoticeRecord {
    /// What, and where.
    pub notice: Notice,
    /// How often it was sent.
    pub attempts: u32,
    /// When it is to be sent; none once it has arrived or was given up.
    pub due_ms: Option<Millis>,
    /// When it arrived or was given up.
    pub ended_ms: Option<Millis>,
    /// Why the last attempt failed; none if it arrived.
    pub error: Option<String>,
}

/// Bytes of an image of a node of a job whose images have this size, once that is known.
pub(crate) fn image_bytes(spec: &JobSpec, resolution: Option<[u32; 2]>) -> u64 {
    let [width, height] = resolution.unwrap_or_default();
    let header = NodeHeader {
        job: JobId(0),
        key: NodeKey::leaf(0),
        width,
        height,
        statistics: spec.integrator.with_defaults().statistics_per_pixel() as u16,
    };
    NodeHeader::BYTES as u64 + header.plane_bytes()
}

/// What is known of a bundle that was announced.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Announced {
    /// Bytes that its owner has with it, or would have.
    pub used: u64,
    /// Its blobs that no bundle named before: if they are there, they are about to be removed.
    pub fresh: BTreeSet<BlobHash>,
}

/// A sign of life of a worker, as one coordinator received it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Beat {
    /// The worker.
    pub worker: WorkerId,
    /// When, by the store's clock.
    pub at_ms: Millis,
    /// The leases it holds and how far they are.
    pub leases: Vec<LeaseProgress>,
}

/// State: jobs, leases, nodes, workers, bundles, tokens.
///
/// # Contract
/// * [`commit`](Self::commit) applies all changes or none, and what it applied survives a crash of the machine.
///   After an error the outcome is unknown until [`news`](Self::news) or [`load`](Self::load) tell.
/// * Counters never fall, even when the rows that used them are gone. A store that finds that it was restored from a
///   backup, or copied, begins a new epoch, with numbers beyond all that the farm can have given meanwhile.
/// * A store either has one user at a time, and opening it twice is an error; or it is
///   [`shared`](Self::is_shared), and a commit is kept only if it was decided upon the newest state.
#[async_trait]
pub trait StateStore: Send + Sync {
    /// Which farm it is; known once the store is open.
    fn identity(&self) -> FarmIdentity;
    /// The state to go on from.
    async fn load(&self) -> Result<(Sequence, Snapshot), StoreError>;
    /// Applies changes, all or none, if the farm still stands at `expected`.
    async fn commit(&self, expected: Sequence, changes: Vec<Change>) -> Result<Commit, StoreError>;
    /// A job, whether it has ended or not.
    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError>;
    /// Up to `limit` jobs.
    async fn jobs(&self, filter: JobFilter, limit: u32) -> Result<Vec<JobRecord>, StoreError>;
    /// The jobs that have ended.
    async fn ended_jobs(&self) -> Result<Vec<EndedJob>, StoreError>;
    /// The job that was submitted with an idempotency key.
    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError>;
    /// Keeps a manifest, which the owner names at the time `now`, under its hash, and counts its distinct blobs for the
    /// owner, once each. Where the owner would have more than `most` bytes then, nothing changes.
    async fn put_bundle(
        &self,
        manifest: BundleManifest,
        owner: String,
        most: u64,
        now: Millis,
    ) -> Result<Announced, StoreError>;
    /// The manifest of a bundle.
    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError>;
    /// The manifest of a bundle, which somebody names at the time `now`.
    async fn name_bundle(&self, hash: BlobHash, now: Millis) -> Result<Option<BundleManifest>, StoreError>;
    /// Forgets bundles that no job names, and that nobody has named since the time `before`; and blobs that no other
    /// bundle names, which count for nobody any more. Returns the number of bundles.
    async fn forget_bundles(&self, before: Millis) -> Result<usize, StoreError>;
    /// The blobs that bundles name.
    async fn bundled_files(&self) -> Result<BTreeSet<BlobHash>, StoreError>;
    /// The largest size that a bundle gives for a blob; `None` if no bundle names it.
    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError>;
    /// What an owner has used.
    async fn usage(&self, owner: String) -> Result<Usage, StoreError>;
    /// Keeps a token; returns false, and changes nothing, if there is one of that name.
    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError>;
    /// All tokens, by name.
    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError>;
    /// Forgets a token. Returns whether there was one.
    async fn remove_token(&self, name: String) -> Result<bool, StoreError>;
    /// Lets go of the store, so that somebody else can open it; every later call fails.
    async fn close(&self);
    /// The picture of a job in the format of this name.
    async fn picture(&self, job: JobId, format: &'static str) -> Result<Option<PictureRecord>, StoreError>;
    /// Keeps a picture of a job that ended at the time `ended_ms`, until it is deleted or goes on. Returns what nothing
    /// names then: the picture that it replaces, or itself if the job did not end at that time.
    async fn put_picture(
        &self,
        job: JobId,
        ended_ms: Millis,
        format: &'static str,
        picture: PictureRecord,
    ) -> Result<Option<BlobName>, StoreError>;
    /// Names of the pictures of a job.
    async fn pictures(&self, job: JobId) -> Result<Vec<BlobName>, StoreError>;
    /// Names of the images of all nodes that count, and of the pictures, of all jobs.
    async fn live_images(&self) -> Result<Vec<BlobName>, StoreError>;
    /// Up to `limit` notices that are to be sent by now: those to URLs of the farm first, then those that are due for longest.
    async fn due_notices(&self, now: Millis, limit: u32) -> Result<Vec<NoticeRecord>, StoreError>;
    /// Up to `limit` notices, newest first, below the notice `before`; those about one job if it is named.
    async fn notices(
        &self,
        job: Option<JobId>,
        before: Option<String>,
        limit: u32,
    ) -> Result<Vec<NoticeRecord>, StoreError>;
    /// Keeps what became of an attempt to send a notice.
    async fn keep_attempt(&self, record: NoticeRecord) -> Result<(), StoreError>;
    /// Forgets notices that arrived or were given up before a time. Returns how many.
    async fn forget_notices(&self, before: Millis) -> Result<u64, StoreError>;

    /// The room on its disk, where it lies on one that can be looked at.
    async fn room(&self) -> Result<Option<Room>, StoreError> {
        Ok(None)
    }

    /// Whether several coordinators may use the store at once.
    fn is_shared(&self) -> bool {
        false
    }

    /// What changed since the farm stood at `since`.
    async fn news(&self, _since: Sequence) -> Result<News, StoreError> {
        Ok(News::Forgotten)
    }

    /// Returns when there may be news since the farm stood at `since`; at the latest after about a second in a shared
    /// store, never in others.
    async fn wait_for_news(&self, _since: Sequence) {
        std::future::pending().await
    }

    /// Passes on signs of life received here, and returns those that others received since the last call.
    async fn share_beats(&self, _heard: Vec<Beat>) -> Result<Vec<Beat>, StoreError> {
        Ok(Vec::new())
    }

    /// Whether this coordinator is the one that expires leases, merges nodes and removes garbage: one at a time is,
    /// until it ends.
    async fn leads(&self) -> Result<bool, StoreError> {
        Ok(true)
    }

    /// The time by the clock that all coordinators share; none where there is one coordinator, whose own will do.
    async fn time_ms(&self) -> Result<Option<Millis>, StoreError> {
        Ok(None)
    }
}
