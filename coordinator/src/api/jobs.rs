//! Jobs: submit, follow, cancel, delete.

use super::extract::{Id, JsonBody, Params};
use super::guard::{By, Steered};
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::api::{IDEMPOTENCY_KEY, JobLog, JobPage};
use photonfarm_proto::history::JobHistory;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_proto::problem::{ErrorCode, Problem};
use serde::Deserialize;

/// Most jobs on a page.
const PAGE: u32 = 100;
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

/// Which page of jobs.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageParams {
    /// The `next` of the page before.
    cursor: Option<String>,
    /// Jobs on the page.
    #[param(minimum = 1, maximum = 100)]
    limit: Option<u32>,
}

/// Jobs, newest first.
#[utoipa::path(
    get, path = "/v1/jobs", operation_id = "list_jobs", params(PageParams),
    responses((status = 200, body = JobPage), (status = "4XX", body = Problem))
)]
pub(super) async fn list(
    State(service): State<App>,
    Params(page): Params<PageParams>,
) -> Result<Json<JobPage>, ApiError> {
    if page.limit.is_some_and(|limit| !(1..=PAGE).contains(&limit)) {
        let detail = format!("limit: a page has 1 to {PAGE} jobs");
        return Err(Problem::new(ErrorCode::Invalid, detail).at("limit", None).into());
    }
    Ok(Json(service.list_jobs(page.cursor.as_deref(), page.limit).await?))
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
