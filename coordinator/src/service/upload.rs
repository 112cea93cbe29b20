//! Nodes arrive: bytes first, then the row, then the acknowledgement.

use super::garbage::Garbage;
use super::{Service, ServiceError};
use crate::scheduler::{Delivered, Delivery, Job, Refusal};
use crate::store;
use axum::body::Bytes;
use futures_util::{Stream, StreamExt};
use photonfarm_proto::codec;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::node::{self, NodeHeader};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{NodeUpload, UPLOAD_FRAME_BYTES};
use std::sync::Arc;
use std::time::Duration;

/// Most bytes of memory taken before any of a body has arrived.
const FIRST_ALLOCATION: u64 = 1 << 20;
/// Longest wait for the next piece of a body.
const LONGEST_STALL: Duration = Duration::from_secs(30);

impl Service {
    /// Receives a node: the framed announcement, then the planes.
    pub(crate) async fn upload<S, E>(self: &Arc<Self>, body: S) -> Result<Delivered, ServiceError>
    where
        S: Stream<Item = Result<Bytes, E>> + Unpin,
        E: std::fmt::Display,
    {
        let mut body = Body {
            stream: body,
            rest: Bytes::new(),
        };
        let length = body.take(4).await?;
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
        if length > UPLOAD_FRAME_BYTES {
            let detail = format!("the announcement of a node has {length} bytes, more than {UPLOAD_FRAME_BYTES}");
            return Err(Problem::new(ErrorCode::Malformed, detail).into());
        }
        let upload: NodeUpload = codec::decode(&body.take(length).await?)?;
        self.check_upload(&upload).await?;
        let header = upload.header();
        let _permit = self.uploads.acquire().await.map_err(|_| ServiceError::Stopping)?;
        let bytes = body.take_node(&header).await?;
        let digest = upload.digest;
        let limits = self.limits.clone();
        let check = move || -> Result<Vec<u8>, ServiceError> {
            let found = BlobHash::of(&bytes);
            if found != digest {
                let detail = format!("the node's image has hash {found}, announced was {digest}");
                return Err(Problem::new(ErrorCode::ContentMismatch, detail).into());
            }
            node::decode_node(&bytes, &limits)?;
            Ok(bytes)
        };
        let bytes = tokio::task::spawn_blocking(check)
            .await
            .map_err(|_| ServiceError::Stopping)??;
        self.accept(upload, bytes).await
    }

    /// Refuses what cannot count before any of it is read.
    pub(super) async fn check_upload(self: &Arc<Self>, upload: &NodeUpload) -> Result<(), ServiceError> {
        self.limits.check_resolution(upload.width, upload.height)?;
        if !upload.totals.is_valid() {
            return Err(Problem::new(ErrorCode::Invalid, "times and bandwidths are finite and not negative").into());
        }
        let job = self.find_job(upload.job).await?;
        if !upload.node.fits(job.control().iterations) {
            let detail = format!("node {} lies beyond the job's iterations", upload.node);
            return Err(Problem::new(ErrorCode::Invalid, detail).into());
        }
        Ok(())
    }

    async fn accept(self: &Arc<Self>, upload: NodeUpload, bytes: Vec<u8>) -> Result<Delivered, ServiceError> {
        let delivery = delivery(&upload, false);
        let service = self.clone();
        let task = async move {
            let publishing = service.publishing.read().await;
            store::put(&*service.stores.nodes, &bytes).await?;
            let result = service.deliver(delivery.clone()).await;
            drop(publishing);
            service.after_delivery(&delivery, result).await
        };
        tokio::spawn(task).await.map_err(|_| ServiceError::Stopping)?
    }

    /// What follows a delivery, whatever became of it.
    pub(super) async fn after_delivery(
        self: &Arc<Self>,
        delivery: &Delivery,
        result: Result<Delivered, ServiceError>,
    ) -> Result<Delivered, ServiceError> {
        let Delivery {
            worker,
            job,
            node,
            digest,
            ..
        } = *delivery;
        let garbage = Garbage { job, node, digest };
        match &result {
            Ok(Delivered::Counted | Delivered::Repeated) => {
                let now = self.clock.now();
                self.fresh_farm().await?.farm.observe(delivery, now);
                self.fold_in_background(job);
            }
            Ok(Delivered::Disputed) => {
                tracing::error!(%worker, %job, %node, "incident: two results for one node; another worker decides");
                self.collect_refused(garbage);
                let detail = format!("job {job}: node {node} counts with another digest; another worker decides");
                return Err(Problem::new(ErrorCode::ResultConflict, detail).into());
            }
            Err(ServiceError::Refusal(refusal @ Refusal::Conflict { .. })) => {
                tracing::error!(%worker, %job, %node, %refusal, "incident: two results for one node");
            }
            _ => {}
        }
        self.collect_refused(garbage);
        result
    }

    pub(super) async fn deliver(self: &Arc<Self>, delivery: Delivery) -> Result<Delivered, ServiceError> {
        let wanted = delivery.clone();
        match self.transact(move |farm, now| farm.deliver(&wanted, now)).await {
            Err(ServiceError::Refusal(Refusal::UnknownJob(id))) => {
                let record = self.stores.state.job(id).await?.ok_or(Refusal::UnknownJob(id))?;
                Ok(Job::from_record(record).deliver(&delivery, false)?.0)
            }
            other => other,
        }
    }
}

/// What the scheduler is told of an upload.
pub(super) fn delivery(upload: &NodeUpload, unread: bool) -> Delivery {
    Delivery {
        token: upload.token,
        worker: upload.worker,
        job: upload.job,
        node: upload.node,
        resolution: [upload.width, upload.height],
        digest: upload.digest,
        unread,
        totals: upload.totals,
    }
}

/// A body read piece by piece.
struct Body<S> {
    stream: S,
    rest: Bytes,
}

impl<S, E> Body<S>
where
    S: Stream<Item = Result<Bytes, E>> + Unpin,
    E: std::fmt::Display,
{
    async fn next(&mut self) -> Result<Option<Bytes>, ServiceError> {
        if !self.rest.is_empty() {
            return Ok(Some(std::mem::take(&mut self.rest)));
        }
        next_piece(&mut self.stream).await
    }

    /// The next `length` bytes; the caller has bounded `length`.
    async fn take(&mut self, length: usize) -> Result<Vec<u8>, ServiceError> {
        let mut bytes = Vec::with_capacity(length);
        while bytes.len() < length {
            let mut piece = self.next().await?.ok_or_else(too_short)?;
            self.rest = piece.split_off(piece.len().min(length - bytes.len()));
            bytes.extend_from_slice(&piece);
        }
        Ok(bytes)
    }

    /// Header and planes, with nothing after them.
    async fn take_node(&mut self, header: &NodeHeader) -> Result<Vec<u8>, ServiceError> {
        let expected = NodeHeader::BYTES as u64 + header.plane_bytes();
        let mut bytes = Vec::with_capacity(expected.min(FIRST_ALLOCATION) as usize);
        bytes.extend_from_slice(&header.to_bytes());
        while let Some(piece) = self.next().await? {
            if (bytes.len() + piece.len()) as u64 > expected {
                return Err(Problem::new(ErrorCode::Malformed, "bytes follow the node's image").into());
            }
            bytes.extend_from_slice(&piece);
        }
        if bytes.len() as u64 != expected {
            return Err(too_short());
        }
        Ok(bytes)
    }
}

/// The next piece of a body; none at its end. A body that stalls is given up.
pub(super) async fn next_piece<S, E>(body: &mut S) -> Result<Option<Bytes>, ServiceError>
where
    S: Stream<Item = Result<Bytes, E>> + Unpin,
    E: std::fmt::Display,
{
    let cut = |error: E| Problem::new(ErrorCode::Malformed, format!("the body ended early: {error}"));
    let stalled = |_| Problem::new(ErrorCode::Malformed, "the body stalled");
    Ok(tokio::time::timeout(LONGEST_STALL, body.next())
        .await
        .map_err(stalled)?
        .transpose()
        .map_err(cut)?)
}

fn too_short() -> ServiceError {
    Problem::new(ErrorCode::Malformed, "the body is shorter than its announcement says").into()
}
