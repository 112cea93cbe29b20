//! Images of nodes as they are read: one that is not what it should be is given up.

use super::{Service, ServiceError};
use crate::background::in_background;
use crate::scheduler::record::BlobName;
use crate::scheduler::{Decision, Farm};
use crate::store::StoreError;
use photonfarm_core::film::Node;
use photonfarm_proto::id::JobId;
use photonfarm_proto::node::{self, NodeHeader, NodeKey};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{StatisticsRequest, statistics_body};
use std::sync::Arc;

impl Service {
    /// Reads the image of a node, which is to have this header. If it is missing, damaged or another's, its leaves go
    /// back to the pool, and nothing is returned.
    pub(super) async fn node(
        self: &Arc<Self>,
        header: NodeHeader,
        image: BlobName,
    ) -> Result<Option<Node>, ServiceError> {
        match self.read_node(header, image).await? {
            Ok(node) => Ok(Some(node)),
            Err(reason) => {
                self.give_up(header.job, (header.key, image), reason).await?;
                Ok(None)
            }
        }
    }

    /// What the iterations of a lease go on from, where the integrator is sequential.
    pub(crate) async fn statistics(self: &Arc<Self>, request: StatisticsRequest) -> Result<Vec<u8>, ServiceError> {
        let StatisticsRequest { token, worker, job } = request;
        let _permit = self.uploads.acquire().await.map_err(|_| ServiceError::Stopping)?;
        let find = move |farm: &Farm, _| farm.checkpoint_of(job, token, worker);
        let node = match self.transact(find).await? {
            Some((header, image)) => self.node(header, image).await?,
            None => None,
        };
        let gone = || {
            Problem::new(
                ErrorCode::NotFound,
                "an iteration before those of the lease is to be rendered again",
            )
        };
        Ok(statistics_body(&node.ok_or_else(gone)?.statistics))
    }

    /// Gives up a node of which the image cannot be used: its leaves go back to the pool.
    pub(super) async fn give_up(
        self: &Arc<Self>,
        job: JobId,
        (node, image): (NodeKey, BlobName),
        reason: String,
    ) -> Result<(), ServiceError> {
        tracing::warn!(%job, %node, reason, "the image of a node cannot be used");
        let lose = move |farm: &Farm, now| {
            // It may have been replaced meanwhile, by another copy.
            match farm.job(job).and_then(|job| job.live_image(node)) == Some(image) {
                true => Ok(farm.lose(job, node, &reason, now)),
                false => Ok(Decision {
                    reply: false,
                    changes: vec![],
                }),
            }
        };
        self.transact(lose).await?;
        Ok(())
    }

    /// Reads the image of a node, which is to have this header; or says why it cannot be used.
    pub(super) async fn read_node(
        &self,
        header: NodeHeader,
        image: BlobName,
    ) -> Result<Result<Node, String>, ServiceError> {
        let most = NodeHeader::BYTES as u64 + header.plane_bytes();
        let bytes = match self.stores.nodes.read(image, most).await {
            Ok(bytes) => bytes,
            Err(error @ (StoreError::NoBlob(_) | StoreError::Damaged(_))) => return Ok(Err(error.to_string())),
            Err(error) => return Err(error.into()),
        };
        let limits = self.limits.clone();
        let decode = move || match node::decode_node(&bytes, &limits) {
            Ok((job, node)) if NodeHeader::of(job, &node) == header => Ok(node),
            Ok(_) => Err("its image is that of another node".to_owned()),
            Err(error) => Err(error.to_string()),
        };
        in_background(decode).await.map_err(|_| ServiceError::Stopping)
    }
}
