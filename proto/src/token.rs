//! Tokens: who may do what, and how much of it.

use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// Longest name of a token.
pub const TOKEN_NAME_BYTES: usize = 64;

/// What the bearer of a token may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Look at jobs, images, scenes and workers.
    Read,
    /// Also send scenes and jobs, and steer the jobs that were sent with this token.
    Submit,
    /// Render: the worker protocol and the files of scenes, and nothing else.
    Worker,
    /// Everything.
    Admin,
}

impl Role {
    /// Whether the bearer may do what needs `needed`.
    #[must_use]
    pub fn includes(self, needed: Self) -> bool {
        match needed {
            Self::Read => matches!(self, Self::Read | Self::Submit | Self::Admin),
            Self::Submit => matches!(self, Self::Submit | Self::Admin),
            Self::Worker => matches!(self, Self::Worker | Self::Admin),
            Self::Admin => self == Self::Admin,
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// How much may be done with a token; what is absent is not bounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Quota {
    /// Jobs that have not ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jobs: Option<u64>,
    /// Bytes of the files of its bundles, each distinct file once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bundle_bytes: Option<u64>,
    /// Iterations of all its jobs, ended ones included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u64>,
}

/// How much was done with a token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Usage {
    /// Jobs that have not ended.
    pub jobs: u64,
    /// Bytes of the files of its bundles, each distinct file once.
    pub bundle_bytes: u64,
    /// Iterations of all its jobs, ended ones included.
    pub iterations: u64,
}

/// Asks for a token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TokenRequest {
    /// Its name: 1 to 64 letters, digits, `-`, `_` and `.`. Jobs show it as their owner.
    #[schema(pattern = "^[A-Za-z0-9._-]{1,64}$")]
    pub name: String,
    /// What it allows.
    pub role: Role,
    /// Seconds until it ends; absent: never.
    #[serde(default)]
    pub expires_in_s: Option<u64>,
    /// How much it allows.
    #[serde(default)]
    pub quota: Quota,
}

impl TokenRequest {
    /// Checks name and numbers.
    ///
    /// # Errors
    /// The field, and a sentence about it.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.name.is_empty() || self.name.len() > TOKEN_NAME_BYTES || !self.name.chars().all(allowed) {
            let reason = format!("a token's name has 1 to {TOKEN_NAME_BYTES} letters, digits, `-`, `_` and `.`");
            return Err(("name", reason));
        }
        let Quota {
            jobs,
            bundle_bytes,
            iterations,
        } = self.quota;
        let numbers = [
            ("expires_in_s", self.expires_in_s),
            ("quota.jobs", jobs),
            ("quota.bundle_bytes", bundle_bytes),
            ("quota.iterations", iterations),
        ];
        let most = i64::MAX as u64;
        let large = numbers
            .iter()
            .find(|(_, number)| number.is_some_and(|number| number > most));
        large.map_or(Ok(()), |(field, _)| Err((*field, format!("{field} is at most {most}"))))
    }
}

/// A new token: the only time that it is shown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NewToken {
    /// What to send as `Authorization: Bearer TOKEN`.
    pub token: String,
    /// What is kept of it.
    pub status: TokenStatus,
}

/// What the farm knows of a token.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct TokenStatus {
    /// Its name.
    pub name: String,
    /// What it allows.
    pub role: Role,
    /// When it was made.
    #[serde(rename = "created", alias = "created_ms", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub created_ms: u64,
    /// When it ends.
    #[serde(rename = "expires", alias = "expires_ms", with = "crate::time::option", default)]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub expires_ms: Option<u64>,
    /// How much it allows.
    pub quota: Quota,
    /// How much of that is used.
    pub usage: Usage,
}

/// The tokens of the farm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct TokenList {
    /// The tokens, by name.
    pub tokens: Vec<TokenStatus>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_include_what_they_say() {
        use Role::{Admin, Read, Submit, Worker};
        let allowed = |role: Role| [Read, Submit, Worker, Admin].map(|needed| role.includes(needed));
        assert_eq!(allowed(Read), [true, false, false, false]);
        assert_eq!(allowed(Submit), [true, true, false, false]);
        assert_eq!(allowed(Worker), [false, false, true, false]);
        assert_eq!(allowed(Admin), [true; 4]);
    }

    #[test]
    fn names_are_plain() {
        let check = |name: &str| {
            let name = name.to_owned();
            TokenRequest {
                name,
                role: Role::Read,
                expires_in_s: None,
                quota: Quota::default(),
            }
            .check()
        };
        assert_eq!(check("render-7.host_a"), Ok(()));
        for bad in ["", "a b", "a/b", "ü", "a\n", &"x".repeat(65)] {
            assert!(check(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn numbers_that_no_database_takes_are_refused() {
        let mut request = TokenRequest {
            name: "a".into(),
            role: Role::Read,
            expires_in_s: Some(i64::MAX as u64),
            quota: Quota::default(),
        };
        assert_eq!(request.check(), Ok(()));
        request.quota.iterations = Some(u64::MAX);
        assert_eq!(request.check().unwrap_err().0, "quota.iterations");
    }
}
