//! Errors as every interface reports them: problem documents of RFC 9457.

use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// The media type of a problem document.
pub const PROBLEM_MEDIA_TYPE: &str = "application/problem+json";

/// What went wrong, as a program tells cases apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorCode {
    /// The body, a header or a parameter cannot be read.
    Malformed,
    /// The request can be read, but asks for something that cannot be.
    Invalid,
    /// Something exceeds a limit of the farm.
    Limit,
    /// No token, or none that is valid.
    Unauthorized,
    /// The token does not allow it.
    Forbidden,
    /// The token's quota is used up.
    Quota,
    /// Too many requests in too short a time.
    TooManyRequests,
    /// No such route, job, bundle, blob or worker.
    NotFound,
    /// The route has no such method.
    MethodNotAllowed,
    /// The body's media type is not the route's.
    UnsupportedMediaType,
    /// The part of the file that was asked for is not there: the file is shorter.
    RangeNotSatisfiable,
    /// The job names a bundle of which files are missing.
    BundleIncomplete,
    /// The bytes do not have the hash or size that was announced.
    ContentMismatch,
    /// The idempotency key was used for another request.
    IdempotencyKeyReused,
    /// The job has no image yet.
    NoImageYet,
    /// The job has ended.
    JobEnded,
    /// The job goes on.
    JobGoesOn,
    /// The lease has expired or was revoked: its work is void.
    StaleLease,
    /// The worker is unknown to this coordinator and must register again.
    UnknownWorker,
    /// The worker speaks another version of the protocol, or renders with another version of the renderer.
    VersionMismatch,
    /// Another result for the same node was already counted: one of the two workers is broken.
    ResultConflict,
    /// The part of a file that was sent does not begin where the kept part of it ends.
    OffsetMismatch,
    /// The coordinator is stopping or overloaded.
    Unavailable,
    /// A fault of the coordinator, such as a full disk.
    Internal,
}

impl ErrorCode {
    /// HTTP status.
    #[must_use]
    pub fn status(self) -> u16 {
        match self {
            Self::Malformed => 400,
            Self::Unauthorized => 401,
            Self::Forbidden | Self::Quota => 403,
            Self::NotFound | Self::NoImageYet | Self::UnknownWorker => 404,
            Self::MethodNotAllowed => 405,
            Self::BundleIncomplete
            | Self::JobEnded
            | Self::JobGoesOn
            | Self::StaleLease
            | Self::ResultConflict
            | Self::OffsetMismatch => 409,
            Self::Limit => 413,
            Self::UnsupportedMediaType => 415,
            Self::RangeNotSatisfiable => 416,
            Self::Invalid | Self::ContentMismatch | Self::IdempotencyKeyReused => 422,
            Self::VersionMismatch => 426,
            Self::TooManyRequests => 429,
            Self::Internal => 500,
            Self::Unavailable => 503,
        }
    }

    /// One sentence for people, the same for every occurrence.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Malformed => "The request cannot be read",
            Self::Invalid => "The request asks for something that cannot be",
            Self::Limit => "A limit of the farm is exceeded",
            Self::Unauthorized => "A valid token is needed",
            Self::Forbidden => "The token does not allow it",
            Self::Quota => "The token's quota is used up",
            Self::TooManyRequests => "There were too many requests",
            Self::NotFound => "There is no such thing here",
            Self::MethodNotAllowed => "The method is not allowed here",
            Self::UnsupportedMediaType => "The media type is not accepted here",
            Self::RangeNotSatisfiable => "The file has no such part",
            Self::BundleIncomplete => "Files of the bundle are missing",
            Self::ContentMismatch => "The bytes are not those announced",
            Self::IdempotencyKeyReused => "The idempotency key belongs to another request",
            Self::NoImageYet => "The job has no image yet",
            Self::JobEnded => "The job has ended",
            Self::JobGoesOn => "The job goes on",
            Self::StaleLease => "The lease has expired or was revoked",
            Self::UnknownWorker => "The worker is not registered",
            Self::VersionMismatch => "The versions do not match",
            Self::ResultConflict => "Another result was already counted",
            Self::OffsetMismatch => "The upload goes on elsewhere",
            Self::Unavailable => "The service is not available now",
            Self::Internal => "The service failed",
        }
    }

    /// Whether the same request may succeed later.
    #[must_use]
    pub fn retryable(self) -> bool {
        matches!(self, Self::Unavailable | Self::Internal | Self::TooManyRequests)
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// A problem document (RFC 9457). Its text never shows internals of the service.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// URI of the kind of problem.
    #[serde(rename = "type")]
    pub kind: String,
    /// One sentence, the same for every occurrence.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What is wrong here, and where.
    pub detail: String,
    /// The kind of problem, for programs.
    pub code: ErrorCode,
    /// Whether the same request may succeed later.
    pub retryable: bool,
    /// Path of the offending field of the body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub field: Option<Box<str>>,
    /// Line of the offending text of the body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<u32>,
    /// Seconds to wait before the same request; also in the header `Retry-After`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_s: Option<u16>,
    /// The name of the request, which the farm's log has too; also in the header `X-Request-Id`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub request_id: Option<Box<str>>,
}

impl Problem {
    /// A problem of this kind.
    pub fn new(code: ErrorCode, detail: impl Into<String>) -> Self {
        Self {
            kind: format!("urn:photonfarm:problem:{code}"),
            title: code.title().to_owned(),
            status: code.status(),
            detail: detail.into(),
            code,
            retryable: code.retryable(),
            field: None,
            line: None,
            retry_after_s: None,
            request_id: None,
        }
    }

    /// Names the field, and the line where it is known.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>, line: Option<u64>) -> Self {
        self.field = Some(field.into().into());
        self.line = line.and_then(|line| line.try_into().ok());
        self
    }

    /// Says when to try again.
    #[must_use]
    pub fn after(mut self, seconds: u16) -> Self {
        self.retry_after_s = Some(seconds);
        self
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.title, self.detail)
    }
}

impl std::error::Error for Problem {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_carries_its_code_and_status() {
        let problem = Problem::new(ErrorCode::StaleLease, "token 7").at("token", Some(3));
        let json = serde_json::to_value(&problem).unwrap();
        assert_eq!(json["type"], "urn:photonfarm:problem:stale-lease");
        assert_eq!(json["status"], 409);
        assert_eq!(json["line"], 3);
        assert_eq!(serde_json::from_value::<Problem>(json).unwrap(), problem);
    }
}
