//! Requests as types; whatever cannot be read becomes a problem that names where.

use super::{ApiError, App};
use axum::body::to_bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::codec::{self, MESSAGE_BYTES, MESSAGE_MEDIA_TYPE, Message};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::trace::{Context, TRACEPARENT};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::str::FromStr;

/// The span that a request says it is part of.
pub(super) fn span_of(headers: &HeaderMap) -> Option<Context> {
    headers.get(TRACEPARENT)?.to_str().ok()?.parse().ok()
}

/// A JSON body.
pub(super) struct JsonBody<T>(pub(super) T);

impl<T: DeserializeOwned + Serialize> FromRequest<App> for JsonBody<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, service: &App) -> Result<Self, ApiError> {
        expect_media_type(request.headers(), "application/json")?;
        let limit = service.limits.json_bytes;
        let bytes = read_body(request, limit as usize, "json_bytes").await?;
        let mut deserializer = serde_json::Deserializer::from_slice(&bytes);
        let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
            let (path, inner) = (error.path().to_string(), error.inner());
            json_problem(inner).at(path, Some(inner.line() as u64))
        })?;
        deserializer
            .end()
            .map_err(|error| json_problem(&error).at(".", Some(error.line() as u64)))?;
        let (given, read) = (serde_json::from_slice(&bytes), serde_json::to_value(&value));
        if let (Ok(given), Ok(read)) = (given, read)
            && let Some(path) = array_for_object(&given, &read)
        {
            let detail = "invalid type: an array, expected an object";
            return Err(Problem::new(ErrorCode::Invalid, detail).at(path, None).into());
        }
        Ok(Self(value))
    }
}

/// Where an array was read as an object: derived code reads a struct from an array of its fields as well, which no
/// schema says. One that says what is said by leaving it out is not noticed.
fn array_for_object(given: &Value, read: &Value) -> Option<String> {
    let within = |name: &str, given: &Value, read: &Value| {
        array_for_object(given, read).map(|path| match path.as_str() {
            "." => name.to_owned(),
            inner => format!("{name}.{inner}"),
        })
    };
    match (given, read) {
        (Value::Array(_), Value::Object(_)) => Some(".".to_owned()),
        (Value::Object(given), Value::Object(read)) => given
            .iter()
            .find_map(|(name, given)| within(name, given, read.get(name)?)),
        (Value::Array(given), Value::Array(read)) => given
            .iter()
            .zip(read)
            .enumerate()
            .find_map(|(index, (given, read))| within(&index.to_string(), given, read)),
        _ => None,
    }
}

fn json_problem(error: &serde_json::Error) -> Problem {
    let code = if error.is_data() {
        ErrorCode::Invalid
    } else {
        ErrorCode::Malformed
    };
    Problem::new(code, error.to_string())
}

/// A framed message as a body or a reply.
pub(super) struct Framed<M>(pub(super) M);

impl<M: Message> FromRequest<App> for Framed<M> {
    type Rejection = ApiError;

    async fn from_request(request: Request, _: &App) -> Result<Self, ApiError> {
        expect_media_type(request.headers(), MESSAGE_MEDIA_TYPE)?;
        let bytes = read_body(request, MESSAGE_BYTES, "message").await?;
        let message = codec::decode(&bytes).map_err(crate::service::ServiceError::from)?;
        Ok(Self(message))
    }
}

impl<M: Message> IntoResponse for Framed<M> {
    fn into_response(self) -> Response {
        match codec::encode(&self.0) {
            Ok(bytes) => ([(header::CONTENT_TYPE, MESSAGE_MEDIA_TYPE)], bytes).into_response(),
            Err(error) => ApiError::from(crate::service::ServiceError::from(error)).into_response(),
        }
    }
}

/// Refuses a body of another media type.
pub(super) fn expect_media_type(headers: &HeaderMap, expected: &str) -> Result<(), ApiError> {
    let given = headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .unwrap_or("");
    let essence = given.split(';').next().unwrap_or("").trim();
    if essence.eq_ignore_ascii_case(expected) {
        return Ok(());
    }
    let detail = format!("the body is {given:?}, expected {expected}");
    Err(Problem::new(ErrorCode::UnsupportedMediaType, detail).into())
}

async fn read_body(request: Request, limit: usize, name: &str) -> Result<axum::body::Bytes, ApiError> {
    let length = request.headers().get(header::CONTENT_LENGTH);
    let announced = length.and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    let too_long = || {
        Problem::new(
            ErrorCode::Limit,
            format!("the body has more than {limit} bytes (limit `{name}`)"),
        )
    };
    if announced.is_some_and(|bytes| bytes > limit as u64) {
        return Err(too_long().into());
    }
    to_bytes(request.into_body(), limit).await.map_err(|error| {
        let limited = std::error::Error::source(&error).is_some_and(|source| source.to_string().contains("limit"));
        if limited {
            too_long()
        } else {
            Problem::new(ErrorCode::Malformed, "the body ended early")
        }
        .into()
    })
}

/// The variable part of a path.
pub(super) struct Id<T>(pub(super) T);

impl<T: FromStr> FromRequestParts<App> for Id<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &App) -> Result<Self, ApiError> {
        let unknown = || Problem::new(ErrorCode::NotFound, "there is nothing under this path");
        let Path(text) = Path::<String>::from_request_parts(parts, service)
            .await
            .map_err(|_| unknown())?;
        Ok(Self(text.parse().map_err(|_| unknown())?))
    }
}

/// Parameters of the query.
pub(super) struct Params<T>(pub(super) T);

impl<T: DeserializeOwned> FromRequestParts<App> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, service: &App) -> Result<Self, ApiError> {
        match Query::<T>::from_request_parts(parts, service).await {
            Ok(Query(params)) => Ok(Self(params)),
            Err(rejection) => Err(Problem::new(ErrorCode::Malformed, rejection.body_text()).into()),
        }
    }
}
