//! Errors of the service, and how clients see them.

use crate::access::AccessError;
use crate::scheduler::Refusal;
use crate::store::StoreError;
use photonfarm_core::film::FilmError;
use photonfarm_core::picture::PictureError;
use photonfarm_proto::codec::CodecError;
use photonfarm_proto::limits::LimitError;
use photonfarm_proto::node::NodeError;
use photonfarm_proto::problem::{ErrorCode, Problem};
use thiserror::Error;

/// Why the service refused or failed.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// A problem as the client sees it.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The scheduler refused.
    #[error(transparent)]
    Refusal(#[from] Refusal),
    /// A store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Beyond a limit.
    #[error(transparent)]
    Limit(#[from] LimitError),
    /// A damaged message.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// A damaged node.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// Nodes that do not fit together.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// A picture that cannot be written.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The service is stopping.
    #[error("the coordinator is stopping")]
    Stopping,
}

impl From<AccessError> for ServiceError {
    fn from(error: AccessError) -> Self {
        match error {
            AccessError::Problem(problem) => problem.into(),
            AccessError::Store(error) => error.into(),
        }
    }
}

impl ServiceError {
    /// As a client sees it: what it did wrong in full, what the service did wrong without internals.
    #[must_use]
    pub fn into_problem(self) -> Problem {
        let text = self.to_string();
        let full = matches!(&self, Self::Store(error) if error.is_full());
        let away = match &self {
            Self::Store(error) => away(error),
            _ => None,
        };
        match self {
            Self::Problem(problem) => problem,
            Self::Refusal(refusal) => refusal_problem(&refusal),
            Self::Limit(limit) => limit_problem(&limit),
            Self::Codec(CodecError::Version { .. }) | Self::Node(NodeError::Version { .. }) => {
                Problem::new(ErrorCode::VersionMismatch, text)
            }
            Self::Codec(_) => Problem::new(ErrorCode::Malformed, text),
            Self::Node(NodeError::Limit(limit)) => limit_problem(&limit),
            Self::Node(_) => Problem::new(ErrorCode::Invalid, text),
            Self::Stopping => Problem::new(ErrorCode::Unavailable, text),
            Self::Store(StoreError::WrongHash { .. }) => Problem::new(ErrorCode::ContentMismatch, text),
            Self::Store(StoreError::NoBlob(_)) => Problem::new(ErrorCode::NotFound, text),
            Self::Store(StoreError::TooLate) => Problem::new(ErrorCode::Unavailable, text),
            Self::Store(_) | Self::Film(_) | Self::Picture(_) => {
                tracing::error!(error = text, "the service failed");
                if full {
                    let detail = "the coordinator's disk is full: it needs room where its data are; nothing is lost";
                    return Problem::new(ErrorCode::Internal, detail);
                }
                if let Some(store) = away {
                    let detail =
                        format!("{store} of the farm does not answer; nothing is lost, and the farm goes on with it");
                    return Problem::new(ErrorCode::Unavailable, detail);
                }
                Problem::new(ErrorCode::Internal, "the coordinator could not do it; its log says why")
            }
        }
    }
}

/// Which store on another machine does not answer, if that is what failed.
fn away(error: &StoreError) -> Option<&'static str> {
    match error {
        StoreError::Connection(_) => Some("the database"),
        // Without a code of the server the connection failed; those of class 57 say that it goes away or comes back.
        StoreError::Postgres(error) => error
            .code()
            .is_none_or(|code| code.code().starts_with("57"))
            .then_some("the database"),
        StoreError::Object(object_store::Error::Generic { .. }) => Some("the object store"),
        _ => None,
    }
}

fn limit_problem(limit: &LimitError) -> Problem {
    match limit {
        LimitError::Exceeded { name, .. } => Problem::new(ErrorCode::Limit, limit.to_string()).at(*name, None),
        LimitError::Invalid { field, .. } => {
            Problem::new(ErrorCode::Invalid, limit.to_string()).at(field.clone(), None)
        }
    }
}

fn refusal_problem(refusal: &Refusal) -> Problem {
    let code = match refusal {
        Refusal::UnknownJob(_) => ErrorCode::NotFound,
        Refusal::UnknownWorker(_) => ErrorCode::UnknownWorker,
        Refusal::ForeignWorker(_) => ErrorCode::Forbidden,
        Refusal::TooManyWorkers { .. } => ErrorCode::Limit,
        Refusal::StaleLease(_) => ErrorCode::StaleLease,
        Refusal::JobEnded(_) => ErrorCode::JobEnded,
        Refusal::JobGoesOn(_) => ErrorCode::JobGoesOn,
        Refusal::Invalid(_) => ErrorCode::Invalid,
        Refusal::Conflict { .. } | Refusal::Disagreement(_) => ErrorCode::ResultConflict,
    };
    Problem::new(code, refusal.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Error, ErrorKind};

    #[test]
    fn a_full_disk_is_named_and_no_path_is() {
        let full = |source: Error| {
            let path = "/srv/secret".into();
            ServiceError::Store(StoreError::Io { path, source }).into_problem()
        };
        for kind in [ErrorKind::StorageFull, ErrorKind::QuotaExceeded] {
            let problem = full(kind.into());
            assert!(
                problem.detail.contains("disk is full") && problem.retryable,
                "{problem:?}"
            );
            assert!(!problem.detail.contains("secret"), "{problem:?}");
        }
        assert!(!full(ErrorKind::PermissionDenied.into()).detail.contains("full"));
    }

    #[test]
    fn a_store_that_does_not_answer_is_named() {
        let silent = ServiceError::Store(StoreError::Connection("10.0.0.7: no answer".into())).into_problem();
        assert_eq!(silent.code, ErrorCode::Unavailable);
        assert!(silent.retryable && silent.detail.starts_with("the database of the farm does not answer"));
        assert!(!silent.detail.contains("10.0.0.7"), "{silent:?}");
    }
}
