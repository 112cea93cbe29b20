//! Who may do what: tokens, their roles and quotas.

mod error;
mod gate;
mod rate;
mod token;
mod tokens;

pub use error::AccessError;
pub(crate) use gate::{Gate, network};
pub(crate) use rate::Buckets;
pub use token::Secret;
pub use tokens::Tokens;

use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::{Quota, Role};

/// Who sent a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// Name of the token; empty where the farm asks for none.
    pub name: String,
    /// What the caller may do.
    pub role: Role,
    /// How much the caller may do.
    pub quota: Quota,
}

impl Caller {
    /// Whoever it is, on a farm that asks for no tokens.
    #[must_use]
    pub fn anyone() -> Self {
        Self {
            name: String::new(),
            role: Role::Admin,
            quota: Quota::default(),
        }
    }

    /// Whether the farm asks for no tokens.
    pub(crate) fn is_anyone(&self) -> bool {
        self.name.is_empty()
    }

    /// Refuses a request that would make the use of `name` exceed its quota.
    ///
    /// # Errors
    /// The problem, with quota and use.
    pub fn within(&self, name: &str, needed: u64, quota: Option<u64>) -> Result<(), Problem> {
        match quota {
            Some(most) if needed > most => {
                let token = &self.name;
                let mut detail =
                    format!("the quota `{name}` of the token {token:?} is {most}; this would make {needed}");
                let options = [
                    ("jobs", "--most-jobs"),
                    ("bundle_bytes", "--most-gigabytes"),
                    ("iterations", "--most-iterations"),
                ];
                if let Some((_, option)) = options.iter().find(|(quota, _)| *quota == name) {
                    detail += &format!("; an administrator sets it with `photonfarm token create {token} {option}`");
                }
                Err(Problem::new(ErrorCode::Quota, detail))
            }
            _ => Ok(()),
        }
    }

    /// An idempotency key as it is kept: keys of different owners never meet.
    pub(crate) fn own_key(&self, key: &str) -> String {
        match self.name.as_str() {
            "" => key.to_owned(),
            name => format!("{name}/{key}"),
        }
    }
}
