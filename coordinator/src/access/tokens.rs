//! Making, listing and revoking tokens on a state store.

use super::{AccessError, Secret};
use crate::scheduler::record::Millis;
use crate::store::{StateStore, TokenRecord};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::{NewToken, TokenRequest, TokenStatus};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// The tokens of a farm, as its state store has them.
#[derive(Clone)]
pub struct Tokens {
    state: Arc<dyn StateStore>,
}

/// The time by the system's clock; what expires does so by the clock that people read.
pub(super) fn wall_clock() -> Millis {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since.as_millis() as Millis
}

impl Tokens {
    /// Those of this store.
    #[must_use]
    pub fn new(state: Arc<dyn StateStore>) -> Self {
        Self { state }
    }

    /// All of them, by name.
    pub(super) async fn records(&self) -> Result<Vec<TokenRecord>, AccessError> {
        Ok(self.state.tokens().await?)
    }

    /// Makes a token. It is in the reply and nowhere else.
    ///
    /// # Errors
    /// A name that is taken or not allowed; a failing store.
    pub async fn create(&self, request: TokenRequest) -> Result<NewToken, AccessError> {
        let at = |field: &str, detail: String| Problem::new(ErrorCode::Invalid, detail).at(field, None);
        request.check().map_err(|(field, reason)| at(field, reason))?;
        let secret = Secret::random().map_err(|error| {
            tracing::error!(%error, "the system gives no random numbers");
            Problem::new(ErrorCode::Internal, "the system gives no random numbers")
        })?;
        let created_ms = wall_clock();
        let record = TokenRecord {
            hash: secret.hash(),
            role: request.role,
            created_ms,
            expires_ms: request
                .expires_in_s
                .map(|seconds| created_ms.saturating_add(seconds.saturating_mul(1000))),
            quota: request.quota,
            name: request.name,
        };
        if !self.state.put_token(record.clone()).await? {
            let detail = format!(
                "there is a token {:?}: revoke it first, or choose another name",
                record.name
            );
            return Err(at("name", detail).into());
        }
        tracing::info!(name = record.name, role = %record.role, "token made");
        Ok(NewToken {
            token: secret.reveal().to_owned(),
            status: self.status(record).await?,
        })
    }

    /// What is known of each token.
    ///
    /// # Errors
    /// A failing store.
    pub async fn list(&self) -> Result<Vec<TokenStatus>, AccessError> {
        let mut statuses = Vec::new();
        for record in self.records().await? {
            statuses.push(self.status(record).await?);
        }
        Ok(statuses)
    }

    /// Revokes a token.
    ///
    /// # Errors
    /// No token of that name; a failing store.
    pub async fn revoke(&self, name: &str) -> Result<(), AccessError> {
        if !self.state.remove_token(name.to_owned()).await? {
            return Err(no_token(name).into());
        }
        tracing::info!(name, "token revoked");
        Ok(())
    }

    async fn status(&self, record: TokenRecord) -> Result<TokenStatus, AccessError> {
        let usage = self.state.usage(record.name.clone()).await?;
        Ok(TokenStatus {
            name: record.name,
            role: record.role,
            created_ms: record.created_ms,
            expires_ms: record.expires_ms,
            quota: record.quota,
            usage,
        })
    }
}

pub(super) fn no_token(name: &str) -> Problem {
    Problem::new(ErrorCode::NotFound, format!("there is no token {name:?}"))
}
