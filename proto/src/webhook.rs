//! What URLs are told of the jobs of a farm, and what became of it.

use crate::id::JobId;
use crate::job::JobState;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Header of a delivery: `sha256=` and the hexadecimal digits of the HMAC-SHA-256, with the farm's secret as the key, of the value of
/// [`TIMESTAMP`], a dot, and the body.
pub const SIGNATURE: &str = "x-photonfarm-signature";

/// Header of a delivery: when it was sent [s since 1970]. Whoever refuses old ones cannot be told the same again by others.
pub const TIMESTAMP: &str = "x-photonfarm-timestamp";

/// Header of a delivery: its name, the same at every attempt.
pub const DELIVERY: &str = "x-photonfarm-delivery";

/// The end of a job, as a URL is told it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobNotice {
    /// `job.done`, `job.failed` or `job.cancelled`.
    pub event: String,
    /// Names the delivery, which may arrive more than once.
    pub delivery: String,
    /// Digits of the farm.
    pub farm: String,
    /// The job.
    pub job: JobId,
    /// Its name for people.
    pub name: String,
    /// Its labels.
    pub labels: BTreeMap<String, String>,
    /// Name of the token that it was submitted with.
    pub owner: String,
    /// How it ended.
    pub state: JobState,
    /// Why it failed or was cancelled, where that is known.
    pub failure: Option<String>,
    /// When it ended.
    #[serde(rename = "at", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub at_ms: u64,
    /// Where its status is.
    pub link: String,
}

/// Where a delivery stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DeliveryState {
    /// It is to be sent, or sent again.
    Pending,
    /// It was answered with a status from 200 to 299.
    Delivered,
    /// It was tried for too long.
    GivenUp,
}

/// Something that a URL is to be told, and what became of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Delivery {
    /// Names it.
    pub id: String,
    /// The job that it is about.
    pub job: JobId,
    /// Where it goes.
    pub url: String,
    /// Whether the operator of the farm has named the URL, and not the job.
    pub of_farm: bool,
    /// Where it stands.
    pub state: DeliveryState,
    /// How often it was sent.
    pub attempts: u32,
    /// When it was made.
    #[serde(rename = "created_at", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub created_ms: u64,
    /// When it is sent next.
    #[serde(
        rename = "due_at",
        with = "crate::time::option",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub due_ms: Option<u64>,
    /// When it arrived, or was given up.
    #[serde(
        rename = "ended_at",
        with = "crate::time::option",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub ended_ms: Option<u64>,
    /// Why the last attempt failed.
    pub error: Option<String>,
}

/// A page of deliveries, newest first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct DeliveryPage {
    /// The deliveries.
    pub deliveries: Vec<Delivery>,
    /// Value of `cursor` for the next page; absent on the last.
    pub next: Option<String>,
}
