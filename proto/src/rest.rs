//! Workers that rest: they stay registered, and take no work for a while.

use crate::id::{LeaseToken, WorkerId};
use serde::{Deserialize, Serialize};
use std::fmt;
use utoipa::ToSchema;

/// A worker says that it takes no work, now and again while it does not: a sign of life. A request for work ends it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rest {
    /// Who.
    pub worker: WorkerId,
    /// Counts the worker's requests, as that of a [`LeaseRequest`](crate::worker::LeaseRequest) does.
    pub serial: u64,
    /// The leases that it still holds, as in a [`LeaseRequest`](crate::worker::LeaseRequest).
    pub held: Vec<LeaseToken>,
    /// Why.
    pub reason: RestReason,
    /// When it ends, if that is known [milliseconds since 1970, UTC].
    pub until_ms: Option<u64>,
}

/// Why a worker rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RestReason {
    /// It is outside the hours that it works in.
    Hours,
    /// Somebody else uses its machine.
    Busy,
}

/// A worker's rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Resting {
    /// Why.
    pub reason: RestReason,
    /// When it ends, if that is known.
    #[serde(rename = "until", with = "crate::time::option", default)]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub until_ms: Option<u64>,
}

impl fmt::Display for Resting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reason = match self.reason {
            RestReason::Hours => "outside its hours",
            RestReason::Busy => "somebody else uses its machine",
        };
        match self.until_ms {
            Some(until_ms) => write!(f, "resting until {}: {reason}", crate::time::rfc3339(until_ms)),
            None => write!(f, "resting: {reason}"),
        }
    }
}
