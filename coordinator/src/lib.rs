//! The service that hands out iterations and folds them into one image. It never renders.
//!
//! [`scheduler`] decides and [`store`] keeps, both without the other; [`service`] joins them; the HTTP interface and
//! [`Coordinator`] are the shell around it.

pub mod access;
mod api;
pub mod scheduler;
pub mod service;
pub mod store;

pub use api::openapi;

use photonfarm_proto::limits::Limits;
use scheduler::SchedulerConfig;
use service::{Service, ServiceError, Stores};
use std::future::IntoFuture;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use store::{FolderStore, SqliteStore, StoreError};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

/// Longest time that a shutdown waits for requests to end.
const SHUTDOWN: Duration = Duration::from_secs(10);

/// What a coordinator needs to know.
#[derive(Clone, Debug)]
pub struct Config {
    /// Folder of the state and the bytes; made if it is not there.
    pub data: PathBuf,
    /// What the farm accepts.
    pub limits: Limits,
    /// How leases are given.
    pub scheduler: SchedulerConfig,
    /// Whether to listen beyond this machine. There are no accounts yet: whoever can connect can do everything.
    pub insecure_listen: bool,
}

impl Config {
    /// A coordinator that keeps everything in `data`.
    #[must_use]
    pub fn new(data: impl Into<PathBuf>) -> Self {
        Self {
            data: data.into(),
            limits: Limits::default(),
            scheduler: SchedulerConfig::default(),
            insecure_listen: false,
        }
    }
}

/// Why a coordinator does not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// An address that other machines can reach, without leave.
    #[error(
        "{0} can be reached from other machines, and there are no accounts yet: listen on 127.0.0.1, or allow it with --insecure-listen"
    )]
    NotLoopback(SocketAddr),
    /// The network failed.
    #[error("the listener failed: {0}")]
    Listener(#[from] std::io::Error),
    /// A store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The state cannot be used.
    #[error(transparent)]
    Service(#[from] ServiceError),
}

/// A running coordinator. Dropping it leaves it running until the runtime ends; see [`Coordinator::shutdown`].
pub struct Coordinator {
    address: SocketAddr,
    service: Arc<Service>,
    server: JoinHandle<std::io::Result<()>>,
    clockwork: JoinHandle<()>,
}

impl Coordinator {
    /// Opens the stores in the data folder, goes on with what they hold, and serves on the listener.
    ///
    /// # Errors
    /// An address beyond this machine without leave; a data folder in use, damaged, or made by a newer version.
    pub async fn start(config: Config, listener: TcpListener) -> Result<Self, StartError> {
        let stores = open_stores(&config.data)?;
        Self::start_with(config, stores, listener).await
    }

    /// As [`start`](Self::start), with stores of the caller's.
    pub async fn start_with(config: Config, stores: Stores, listener: TcpListener) -> Result<Self, StartError> {
        let address = listener.local_addr()?;
        if !address.ip().is_loopback() && !config.insecure_listen {
            return Err(StartError::NotLoopback(address));
        }
        let step = Duration::from_millis((config.scheduler.lease_ttl_ms / 10).clamp(10, 1000));
        let service = Service::open(config.limits, config.scheduler, stores).await?;
        let mut stopping = service.stopping();
        let stopped = async move { _ = stopping.wait_for(|stop| *stop).await };
        let server = axum::serve(listener, api::router(service.clone())).with_graceful_shutdown(stopped);
        tracing::info!(%address, "coordinator listens");
        Ok(Self {
            address,
            server: tokio::spawn(server.into_future()),
            clockwork: tokio::spawn(service.clone().run(step)),
            service,
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The URL for workers and clients.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The service behind the interface.
    #[must_use]
    pub fn service(&self) -> &Arc<Service> {
        &self.service
    }

    /// Ends: answers waiting requests, takes no new ones, and returns when the requests under way are done.
    pub async fn shutdown(self) {
        self.service.stop();
        let (server, clockwork) = (self.server.abort_handle(), self.clockwork.abort_handle());
        if tokio::time::timeout(SHUTDOWN, async { tokio::join!(self.server, self.clockwork) })
            .await
            .is_err()
        {
            tracing::warn!("requests under way were cut off");
            server.abort();
            clockwork.abort();
        }
        self.service.close().await;
        tracing::info!("coordinator stopped");
    }
}

/// The stores of a data folder: `farm.sqlite`, `scenes/`, `nodes/`. The database's lock keeps the whole folder.
pub fn open_stores(data: &Path) -> Result<Stores, StoreError> {
    std::fs::create_dir_all(data).map_err(|source| StoreError::Io {
        path: data.to_owned(),
        source,
    })?;
    let state = SqliteStore::open(&data.join("farm.sqlite"))?;
    let scenes = FolderStore::open(&data.join("scenes"), false)?;
    let nodes = FolderStore::open(&data.join("nodes"), false)?;
    Ok(Stores {
        state: Arc::new(state),
        scenes: Arc::new(scenes),
        nodes: Arc::new(nodes),
    })
}
