//! The process that leases iterations, renders them and sends the sums back.
//!
//! One lease is rendered at a time; while it is, finished nodes go out and heartbeats go on beside it. A finished node
//! is kept until the coordinator has acknowledged it, however long the coordinator is away; a worker that has to go
//! before that keeps it on disk.

mod backoff;
mod block;
mod cache;
mod client;
mod credentials;
mod drain;
mod held;
mod kept;
mod notices;
mod otlp;
mod outbox;
mod parcel;
mod reach;
mod render;
pub mod transfer;
mod worker;

pub use cache::{BundleFiles, Cache, FileError};
pub use client::ClientError;
pub use credentials::{Credentials, CredentialsError, TOKEN_VARIABLE};
pub use otlp::{Exporter, OtlpError};
pub use reach::{explain, is_lasting};
pub use render::{CoreRenderer, CoreScene, LoadedScene, Renderer};
pub use tokio_util::sync::CancellationToken;
pub use worker::{Worker, WorkerConfig, WorkerError};
