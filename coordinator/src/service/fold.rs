//! Siblings become their parent, until only maximal nodes are left; then a complete job ends.

use super::garbage::Garbage;
use super::{Service, ServiceError};
use crate::scheduler::Job;
use crate::store;
use photonfarm_core::film::Node;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::node::{self, NodeKey};
use std::sync::Arc;

impl Service {
    /// Merges what there is, by and by; where several coordinators share the farm, the one that leads does.
    pub(super) fn fold_in_background(self: &Arc<Self>, job: JobId) {
        if !self.leads() {
            return;
        }
        let service = self.clone();
        tokio::spawn(async move { service.fold_and_log(job).await });
    }

    /// Folds every job that goes on: what a crash or a full disk left undone.
    pub(super) async fn fold_all(self: &Arc<Self>) {
        let jobs: Vec<JobId> = match self.fresh_farm().await {
            Ok(cell) => cell.farm.jobs().map(|job| job.id()).collect(),
            Err(error) => return tracing::error!(%error, "the state cannot be loaded"),
        };
        for job in jobs {
            self.fold_and_log(job).await;
        }
    }

    async fn fold_and_log(self: &Arc<Self>, job: JobId) {
        if let Err(error) = self.fold(job).await {
            tracing::error!(%job, %error, "nodes could not be merged; it is tried again");
        }
    }

    /// Merges while there are siblings. One merge at a time in the whole process bounds its memory.
    async fn fold(self: &Arc<Self>, job: JobId) -> Result<(), ServiceError> {
        let _one_at_a_time = self.folding.lock().await;
        self.merge_all(job).await?;
        while self.measure_noise(job).await? {
            self.merge_all(job).await?;
        }
        while let Some(node) = self.next_unread(job).await? {
            if self.child(job, node).await?.is_some() {
                self.transact(move |farm, _| Ok(farm.check(job, node.0))).await?;
            }
        }
        self.transact(move |farm, now| Ok(farm.settle(job, now))).await
    }

    async fn merge_all(self: &Arc<Self>, job: JobId) -> Result<(), ServiceError> {
        while let Some((parent, children)) = self.next_merge(job).await? {
            let [Some(left), Some(right)] = [self.child(job, children[0]).await?, self.child(job, children[1]).await?]
            else {
                continue;
            };
            let merge = move || left.merge(&right).map(|parent| node::encode_node(job, &parent));
            let bytes = tokio::task::spawn_blocking(merge)
                .await
                .map_err(|_| ServiceError::Stopping)??;
            let _publishing = self.publishing.read().await;
            let digest = store::put(&*self.stores.nodes, &bytes).await?;
            if !self
                .transact(move |farm, _| Ok(farm.merge(job, parent, digest)))
                .await?
            {
                self.collect_refused(Garbage {
                    job,
                    node: parent,
                    digest,
                });
            }
        }
        Ok(())
    }

    /// A node of the image that nobody has looked at, where nothing is left to merge.
    async fn next_unread(self: &Arc<Self>, job: JobId) -> Result<Option<(NodeKey, BlobHash)>, ServiceError> {
        Ok(self.fresh_farm().await?.farm.job(job).and_then(Job::next_unread))
    }

    async fn next_merge(
        self: &Arc<Self>,
        job: JobId,
    ) -> Result<Option<(NodeKey, [(NodeKey, BlobHash); 2])>, ServiceError> {
        let cell = self.fresh_farm().await?;
        let Some(job) = cell.farm.job(job) else { return Ok(None) };
        Ok(job.next_merge().and_then(|parent| {
            let digest = |child| job.live_nodes().find(|(live, _)| *live == child);
            let [left, right] = parent.children()?;
            Some((parent, [digest(left)?, digest(right)?]))
        }))
    }

    pub(super) async fn child(
        self: &Arc<Self>,
        job: JobId,
        node: (NodeKey, BlobHash),
    ) -> Result<Option<Node>, ServiceError> {
        let resolution = self.fresh_farm().await?.farm.job(job).and_then(Job::resolution);
        self.node(job, node, resolution).await
    }
}
