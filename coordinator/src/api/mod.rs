//! The HTTP interface under `/v1`: JSON for clients, framed messages for workers, problem documents for errors.

mod bundles;
mod events;
mod extract;
mod guard;
mod jobs;
mod metrics;
mod steer;
mod system;
mod tokens;
mod worker;

use crate::access::Gate;
use crate::service::{Service, ServiceError};
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post, put};
use axum::{Extension, Router};
use photonfarm_proto::problem::{ErrorCode, PROBLEM_MEDIA_TYPE, Problem};
use photonfarm_proto::token::Role;
use std::sync::Arc;
use tower_http::trace::TraceLayer;

type App = Arc<Service>;

/// All routes, by who may use them; `healthz` is for everybody.
pub(crate) fn router(service: App, gate: Arc<Gate>) -> Router {
    let for_role =
        |roles: &'static [Role], routes: Router<App>| routes.route_layer(from_fn_with_state(roles, guard::need));
    let v1 = Router::new()
        .merge(for_role(&[Role::Read], read_routes()))
        .merge(for_role(&[Role::Read, Role::Worker], scene_routes()))
        .merge(for_role(&[Role::Submit], submit_routes()))
        .merge(for_role(&[Role::Worker], worker_routes()))
        .merge(for_role(&[Role::Admin], admin_routes()))
        .route("/healthz", get(system::health));
    Router::new()
        .nest("/v1", v1)
        .merge(for_role(
            &[Role::Read],
            Router::new().route("/metrics", get(metrics::metrics)),
        ))
        .fallback(async || ApiError::from(Problem::new(ErrorCode::NotFound, "there is no such route")))
        .method_not_allowed_fallback(async || {
            ApiError::from(Problem::new(
                ErrorCode::MethodNotAllowed,
                "the route has no such method",
            ))
        })
        .layer(from_fn_with_state(gate.clone(), guard::identify))
        .layer(Extension(gate))
        .layer(DefaultBodyLimit::disable())
        .layer(TraceLayer::new_for_http())
        .with_state(service)
}

fn read_routes() -> Router<App> {
    Router::new()
        .route("/jobs", get(jobs::list))
        .route("/jobs/{id}", get(jobs::status))
        .route("/jobs/{id}/image.exr", get(jobs::image_exr))
        .route("/jobs/{id}/image.png", get(jobs::image_png))
        .route("/jobs/{id}/events", get(events::events))
        .route("/workers", get(system::workers))
        .route("/openapi.json", get(system::openapi))
}

fn scene_routes() -> Router<App> {
    Router::new()
        .route("/bundles/{hash}", get(bundles::manifest))
        .route("/blobs/{hash}", get(bundles::download))
}

fn submit_routes() -> Router<App> {
    Router::new()
        .route("/bundles", post(bundles::submit))
        .route("/blobs/{hash}", put(bundles::upload))
        .route("/jobs", post(jobs::submit))
        .route("/jobs/{id}", delete(jobs::remove))
        .route("/jobs/{id}/cancel", post(jobs::cancel))
        .route("/jobs/{id}/pause", post(steer::pause))
        .route("/jobs/{id}/resume", post(steer::resume))
        .route("/jobs/{id}/extend", post(steer::extend))
        .route("/jobs/{id}/priority", put(steer::prioritize))
}

fn worker_routes() -> Router<App> {
    Router::new()
        .route("/worker/register", post(worker::register))
        .route("/worker/lease", post(worker::lease))
        .route("/worker/heartbeat", post(worker::heartbeat))
        .route("/worker/nodes", post(worker::upload))
        .route("/worker/nodes/place", post(worker::place))
        .route("/worker/nodes/stored", post(worker::stored))
        .route("/worker/statistics", post(worker::statistics))
        .route("/worker/failures", post(worker::fail))
        .route("/worker/release", post(worker::release))
        .route("/worker/leave", post(worker::leave))
}

fn admin_routes() -> Router<App> {
    Router::new()
        .route("/tokens", post(tokens::create).get(tokens::list))
        .route("/tokens/{name}", delete(tokens::revoke))
        .route("/workers/{id}/quarantine", post(steer::quarantine))
        .route("/workers/{id}/release", post(steer::release))
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
        if status == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer");
            response.headers_mut().insert(header::WWW_AUTHENTICATE, scheme);
        }
        if let Some(seconds) = wait {
            response.headers_mut().insert(header::RETRY_AFTER, seconds.into());
        }
        response
    }
}
