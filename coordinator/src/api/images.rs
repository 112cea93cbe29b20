//! Pictures of jobs, whole and in parts.

use super::extract::{Id, Params};
use super::spool::{LongBody, Spool};
use super::{ApiError, App};
use crate::service::{ImageFormat, PictureFile, Section, Wanted};
use axum::Extension;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_core::integrator::layers::MAX_LAYERS;
use photonfarm_proto::id::JobId;
use photonfarm_proto::problem::{ErrorCode, Problem};
use serde::Deserialize;
use std::convert::Infallible;
use std::sync::Arc;

/// What the OpenAPI document says of the headers of a request for a picture.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Header)]
#[expect(dead_code, reason = "`Asked` reads them")]
struct AskedHeaders {
    /// the `ETag` of a picture that is there already
    #[param(rename = "If-None-Match")]
    known: Option<String>,
    /// `bytes=FIRST-LAST`, `bytes=FIRST-` or `bytes=-COUNT`: a part of the picture
    #[param(rename = "Range")]
    range: Option<String>,
    /// the `ETag` of the picture that `Range` is of: of another one all is sent
    #[param(rename = "If-Range")]
    if_range: Option<String>,
}

/// The headers of a request for a picture.
pub(super) struct Asked {
    headers: HeaderMap,
    /// Whether ranges have a meaning, as they have for GET alone.
    in_parts: bool,
}

impl FromRequestParts<App> for Asked {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &App) -> Result<Self, Infallible> {
        Ok(Self {
            headers: parts.headers.clone(),
            in_parts: parts.method == Method::GET,
        })
    }
}

impl Asked {
    /// A header that cannot be read is as good as none.
    fn header(&self, name: HeaderName) -> Option<&str> {
        self.headers.get(name)?.to_str().ok()
    }

    fn wanted(&self) -> Wanted<'_> {
        Wanted {
            known: self.header(header::IF_NONE_MATCH),
            range: self.header(header::RANGE).filter(|_| self.in_parts),
            if_range: self
                .headers
                .get(header::IF_RANGE)
                .map(|tag| tag.to_str().unwrap_or_default()),
        }
    }
}

/// The image as it stands, as OpenEXR with metadata.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.exr", operation_id = "get_job_exr", params(("id" = JobId, Path), AskedHeaders),
    responses(
        (status = 200, content_type = "image/x-exr"),
        (status = 206, content_type = "image/x-exr", description = "the part that `Range` asks for"),
        (status = 304),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn exr(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    asked: Asked,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Exr), "image/x-exr", &asked).await
}

/// The image as it stands, as PNG by a tone curve.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.png", operation_id = "get_job_png", params(("id" = JobId, Path), AskedHeaders),
    responses(
        (status = 200, content_type = "image/png"),
        (status = 206, content_type = "image/png", description = "the part that `Range` asks for"),
        (status = 304),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn png(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    asked: Asked,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Png), "image/png", &asked).await
}

/// The image as it stands, small, as JPEG: as the PNG shows it, of at most 256 pixels across and down.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/image.jpg", operation_id = "get_job_jpg", params(
        ("id" = JobId, Path),
        ("If-None-Match" = Option<String>, Header, description = "the `ETag` of a picture that is there already")
    ),
    responses((status = 200, content_type = "image/jpeg"), (status = 304), (status = "4XX", body = Problem))
)]
pub(super) async fn jpg(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    asked: Asked,
) -> Result<Response, ApiError> {
    image(service, &spool, (id, ImageFormat::Jpeg), "image/jpeg", &asked).await
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
    get, path = "/v1/jobs/{id}/image.raw", operation_id = "get_job_raw", params(("id" = JobId, Path), RawParams, AskedHeaders),
    responses(
        (status = 200, content_type = "application/octet-stream"),
        (status = 206, content_type = "application/octet-stream", description = "the part that `Range` asks for"),
        (status = 304),
        (status = "4XX", body = Problem)
    )
)]
pub(super) async fn raw(
    State(service): State<App>,
    Extension(spool): Extension<Arc<Spool>>,
    Id(id): Id<JobId>,
    Params(params): Params<RawParams>,
    asked: Asked,
) -> Result<Response, ApiError> {
    let format = ImageFormat::Raw(params.places()?);
    image(service, &spool, (id, format), "application/octet-stream", &asked).await
}

async fn image(
    service: App,
    spool: &Spool,
    (id, format): (JobId, ImageFormat),
    media_type: &'static str,
    asked: &Asked,
) -> Result<Response, ApiError> {
    let make = async {
        let picture = service.picture(id, format, &asked.wanted()).await?;
        let tag = (header::ETAG, picture.etag);
        let (section, body) = match picture.file {
            PictureFile::Known => (None, LongBody::None),
            PictureFile::Beyond(length) => {
                let of = format!("bytes */{length}");
                let refused = ([tag, (header::CONTENT_RANGE, of)], beyond(length)).into_response();
                return Ok((refused, LongBody::None));
            }
            PictureFile::Made(section, bytes) => (Some(section), LongBody::Bytes(bytes)),
            PictureFile::Kept(section, reader) => {
                let length = section.bytes.end - section.bytes.start;
                (Some(section), LongBody::Stored(length, reader))
            }
        };
        let (status, part) = match section {
            None => (StatusCode::NOT_MODIFIED, None),
            Some(Section { partial: false, .. }) => (StatusCode::OK, None),
            Some(Section { bytes, of, .. }) => {
                let part = format!("bytes {}-{}/{of}", bytes.start, bytes.end - 1);
                (StatusCode::PARTIAL_CONTENT, Some([(header::CONTENT_RANGE, part)]))
            }
        };
        let rules = [
            (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
            (header::ACCEPT_RANGES, HeaderValue::from_static("bytes")),
            (header::CONTENT_TYPE, HeaderValue::from_static(media_type)),
        ];
        Ok(((status, [tag], part, rules).into_response(), body))
    };
    spool.answer(make).await
}

fn beyond(length: u64) -> ApiError {
    let detail = format!("the picture has {length} bytes, and none where `Range` begins");
    Problem::new(ErrorCode::RangeNotSatisfiable, detail).into()
}
