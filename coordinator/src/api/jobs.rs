//! Jobs: submit, follow, cancel, delete.

use super::extract::{Id, JsonBody, Params};
use super::guard::{By, Steered};
use super::listing::{JobOrder, Listing};
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::api::{IDEMPOTENCY_KEY, JobLog, JobPage, ListedState};
use photonfarm_proto::history::JobHistory;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_proto::problem::{ErrorCode, Problem};

/// Longest idempotency key.
const KEY_BYTES: usize = 255;

/// Submits a job. With an `Idempotency-Key`, the same request gives the same job however often it is sent.
#[utoipa::path(
    post, path = "/v1/jobs", operation_id = "create_job", request_body = JobSpec,
    params(("Idempotency-Key" = Option<String>, Header, description = "any text of at most 255 bytes")),
    responses(
        (status = 201, body = JobStatus),
        (status = 200, body = JobStatus, description = "submitted before with this key"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn submit(
    State(service): State<App>,
    By(caller): By,
    headers: HeaderMap,
    JsonBody(spec): JsonBody<JobSpec>,
) -> Result<Response, ApiError> {
    let key = headers
        .get(IDEMPOTENCY_KEY)
        .map(|value| value.to_str().map(str::to_owned));
    let key = key
        .transpose()
        .ok()
        .filter(|key| key.as_ref().is_none_or(|key| key.len() <= KEY_BYTES));
    let bad_key = || {
        Problem::new(
            ErrorCode::Malformed,
            "an idempotency key is ASCII text of at most 255 bytes",
        )
    };
    let (status, new) = service.submit_job(spec, key.ok_or_else(bad_key)?, &caller).await?;
    let location = [(header::LOCATION, format!("/v1/jobs/{}", status.id))];
    let code = if new { StatusCode::CREATED } else { StatusCode::OK };
    Ok((code, location, Json(status)).into_response())
}

/// Jobs: all, or those that the parameters ask for; the newest first, or the oldest.
#[utoipa::path(
    get, path = "/v1/jobs", operation_id = "list_jobs",
    params(
        ("state" = Option<Vec<ListedState>>, Query, description = "jobs of this state; of one of these where it is given several times"),
        ("owner" = Option<String>, Query, description = "jobs that were submitted with the token of this name", max_length = 200),
        ("label" = Option<Vec<String>>, Query, description = "jobs that have this label, `NAME=VALUE`, or `NAME` whatever its value; \
            all of these where it is given several times, at most 8"),
        ("name" = Option<String>, Query, description = "jobs whose name has this in it; that of the scene file where they have none", max_length = 200),
        ("created_after" = Option<String>, Query, description = "jobs that were submitted after this time (RFC 3339)"),
        ("created_before" = Option<String>, Query, description = "jobs that were submitted before this time (RFC 3339)"),
        ("order" = Option<JobOrder>, Query, description = "which come first [default: `newest`]"),
        ("cursor" = Option<String>, Query, description = "the `next` of the page before, of the same order"),
        ("limit" = Option<u32>, Query, description = "jobs on the page [default: 20]", minimum = 1, maximum = 100)
    ),
    responses((status = 200, body = JobPage), (status = "4XX", body = Problem))
)]
pub(super) async fn list(
    State(service): State<App>,
    Params(given): Params<Vec<(String, String)>>,
) -> Result<Json<JobPage>, ApiError> {
    let Listing { filter, limit } = Listing::read(given)?;
    Ok(Json(service.list_jobs(filter, limit).await?))
}

/// How far a job has come.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", operation_id = "get_job", params(("id" = JobId, Path)),
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn status(State(service): State<App>, Id(id): Id<JobId>) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.status(id).await?))
}

/// What has happened to a job: progress, noise, leases and failures. All but the failures is what the coordinator that answers has seen
/// since its start.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/history", operation_id = "get_job_history", params(("id" = JobId, Path)),
    responses((status = 200, body = JobHistory), (status = "4XX", body = Problem))
)]
pub(super) async fn history(State(service): State<App>, Id(id): Id<JobId>) -> Result<Json<JobHistory>, ApiError> {
    Ok(Json(service.history(id).await?))
}

/// What happened to a job, oldest first. Submission, failed attempts and the end are kept; what else there is this coordinator
/// remembers since its start.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/log", operation_id = "get_job_log", params(("id" = JobId, Path)),
    responses((status = 200, body = JobLog), (status = "4XX", body = Problem))
)]
pub(super) async fn log(State(service): State<App>, Id(id): Id<JobId>) -> Result<Json<JobLog>, ApiError> {
    Ok(Json(service.job_log(id).await?))
}

/// Cancels a job. What has arrived stays. Cancelling a job that has ended changes nothing.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", operation_id = "cancel_job", params(("id" = JobId, Path)),
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn cancel(State(service): State<App>, Steered(id): Steered) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.cancel_job(id).await?))
}

/// Deletes a job that has ended, with its picture. One that goes on is refused: cancel it first.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", operation_id = "delete_job", params(("id" = JobId, Path)),
    responses((status = 204), (status = "4XX", body = Problem))
)]
pub(super) async fn remove(State(service): State<App>, Steered(id): Steered) -> Result<StatusCode, ApiError> {
    service.delete_job(id).await?;
    Ok(StatusCode::NO_CONTENT)
}
