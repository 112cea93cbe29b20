//! Nodes arrive: bytes first, then the row, then the acknowledgement.

use super::arrival::{Arrival, Arrived, too_short};
use super::{Service, ServiceError};
use crate::scheduler::record::{Millis, Principal};
use crate::scheduler::{Delivered, Delivery, Farm, Job, Refusal};
use crate::store;
use axum::body::Bytes;
use futures_util::{Stream, StreamExt};
use photonfarm_proto::codec;
use photonfarm_proto::job::MOST_COUNTED;
use photonfarm_proto::node::NodeHeader;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::trace::Context;
use photonfarm_proto::worker::{NodeUpload, UPLOAD_FRAME_BYTES};
use std::sync::Arc;
use std::time::Duration;

/// Longest wait for the next piece of a body.
const LONGEST_STALL: Duration = Duration::from_secs(30);
/// How long the rest of a body is read that does not matter.
const LINGER: Duration = Duration::from_secs(2);

impl Service {
    /// Receives a node: the framed announcement, then the planes. The worker is to have been registered with this token; it may ask
    /// from within a span of its own.
    pub(crate) async fn upload<S, E>(
        self: &Arc<Self>,
        body: S,
        token: &str,
        asked_by: Option<Context>,
    ) -> Result<Delivered, ServiceError>
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
        self.check_worker(upload.worker, token).await?;
        let header = self.check_upload(&upload).await?;
        if let Some(answer) = self.foresee(&upload).await {
            body.linger().await;
            return answer;
        }
        let delivery = delivery(&upload, false, store::new_copy()?);
        let mut image = Arrival::begin(&*self.stores.nodes, &self.at_hand, &header, delivery.image()).await?;
        while let Some(piece) = body.next().await? {
            image.take(piece).await?;
        }
        match image.end().await? {
            Ok(image) => self.accept(delivery, image, asked_by).await,
            // Its bytes came as they were sent, so that the network is not to blame.
            Err(error) => {
                self.blame(&upload, &error.to_string()).await?;
                Err(error.into())
            }
        }
    }

    /// What becomes of a node whatever its image is: it is known already, or refused. Nobody may take the
    /// coordinator's time for an image that cannot count.
    async fn foresee(self: &Arc<Self>, upload: &NodeUpload) -> Option<Result<Delivered, ServiceError>> {
        match self.would_count(upload).await {
            Ok(Delivered::Duplicate) => Some(self.deliver(delivery(upload, false, 0), Millis::MAX).await),
            Ok(_) => None,
            Err(error) => {
                note_incident(&delivery(upload, false, 0), &error);
                Some(Err(error))
            }
        }
    }

    /// Refuses what cannot count before any of it is read. Replies with what precedes the planes of the image.
    pub(super) async fn check_upload(self: &Arc<Self>, upload: &NodeUpload) -> Result<NodeHeader, ServiceError> {
        self.limits.check_resolution(upload.width, upload.height)?;
        let read = |job: &Job| (job.control().iterations, job.statistics_per_pixel());
        let (iterations, statistics) = self.with_job(upload.job, read).await?;
        if !upload.node.fits(iterations) {
            let detail = format!("node {} lies beyond the job's iterations", upload.node);
            return Err(Problem::new(ErrorCode::Invalid, detail).into());
        }
        if !upload.totals.is_valid(upload.node.leaves()) {
            let detail = format!(
                "times and bandwidths are finite and not negative, counts at most {MOST_COUNTED} of each iteration"
            );
            return Err(Problem::new(ErrorCode::Invalid, detail).into());
        }
        Ok(upload.header(statistics))
    }

    async fn accept(
        self: &Arc<Self>,
        delivery: Delivery,
        Arrived { staged, held }: Arrived,
        asked_by: Option<Context>,
    ) -> Result<Delivered, ServiceError> {
        let service = self.clone();
        let task = async move {
            let span = service.begin_commit(&delivery, asked_by);
            let publication = service.publication().await;
            staged.publish().await?;
            let result = service.deliver(delivery.clone(), publication.last).await;
            drop(publication);
            span.end(&result);
            if let (Ok(Delivered::Counted), Some(held)) = (&result, held) {
                service.at_hand.keep(delivery.digest, held);
            }
            service.after_delivery(&delivery, result).await
        };
        tokio::spawn(task).await.map_err(|_| ServiceError::Stopping)?
    }

    /// What follows a delivery of an image that was published, whatever became of it.
    pub(super) async fn after_delivery(
        self: &Arc<Self>,
        delivery: &Delivery,
        result: Result<Delivered, ServiceError>,
    ) -> Result<Delivered, ServiceError> {
        match &result {
            Ok(Delivered::Counted) => {}
            Ok(_) | Err(ServiceError::Refusal(_)) => self.discard(delivery.job, delivery.image()),
            Err(_) => {}
        }
        let Delivery { worker, job, node, .. } = *delivery;
        match &result {
            Ok(Delivered::Counted | Delivered::Repeated) => {
                self.fold_in_background(job);
            }
            Ok(Delivered::Disputed) => {
                tracing::error!(%worker, %job, %node, "incident: two results for one node; another worker decides");
                let detail = format!("job {job}: node {node} counts with another digest; another worker decides");
                return Err(Problem::new(ErrorCode::ResultConflict, detail).into());
            }
            Ok(Delivered::Duplicate) => {}
            Err(error) => note_incident(delivery, error),
        }
        result
    }

    /// Decides over a delivery, and commits that before the time `last` is over.
    pub(super) async fn deliver(self: &Arc<Self>, delivery: Delivery, last: Millis) -> Result<Delivered, ServiceError> {
        let wanted = delivery.clone();
        let decide = move |farm: &Farm, now| farm.deliver(&wanted, now);
        match self.transact_until(last, decide).await {
            Err(ServiceError::Refusal(Refusal::UnknownJob(id))) => {
                let late = |job: &Job| deliver_late(job, &delivery);
                Ok(self.with_job(id, late).await??)
            }
            other => other,
        }
    }
}

/// A result that differs from one that counts is more than a refusal.
fn note_incident(delivery: &Delivery, error: &ServiceError) {
    if let ServiceError::Refusal(refusal @ Refusal::Conflict { .. }) = error {
        let Delivery { worker, job, node, .. } = delivery;
        tracing::error!(%worker, %job, %node, %refusal, "incident: two results for one node");
    }
}

/// What becomes of a delivery to a job that has ended: it is known, or refused.
pub(super) fn deliver_late(job: &Job, delivery: &Delivery) -> Result<Delivered, Refusal> {
    Ok(job.deliver(delivery, Principal::default(), false)?.0)
}

/// What the scheduler is told of an upload.
pub(super) fn delivery(upload: &NodeUpload, unread: bool, copy: u64) -> Delivery {
    Delivery {
        token: upload.token,
        worker: upload.worker,
        job: upload.job,
        node: upload.node,
        resolution: [upload.width, upload.height],
        digest: upload.digest,
        copy,
        unread,
        totals: upload.totals,
        memory_mb: upload.memory_mb,
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

    /// Reads on for a moment, so that the sender comes to read the answer.
    async fn linger(&mut self) {
        let rest = async { while let Ok(Some(_)) = self.next().await {} };
        let _late = tokio::time::timeout(LINGER, rest).await;
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
