//! Tokens as they are kept.

use crate::scheduler::record::Millis;
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::token::{Quota, Role};
use serde::{Deserialize, Serialize};

/// What is kept of a token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TokenRecord {
    /// Its name.
    pub name: String,
    /// What it allows.
    pub role: Role,
    /// BLAKE3 hash of the token.
    pub hash: BlobHash,
    /// When it was made.
    pub created_ms: Millis,
    /// When it ends.
    pub expires_ms: Option<Millis>,
    /// How much it allows.
    pub quota: Quota,
}
