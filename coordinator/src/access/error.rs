//! Why somebody is not let in, or tokens cannot be made, listed or revoked.

use crate::store::StoreError;
use photonfarm_proto::problem::Problem;
use thiserror::Error;

/// A refusal, or a failing store.
#[derive(Debug, Error)]
pub enum AccessError {
    /// What the caller did wrong.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The store of tokens failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}
