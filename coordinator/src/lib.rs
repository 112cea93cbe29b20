//! The service that hands out iterations and folds them into one image. It never renders.
//!
//! [`scheduler`] decides and [`store`] keeps, both without the other; [`service`] joins them; the HTTP interface and
//! [`Coordinator`] are the shell around it.

pub mod access;
mod api;
mod audit;
mod background;
pub mod scheduler;
mod server;
pub mod service;
pub mod store;
mod webhook;

pub use api::{Route, openapi, routes};
pub use server::{Timeouts, TlsError, TlsFiles};
pub use webhook::{Retries, WebhookConfig, WebhookError, WebhookSecret};

use access::{Gate, Tokens};
use audit::Audit;
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use photonfarm_proto::limits::Limits;
use photonfarm_proto::trace::Tracer;
use scheduler::SchedulerConfig;
use server::{Certificates, Server};
use service::{Keep, Service, ServiceError, Stores};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use store::{BlobPlace, StatePlace, StoreError};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use webhook::Webhooks;

/// Longest time that a shutdown waits for requests to end.
const SHUTDOWN: Duration = Duration::from_secs(10);

/// What a coordinator needs to know.
#[derive(Clone, Debug)]
pub struct Config {
    /// Where the state is.
    pub state: StatePlace,
    /// Where the bytes are.
    pub blobs: BlobPlace,
    /// What the farm accepts.
    pub limits: Limits,
    /// How leases are given.
    pub scheduler: SchedulerConfig,
    /// Certificate for encrypted connections; none: connections are not encrypted.
    pub tls: Option<TlsFiles>,
    /// Requests a second that one token may send from one address, over two seconds.
    pub rate: u32,
    /// Connections at once; more wait until one of them ends.
    pub connections: usize,
    /// Connections at once from one address (IPv6: one network of 64 bits); more are closed at once.
    pub connections_per_address: usize,
    /// How long peers may take.
    pub timeouts: Timeouts,
    /// How long jobs that have ended are kept.
    pub keep: Keep,
    /// URLs that are told when jobs end.
    pub webhooks: WebhookConfig,
    /// File to which each request is written that changes something.
    pub audit_log: Option<PathBuf>,
    /// Where spans of what happens to jobs go, if anywhere.
    pub tracer: Tracer,
}

impl Config {
    /// A coordinator that keeps everything in the folder `data`: state in `farm.sqlite`, bytes in `scenes` and `nodes`.
    #[must_use]
    pub fn new(data: impl Into<PathBuf>) -> Self {
        let data = data.into();
        Self {
            state: StatePlace::Sqlite(data.join("farm.sqlite")),
            blobs: BlobPlace::Folder(data),
            limits: Limits::default(),
            scheduler: SchedulerConfig::default(),
            tls: None,
            rate: 1000,
            connections: 4096,
            connections_per_address: 1024,
            timeouts: Timeouts::default(),
            keep: Keep::default(),
            webhooks: WebhookConfig::default(),
            audit_log: None,
            tracer: Tracer::default(),
        }
    }
}

/// Why a coordinator does not start.
#[derive(Debug, Error)]
pub enum StartError {
    /// An address that other machines can reach, on a farm that asks for no tokens.
    #[error(
        "{0} can be reached from other machines, and the farm has no token yet: make one with `photonfarm token create`, or listen on 127.0.0.1"
    )]
    NoToken(SocketAddr),
    /// The certificate cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// URLs cannot be told of jobs.
    #[error(transparent)]
    Webhook(#[from] WebhookError),
    /// The audit log cannot be written.
    #[error("audit log {}: {source}", path.display())]
    Audit {
        /// The file.
        path: PathBuf,
        /// What failed.
        source: std::io::Error,
    },
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
    certificates: Option<Arc<Certificates>>,
    audit: Option<Arc<Audit>>,
    server: JoinHandle<()>,
    clockwork: JoinHandle<()>,
}

// The futures of what other crates call are boxed: their code is compiled once, here, and not again in every program.
impl Coordinator {
    /// Opens the stores in the data folder, goes on with what they hold, and serves on the listener.
    ///
    /// # Errors
    /// An address beyond this machine without any token; a certificate that cannot be used; a data folder in use, damaged, or made by a newer version.
    pub fn start(config: Config, listener: TcpListener) -> BoxFuture<'static, Result<Self, StartError>> {
        async move {
            let stores = open_stores(&config).await?;
            Self::start_with(config, stores, listener).await
        }
        .boxed()
    }

    /// As [`start`](Self::start), with stores of the caller's.
    pub fn start_with(
        config: Config,
        stores: Stores,
        listener: TcpListener,
    ) -> BoxFuture<'static, Result<Self, StartError>> {
        Self::serve(config, stores, listener).boxed()
    }

    async fn serve(config: Config, stores: Stores, listener: TcpListener) -> Result<Self, StartError> {
        let address = listener.local_addr()?;
        let loopback = address.ip().to_canonical().is_loopback();
        let certificates = config.tls.as_ref().map(Certificates::read).transpose()?.map(Arc::new);
        let encrypted = certificates.is_some();
        let gate = Gate::new(Tokens::new(stores.state.clone()), loopback, config.rate);
        if !loopback && !gate.has_tokens().await.map_err(ServiceError::from)? {
            return Err(StartError::NoToken(address));
        }
        if !loopback && !encrypted {
            tracing::warn!(%address, "connections are not encrypted: tokens can be read on the way");
        }
        let step = Duration::from_millis((config.scheduler.lease_ttl_ms / 10).clamp(10, 1000));
        let webhooks = Webhooks::new(config.webhooks, &url(address, encrypted))?;
        let service = Service::open(config.limits, config.scheduler, stores, webhooks, config.tracer).await?;
        let lost = service.audit_lost.clone();
        let audit = config.audit_log.map(|path| {
            let opened = Audit::open(path.clone(), lost);
            opened.map_err(|source| StartError::Audit { path, source })
        });
        let audit = audit.transpose()?.map(Arc::new);
        let server = Server {
            router: api::router(service.clone(), Arc::new(gate), audit.clone()),
            tls: certificates.clone(),
            timeouts: config.timeouts,
            connections: config.connections,
            connections_per_address: config.connections_per_address,
            stopping: service.stopping(),
            refused: service.refused_connections.clone(),
        };
        tracing::info!(%address, encrypted, "coordinator listens");
        Ok(Self {
            address,
            certificates,
            audit,
            server: tokio::spawn(server.run(listener)),
            clockwork: tokio::spawn(service.clone().run(step, config.keep)),
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
        url(self.address, self.certificates.is_some())
    }

    /// The service behind the interface.
    #[must_use]
    pub fn service(&self) -> &Arc<Service> {
        &self.service
    }

    /// Reads the files of the certificate again; new connections get what is in them. Files that cannot be used change
    /// nothing: connections go on with what was there. Returns whether there is a certificate.
    ///
    /// # Errors
    /// What is wrong with the files.
    pub fn renew_certificates(&self) -> Result<bool, TlsError> {
        let renewed = self.certificates.as_ref().map(|certificates| certificates.renew());
        Ok(renewed.transpose()?.is_some())
    }

    /// Opens the audit log again, whose file was moved away. Where that fails, it goes on in the one that was open.
    pub async fn reopen_audit_log(&self) {
        if let Some(audit) = &self.audit {
            audit.reopen().await;
        }
    }

    /// Ends: answers waiting requests, takes no new ones, and returns when the requests under way are done.
    pub fn shutdown(self) -> BoxFuture<'static, ()> {
        self.end().boxed()
    }

    async fn end(self) {
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

fn url(address: SocketAddr, encrypted: bool) -> String {
    let scheme = if encrypted { "https" } else { "http" };
    format!("{scheme}://{address}")
}

/// Opens the stores. The lock of a database file keeps a folder of bytes beside it as well.
pub fn open_stores(config: &Config) -> BoxFuture<'_, Result<Stores, StoreError>> {
    async {
        let state = config.state.open().await?;
        let [scenes, nodes] = config.blobs.open(state.is_shared()).await?;
        Ok(Stores { state, scenes, nodes })
    }
    .boxed()
}
