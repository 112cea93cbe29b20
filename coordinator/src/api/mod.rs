//! The HTTP interface under `/v1`: JSON for clients, framed messages for workers, problem documents for errors; and the page at `/`.

mod bundles;
mod checks;
mod docs;
mod events;
mod extract;
mod farm;
mod guard;
mod images;
mod jobs;
mod listing;
mod local;
mod metrics;
mod page;
mod request;
mod session;
mod spool;
mod steer;
mod system;
mod tokens;
mod webhooks;
mod worker;

use crate::access::{AccessError, Gate};
use crate::audit::Audit;
use crate::service::{Service, ServiceError};
use axum::extract::DefaultBodyLimit;
use axum::handler::Handler;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, on};
use axum::{Extension, Router};
use photonfarm_proto::problem::{ErrorCode, PROBLEM_MEDIA_TYPE, Problem};
use photonfarm_proto::token::Role;
use serde_json::Value;
use spool::Spool;
use std::sync::{Arc, LazyLock};
use tower_http::trace::TraceLayer;

type App = Arc<Service>;

/// A route of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route {
    /// The method, such as `GET`.
    pub method: &'static str,
    /// The path as a template, such as `/v1/jobs/{id}`.
    pub path: &'static str,
    /// Who may use it, besides administrators; everybody where there is none.
    pub roles: Option<&'static [Role]>,
}

/// Routes of one kind of callers. What the router serves and what [`routes`] says are made by the same calls.
struct Routes {
    roles: Option<&'static [Role]>,
    router: Router<App>,
    known: Vec<Route>,
}

impl Routes {
    fn of(roles: Option<&'static [Role]>) -> Self {
        Self {
            roles,
            router: Router::new(),
            known: Vec::new(),
        }
    }

    fn on<H: Handler<T, App>, T: 'static>(mut self, method: &'static str, path: &'static str, handler: H) -> Self {
        let filter = match method {
            "GET" => MethodFilter::GET,
            "PUT" => MethodFilter::PUT,
            "POST" => MethodFilter::POST,
            "PATCH" => MethodFilter::PATCH,
            _ => MethodFilter::DELETE,
        };
        self.router = self.router.route(path, on(filter, handler));
        let roles = self.roles;
        self.known.push(Route { method, path, roles });
        self
    }

    fn get<H: Handler<T, App>, T: 'static>(self, path: &'static str, handler: H) -> Self {
        self.on("GET", path, handler)
    }

    fn put<H: Handler<T, App>, T: 'static>(self, path: &'static str, handler: H) -> Self {
        self.on("PUT", path, handler)
    }

    fn post<H: Handler<T, App>, T: 'static>(self, path: &'static str, handler: H) -> Self {
        self.on("POST", path, handler)
    }

    fn patch<H: Handler<T, App>, T: 'static>(self, path: &'static str, handler: H) -> Self {
        self.on("PATCH", path, handler)
    }

    fn delete<H: Handler<T, App>, T: 'static>(self, path: &'static str, handler: H) -> Self {
        self.on("DELETE", path, handler)
    }

    /// The routes, behind a guard that asks for a role.
    fn guarded(self) -> Router<App> {
        match self.roles {
            Some(roles) => self.router.route_layer(from_fn_with_state(roles, guard::need)),
            None => self.router,
        }
    }
}

/// All routes that look at who asks.
fn guarded_routes() -> [Routes; 5] {
    [
        read_routes(),
        scene_routes(),
        submit_routes(),
        worker_routes(),
        admin_routes(),
    ]
}

/// Every route of the interface, by who may use it.
#[must_use]
pub fn routes() -> Vec<Route> {
    let guarded = guarded_routes().into_iter();
    guarded.chain([open_routes()]).flat_map(|routes| routes.known).collect()
}

/// The interface. `healthz` is for everybody and costs next to nothing: not even tokens are looked at.
pub(crate) fn router(service: App, gate: Arc<Gate>, audit: Option<Arc<Audit>>) -> Router {
    let door = Arc::new(guard::Door {
        gate: gate.clone(),
        audit,
    });
    let guarded = guarded_routes().map(Routes::guarded);
    let guarded = guarded.into_iter().fold(Router::new(), Router::merge);
    guarded
        .fallback(async || ApiError::from(Problem::new(ErrorCode::NotFound, "there is no such route")))
        .method_not_allowed_fallback(not_allowed)
        .layer(from_fn_with_state(door, guard::identify))
        .layer(Extension(gate))
        .layer(Extension(Arc::new(Spool::default())))
        .merge(open_routes().guarded().method_not_allowed_fallback(not_allowed))
        .layer(from_fn_with_state(farm_name(&service), guard::name_farm))
        .layer(DefaultBodyLimit::disable())
        .layer(TraceLayer::new_for_http())
        .layer(from_fn(request::name))
        .with_state(service)
}

/// The farm's digits as the value of a header.
fn farm_name(service: &App) -> Option<HeaderValue> {
    HeaderValue::try_from(service.identity().farm).ok()
}

async fn not_allowed() -> ApiError {
    Problem::new(ErrorCode::MethodNotAllowed, "the route has no such method").into()
}

fn open_routes() -> Routes {
    Routes::of(None)
        .get("/v1/healthz", system::health)
        .get("/", page::index)
        .get("/page/{name}", page::file)
}

fn read_routes() -> Routes {
    Routes::of(Some(&[Role::Read]))
        .get("/v1/jobs", jobs::list)
        .get("/v1/jobs/{id}", jobs::status)
        .get("/v1/jobs/{id}/image.exr", images::exr)
        .get("/v1/jobs/{id}/image.png", images::png)
        .get("/v1/jobs/{id}/image.jpg", images::jpg)
        .get("/v1/jobs/{id}/image.raw", images::raw)
        .get("/v1/jobs/{id}/events", events::events)
        .get("/v1/jobs/{id}/history", jobs::history)
        .get("/v1/jobs/{id}/log", jobs::log)
        .get("/v1/events", farm::events)
        .get("/v1/farm", farm::figures)
        .get("/v1/session", session::show)
        .post("/v1/session", session::create)
        .delete("/v1/session", session::end)
        .get("/v1/workers", system::workers)
        .get("/v1/openapi.json", system::openapi)
        .get("/v1/docs", docs::docs)
        .get("/metrics", metrics::metrics)
}

fn scene_routes() -> Routes {
    Routes::of(Some(&[Role::Read, Role::Worker]))
        .get("/v1/bundles/{hash}", bundles::manifest)
        .get("/v1/blobs/{hash}", bundles::download)
}

fn submit_routes() -> Routes {
    Routes::of(Some(&[Role::Submit]))
        .post("/v1/bundles", bundles::submit)
        .put("/v1/blobs/{hash}", bundles::upload)
        .get("/v1/blobs/{hash}/upload", bundles::upload_state)
        .patch("/v1/blobs/{hash}/upload", bundles::append)
        .post("/v1/checks", checks::ask)
        .get("/v1/checks/{id}", checks::status)
        .post("/v1/jobs", jobs::submit)
        .delete("/v1/jobs/{id}", jobs::remove)
        .post("/v1/jobs/{id}/cancel", jobs::cancel)
        .post("/v1/jobs/{id}/pause", steer::pause)
        .post("/v1/jobs/{id}/resume", steer::resume)
        .post("/v1/jobs/{id}/extend", steer::extend)
        .post("/v1/jobs/{id}/retry", steer::retry)
        .put("/v1/jobs/{id}/priority", steer::prioritize)
}

fn worker_routes() -> Routes {
    Routes::of(Some(&[Role::Worker]))
        .post("/v1/worker/register", worker::register)
        .post("/v1/worker/lease", worker::lease)
        .post("/v1/worker/rest", worker::rest)
        .post("/v1/worker/heartbeat", worker::heartbeat)
        .post("/v1/worker/nodes", worker::upload)
        .post("/v1/worker/nodes/place", worker::place)
        .post("/v1/worker/nodes/stored", worker::stored)
        .post("/v1/worker/statistics", worker::statistics)
        .post("/v1/worker/scene", worker::scene)
        .post("/v1/worker/check", worker::check)
        .post("/v1/worker/failures", worker::fail)
        .post("/v1/worker/release", worker::release)
        .post("/v1/worker/leave", worker::leave)
}

fn admin_routes() -> Routes {
    Routes::of(Some(&[Role::Admin]))
        .post("/v1/tokens", tokens::create)
        .get("/v1/tokens", tokens::list)
        .delete("/v1/tokens/{name}", tokens::revoke)
        .get("/v1/webhooks", webhooks::list)
        .post("/v1/workers/{id}/quarantine", steer::quarantine)
        .post("/v1/workers/{id}/release", steer::release)
        .post("/v1/workers/{id}/drain", steer::drain)
        .post("/v1/workers/{id}/resume", steer::resume_worker)
}

/// The OpenAPI document of the public interface.
#[must_use]
pub fn openapi() -> utoipa::openapi::OpenApi {
    use utoipa::OpenApi;
    system::ApiDoc::openapi()
}

/// The same as the text that is sent.
static DOCUMENT: LazyLock<Vec<u8>> = LazyLock::new(|| serde_json::to_vec(&openapi()).unwrap_or_default());

/// The same, to look things up in.
fn document() -> Value {
    serde_json::from_slice(&DOCUMENT).unwrap_or_default()
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

impl From<AccessError> for ApiError {
    fn from(error: AccessError) -> Self {
        ServiceError::from(error).into()
    }
}

impl IntoResponse for ApiError {
    fn into_response(mut self) -> Response {
        self.0.request_id = request::current().map(Into::into);
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// The worker protocol is no JSON; figures and the page are no part of the interface for programs that send jobs.
    fn is_described(path: &str) -> bool {
        path.starts_with("/v1/") && !path.starts_with("/v1/worker/")
    }

    /// Makers of clients name their functions by them.
    #[test]
    fn every_operation_has_an_identifier_of_its_own() {
        let document = document();
        let paths = document["paths"].as_object().unwrap().values();
        let operations = paths.flat_map(|item| item.as_object().unwrap().values());
        let identifiers: Vec<&str> = operations.map(|it| it["operationId"].as_str().unwrap()).collect();
        assert_eq!(
            identifiers.iter().collect::<BTreeSet<_>>().len(),
            identifiers.len(),
            "{identifiers:?}"
        );
    }

    /// What clients are made from lies in the documentation, so that a change of the interface shows as a change of that file.
    #[test]
    fn the_document_is_the_one_that_is_kept() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/openapi.json");
        let document = serde_json::to_string_pretty(&openapi()).unwrap() + "\n";
        if std::env::var_os("UPDATE").is_some() {
            std::fs::write(&path, &document).unwrap();
        }
        let kept = std::fs::read_to_string(&path).unwrap();
        let first = document.lines().zip(kept.lines()).position(|(now, kept)| now != kept);
        assert!(
            document == kept,
            "line {} of docs/openapi.json is another; UPDATE=1 writes the file anew",
            first.map_or(0, |line| line + 1)
        );
    }

    #[test]
    fn every_route_is_described_and_nothing_else_is() {
        let document = document();
        let described: BTreeSet<(String, String)> = document["paths"]
            .as_object()
            .unwrap()
            .iter()
            .flat_map(|(path, item)| {
                let methods = item.as_object().unwrap().keys();
                methods.map(|method| (path.clone(), method.to_uppercase()))
            })
            .collect();
        let served = routes().into_iter().filter(|route| is_described(route.path));
        let served: BTreeSet<_> = served
            .map(|route| (route.path.to_owned(), route.method.to_owned()))
            .collect();
        assert_eq!(described, served);
    }
}
