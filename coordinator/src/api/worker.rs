//! The worker protocol.

use super::extract::{Framed, expect_media_type};
use super::spool::Spool;
use super::{ApiError, App};
use crate::scheduler::Delivered;
use crate::service::{Part, ServiceError};
use axum::Extension;
use axum::extract::{Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use photonfarm_proto::codec::MESSAGE_MEDIA_TYPE;
use photonfarm_proto::worker::{
    Acknowledged, FailureReport, Heartbeat, HeartbeatReply, LeaseReply, LeaseRequest, Leave, NodePlace, NodeReply,
    NodeUpload, Register, Registered, Release, SettingsReport, StatisticsRequest,
};
use std::sync::Arc;

pub(super) async fn register(
    State(service): State<App>,
    Framed(register): Framed<Register>,
) -> Result<Framed<Registered>, ApiError> {
    let worker = service.register(register).await?;
    let heartbeat_ms = service.heartbeat_ms().await;
    Ok(Framed(Registered {
        worker,
        heartbeat_ms,
        stores: service.workers_store(),
    }))
}

pub(super) async fn lease(
    State(service): State<App>,
    Framed(request): Framed<LeaseRequest>,
) -> Result<Framed<LeaseReply>, ApiError> {
    Ok(Framed(LeaseReply {
        assignment: service.lease(request).await?,
    }))
}

pub(super) async fn heartbeat(
    State(service): State<App>,
    Framed(heartbeat): Framed<Heartbeat>,
) -> Result<Framed<HeartbeatReply>, ApiError> {
    Ok(Framed(HeartbeatReply {
        lost: service.heartbeat(&heartbeat).await?,
    }))
}

pub(super) async fn upload(State(service): State<App>, request: Request) -> Result<Framed<NodeReply>, ApiError> {
    expect_media_type(request.headers(), MESSAGE_MEDIA_TYPE)?;
    let delivered = service.upload(request.into_body().into_data_stream()).await;
    note_images(&service, &delivered);
    let delivered = delivered?;
    Ok(Framed(NodeReply {
        duplicate: delivered == Delivered::Duplicate,
    }))
}

pub(super) async fn place(
    State(service): State<App>,
    Framed(upload): Framed<NodeUpload>,
) -> Result<Framed<NodePlace>, ApiError> {
    Ok(Framed(service.place(&upload).await?))
}

pub(super) async fn stored(
    State(service): State<App>,
    Framed(upload): Framed<NodeUpload>,
) -> Result<Framed<NodeReply>, ApiError> {
    let delivered = service.stored(upload).await;
    note_images(&service, &delivered);
    let delivered = delivered?;
    Ok(Framed(NodeReply {
        duplicate: delivered == Delivered::Duplicate,
    }))
}

pub(super) async fn statistics(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Framed(request): Framed<StatisticsRequest>,
) -> Result<Response, ApiError> {
    let head = [(CONTENT_TYPE, "application/octet-stream")].into_response();
    let make = async { Ok((head, Some(service.statistics(request).await?))) };
    spool.answer(make).await
}

pub(super) async fn settings(
    State(service): State<App>,
    Framed(report): Framed<SettingsReport>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.report_settings(report).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn fail(
    State(service): State<App>,
    Framed(report): Framed<FailureReport>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.fail(report).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn release(
    State(service): State<App>,
    Framed(release): Framed<Release>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.release(release).await?;
    Ok(Framed(Acknowledged))
}

pub(super) async fn leave(
    State(service): State<App>,
    Framed(leave): Framed<Leave>,
) -> Result<Framed<Acknowledged>, ApiError> {
    service.leave(leave.worker).await?;
    Ok(Framed(Acknowledged))
}

/// A delivery says whether images can be stored; one that was there already was not stored.
fn note_images(service: &App, delivered: &Result<Delivered, ServiceError>) {
    if !matches!(delivered, Ok(Delivered::Duplicate)) {
        service.note(Part::Images, delivered);
    }
}
