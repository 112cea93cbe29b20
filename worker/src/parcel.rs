//! Finished work of a lease, as it is to be delivered.

use crate::block::Sum;
use crate::held::LeaseState;
use bytes::Bytes;
use photonfarm_proto::id::{BlobHash, WorkerId};
use photonfarm_proto::node::{self, NodeKey};
use photonfarm_proto::worker::{FailureReport, Lease, NodeUpload};
use std::sync::Arc;

/// What remains to be said of a lease.
pub(crate) struct Parcel {
    pub(crate) lease: Lease,
    pub(crate) state: Arc<LeaseState>,
    pub(crate) uploads: Vec<Upload>,
    pub(crate) farewell: Farewell,
    /// Whether nodes go to the object store rather than through the coordinator.
    pub(crate) stores: bool,
}

/// A node, encoded and hashed once.
pub(crate) struct Upload {
    pub(crate) announced: NodeUpload,
    pub(crate) image: Bytes,
}

/// The last word on a lease.
pub(crate) enum Farewell {
    /// The nodes say it all.
    Nothing,
    /// Take it back.
    Release,
    /// A leaf failed.
    Failure(FailureReport),
}

/// Encodes sums and hashes their images.
pub(crate) fn encode(worker: WorkerId, lease: &Lease, sums: Vec<Sum>) -> Vec<Upload> {
    let upload = |Sum { node, totals }: Sum| {
        let image = node::encode_node(lease.job, &node);
        let announced = NodeUpload {
            token: lease.token,
            worker,
            job: lease.job,
            node: NodeKey {
                level: node.level,
                index: node.index,
            },
            width: node.width,
            height: node.height,
            digest: BlobHash::of(&image),
            totals,
            memory_mb: None,
        };
        Upload {
            announced,
            image: image.into(),
        }
    };
    sums.into_iter().map(upload).collect()
}
