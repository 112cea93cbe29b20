//! Finished work on its way to the coordinator: kept until acknowledged.

use crate::backoff::Backoff;
use crate::block::Sum;
use crate::client::{Client, ClientError, retry};
use crate::held::{Held, LeaseState};
use photonfarm_proto::id::{BlobHash, WorkerId};
use photonfarm_proto::node::{self, NodeKey};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::worker::{Acknowledged, FailureReport, Lease, NodeReply, NodeUpload, Release, frame_upload};
use reqwest::Request;
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Attempts at a node that the coordinator refuses as damaged: bits may fall over on the way.
const DAMAGED_ATTEMPTS: u32 = 4;

/// What remains to be said of a lease.
pub(crate) struct Parcel {
    pub(crate) lease: Lease,
    pub(crate) state: Arc<LeaseState>,
    pub(crate) uploads: Vec<Request>,
    pub(crate) farewell: Farewell,
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

/// Turns sums into requests: the images are encoded and hashed once.
pub(crate) fn encode(
    client: &Client,
    worker: WorkerId,
    lease: &Lease,
    sums: Vec<Sum>,
) -> Result<Vec<Request>, ClientError> {
    let request = |Sum { node, totals }: Sum| {
        let image = node::encode_node(lease.job, &node);
        let upload = NodeUpload {
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
        };
        let mut body = frame_upload(&upload)?;
        body.extend_from_slice(&image[node::NodeHeader::BYTES..]);
        client.post("worker/nodes", body, Duration::ZERO)
    };
    sums.into_iter().map(request).collect()
}

/// Delivers a parcel, however long it takes. `stop` gives up what is not delivered.
pub(crate) async fn deliver(client: &Client, held: &Held, parcel: Parcel, stop: &CancellationToken) {
    let Parcel {
        lease,
        state,
        uploads,
        farewell,
    } = parcel;
    let mut farewell = farewell;
    for upload in &uploads {
        if let Err(error) = deliver_node(client, upload, &state, stop).await {
            tracing::warn!(job = %lease.job, node = %lease.node, token = %lease.token, %error, "work is dropped");
            farewell = Farewell::Release;
            break;
        }
    }
    let said = match farewell {
        _ if state.is_lost() => Ok(Acknowledged),
        Farewell::Nothing => Ok(Acknowledged),
        Farewell::Release => {
            let release = Release {
                token: lease.token,
                worker: lease.worker,
                job: lease.job,
            };
            client.insist("worker/release", &release, Duration::ZERO, stop).await
        }
        Farewell::Failure(report) => client.insist("worker/failures", &report, Duration::ZERO, stop).await,
    };
    if let Err(error) = said {
        tracing::debug!(token = %lease.token, %error, "the lease was over already");
    }
    held.remove(lease.token);
}

async fn deliver_node(
    client: &Client,
    upload: &Request,
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let mut backoff = Backoff::default();
    for attempt in 1.. {
        if state.is_lost() {
            return Ok(());
        }
        let error = match retry_while_held(client, upload, state, stop).await {
            Ok(NodeReply { .. }) => return Ok(()),
            Err(error) => error,
        };
        let damaged = matches!(error.code(), Some(ErrorCode::ContentMismatch | ErrorCode::Malformed));
        if !damaged || attempt == DAMAGED_ATTEMPTS {
            return Err(error);
        }
        tokio::time::sleep(backoff.next()).await;
    }
    Ok(())
}

/// Repeats an upload while the coordinator is away; an upload whose lease is lost meanwhile is refused at the latest.
async fn retry_while_held(
    client: &Client,
    upload: &Request,
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<NodeReply, ClientError> {
    retry(stop, || async {
        if state.is_lost() {
            return Ok(NodeReply { duplicate: true });
        }
        client.send(upload).await
    })
    .await
}
