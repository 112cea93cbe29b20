//! Steering: how jobs go on, and which workers are trusted. Every request may be repeated without harm.

use super::extract::{Id, JsonBody};
use super::guard::{By, Steered};
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use photonfarm_proto::api::{Extend, Quarantine, SetPriority, WorkerStatus};
use photonfarm_proto::id::{JobId, WorkerId};
use photonfarm_proto::job::JobStatus;
use photonfarm_proto::problem::Problem;

/// Hands out no new work of a job. What is at work goes on to its end and counts.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/pause", operation_id = "pause_job", params(("id" = JobId, Path)),
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn pause(State(service): State<App>, Steered(id): Steered) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.pause_job(id, true).await?))
}

/// Goes on with a job that was paused.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/resume", operation_id = "resume_job", params(("id" = JobId, Path)),
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn resume(State(service): State<App>, Steered(id): Steered) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.pause_job(id, false).await?))
}

/// Asks for more iterations of a job that goes on or is done. Those in the image are not rendered again, and the image
/// becomes that of a job with this number from the start.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/extend", operation_id = "extend_job", params(("id" = JobId, Path)), request_body = Extend,
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn extend(
    State(service): State<App>,
    Steered(id): Steered,
    By(caller): By,
    JsonBody(request): JsonBody<Extend>,
) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.extend_job(id, request.iterations, &caller).await?))
}

/// Gives iterations that were given up new attempts: of a job that goes on, or of one that failed, which goes on then. What was
/// held against them is forgotten. A job without such iterations stays as it is; one that was cancelled is refused.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/retry", operation_id = "retry_job", params(("id" = JobId, Path)),
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn retry(
    State(service): State<App>,
    Steered(id): Steered,
    By(caller): By,
) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.retry_job(id, &caller).await?))
}

/// Sets the priority of a job: its weight among the jobs of its owner.
#[utoipa::path(
    put, path = "/v1/jobs/{id}/priority", operation_id = "set_job_priority", params(("id" = JobId, Path)), request_body = SetPriority,
    responses((status = 200, body = JobStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn prioritize(
    State(service): State<App>,
    Steered(id): Steered,
    JsonBody(request): JsonBody<SetPriority>,
) -> Result<Json<JobStatus>, ApiError> {
    Ok(Json(service.prioritize_job(id, request.priority).await?))
}

/// Puts a worker into quarantine: it gets no work, and its unconfirmed work in jobs that go on is done again.
#[utoipa::path(
    post, path = "/v1/workers/{id}/quarantine", operation_id = "quarantine_worker", params(("id" = WorkerId, Path)), request_body = Quarantine,
    responses((status = 200, body = WorkerStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn quarantine(
    State(service): State<App>,
    Id(id): Id<WorkerId>,
    JsonBody(request): JsonBody<Quarantine>,
) -> Result<Json<WorkerStatus>, ApiError> {
    Ok(Json(service.quarantine(id, request.reason).await?))
}

/// Lets a worker, and those of its name, out of quarantine.
#[utoipa::path(
    post, path = "/v1/workers/{id}/release", operation_id = "release_worker", params(("id" = WorkerId, Path)),
    responses((status = 200, body = WorkerStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn release(State(service): State<App>, Id(id): Id<WorkerId>) -> Result<Json<WorkerStatus>, ApiError> {
    Ok(Json(service.release_worker(id).await?))
}

/// Gives a worker no new work. What it holds it finishes, and that counts.
#[utoipa::path(
    post, path = "/v1/workers/{id}/drain", operation_id = "drain_worker", params(("id" = WorkerId, Path)),
    responses((status = 200, body = WorkerStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn drain(State(service): State<App>, Id(id): Id<WorkerId>) -> Result<Json<WorkerStatus>, ApiError> {
    Ok(Json(service.drain_worker(id, true).await?))
}

/// Gives a worker that was drained work again.
#[utoipa::path(
    post, path = "/v1/workers/{id}/resume", operation_id = "resume_worker", params(("id" = WorkerId, Path)),
    responses((status = 200, body = WorkerStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn resume_worker(
    State(service): State<App>,
    Id(id): Id<WorkerId>,
) -> Result<Json<WorkerStatus>, ApiError> {
    Ok(Json(service.drain_worker(id, false).await?))
}
