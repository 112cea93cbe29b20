//! Images of nodes that do not count are removed, by and by; and scenes that nobody names.
//!
//! No name of an image is ever used twice: every upload and every merge makes a copy with a number of its own. So what
//! decides over a removal is the commit that drops the row with the name, whoever made it; nobody can publish that name
//! again afterwards. What a crash leaves between the bytes and their row is garbage once it is old: a row must name its
//! bytes soon after they were published, or never.

use super::partial::owner_of_part;
use super::{Service, ServiceError};
use crate::scheduler::Farm;
use crate::scheduler::record::{BlobName, Change, Millis};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::RwLockReadGuard;

/// Age at which an image without a row is garbage.
const GARBAGE_AGE: Duration = Duration::from_secs(3600);
/// Age at which a scene that no job names, or a file that no scene names, is garbage: its client may have sent it, and be
/// about to submit the job.
const SCENE_AGE: Duration = Duration::from_secs(24 * 3600);
/// Longest time from the publication of an image to the commit of its row \[ms\]. It is far shorter than the age of
/// garbage, so that no removal meets an image whose row is about to come, wherever that is decided.
const COMMIT_WITHIN: Millis = 600_000;

/// An image is about to be published, and then its row committed.
pub(super) struct Publication<'a> {
    /// No sweep of this process looks at the rows before the commit.
    _shared: RwLockReadGuard<'a, ()>,
    /// When the row must be committed at the latest.
    pub(super) last: Millis,
}

/// The answer to a sender whose image was published too long ago.
pub(super) fn too_late() -> ServiceError {
    let detail = "the image of the node could not be counted in time: send it again";
    Problem::new(ErrorCode::Unavailable, detail).into()
}

impl Service {
    /// Announces that an image is published now and its row committed then.
    pub(super) async fn publication(&self) -> Publication<'_> {
        Publication {
            _shared: self.publishing.read().await,
            last: self.clock.now().saturating_add(COMMIT_WITHIN),
        }
    }

    /// Removes images that a commit has dropped.
    pub(super) fn collect(self: &Arc<Self>, garbage: Vec<BlobName>) {
        if garbage.is_empty() {
            return;
        }
        let service = self.clone();
        tokio::spawn(async move { service.remove_all(garbage).await });
    }

    pub(super) async fn remove_all(&self, garbage: Vec<BlobName>) {
        for image in garbage {
            self.at_hand.forget(image.hash);
            self.remove(image).await;
        }
    }

    /// Removes the image of a delivery that was decided over, unless it counts. Where the outcome of the decision is not
    /// known, age decides.
    pub(super) fn discard(self: &Arc<Self>, job: JobId, image: BlobName) {
        let service = self.clone();
        tokio::spawn(async move {
            match service.find_job(job).await {
                Ok(job) if job.live_images().any(|(_, live)| live == image) => {}
                Ok(_) | Err(ServiceError::Refusal(_)) => service.remove(image).await,
                Err(error) => tracing::warn!(%error, "garbage is left for later"),
            }
        });
    }

    async fn remove(&self, image: BlobName) {
        if let Err(error) = self.stores.nodes.remove(image).await {
            tracing::warn!(%error, "garbage is left for later");
        }
    }

    /// Removes what nothing names any more, once it is old.
    pub(super) async fn sweep(&self) -> Result<(), ServiceError> {
        self.remove_orphans().await?;
        self.remove_scenes().await
    }

    /// Removes scenes that no job names, once no client has named them for a while; and their files, once none was sent
    /// for a while.
    async fn remove_scenes(&self) -> Result<(), ServiceError> {
        let before = self.clock.now().saturating_sub(SCENE_AGE.as_millis() as Millis);
        let scenes = self.stores.state.forget_bundles(before).await?;
        let named = self.stores.state.bundled_files().await?;
        // A manifest that names what the parts of an upload have in common keeps none of them.
        let is_named = |file: &BlobName| owner_of_part(*file).is_none() && named.contains(&file.hash);
        let mut files = 0;
        let listed = self.stores.scenes.list().await?;
        let uploads = self.count_uploads(&listed);
        for (file, age) in listed {
            // An upload goes as a whole, or a slow one would lose its first parts.
            let age = uploads.get(&file.hash).copied().unwrap_or(age);
            if age < SCENE_AGE || is_named(&file) {
                continue;
            }
            // Whoever names it from here on is told that it is missing, and sends it again.
            let _nobody_names = self.naming.write().await;
            if owner_of_part(file).is_some() || self.stores.state.bundled_size(file.hash).await?.is_none() {
                self.stores.scenes.remove(file).await?;
                self.partials.release(file.hash);
                files += 1;
            }
        }
        if scenes > 0 || files > 0 {
            tracing::info!("removed {scenes} scenes that no job and no client had named for a day, and {files} files");
        }
        Ok(())
    }

    /// The time since each unfinished upload last grew, by what the names of its parts have in common; and counts those that
    /// nothing was known of.
    fn count_uploads(&self, listed: &[(BlobName, Duration)]) -> BTreeMap<BlobHash, Duration> {
        let mut uploads: BTreeMap<BlobHash, (Duration, u32, u64)> = BTreeMap::new();
        for (name, age) in listed {
            if let Some(owner) = owner_of_part(*name) {
                let (youngest, _, parts) = uploads.entry(name.hash).or_insert((*age, owner, 0));
                *youngest = (*youngest).min(*age);
                *parts += 1;
            }
        }
        let count = |(key, (youngest, owner, parts))| {
            self.partials.found(key, owner, parts);
            (key, youngest)
        };
        uploads.into_iter().map(count).collect()
    }

    /// Removes old images that no row names: what a crash between bytes and row leaves.
    async fn remove_orphans(&self) -> Result<(), ServiceError> {
        self.stores.nodes.tidy(GARBAGE_AGE).await?;
        let listed = self.stores.nodes.list().await?.into_iter();
        let old: Vec<BlobName> = listed
            .filter(|(_, age)| *age >= GARBAGE_AGE)
            .map(|(name, _)| name)
            .collect();
        if old.is_empty() {
            return Ok(());
        }
        // Whatever of it was about to be committed here is committed once this process publishes nothing.
        drop(self.publishing.write().await);
        let mut live = self.stores.state.live_images().await?;
        live.sort_unstable();
        for image in old {
            if live.binary_search(&image).is_err() {
                self.stores.nodes.remove(image).await?;
            }
        }
        Ok(())
    }
}

/// The images that counted and are named no more once `changes` are applied.
pub(super) fn superfluous(farm: &Farm, changes: &[Change]) -> Vec<BlobName> {
    let named = |image: &BlobName| {
        changes.iter().any(|change| match change {
            Change::NodeAdded { record, .. } | Change::NodeJudged { record, .. } => record.image() == *image,
            _ => false,
        })
    };
    let dropped = changes.iter().filter_map(|change| match change {
        Change::NodeMerged { job, node }
        | Change::NodeLost { job, node, .. }
        | Change::NodeJudged { job, node, .. } => farm.job(*job)?.live_image(*node),
        _ => None,
    });
    dropped.filter(|image| !named(image)).collect()
}
