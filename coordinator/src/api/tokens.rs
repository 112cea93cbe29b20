//! Tokens: make, list, revoke.

use super::ApiError;
use super::extract::{Id, JsonBody};
use super::guard::Made;
use crate::access::Gate;
use axum::http::StatusCode;
use axum::{Extension, Json};
use photonfarm_proto::problem::Problem;
use photonfarm_proto::token::{NewToken, TokenList, TokenRequest};
use std::sync::Arc;

/// Makes a token. The reply is the only place where it can be read.
#[utoipa::path(
    post, path = "/v1/tokens", operation_id = "create_token", request_body = TokenRequest,
    responses((status = 201, body = NewToken), (status = "4XX", body = Problem))
)]
pub(super) async fn create(
    Extension(gate): Extension<Arc<Gate>>,
    JsonBody(request): JsonBody<TokenRequest>,
) -> Result<(StatusCode, Extension<Made>, Json<NewToken>), ApiError> {
    let made = Extension(Made(request.name.clone()));
    Ok((StatusCode::CREATED, made, Json(gate.create(request).await?)))
}

/// The tokens of the farm, with what was used of their quotas.
#[utoipa::path(get, path = "/v1/tokens", operation_id = "list_tokens", responses((status = 200, body = TokenList), (status = "4XX", body = Problem)))]
pub(super) async fn list(Extension(gate): Extension<Arc<Gate>>) -> Result<Json<TokenList>, ApiError> {
    Ok(Json(TokenList {
        tokens: gate.list().await?,
    }))
}

/// Revokes a token. Its jobs go on.
#[utoipa::path(
    delete, path = "/v1/tokens/{name}", operation_id = "revoke_token", params(("name" = String, Path)),
    responses((status = 204), (status = "4XX", body = Problem))
)]
pub(super) async fn revoke(
    Extension(gate): Extension<Arc<Gate>>,
    Id(name): Id<String>,
) -> Result<StatusCode, ApiError> {
    gate.revoke(&name).await?;
    Ok(StatusCode::NO_CONTENT)
}
