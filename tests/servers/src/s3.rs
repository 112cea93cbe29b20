//! An S3 server (`s3s-fs`) on the loopback interface, which checks signatures.

use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use s3s::auth::SimpleAuth;
use s3s::service::{S3Service, S3ServiceBuilder};
use s3s_fs::FileSystem;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

const BUCKET: &str = "farm";
const ACCESS_KEY: &str = "photonfarm-tests";
const SECRET_KEY: &str = "only-for-tests";

/// An S3 server with an empty bucket. It ends, and its objects with it, when it is dropped.
#[derive(Debug)]
pub struct S3 {
    folder: TempDir,
    address: SocketAddr,
    /// None while it is down.
    runtime: Option<Runtime>,
}

impl S3 {
    /// Starts a server on a free port.
    ///
    /// # Panics
    /// Where it cannot be started.
    #[must_use]
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::create_dir(folder.path().join(BUCKET)).expect("the bucket's folder");
        let (runtime, address) = serve(folder.path(), "127.0.0.1:0");
        Self {
            folder,
            address,
            runtime: Some(runtime),
        }
    }

    /// URL of the bucket for `--blobs`.
    #[must_use]
    pub fn url(&self, prefix: &str) -> String {
        format!("s3://{BUCKET}/{prefix}")
    }

    /// The environment by which clients find the server and have access.
    #[must_use]
    pub fn environment(&self) -> [(&'static str, String); 4] {
        [
            ("AWS_ENDPOINT", format!("http://{}", self.address)),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_ACCESS_KEY_ID", ACCESS_KEY.into()),
            ("AWS_SECRET_ACCESS_KEY", SECRET_KEY.into()),
        ]
    }

    /// Where an object lies as a file.
    #[must_use]
    pub fn file(&self, key: &str) -> PathBuf {
        self.folder.path().join(BUCKET).join(key)
    }

    /// Cuts all connections and listens no more.
    ///
    /// # Panics
    /// Where a task of the server panicked.
    pub fn stop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Another thread may wait for the end of tasks even where this one belongs to a runtime of its own.
            let ended = std::thread::spawn(move || drop(runtime)).join();
            assert!(ended.is_ok(), "the S3 server ends");
        }
    }

    /// Listens again, at the same address, with the same objects.
    ///
    /// # Panics
    /// Where the port was taken meanwhile.
    pub fn restart(&mut self) {
        self.stop();
        let (runtime, _) = serve(self.folder.path(), &self.address.to_string());
        self.runtime = Some(runtime);
    }
}

impl Drop for S3 {
    fn drop(&mut self) {
        self.stop();
    }
}

fn serve(folder: &Path, address: &str) -> (Runtime, SocketAddr) {
    let mut builder = S3ServiceBuilder::new(FileSystem::new(folder).expect("the bucket's folder is readable"));
    builder.set_auth(SimpleAuth::from_single(ACCESS_KEY, SECRET_KEY));
    let service = builder.build();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    let listener = std::net::TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
        .unwrap_or_else(|error| panic!("the S3 server cannot listen on {address}: {error}"));
    let address = listener.local_addr().expect("the address listened on");
    runtime.spawn(async move {
        let listener = TcpListener::from_std(listener).expect("a listener that does not block");
        accept(listener, service).await;
    });
    (runtime, address)
}

async fn accept(listener: TcpListener, service: S3Service) {
    while let Ok((socket, _)) = listener.accept().await {
        let service = service.clone();
        tokio::spawn(async move {
            let server = Builder::new(TokioExecutor::new());
            let _ended = server.serve_connection(TokioIo::new(socket), service).await;
        });
    }
}
