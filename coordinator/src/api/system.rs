//! The farm itself: workers, health, and the description of this interface.

use super::{ApiError, App};
use crate::service::VERSION;
use axum::Json;
use axum::extract::State;
use photonfarm_proto::api::{Health, WorkerList};
use photonfarm_proto::problem::Problem;
use utoipa::OpenApi;

/// The workers heard of lately.
#[utoipa::path(get, path = "/v1/workers", responses((status = 200, body = WorkerList)))]
pub(super) async fn workers(State(service): State<App>) -> Result<Json<WorkerList>, ApiError> {
    Ok(Json(WorkerList {
        workers: service.workers().await?,
    }))
}

/// Whether the coordinator can use its stores, and what it accepts.
#[utoipa::path(get, path = "/v1/healthz", responses((status = 200, body = Health), (status = "5XX", body = Problem)))]
pub(super) async fn health(State(service): State<App>) -> Result<Json<Health>, ApiError> {
    service.list_jobs(None, Some(1)).await?;
    Ok(Json(Health {
        status: "ok".into(),
        version: VERSION.into(),
        limits: service.limits.clone(),
    }))
}

/// This document.
#[utoipa::path(get, path = "/v1/openapi.json", responses((status = 200, content_type = "application/json")))]
pub(super) async fn openapi() -> Json<utoipa::openapi::OpenApi> {
    Json(super::openapi())
}

#[derive(OpenApi)]
#[openapi(
    info(title = "Photonfarm", description = "A render farm for photon mapping."),
    paths(
        super::bundles::submit,
        super::bundles::manifest,
        super::bundles::upload,
        super::bundles::download,
        super::jobs::submit,
        super::jobs::list,
        super::jobs::status,
        super::jobs::cancel,
        super::jobs::image_exr,
        super::jobs::image_png,
        super::events::events,
        super::steer::pause,
        super::steer::resume,
        super::steer::extend,
        super::steer::prioritize,
        super::steer::quarantine,
        super::steer::release,
        super::tokens::create,
        super::tokens::list,
        super::tokens::revoke,
        workers,
        health,
        openapi,
    ),
    components(schemas(Problem))
)]
pub(super) struct ApiDoc;
