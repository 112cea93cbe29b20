//! Checks: what a worker says of a scene before a job is made of it.

use super::extract::{Id, JsonBody, Params};
use super::guard::By;
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::check::{CheckSpec, CheckStatus};
use photonfarm_proto::id::CheckId;
use photonfarm_proto::problem::{ErrorCode, Problem};
use serde::Deserialize;
use std::time::Duration;

/// The longest wait for an answer \[ms\].
const LONGEST_WAIT: u64 = 30_000;

/// Has a worker load a scene and say what it holds, or all that is wrong with it. Nothing is rendered, and nothing of it is kept:
/// the coordinator that was asked remembers the answer for ten minutes, or until it ends.
#[utoipa::path(
    post, path = "/v1/checks", operation_id = "create_check", request_body = CheckSpec,
    responses((status = 202, body = CheckStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn ask(
    State(service): State<App>,
    By(caller): By,
    JsonBody(spec): JsonBody<CheckSpec>,
) -> Result<Response, ApiError> {
    let status = service.ask_check(spec, &caller).await?;
    let location = [(header::LOCATION, format!("/v1/checks/{}", status.id))];
    Ok((StatusCode::ACCEPTED, location, Json(status)).into_response())
}

/// How long to wait.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WaitParams {
    /// The answer comes as soon as the check is done or has failed, and after so many milliseconds at the latest.
    #[param(minimum = 0, maximum = 30000)]
    wait_ms: Option<u64>,
}

/// How far a check has come, for whoever asked for it.
#[utoipa::path(
    get, path = "/v1/checks/{id}", operation_id = "get_check", params(("id" = CheckId, Path), WaitParams),
    responses((status = 200, body = CheckStatus), (status = "4XX", body = Problem))
)]
pub(super) async fn status(
    State(service): State<App>,
    By(caller): By,
    Id(id): Id<CheckId>,
    Params(WaitParams { wait_ms }): Params<WaitParams>,
) -> Result<Json<CheckStatus>, ApiError> {
    let wait = wait_ms.unwrap_or(0);
    if wait > LONGEST_WAIT {
        let detail = format!("wait_ms: {wait} is over the limit of {LONGEST_WAIT}");
        return Err(Problem::new(ErrorCode::Invalid, detail).at("wait_ms", None).into());
    }
    Ok(Json(
        service.check_status(id, &caller, Duration::from_millis(wait)).await?,
    ))
}
