//! Nodes become one, until only maximal nodes are left; then a complete job ends.

use super::at_hand::buffer;
use super::merge::{AddError, Merge, Unusable, add_up};
use super::{Part, Service, ServiceError};
use crate::background::in_background;
use crate::scheduler::record::BlobName;
use crate::scheduler::{Farm, Job};
use crate::store::{self, StoreError};
use axum::body::Bytes;
use photonfarm_core::film::Node;
use photonfarm_proto::id::JobId;
use photonfarm_proto::node::NodeKey;
use std::sync::Arc;
use tokio::runtime::Handle;

impl Service {
    /// Merges what there is, by and by; where several coordinators share the farm, the one that leads does.
    pub(super) fn fold_in_background(self: &Arc<Self>, job: JobId) {
        if !self.leads() {
            return;
        }
        let service = self.clone();
        tokio::spawn(async move { service.fold_and_log(job).await });
    }

    /// Folds every job of which something is left to fold: what a crash or a full disk left undone.
    pub(super) async fn fold_all(self: &Arc<Self>) {
        let jobs: Vec<JobId> = match self.fresh_farm().await {
            Ok(cell) => cell.farm.jobs_to_fold(),
            Err(error) => return tracing::error!(%error, "the state cannot be loaded"),
        };
        for job in jobs {
            self.fold_and_log(job).await;
        }
    }

    async fn fold_and_log(self: &Arc<Self>, job: JobId) {
        let folded = self.fold(job).await;
        if let Err(error) = &folded {
            self.note(Part::Images, &folded);
            tracing::error!(%job, %error, "nodes could not be merged; it is tried again");
        }
    }

    /// Merges while there is something to merge. One merge at a time in the whole process bounds its memory.
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
        while let Some(merge) = self.next_merge(job).await? {
            let node = merge.node.key;
            let mut span = self.begin_for(job, "merge");
            span.fact("node", || node.to_string());
            span.fact("parts", || merge.parts.len() as u64);
            let (service, runtime) = (self.clone(), Handle::current());
            let add = move || {
                let (store, at_hand) = (&*service.stores.nodes, &service.at_hand);
                let mut image = buffer(merge.bytes()).map_err(StoreError::Memory)?;
                runtime.block_on(add_up(store, at_hand, &merge, &mut image))?;
                Ok(Bytes::from_owner(image))
            };
            let added = in_background(add).await;
            let bytes = match added.map_err(|_| ServiceError::Stopping)? {
                Ok(bytes) => bytes,
                Err(AddError::Unusable(Unusable { node, image, reason })) => {
                    span.failed(&reason);
                    self.give_up(job, (node, image), reason).await?;
                    continue;
                }
                Err(AddError::Store(error)) => return Err(error.into()),
            };
            let publication = self.publication().await;
            let stored = store::put(&*self.stores.nodes, bytes.clone(), store::new_copy()?)
                .await
                .map_err(ServiceError::from);
            self.note(Part::Images, &stored);
            let sum = stored?;
            let merge = move |farm: &Farm, _| Ok(farm.merge(job, node, sum));
            if !self.transact_until(publication.last, merge).await? {
                self.discard(job, sum);
            } else if let Some(room) = self.at_hand.room(sum.hash, bytes.len() as u64) {
                self.at_hand.keep(sum.hash, room.hold(bytes));
            }
        }
        Ok(())
    }

    /// A node of the image that nobody has looked at, where nothing is left to merge.
    async fn next_unread(self: &Arc<Self>, job: JobId) -> Result<Option<(NodeKey, BlobName)>, ServiceError> {
        Ok(self.fresh_farm().await?.farm.job(job).and_then(Job::next_unread))
    }

    async fn next_merge(self: &Arc<Self>, id: JobId) -> Result<Option<Merge>, ServiceError> {
        let cell = self.fresh_farm().await?;
        let Some(job) = cell.farm.job(id) else { return Ok(None) };
        let merge = || {
            let key = job.next_merge()?;
            let parts = job.parts(key)?.into_iter();
            let parts = parts.map(|part| Some((part, job.live_image(part)?)));
            Some(Merge {
                node: job.header(key),
                parts: parts.collect::<Option<_>>()?,
            })
        };
        Ok(merge())
    }

    pub(super) async fn child(
        self: &Arc<Self>,
        job: JobId,
        (node, image): (NodeKey, BlobName),
    ) -> Result<Option<Node>, ServiceError> {
        let header = self.fresh_farm().await?.farm.job(job).map(|job| job.header(node));
        match header {
            Some(header) => self.node(header, image).await,
            None => Ok(None),
        }
    }
}
