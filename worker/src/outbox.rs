//! Finished work on its way to the coordinator: kept until acknowledged.

use crate::backoff::Backoff;
use crate::block::Sum;
use crate::client::{Client, ClientError, reading_time, retry};
use crate::held::{Held, LeaseState};
use bytes::Bytes;
use photonfarm_proto::id::{BlobHash, WorkerId};
use photonfarm_proto::node::{self, NodeKey};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::worker::{
    Acknowledged, FailureReport, Lease, NodePlace, NodeReply, NodeUpload, Release, frame_upload,
};
use std::sync::Arc;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Attempts at a node that the coordinator refuses as damaged: bits may fall over on the way.
const DAMAGED_ATTEMPTS: u32 = 4;

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
    announced: NodeUpload,
    image: Bytes,
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
        };
        Upload {
            announced,
            image: image.into(),
        }
    };
    sums.into_iter().map(upload).collect()
}

/// Delivers a parcel, however long it takes. `stop` gives up what is not delivered.
pub(crate) async fn deliver(client: &Client, held: &Held, parcel: Parcel, stop: &CancellationToken) {
    let Parcel {
        lease,
        state,
        uploads,
        farewell,
        stores,
    } = parcel;
    let mut farewell = farewell;
    for upload in &uploads {
        if let Err(error) = deliver_node(client, upload, &state, stores, stop).await {
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

/// Whether the lease of a node was lost, so that nobody wants it any more.
fn is_void(upload: &Upload, state: &LeaseState) -> bool {
    if state.is_lost() {
        let NodeUpload { job, node, token, .. } = upload.announced;
        tracing::info!(%job, %node, %token, "the lease is lost: its work is void");
    }
    state.is_lost()
}

async fn deliver_node(
    client: &Client,
    upload: &Upload,
    state: &LeaseState,
    stores: bool,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let mut backoff = Backoff::default();
    for attempt in 1.. {
        if is_void(upload, state) {
            return Ok(());
        }
        let sent = if stores {
            store(client, upload, state, stop).await
        } else {
            send(client, upload, state, stop).await
        };
        let error = match sent {
            Ok(()) => return Ok(()),
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

/// Sends a node to the coordinator, again and again while it is away; an upload whose lease is lost meanwhile is
/// refused at the latest.
async fn send(
    client: &Client,
    upload: &Upload,
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let mut body = frame_upload(&upload.announced)?;
    body.extend_from_slice(&upload.image[node::NodeHeader::BYTES..]);
    let request = client.post("worker/nodes", body, Duration::ZERO)?;
    retry(stop, || async {
        if is_void(upload, state) {
            return Ok(());
        }
        client.send::<NodeReply>(&request).await.map(drop)
    })
    .await
}

/// Puts a node into the object store, where the coordinator says, and says so: again and again while either is away,
/// and to a new place each time.
async fn store(
    client: &Client,
    upload: &Upload,
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let announced = &upload.announced;
    retry(stop, || async {
        if is_void(upload, state) {
            return Ok(());
        }
        match client.call("worker/nodes/place", announced, Duration::ZERO).await? {
            NodePlace::Known => Ok(()),
            NodePlace::Here => send(client, upload, state, stop).await,
            NodePlace::Url(url) => {
                client.put(&url, upload.image.clone()).await?;
                // The coordinator may have to read the image first.
                let reading = reading_time(upload.image.len() as u64);
                let _reply: NodeReply = client.call("worker/nodes/stored", announced, reading).await?;
                Ok(())
            }
        }
    })
    .await
}
