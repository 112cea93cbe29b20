//! The process that leases iterations, renders them and sends the sums back.
//!
//! One lease is rendered at a time; while it is, finished nodes go out, heartbeats go on, and a scene may be checked beside it. A finished node
//! is kept until the coordinator has acknowledged it, however long the coordinator is away; a worker that has to go
//! before that keeps it on disk.

mod attendance;
mod backoff;
mod block;
mod cache;
mod check;
mod client;
mod config;
mod credentials;
mod drain;
mod held;
mod hours;
mod kept;
mod memory;
mod notices;
mod others;
mod otlp;
mod outbox;
mod parcel;
mod reach;
mod render;
mod shift;
pub mod transfer;
mod witness;
mod worker;

pub use attendance::Attendance;
pub use cache::{BundleFiles, Cache, FileError};
pub use client::ClientError;
pub use config::{WorkerConfig, WorkerError};
pub use credentials::{Credentials, CredentialsError, TOKEN_VARIABLE};
pub use hours::{Hours, HoursError};
pub use memory::available_mb;
pub use others::OTHERS_PERCENT;
pub use otlp::{Exporter, OtlpError};
pub use reach::{explain, is_lasting};
pub use render::{CoreRenderer, CoreScene, LoadedScene, Renderer};
pub use tokio_util::sync::CancellationToken;
pub use worker::Worker;
