//! What a worker is told, and why it may not begin.

use crate::client::ClientError;
use crate::credentials::Credentials;
use crate::render::{CoreRenderer, Renderer};
use photonfarm_proto::rest::Resting;
use photonfarm_proto::trace::Tracer;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;
use tokio::sync::watch;

/// How long a worker that is told to stop may go on, unless it is told otherwise: less than the two minutes after which
/// our units for systemd and our containers are killed.
const DRAIN: Duration = Duration::from_secs(100);

/// What a worker needs to know.
#[derive(Clone)]
pub struct WorkerConfig {
    /// URL of the coordinator.
    pub coordinator: String,
    /// What is shown to the coordinator.
    pub credentials: Credentials,
    /// A name for people.
    pub name: String,
    /// Threads to render with; 0: all processors.
    pub threads: usize,
    /// Folder for the files of scenes.
    pub cache: PathBuf,
    /// Bytes that the folder may hold.
    pub cache_bytes: u64,
    /// What renders.
    pub renderer: Arc<dyn Renderer>,
    /// Name of what renders: a job takes results of one name only.
    pub build: String,
    /// What this worker has: jobs may ask for it.
    pub tags: BTreeSet<String>,
    /// How long a worker that is told to stop may go on: three quarters of it with the iteration at hand, then with the
    /// delivery of what is done. What is left then is kept in the cache's folder.
    pub drain: Duration,
    /// Memory that jobs may take of this machine, if it is known \[MiB\]: none is taken that needs more.
    pub memory_mb: Option<u32>,
    /// Whether this process tells how much memory jobs take, for which it sets its high-water mark back, and at its start
    /// which leases an earlier one had that was killed for lack of memory.
    pub watches_memory: bool,
    /// Where spans of its work go, if anywhere.
    pub tracer: Tracer,
    /// Set while no work is to be taken.
    pub rest: watch::Receiver<Option<Resting>>,
}

impl WorkerConfig {
    /// A worker that renders with the core, on all processors.
    #[must_use]
    pub fn new(coordinator: impl Into<String>, cache: impl Into<PathBuf>) -> Self {
        Self {
            coordinator: coordinator.into(),
            credentials: Credentials::default(),
            name: "worker".into(),
            threads: 0,
            cache: cache.into(),
            cache_bytes: 16 << 30,
            renderer: Arc::new(CoreRenderer),
            build: photonfarm_proto::RENDERER.to_owned(),
            tags: BTreeSet::new(),
            drain: DRAIN,
            memory_mb: None,
            watches_memory: false,
            tracer: Tracer::default(),
            rest: watch::channel(None).1,
        }
    }
}

/// Why a worker cannot work.
#[derive(Debug, Error)]
pub enum WorkerError {
    /// Not a URL of a coordinator.
    #[error("{0}")]
    Url(String),
    /// The coordinator does not take this worker.
    #[error("the coordinator refuses this worker")]
    Refused(#[source] ClientError),
    /// The cache's folder cannot be used.
    #[error("the cache {} cannot be written: choose another folder with --cache", path.display())]
    Cache {
        /// The folder.
        path: PathBuf,
        /// What failed.
        source: std::io::Error,
    },
    /// No threads.
    #[error("no threads to render with: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}
