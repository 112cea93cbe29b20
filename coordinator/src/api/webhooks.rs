//! What URLs are told of jobs, and what became of it.

use super::extract::Params;
use super::listing::page_limit;
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use photonfarm_proto::id::JobId;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::webhook::DeliveryPage;
use serde::Deserialize;

/// Longest cursor [bytes]; those that this service gives are shorter.
const CURSOR_BYTES: usize = 64;

/// Which deliveries.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DeliveryParams {
    /// Of this job only.
    job: Option<JobId>,
    /// The `next` of the page before.
    #[param(max_length = 64)]
    cursor: Option<String>,
    /// Deliveries on the page.
    #[param(minimum = 1, maximum = 100)]
    limit: Option<u32>,
}

/// Deliveries to webhooks, newest first. Those that arrived or were given up are shown for a week.
#[utoipa::path(
    get, path = "/v1/webhooks", operation_id = "list_deliveries", params(DeliveryParams),
    responses((status = 200, body = DeliveryPage), (status = "4XX", body = Problem))
)]
pub(super) async fn list(
    State(service): State<App>,
    Params(page): Params<DeliveryParams>,
) -> Result<Json<DeliveryPage>, ApiError> {
    let limit = page.limit.map(|limit| page_limit(limit, "deliveries")).transpose()?;
    // The highest number that the interface's document allows.
    if page.job.is_some_and(|job| i64::try_from(job.0).is_err()) {
        let detail = format!("job: numbers of jobs end at {}", i64::MAX);
        return Err(Problem::new(ErrorCode::Invalid, detail).at("job", None).into());
    }
    let given = |cursor: &String| cursor.len() <= CURSOR_BYTES && cursor.bytes().all(|byte| byte.is_ascii_hexdigit());
    if page.cursor.as_ref().is_some_and(|cursor| !given(cursor)) {
        let detail = "cursor: not one that this service gave";
        return Err(Problem::new(ErrorCode::Malformed, detail).at("cursor", None).into());
    }
    Ok(Json(service.deliveries(page.job, page.cursor, limit).await?))
}
