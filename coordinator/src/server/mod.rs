//! Connections: how many at once, how long a peer may take, encrypted or not, and how they end.
//!
//! axum's own loop has no time limits and no bound on connections, so this one drives hyper itself.

mod body;
mod deadline;
mod slots;
mod tls;

pub(crate) use tls::Certificates;
pub use tls::{TlsError, TlsFiles};

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use body::Patience;
use deadline::Deadline;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use slots::Slots;
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

/// Most bytes of a request's head, and of what is read ahead of a body.
const BUFFER_BYTES: usize = 128 << 10;
/// Most bytes of an answer that the system holds before it sends them, so that what moves shows soon.
#[cfg(target_os = "linux")]
const UNSENT_BYTES: u32 = 128 << 10;
/// Pause after the system could not give a connection, as when there are no file descriptors left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// How long peers may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// From the first wait for a request to the end of its head; an idle connection is closed after it.
    pub head: Duration,
    /// Between two pieces of a body, and between two of an answer, which may take the time of `bytes_per_second` besides.
    pub stall: Duration,
    /// For an encrypted connection's handshake.
    pub handshake: Duration,
    /// Least speed of a body over its whole time, after one `stall` [bytes per second].
    pub bytes_per_second: u64,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            head: Duration::from_secs(60),
            stall: Duration::from_secs(30),
            handshake: Duration::from_secs(10),
            bytes_per_second: 1000,
        }
    }
}

impl Timeouts {
    /// How long the other end may read nothing of an answer: the system takes in the next bytes only when a good part of
    /// what it holds is sent.
    fn longest_write(&self) -> Duration {
        #[cfg(target_os = "linux")]
        let held = u64::from(UNSENT_BYTES);
        #[cfg(not(target_os = "linux"))]
        let held = 4 << 20;
        self.stall + Duration::from_millis(1000 * held / self.bytes_per_second.max(1))
    }
}

/// The address of whoever sent a request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer(pub(crate) IpAddr);

/// What every connection shares.
#[derive(Clone)]
pub(crate) struct Server {
    pub(crate) router: Router,
    pub(crate) tls: Option<Arc<Certificates>>,
    pub(crate) timeouts: Timeouts,
    /// Connections at once.
    pub(crate) connections: usize,
    /// Connections at once from one address.
    pub(crate) connections_per_address: usize,
    pub(crate) stopping: watch::Receiver<bool>,
    /// Connections that were closed at once, since their address had too many.
    pub(crate) refused: Arc<AtomicU64>,
}

impl Server {
    /// Takes connections, so many at once, until the service stops; returns when the last has ended.
    pub(crate) async fn run(self, listener: TcpListener) {
        let slots = Arc::new(Semaphore::new(self.connections));
        let of_address = Slots::new(self.connections_per_address);
        let tracker = TaskTracker::new();
        let mut stopping = self.stopping.clone();
        loop {
            let next = async {
                let slot = slots.clone().acquire_owned().await;
                (slot, listener.accept().await)
            };
            let (slot, accepted) = tokio::select! {
                next = next => next,
                _ = stopping.wait_for(|stop| *stop) => break,
            };
            match accepted {
                Ok((stream, peer)) => {
                    let Some(of_address) = of_address.take(peer.ip()) else {
                        tracing::debug!(%peer, "a connection too many of one address");
                        self.refused.fetch_add(1, Ordering::Relaxed);
                        continue;
                    };
                    let server = self.clone();
                    tracker.spawn(async move {
                        server.connection(stream, peer).await;
                        drop((slot, of_address));
                    });
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be taken");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
        }
        drop(listener);
        tracker.close();
        tracker.wait().await;
    }

    async fn connection(self, stream: TcpStream, peer: SocketAddr) {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no delay could not be set");
        }
        #[cfg(target_os = "linux")]
        if let Err(error) = socket2::SockRef::from(&stream).set_tcp_notsent_lowat(UNSENT_BYTES) {
            tracing::debug!(%error, "what is not sent yet could not be bounded");
        }
        let stream = Deadline::of(stream, self.timeouts.longest_write());
        let Some(tls) = &self.tls else {
            return self.requests(stream, peer).await;
        };
        match tokio::time::timeout(self.timeouts.handshake, tls.acceptor().accept(stream)).await {
            Ok(Ok(stream)) => self.requests(stream, peer).await,
            Ok(Err(error)) => tracing::debug!(%peer, %error, "the handshake failed"),
            Err(_) => tracing::debug!(%peer, "the handshake took too long"),
        }
    }

    /// Answers the requests of one connection. When the service stops, the one under way is the last.
    async fn requests(self, stream: impl AsyncRead + AsyncWrite + Unpin + 'static, peer: SocketAddr) {
        let Self {
            router,
            timeouts,
            mut stopping,
            ..
        } = self;
        let service = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(Peer(peer.ip().to_canonical()));
            let request = request.map(|body| Body::from_stream(Patience::of(Body::new(body), timeouts)));
            router.clone().oneshot(request)
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(timeouts.head)
            .max_buf_size(BUFFER_BYTES)
            .serve_connection(TokioIo::new(stream), service);
        let mut connection = pin!(connection);
        let ended = tokio::select! {
            ended = connection.as_mut() => ended,
            () = async { _ = stopping.wait_for(|stop| *stop).await } => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(%peer, %error, "a connection broke");
        }
    }
}
