//! Scenes arrive: the manifest, then the files that are missing.

use super::extract::{Id, JsonBody, Params};
use super::guard::By;
use super::{ApiError, App};
use crate::service::{Part, SceneFile};
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use photonfarm_proto::api::BundleReply;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::Problem;
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
