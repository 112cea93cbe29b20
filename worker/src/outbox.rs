//! Finished work on its way to the coordinator: kept until acknowledged.

use crate::backoff::Backoff;
use crate::cache::Cache;
use crate::client::{Client, ClientError, reading_time, retry};
use crate::held::{Held, LeaseState};
use crate::kept;
use crate::parcel::{Farewell, Parcel, Upload};
use photonfarm_proto::codec;
use photonfarm_proto::job::FailureKind;
use photonfarm_proto::node::NodeHeader;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::trace::Context;
use photonfarm_proto::worker::{
    Acknowledged, FailureReport, Lease, NodePlace, NodeReply, NodeUpload, Release, cut_text, frame_upload,
};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Attempts at a node that the coordinator refuses as damaged: bits may fall over on the way.
const DAMAGED_ATTEMPTS: u32 = 4;

/// Whether work was left on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LeftOnDisk {
    /// All was delivered, or is void.
    Nothing,
    /// Something waits for the next start.
    Work,
}

/// Who delivers, and keeps on disk what is not delivered when it is to give up.
pub(crate) struct Courier {
    pub(crate) client: Client,
    pub(crate) held: Held,
    pub(crate) cache: Cache,
    pub(crate) give_up: CancellationToken,
}

impl Courier {
    /// Delivers what an earlier process has kept, then finished work in its order, until there is no more.
    pub(crate) async fn carry(self, mut parcels: mpsc::Receiver<Parcel>) -> LeftOnDisk {
        self.deliver_kept().await;
        let mut kept = LeftOnDisk::Nothing;
        while let Some(parcel) = parcels.recv().await {
            if deliver(&self.client, &self.held, &parcel, &self.give_up).await {
                continue;
            }
            let Lease { job, node, .. } = parcel.lease;
            match self.cache.keep(self.client.coordinator(), &parcel) {
                Ok(path) => {
                    kept = LeftOnDisk::Work;
                    tracing::info!(%job, %node, path = %path.display(), "finished work is kept for the next start");
                }
                Err(error) => {
                    tracing::error!(%job, %node, %error, "finished work cannot be kept: it is rendered again")
                }
            }
        }
        kept
    }

    async fn deliver_kept(&self) {
        let unsent = self.cache.unsent().unwrap_or_else(|error| {
            tracing::warn!(%error, "work of an earlier process cannot be looked for");
            Vec::new()
        });
        for path in unsent {
            let kept = match kept::read(&path, self.client.coordinator()) {
                Ok(Some(kept)) => kept,
                Ok(None) => continue,
                Err(error) => {
                    tracing::warn!(path = %path.display(), %error, "work of an earlier process cannot be read");
                    continue;
                }
            };
            let Lease { job, node, .. } = kept.parcel.lease;
            tracing::info!(%job, %node, path = %path.display(), "delivering work of an earlier process");
            if !deliver(&self.client, &self.held, &kept.parcel, &self.give_up).await {
                return;
            }
            if let Err(error) = kept.remove() {
                tracing::warn!(path = %path.display(), %error, "delivered work cannot be removed");
            }
        }
    }
}

/// Delivers a parcel, however long it takes. `stop` gives up what is not delivered; then something is left, and this is false.
pub(crate) async fn deliver(client: &Client, held: &Held, parcel: &Parcel, stop: &CancellationToken) -> bool {
    let Parcel { lease, state, .. } = parcel;
    let mut refused = None;
    for upload in &parcel.uploads {
        let mut span = client.tracer.begin(lease.trace, "upload");
        span.fact("node", || upload.announced.node.to_string());
        span.fact("bytes", || upload.image.len() as u64);
        let within = span.context();
        let delivered = deliver_node(client, (upload, within), state, parcel.stores, stop).await;
        span.end(&delivered);
        match delivered {
            Ok(()) => {}
            Err(ClientError::Stopping) => return false,
            Err(error) => {
                tracing::warn!(job = %lease.job, node = %lease.node, token = %lease.token, %error, "work is dropped");
                refused = Some(farewell_after(upload, &error));
                break;
            }
        }
    }
    let said = match refused.as_ref().unwrap_or(&parcel.farewell) {
        _ if state.is_lost() => Ok(Acknowledged),
        Farewell::Nothing => Ok(Acknowledged),
        Farewell::Release => {
            let release = Release {
                token: lease.token,
                worker: lease.worker,
                job: lease.job,
            };
            client.insist("worker/release", &release, stop).await
        }
        Farewell::Failure(report) => client.insist("worker/failures", report, stop).await,
    };
    match said {
        Ok(Acknowledged) => {}
        Err(ClientError::Stopping) => return false,
        Err(error) => tracing::debug!(token = %lease.token, %error, "the lease was over already"),
    }
    held.remove(lease.token);
    true
}

/// What is said of a lease of which a node was refused. What came too late, or was damaged on the way, is nobody's fault;
/// anything else would happen to the next worker as well, so that people must learn of it from the job.
fn farewell_after(upload: &Upload, error: &ClientError) -> Farewell {
    use ErrorCode::{ContentMismatch, JobEnded, Malformed, NotFound, ResultConflict, StaleLease, UnknownWorker};
    let passes = [
        ContentMismatch,
        JobEnded,
        Malformed,
        NotFound,
        ResultConflict,
        StaleLease,
        UnknownWorker,
    ];
    if error.code().is_some_and(|code| passes.contains(&code)) {
        return Farewell::Release;
    }
    let NodeUpload {
        token,
        worker,
        job,
        node,
        ..
    } = upload.announced;
    Farewell::Failure(FailureReport {
        token,
        worker,
        job,
        leaf: node.first() as u32,
        kind: FailureKind::Render,
        message: cut_text(format!("the image of node {node} was refused: {error}")),
        shortage: None,
    })
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
    (upload, within): (&Upload, Context),
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
            store(client, (upload, within), state, stop).await
        } else {
            send(client, (upload, within), state, stop).await
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

/// In words.
fn delivery_of(upload: &NodeUpload) -> String {
    format!("the delivery of node {} of job {}", upload.node, upload.job)
}

/// Sends a node to the coordinator, again and again while it is away; an upload whose lease is lost meanwhile is
/// refused at the latest.
async fn send(
    client: &Client,
    (upload, within): (&Upload, Context),
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let mut body = frame_upload(&upload.announced)?;
    body.extend_from_slice(&upload.image[NodeHeader::BYTES..]);
    let request = client.post("worker/nodes", body, Duration::ZERO)?.within(within);
    let what = delivery_of(&upload.announced);
    retry(stop, &what, || async {
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
    (upload, within): (&Upload, Context),
    state: &LeaseState,
    stop: &CancellationToken,
) -> Result<(), ClientError> {
    let announced = &upload.announced;
    retry(stop, &delivery_of(announced), || async {
        if is_void(upload, state) {
            return Ok(());
        }
        match client.call("worker/nodes/place", announced, Duration::ZERO).await? {
            NodePlace::Known => Ok(()),
            NodePlace::Here => send(client, (upload, within), state, stop).await,
            NodePlace::Url(url) => {
                client.put(&url, upload.image.clone()).await?;
                // The coordinator may have to read the image first.
                let reading = reading_time(upload.image.len() as u64);
                let stored = client.post("worker/nodes/stored", codec::encode(announced)?, reading)?;
                client.send::<NodeReply>(&stored.within(within)).await.map(drop)
            }
        }
    })
    .await
}
