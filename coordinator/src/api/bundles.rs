//! Scenes arrive: the manifest, then the files that are missing.

use super::extract::{Id, JsonBody, Params};
use super::guard::By;
use super::{ApiError, App};
use crate::service::{Part, SceneFile};
use axum::Json;
use axum::body::{Body, HttpBody};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use photonfarm_proto::api::{BundleReply, UPLOAD_COMPLETE, UPLOAD_OFFSET, UploadState};
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::{ErrorCode, Problem};
use serde::Deserialize;
use tokio_util::io::ReaderStream;

/// Keeps a manifest; the reply names the files to upload.
#[utoipa::path(
    post, path = "/v1/bundles", operation_id = "create_bundle", request_body = BundleManifest,
    responses((status = 200, body = BundleReply), (status = "4XX", body = Problem))
)]
pub(super) async fn submit(
    State(service): State<App>,
    By(caller): By,
    JsonBody(manifest): JsonBody<BundleManifest>,
) -> Result<Json<BundleReply>, ApiError> {
    Ok(Json(service.submit_bundle(manifest, &caller).await?))
}

/// The manifest of a bundle.
#[utoipa::path(
    get, path = "/v1/bundles/{hash}", operation_id = "get_bundle", params(("hash" = BlobHash, Path)),
    responses((status = 200, body = BundleManifest), (status = "4XX", body = Problem))
)]
pub(super) async fn manifest(
    State(service): State<App>,
    Id(hash): Id<BlobHash>,
) -> Result<Json<BundleManifest>, ApiError> {
    Ok(Json(service.bundle(hash).await?))
}

/// Uploads a file that a manifest names. Uploading it again changes nothing.
#[utoipa::path(
    put, path = "/v1/blobs/{hash}", operation_id = "put_blob", params(("hash" = BlobHash, Path)),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses((status = 201), (status = 204, description = "known already"), (status = "4XX", body = Problem))
)]
pub(super) async fn upload(
    State(service): State<App>,
    Id(hash): Id<BlobHash>,
    body: Body,
) -> Result<StatusCode, ApiError> {
    let stored = service.put_blob(hash, body.into_data_stream()).await;
    service.note(Part::Scenes, &stored);
    Ok(if stored? {
        StatusCode::CREATED
    } else {
        StatusCode::NO_CONTENT
    })
}

/// How much is kept of an upload of the caller's that is not finished, also in the header `Upload-Offset`. Asking ends a request
/// that goes on with it.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}/upload", operation_id = "get_upload", params(("hash" = BlobHash, Path)),
    responses((status = 200, body = UploadState), (status = "4XX", body = Problem))
)]
pub(super) async fn upload_state(
    State(service): State<App>,
    Id(hash): Id<BlobHash>,
    By(caller): By,
) -> Result<Response, ApiError> {
    let state = service.upload_state(hash, &caller).await?;
    Ok(told(StatusCode::OK, state))
}

/// Goes on with an upload where the kept part of it ends. What comes is kept even if the connection breaks; once the file is whole,
/// it is held against its hash. Where the kept part ends elsewhere, the answer is 409, and says where in its detail.
#[utoipa::path(
    patch, path = "/v1/blobs/{hash}/upload", operation_id = "append_upload",
    params(
        ("hash" = BlobHash, Path),
        ("Upload-Offset" = u64, Header, description = "where the body begins in the file"),
        ("Upload-Complete" = Option<String>, Header, description = "`?0` if more of the file follows this body; else it ends with it")
    ),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 200, body = UploadState, description = "kept; more is to come"),
        (status = 201, body = UploadState, description = "the file is whole"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn append(
    State(service): State<App>,
    Id(hash): Id<BlobHash>,
    By(caller): By,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let (offset, last) = (offset(&headers)?, is_last(&headers)?);
    let span = (offset, body.size_hint().exact());
    let appended = service
        .append_blob(hash, span, last, body.into_data_stream(), &caller)
        .await;
    service.note(Part::Scenes, &appended);
    let state = appended?;
    let status = if state.complete {
        StatusCode::CREATED
    } else {
        StatusCode::OK
    };
    Ok(told(status, state))
}

fn told(status: StatusCode, state: UploadState) -> Response {
    let headers = [(UPLOAD_OFFSET, state.offset.to_string())];
    (status, headers, Json(state)).into_response()
}

fn offset(headers: &HeaderMap) -> Result<u64, Problem> {
    let given = headers.get(UPLOAD_OFFSET).and_then(|value| value.to_str().ok());
    given.and_then(|digits| digits.parse().ok()).ok_or_else(|| {
        let detail = "the header Upload-Offset says where the body begins in the file, in bytes, such as 0";
        Problem::new(ErrorCode::Malformed, detail)
    })
}

fn is_last(headers: &HeaderMap) -> Result<bool, Problem> {
    match headers.get(UPLOAD_COMPLETE).map(HeaderValue::as_bytes) {
        None | Some(b"?1") => Ok(true),
        Some(b"?0") => Ok(false),
        Some(_) => {
            let detail = "the header Upload-Complete is ?1 if the file ends with the body, or ?0";
            Err(Problem::new(ErrorCode::Malformed, detail))
        }
    }
}

/// How a file is asked for.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct FileParams {
    /// The bytes that came had another hash, or there were none: the farm is to verify its own first.
    #[serde(default)]
    suspect: bool,
}

/// The bytes of a file, perhaps from another place. The receiver verifies the hash.
#[utoipa::path(
    get, path = "/v1/blobs/{hash}", operation_id = "get_blob", params(("hash" = BlobHash, Path), FileParams),
    responses(
        (status = 200, content_type = "application/octet-stream"),
        (status = 307, description = "they are in the object store, at the URL in `Location`"),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn download(
    State(service): State<App>,
    Id(hash): Id<BlobHash>,
    Params(FileParams { suspect }): Params<FileParams>,
) -> Result<Response, ApiError> {
    match service.scene_file(hash, suspect).await? {
        SceneFile::At(url) => Ok(Redirect::temporary(&url).into_response()),
        SceneFile::Here(bytes, reader) => {
            let headers = [
                (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
                (header::CONTENT_LENGTH, bytes.to_string()),
            ];
            Ok((headers, Body::from_stream(ReaderStream::new(reader))).into_response())
        }
    }
}
