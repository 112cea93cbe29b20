//! The worker protocol.

use super::extract::{Framed, expect_media_type, span_of};
use super::guard::{By, From};
use super::spool::{LongBody, Spool};
use super::{ApiError, App};
use crate::scheduler::Delivered;
use crate::service::{Part, ServiceError};
use axum::Extension;
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use photonfarm_proto::check::CheckResult;
use photonfarm_proto::codec::MESSAGE_MEDIA_TYPE;
use photonfarm_proto::rest::Rest;
use photonfarm_proto::worker::{
    Acknowledged, FailureReport, Heartbeat, HeartbeatReply, LeaseReply, LeaseRequest, Leave, NodePlace, NodeReply,
    NodeUpload, Register, Registered, Release, SceneReport, StatisticsRequest,
};
use std::sync::Arc;

pub(super) async fn register(
    State(service): State<App>,
    From(origin): From,
    Framed(register): Framed<Register>,
) -> Result<Framed<Registered>, ApiError> {
    let worker = service.register(register, origin).await?;
    let heartbeat_ms = service.heartbeat_ms().await;
    Ok(Framed(Registered {
        worker,
        heartbeat_ms,
        stores: service.workers_store(),
    }))
}

pub(super) async fn lease(
    State(service): State<App>,
    By(caller): By,
    Framed(request): Framed<LeaseRequest>,
) -> Result<Framed<LeaseReply>, ApiError> {
    service.check_worker(request.worker, &caller.name).await?;
    Ok(Framed(service.lease(request).await?))
}

pub(super) async fn rest(
    State(service): State<App>,
    By(caller): By,
    Framed(rest): Framed<Rest>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(rest.worker, &caller.name).await?;
    service.rest(rest).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn heartbeat(
    State(service): State<App>,
    By(caller): By,
    Framed(heartbeat): Framed<Heartbeat>,
) -> Result<Framed<HeartbeatReply>, ApiError> {
    service.check_worker(heartbeat.worker, &caller.name).await?;
    Ok(Framed(HeartbeatReply {
        lost: service.heartbeat(&heartbeat).await?,
        check: service.beat_check(&heartbeat).await?,
    }))
}

pub(super) async fn upload(
    State(service): State<App>,
    By(caller): By,
    request: Request,
) -> Result<Framed<NodeReply>, ApiError> {
    expect_media_type(request.headers(), MESSAGE_MEDIA_TYPE)?;
    let asked_by = span_of(request.headers());
    let stream = request.into_body().into_data_stream();
    let delivered = service.upload(stream, &caller.name, asked_by).await;
    note_images(&service, &delivered);
    let delivered = delivered?;
    Ok(Framed(NodeReply {
        duplicate: delivered == Delivered::Duplicate,
    }))
}

pub(super) async fn place(
    State(service): State<App>,
    By(caller): By,
    Framed(upload): Framed<NodeUpload>,
) -> Result<Framed<NodePlace>, ApiError> {
    service.check_worker(upload.worker, &caller.name).await?;
    Ok(Framed(service.place(&upload).await?))
}

pub(super) async fn stored(
    State(service): State<App>,
    By(caller): By,
    headers: HeaderMap,
    Framed(upload): Framed<NodeUpload>,
) -> Result<Framed<NodeReply>, ApiError> {
    service.check_worker(upload.worker, &caller.name).await?;
    let delivered = service.stored(upload, span_of(&headers)).await;
    note_images(&service, &delivered);
    let delivered = delivered?;
    Ok(Framed(NodeReply {
        duplicate: delivered == Delivered::Duplicate,
    }))
}

pub(super) async fn statistics(
    State(service): State<App>,
    By(caller): By,
    Extension(spool): Extension<Arc<Spool>>,
    Framed(request): Framed<StatisticsRequest>,
) -> Result<Response, ApiError> {
    service.check_worker(request.worker, &caller.name).await?;
    let head = [(CONTENT_TYPE, "application/octet-stream")].into_response();
    let make = async { Ok((head, LongBody::Bytes(service.statistics(request).await?.into()))) };
    spool.answer(make).await
}

pub(super) async fn scene(
    State(service): State<App>,
    By(caller): By,
    Framed(report): Framed<SceneReport>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(report.worker, &caller.name).await?;
    service.report_scene(report).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn check(
    State(service): State<App>,
    By(caller): By,
    Framed(result): Framed<CheckResult>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(result.worker, &caller.name).await?;
    service.answer_check(result)?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn fail(
    State(service): State<App>,
    By(caller): By,
    Framed(report): Framed<FailureReport>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(report.worker, &caller.name).await?;
    service.fail(report).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn release(
    State(service): State<App>,
    By(caller): By,
    Framed(release): Framed<Release>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(release.worker, &caller.name).await?;
    service.release(release).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn leave(
    State(service): State<App>,
    By(caller): By,
    Framed(leave): Framed<Leave>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.check_worker(leave.worker, &caller.name).await?;
    service.leave(leave.worker).await?;
    Ok(Framed(Acknowledged))
}

/// A delivery says whether images can be stored; one that was there already was not stored.
fn note_images(service: &App, delivered: &Result<Delivered, ServiceError>) {
    if !matches!(delivered, Ok(Delivered::Duplicate)) {
        service.note(Part::Images, delivered);
    }
}
