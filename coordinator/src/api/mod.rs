//! The HTTP interface under `/v1`: JSON for clients, framed messages for workers, problem documents for errors.

mod bundles;
mod events;
mod extract;
mod jobs;
mod system;
mod worker;

use crate::access::Caller;
use crate::service::{Service, ServiceError};
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use photonfarm_proto::problem::{ErrorCode, PROBLEM_MEDIA_TYPE, Problem};
use std::sync::Arc;
use tower_http::trace::TraceLayer;

type App = Arc<Service>;

/// All routes.
pub(crate) fn router(service: App) -> Router {
    let v1 = Router::new()
        .route("/bundles", post(bundles::submit))
        .route("/bundles/{hash}", get(bundles::manifest))
        .route("/blobs/{hash}", put(bundles::upload).get(bundles::download))
        .route("/jobs", post(jobs::submit).get(jobs::list))
        .route("/jobs/{id}", get(jobs::status).delete(jobs::cancel))
        .route("/jobs/{id}/cancel", post(jobs::cancel))
        .route("/jobs/{id}/image.exr", get(jobs::image_exr))
        .route("/jobs/{id}/image.png", get(jobs::image_png))
        .route("/jobs/{id}/events", get(events::events))
        .route("/workers", get(system::workers))
        .route("/healthz", get(system::health))
        .route("/openapi.json", get(system::openapi))
        .route("/worker/register", post(worker::register))
        .route("/worker/lease", post(worker::lease))
        .route("/worker/heartbeat", post(worker::heartbeat))
        .route("/worker/nodes", post(worker::upload))
        .route("/worker/failures", post(worker::fail))
        .route("/worker/release", post(worker::release))
        .route("/worker/leave", post(worker::leave));
    Router::new()
        .nest("/v1", v1)
        .fallback(async || ApiError::from(Problem::new(ErrorCode::NotFound, "there is no such route")))
        .method_not_allowed_fallback(async || {
            ApiError::from(Problem::new(
                ErrorCode::MethodNotAllowed,
                "the route has no such method",
            ))
        })
        .layer(axum::Extension(Caller::anyone()))
        .layer(DefaultBodyLimit::disable())
        .layer(TraceLayer::new_for_http())
        .with_state(service)
}

/// The OpenAPI document of the public interface.
#[must_use]
pub fn openapi() -> utoipa::openapi::OpenApi {
    use utoipa::OpenApi;
    system::ApiDoc::openapi()
}

/// A problem as a response.
#[derive(Debug)]
struct ApiError(Problem);

impl From<Problem> for ApiError {
    fn from(problem: Problem) -> Self {
        Self(problem)
    }
}

impl From<ServiceError> for ApiError {
    fn from(error: ServiceError) -> Self {
        Self(error.into_problem())
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.0.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let wait = self.0.retry_after_s;
        let mut response = (status, axum::Json(self.0)).into_response();
        response
            .headers_mut()
            .insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_MEDIA_TYPE));
        if let Some(seconds) = wait {
            response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
        }
        response
    }
}
