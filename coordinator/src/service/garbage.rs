//! Images of nodes that do not count are removed, by and by.
//!
//! Where nobody else publishes bytes, that is as soon as their row is gone, and at every start. Elsewhere a blob without
//! a row may be one whose row is about to come: it is garbage only once it is old.

use super::{Service, ServiceError};
use crate::scheduler::record::{Change, Millis};
use crate::scheduler::{Farm, Job};
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::node::NodeKey;
use std::sync::Arc;

/// Age at which a blob without a row is garbage where others publish as well [ms].
const GARBAGE_AGE: Millis = 3_600_000;

/// A node's image that may be garbage.
#[derive(Clone, Copy, Debug)]
pub(super) struct Garbage {
    pub(super) job: JobId,
    pub(super) node: NodeKey,
    pub(super) digest: BlobHash,
}

impl Service {
    /// Whether others publish bytes: other coordinators, or workers by signed URL.
    fn others_publish(&self) -> bool {
        self.stores.state.is_shared() || self.stores.nodes.signs()
    }

    /// Removes the images of nodes that were merged or given up.
    pub(super) fn collect(self: &Arc<Self>, garbage: Vec<Garbage>) {
        if garbage.is_empty() {
            return;
        }
        let service = self.clone();
        tokio::spawn(async move {
            for garbage in garbage {
                service.at_hand.forget(garbage.digest);
                service.remove_if_garbage(garbage).await;
            }
        });
    }

    /// Removes the image of a delivery that did not count; where others publish, time does.
    pub(super) fn collect_refused(self: &Arc<Self>, garbage: Garbage) {
        if !self.others_publish() {
            self.collect(vec![garbage]);
        }
    }

    async fn remove_if_garbage(self: &Arc<Self>, Garbage { job, node, digest }: Garbage) {
        let _alone = self.publishing.write().await;
        let counts = |job: &Job| job.live_nodes().any(|(live, hash)| live == node && hash == digest);
        let result = match self.find_job(job).await {
            Ok(job) if counts(&job) => return,
            Ok(_) | Err(ServiceError::Refusal(_)) => self.stores.nodes.remove(digest).await,
            Err(error) => return tracing::warn!(%error, "garbage is left for later"),
        };
        if let Err(error) = result {
            tracing::warn!(%error, "garbage is left for later");
        }
    }

    /// Removes node images that no row names: what a crash between bytes and row leaves.
    pub(super) async fn remove_orphans(&self) -> Result<(), ServiceError> {
        let now = self.clock.now();
        let before = if self.others_publish() {
            now.saturating_sub(GARBAGE_AGE)
        } else {
            Millis::MAX
        };
        self.stores.nodes.tidy(before).await?;
        let old = self.stores.nodes.list().await?.into_iter();
        let old: Vec<BlobHash> = old.filter(|(_, at)| *at < before).map(|(hash, _)| hash).collect();
        let mut live = self.stores.state.live_digests().await?;
        live.sort_unstable();
        for digest in old {
            if live.binary_search(&digest).is_err() {
                self.stores.nodes.remove(digest).await?;
            }
        }
        Ok(())
    }
}

/// The images that `changes` make superfluous.
pub(super) fn superfluous(farm: &Farm, changes: &[Change]) -> Vec<Garbage> {
    let merged = changes.iter().filter_map(|change| match change {
        Change::NodeMerged { job, node }
        | Change::NodeLost { job, node, .. }
        | Change::NodeJudged { job, node, .. } => Some((*job, *node)),
        _ => None,
    });
    merged
        .filter_map(|(job, node)| {
            let (_, digest) = farm.job(job)?.live_nodes().find(|(live, _)| *live == node)?;
            Some(Garbage { job, node, digest })
        })
        .collect()
}
