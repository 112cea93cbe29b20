//! Jobs: submit, follow, cancel, delete, look at.

use super::extract::{Id, JsonBody, Params};
use super::guard::{By, Steered};
use super::spool::{LongBody, Spool};
use super::{ApiError, App};
use crate::service::{ImageFormat, PictureFile};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use photonfarm_core::integrator::layers::MAX_LAYERS;
use photonfarm_proto::api::{IDEMPOTENCY_KEY, JobLog, JobPage};
use photonfarm_proto::history::JobHistory;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_proto::problem::{ErrorCode, Problem};
use serde::Deserialize;
use std::sync::Arc;

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

/// The image as it stands, as OpenEXR with metadata.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.exr", operation_id = "get_job_exr", params(("id" = JobId, Path)),
    responses((status = 200, content_type = "image/x-exr"), (status = 304), (status = "4XX", body = Problem))
)]
pub(super) async fn image_exr(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Exr), "image/x-exr", &headers).await
}

/// The image as it stands, as PNG by a tone curve.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.png", operation_id = "get_job_png", params(("id" = JobId, Path)),
    responses((status = 200, content_type = "image/png"), (status = 304), (status = "4XX", body = Problem))
)]
pub(super) async fn image_png(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Png), "image/png", &headers).await
}

/// The image as it stands, small, as JPEG: as the PNG shows it, of at most 256 pixels across and down.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.jpg", operation_id = "get_job_jpg", params(("id" = JobId, Path)),
    responses((status = 200, content_type = "image/jpeg"), (status = 304), (status = "4XX", body = Problem))
)]
pub(super) async fn image_jpg(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Jpeg), "image/jpeg", &headers).await
}

/// Which layers are to follow the picture.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RawParams {
    /// Numbers of layers in the job's list `layers`, from 1, with commas between them.
    #[param(pattern = "^([1-9]|1[0-6])(,([1-9]|1[0-6])){0,15}$", example = "1,3")]
    layers: Option<String>,
}

impl RawParams {
    /// The places in the list.
    fn places(&self) -> Result<Vec<usize>, Problem> {
        let wrong = || {
            let detail = format!("layers: up to {MAX_LAYERS} numbers from 1 to {MAX_LAYERS}, with commas between them");
            Problem::new(ErrorCode::Invalid, detail).at("layers", None)
        };
        let place = |number: &str| match number.parse::<usize>() {
            Ok(number @ 1..=MAX_LAYERS) => Ok(number - 1),
            _ => Err(wrong()),
        };
        let places = self.layers.iter().flat_map(|list| list.split(','));
        let places: Vec<usize> = places.take(MAX_LAYERS + 1).map(place).collect::<Result<_, _>>()?;
        match places.len() {
            0..=MAX_LAYERS => Ok(places),
            _ => Err(wrong()),
        }
    }
}

/// The image as it stands, as plain numbers: the same as those of the OpenEXR file.
///
/// All are little-endian. First 32 bytes: the letters `photonf1`, pixels across and down (32-bit integers), iterations (64-bit
/// integer), and the noise (64-bit float; NaN where unknown). Then for each pixel, row by row from the top left, four 32-bit floats:
/// radiance in red, green and blue, and the standard error of the luminance (NaN where unknown). The layers asked for follow likewise,
/// each of all pixels: its three channels, or its only one three times, and the standard error of its luminance (NaN for what is no
/// light); `halves` are two of them.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.raw", operation_id = "get_job_raw", params(("id" = JobId, Path), RawParams),
    responses((status = 200, content_type = "application/octet-stream"), (status = 304), (status = "4XX", body = Problem))
)]
pub(super) async fn image_raw(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    Params(params): Params<RawParams>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let format = ImageFormat::Raw(params.places()?);
    image(service, &spool, (id, format), "application/octet-stream", &headers).await
}

async fn image(
    service: App,
    spool: &Spool,
    (id, format): (JobId, ImageFormat),
    media_type: &'static str,
    headers: &HeaderMap,
) -> Result<Response, ApiError> {
    let known = headers.get(header::IF_NONE_MATCH).and_then(|value| value.to_str().ok());
    let make = async {
        let picture = service.picture(id, format, known).await?;
        let (status, body) = match picture.file {
            PictureFile::Known => (StatusCode::NOT_MODIFIED, LongBody::None),
            PictureFile::Made(bytes) => (StatusCode::OK, LongBody::Bytes(bytes)),
            PictureFile::Kept(bytes, reader) => (StatusCode::OK, LongBody::Stored(bytes, reader)),
        };
        let head = [
            (header::ETAG, picture.etag),
            (header::CACHE_CONTROL, "no-cache".to_owned()),
            (header::CONTENT_TYPE, media_type.to_owned()),
        ];
        Ok(((status, head).into_response(), body))
    };
    spool.answer(make).await
}
