//! Nodes that workers put into the object store themselves: a place to put them, then the row, then the acknowledgement.
//!
//! The bytes do not pass through the coordinator before they count. A job's first node, which fixes its image size, is
//! read at once; any other when it is merged, shown, or before the job ends.

use super::upload::{deliver_late, delivery};
use super::{Service, ServiceError};
use crate::scheduler::record::Millis;
use crate::scheduler::{Delivered, Job, Refusal};
use crate::store::{self, StoreError};
use photonfarm_proto::node::NodeHeader;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::trace::Context;
use photonfarm_proto::worker::{NodePlace, NodeUpload};
use std::sync::Arc;

/// An object of this upload alone, which no other worker can name.
fn name(upload: &NodeUpload) -> String {
    format!("{}-{}-{}", upload.worker, upload.token, upload.digest)
}

impl Service {
    /// Whether workers put nodes into the store themselves.
    pub(crate) fn workers_store(&self) -> bool {
        self.stores.nodes.signs()
    }

    /// Where a worker may put a node that it could deliver now.
    pub(crate) async fn place(self: &Arc<Self>, upload: &NodeUpload) -> Result<NodePlace, ServiceError> {
        self.check_upload(upload).await?;
        if self.foresee_stored(upload).await? == Delivered::Duplicate {
            self.deliver(delivery(upload, true, 0), Millis::MAX).await?;
            return Ok(NodePlace::Known);
        }
        let url = self.stores.nodes.write_url(&name(upload)).await?;
        Ok(url.map_or(NodePlace::Here, NodePlace::Url))
    }

    /// A worker says, perhaps from within a span of its own, that it has put a node to its place.
    pub(crate) async fn stored(
        self: &Arc<Self>,
        upload: NodeUpload,
        asked_by: Option<Context>,
    ) -> Result<Delivered, ServiceError> {
        let header = self.check_upload(&upload).await?;
        if self.foresee_stored(&upload).await? == Delivered::Duplicate {
            return self.deliver(delivery(&upload, true, 0), Millis::MAX).await;
        }
        let service = self.clone();
        let task = async move {
            let mut delivery = delivery(&upload, true, store::new_copy()?);
            let span = service.begin_commit(&delivery, asked_by);
            let publication = service.publication().await;
            let bytes = NodeHeader::BYTES as u64 + header.plane_bytes();
            let adopted = service
                .stores
                .nodes
                .adopt(&name(&upload), delivery.image(), bytes)
                .await;
            adopted.map_err(not_there)?;
            let is_first = |job: &Job| job.resolution().is_none();
            let first = service.with_job(upload.job, is_first).await?;
            let _permit = match first {
                true => Some(service.uploads.acquire().await.map_err(|_| ServiceError::Stopping)?),
                false => None,
            };
            if first && let Err(reason) = service.read_node(header, delivery.image()).await? {
                service.stores.nodes.remove(delivery.image()).await?;
                service.blame(&upload, &reason).await?;
                return Err(Problem::new(ErrorCode::ContentMismatch, reason).into());
            }
            delivery.unread = !first;
            let result = service.deliver(delivery.clone(), publication.last).await;
            drop(publication);
            span.end(&result);
            service.after_delivery(&delivery, result).await
        };
        tokio::spawn(task).await.map_err(|_| ServiceError::Stopping)?
    }

    /// What would become of a node that its worker stores. If it is known already, or refused, what was put is removed:
    /// nobody would adopt it.
    async fn foresee_stored(self: &Arc<Self>, upload: &NodeUpload) -> Result<Delivered, ServiceError> {
        let foreseen = self.would_count(upload).await;
        if let Ok(Delivered::Duplicate) | Err(ServiceError::Refusal(_)) = foreseen
            && let Err(error) = self.stores.nodes.discard(&name(upload)).await
        {
            tracing::warn!(%error, "what a worker put is left for later");
        }
        foreseen
    }

    /// What would become of a delivery now.
    pub(super) async fn would_count(self: &Arc<Self>, upload: &NodeUpload) -> Result<Delivered, ServiceError> {
        let delivery = delivery(upload, true, 0);
        let wanted = delivery.clone();
        let decide = move |farm: &crate::scheduler::Farm, now| {
            let mut decision = farm.deliver(&wanted, now)?;
            decision.changes.clear();
            Ok(decision)
        };
        match self.transact(decide).await {
            Err(ServiceError::Refusal(Refusal::UnknownJob(id))) => {
                let late = |job: &Job| deliver_late(job, &delivery);
                Ok(self.with_job(id, late).await??)
            }
            other => other,
        }
    }
}

/// Nothing was put, or only a part: the worker is to put it again.
fn not_there(error: StoreError) -> ServiceError {
    match error {
        StoreError::NoBlob(_) | StoreError::Damaged(_) => Problem::new(
            ErrorCode::ContentMismatch,
            format!("the node is not in the store: {error}"),
        )
        .into(),
        other => other.into(),
    }
}
