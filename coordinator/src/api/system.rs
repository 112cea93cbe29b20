//! The farm itself: workers, health, and the description of this interface.

use super::listing::JobOrder;
use super::{ApiError, App};
use crate::service::{Part, VERSION};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use photonfarm_proto::api::{Health, ListedState, WorkerList};
use photonfarm_proto::problem::{ErrorCode, PROBLEM_MEDIA_TYPE, Problem};
use photonfarm_proto::webhook::JobNotice;
use utoipa::openapi::path::Operation;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{ContentBuilder, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{Modify, OpenApi};

/// The workers heard of lately.
#[utoipa::path(get, path = "/v1/workers", operation_id = "list_workers", responses((status = 200, body = WorkerList)))]
pub(super) async fn workers(State(service): State<App>) -> Result<Json<WorkerList>, ApiError> {
    Ok(Json(WorkerList {
        workers: service.workers().await?,
    }))
}

/// Whether the coordinator can use its stores, why jobs wait, and what it accepts. It is as of a few seconds ago, and
/// costs nothing.
#[utoipa::path(get, path = "/v1/healthz", operation_id = "get_health", responses((status = 200, body = Health), (status = "5XX", body = Problem)))]
pub(super) async fn health(State(service): State<App>) -> Result<Json<Health>, ApiError> {
    let found = service.found_obstacles();
    if let Some((_, obstacle)) = found.iter().find(|(part, _)| *part == Part::Answers) {
        return Err(Problem::new(ErrorCode::Unavailable, obstacle.detail.clone()).into());
    }
    let status = if found.is_empty() { "ok" } else { "failing" };
    Ok(Json(Health {
        status: status.into(),
        obstacles: found.into_iter().map(|(_, obstacle)| obstacle).collect(),
        waiting: service.jobs_waiting(),
        version: VERSION.into(),
        farm: service.identity(),
        limits: service.limits.clone(),
    }))
}

/// This document.
#[utoipa::path(get, path = "/v1/openapi.json", operation_id = "get_openapi", responses((status = 200, content_type = "application/json")))]
pub(super) async fn openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], super::DOCUMENT.as_slice())
}

#[derive(OpenApi)]
#[openapi(
    info(title = "Photonfarm", description = "A render farm for photon mapping."),
    paths(
        super::bundles::submit,
        super::bundles::manifest,
        super::bundles::upload,
        super::bundles::upload_state,
        super::bundles::append,
        super::bundles::download,
        super::checks::ask,
        super::checks::status,
        super::jobs::submit,
        super::jobs::list,
        super::jobs::status,
        super::jobs::log,
        super::jobs::cancel,
        super::jobs::remove,
        super::images::exr,
        super::images::png,
        super::images::jpg,
        super::images::raw,
        super::jobs::history,
        super::events::events,
        super::farm::events,
        super::farm::figures,
        super::session::show,
        super::session::create,
        super::session::end,
        super::steer::pause,
        super::steer::resume,
        super::steer::extend,
        super::steer::retry,
        super::steer::prioritize,
        super::steer::quarantine,
        super::steer::release,
        super::steer::drain,
        super::steer::resume_worker,
        super::tokens::create,
        super::tokens::list,
        super::tokens::revoke,
        super::webhooks::list,
        workers,
        health,
        openapi,
        super::docs::docs,
    ),
    components(schemas(Problem, JobNotice, JobOrder, ListedState)),
    modifiers(&EveryOperation)
)]
pub(super) struct ApiDoc;

/// What holds for every operation: problems as answers, and a token.
struct EveryOperation;

/// Name of the security scheme.
const TOKEN: &str = "token";

fn problem(description: &str) -> Response {
    let content = ContentBuilder::new()
        .schema(Some(Ref::from_schema_name("Problem")))
        .build();
    let response = ResponseBuilder::new().description(description);
    response.content(PROBLEM_MEDIA_TYPE, content).build()
}

impl Modify for EveryOperation {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        if let Some(components) = &mut document.components {
            components.add_security_scheme(TOKEN, scheme);
        }
        for (path, item) in &mut document.paths.paths {
            let operations = [
                &mut item.get,
                &mut item.put,
                &mut item.post,
                &mut item.patch,
                &mut item.delete,
            ];
            let open = path.ends_with("/healthz");
            operations
                .into_iter()
                .flatten()
                .for_each(|operation| complete(operation, path, open));
        }
    }
}

/// The media type of files of scenes.
const BYTES: &str = "application/octet-stream";

/// The schema of content that none is written for: makers of clients take what is neither JSON nor text for a file. A stream of events
/// is no text, and has none.
fn schema_of(media_type: &str) -> Option<RefOr<Schema>> {
    let schema = ObjectBuilder::new();
    let schema = match media_type {
        "text/event-stream" => return None,
        "application/json" => schema,
        text if text.starts_with("text/") => schema.schema_type(Type::String),
        _ => schema
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary))),
    };
    Some(schema.into())
}

fn complete(operation: &mut Operation, path: &str, open: bool) {
    // `/v1/jobs/{id}` is one of the operations on `jobs`; blobs are the files of bundles.
    let group = match path.split('/').nth(2).unwrap_or_default() {
        "blobs" => "bundles",
        group => group.trim_end_matches(".json"),
    };
    operation.tags = Some(vec![group.to_owned()]);
    let responses = &mut operation.responses.responses;
    for response in responses.values_mut() {
        if let RefOr::T(response) = response {
            for (media_type, content) in &mut response.content {
                content.schema = content.schema.take().or_else(|| schema_of(media_type));
            }
        }
    }
    if let Some(body) = &mut operation.request_body {
        let files = body.content.iter_mut().filter(|(media_type, _)| *media_type == BYTES);
        files.for_each(|(media_type, content)| content.schema = schema_of(media_type));
    }
    let refused = problem("the request was refused; the problem says why").into();
    responses.insert("4XX".into(), refused);
    responses.insert("5XX".into(), problem("the coordinator failed, or is stopping").into());
    if !open {
        operation.security = Some(vec![SecurityRequirement::new::<_, [&str; 0], &str>(TOKEN, [])]);
    }
}

#[cfg(test)]
mod tests {
    use crate::access::{Gate, Tokens};
    use crate::api::router;
    use crate::service::Stores;
    use crate::service::tests::opened;
    use crate::store::faulty::{Faults, FaultyBlobs, FaultyState};
    use crate::store::memory::MemoryStore;
    use crate::store::{BlobStore, FolderStore, StateStore};
    use axum::body::Body;
    use axum::http::Request;
    use std::sync::Arc;
    use tower::ServiceExt;

    #[tokio::test]
    async fn whoever_asks_how_the_farm_is_costs_no_use_of_a_store() {
        let (folder, faults) = (tempfile::tempdir().unwrap(), Arc::<Faults>::default());
        let inner: Arc<dyn StateStore> = Arc::new(MemoryStore::default());
        let state = Arc::new(FaultyState {
            inner: inner.into(),
            faults: faults.clone(),
        });
        let blobs = |name: &str| {
            let inner: Arc<dyn BlobStore> = Arc::new(FolderStore::open(&folder.path().join(name), false).unwrap());
            Arc::new(FaultyBlobs {
                inner: inner.into(),
                faults: faults.clone(),
            })
        };
        let (scenes, nodes) = (blobs("scenes"), blobs("nodes"));
        let stores = Stores {
            state: state.clone(),
            scenes: scenes.clone(),
            nodes: nodes.clone(),
        };
        let calls = || state.inner.calls() + scenes.inner.calls() + nodes.inner.calls();
        let service = opened(stores).await;
        let gate = Gate::new(Tokens::new(state.clone()), true, 1);
        let router = router(service.unwrap(), Arc::new(gate), None);
        let ask = async |path: &str| {
            let request = Request::get(path).header("host", "localhost").body(Body::empty());
            let reply = router.clone().oneshot(request.unwrap()).await;
            reply.unwrap().status().as_u16()
        };
        let before = calls();
        for _ in 0..3 {
            assert_eq!(ask("/v1/healthz").await, 200);
        }
        assert_eq!(calls(), before);
        assert_eq!(ask("/v1/jobs").await, 200);
        assert!(calls() > before, "what others ask costs something");
    }
}
