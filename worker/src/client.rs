//! The coordinator as a worker sees it.

use crate::backoff::Backoff;
use crate::credentials::Credentials;
use crate::notices::Notices;
use crate::reach::{Reach, explain, is_no_connection};
use crate::transfer::{self, SILENCE, TransferError};
use bytes::Bytes;
use futures_util::StreamExt;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::codec::{self, CodecError, MESSAGE_BYTES, MESSAGE_MEDIA_TYPE, Message};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::trace::{Context, TRACEPARENT, Tracer};
use photonfarm_proto::worker::{StatisticsRequest, read_statistics, statistics_body_bytes};
use reqwest::header::{CONTENT_TYPE, HeaderName, HeaderValue, LOCATION};
use reqwest::redirect::Policy;
use reqwest::{Method, Request, RequestBuilder, Response, StatusCode, Url};
use std::time::{Duration, Instant};
use thiserror::Error;
use tokio_util::sync::CancellationToken;

/// Time for a short message, and what any message may take beyond its own time.
const SHORT: Duration = Duration::from_secs(15);
/// How long a connection is kept for the next request: less than a coordinator keeps it.
const IDLE: Duration = Duration::from_secs(30);
/// How fast a coordinator reads images at least, which it may have to before it answers [bytes per second].
const READING: u64 = 1_000_000;
/// How long a request may fail before that is said.
const PATIENCE: Duration = Duration::from_secs(1);
/// Most bytes of a manifest.
const MANIFEST_BYTES: usize = 64 << 20;

/// Why a request failed.
#[derive(Debug, Error)]
pub enum ClientError {
    /// No answer: the coordinator is away, or the network.
    #[error("no answer from the coordinator: {}", explain(.0))]
    Away(#[from] TransferError),
    /// No answer of the object store.
    #[error("no answer from the object store: {0}")]
    StoreAway(String),
    /// The object store says no, perhaps because a signed URL is too old.
    #[error("the object store answers {0}")]
    Store(reqwest::StatusCode),
    /// The coordinator says no.
    #[error("{0}")]
    Problem(Box<Problem>),
    /// Something that is not a coordinator refuses a body for its size.
    #[error(
        "something between here and the coordinator refuses bodies of {0} bytes (413 Payload Too Large): raise its limit \
         (of nginx: client_max_body_size)"
    )]
    TooLarge(u64),
    /// Something else answers where the coordinator should, as a proxy does whose service is away.
    #[error("something answers there that is no coordinator: {0}")]
    Stranger(StatusCode),
    /// An answer that is not Photonfarm's.
    #[error("the answer cannot be read: {0}")]
    Answer(String),
    /// An answer of another version.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The worker is to stop.
    #[error("the worker is stopping")]
    Stopping,
}

impl ClientError {
    /// Whether the same request may succeed later.
    #[must_use]
    pub fn retryable(&self) -> bool {
        match self {
            Self::Away(_) | Self::StoreAway(_) | Self::Store(_) | Self::Stranger(_) => true,
            Self::Problem(problem) => problem.retryable,
            Self::TooLarge(_) | Self::Answer(_) | Self::Codec(_) | Self::Stopping => false,
        }
    }

    /// The problem's code, if the coordinator said no.
    #[must_use]
    pub fn code(&self) -> Option<ErrorCode> {
        match self {
            Self::Problem(problem) => Some(problem.code),
            _ => None,
        }
    }
}

impl From<reqwest::Error> for ClientError {
    fn from(error: reqwest::Error) -> Self {
        Self::Away(error.into())
    }
}

/// A request with a body, ready to be sent any number of times.
pub(crate) struct Prepared {
    head: Request,
    body: Bytes,
    wait: Duration,
}

impl Prepared {
    /// Says which span the request is part of, if there is one.
    pub(crate) fn within(mut self, span: Context) -> Self {
        if let Some(value) = Some(span)
            .filter(|span| span.is_some())
            .and_then(|span| HeaderValue::try_from(span.to_string()).ok())
        {
            let name = HeaderName::from_static(TRACEPARENT);
            self.head.headers_mut().insert(name, value);
        }
        self
    }
}

/// A connection to a coordinator.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    http: reqwest::Client,
    /// For signed URLs of the object store, which are all the leave that it takes.
    store: reqwest::Client,
    base: Url,
    credentials: Credentials,
    pub(crate) reach: Reach,
    /// Where spans of what is sent go.
    pub(crate) tracer: Tracer,
}

impl Client {
    /// A client for the coordinator at `url`; nothing is sent yet.
    pub(crate) fn new(url: &str, credentials: Credentials, tracer: Tracer) -> Result<Self, String> {
        let base = Url::parse(url).map_err(|error| format!("{url:?} is not a URL: {error}"))?;
        if !matches!(base.scheme(), "http" | "https") || base.cannot_be_a_base() {
            return Err(format!("{url:?} is not an address such as http://127.0.0.1:7800"));
        }
        credentials.warn_if_exposed(&base);
        let builder = || {
            let builder = reqwest::Client::builder().connect_timeout(SHORT);
            builder.pool_idle_timeout(IDLE).no_proxy()
        };
        let http = credentials.trust(builder()).redirect(Policy::none()).build();
        let store = credentials.trust_also(builder()).build();
        Ok(Self {
            http: http.map_err(|error| error.to_string())?,
            store: store.map_err(|error| error.to_string())?,
            reach: Reach::to(base.as_str().trim_end_matches('/')),
            base,
            credentials,
            tracer,
        })
    }

    /// The coordinator's URL.
    pub(crate) fn coordinator(&self) -> &str {
        self.base.as_str()
    }

    /// Notes whether the coordinator can be reached.
    fn noted(&self, answer: Result<Response, TransferError>) -> Result<Response, ClientError> {
        match &answer {
            Ok(_) => self.reach.whole(),
            Err(error) if is_no_connection(error) => self.reach.broken(error),
            Err(_) => {}
        }
        Ok(answer?)
    }

    /// A request to the coordinator, with the token.
    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.credentials.sign(self.http.request(method, self.url(path)))
    }

    fn url(&self, path: &str) -> Url {
        let mut url = self.base.clone();
        url.set_path(&format!("{}/v1/{path}", self.base.path().trim_end_matches('/')));
        url
    }

    /// A request with a body; its answer may take `wait` longer than usual.
    pub(crate) fn post(&self, path: &str, body: Vec<u8>, wait: Duration) -> Result<Prepared, ClientError> {
        let request = self
            .request(Method::POST, path)
            .header(CONTENT_TYPE, MESSAGE_MEDIA_TYPE);
        Ok(Prepared {
            head: request.build()?,
            body: body.into(),
            wait: SHORT + wait,
        })
    }

    async fn execute(&self, request: &Prepared) -> Result<Response, ClientError> {
        let head = request.head.try_clone();
        let head = head.ok_or_else(|| ClientError::Answer("a request that cannot be repeated".into()))?;
        let answer = transfer::send(&self.http, head, request.body.clone(), request.wait, |_| {}).await;
        match succeed(self.noted(answer)?).await {
            Err(ClientError::TooLarge(_)) => Err(ClientError::TooLarge(request.body.len() as u64)),
            other => other,
        }
    }

    /// Sends a prepared request and reads the reply.
    pub(crate) async fn send<R: Message>(&self, request: &Prepared) -> Result<R, ClientError> {
        let response = self.execute(request).await?;
        Ok(codec::decode(&read_bounded(response, MESSAGE_BYTES).await?)?)
    }

    /// Sends a message and reads the reply, which may take `wait` longer than usual.
    pub(crate) async fn call<M: Message, R: Message>(
        &self,
        path: &str,
        message: &M,
        wait: Duration,
    ) -> Result<R, ClientError> {
        self.send(&self.post(path, codec::encode(message)?, wait)?).await
    }

    /// As [`call`](Self::call), again and again while the coordinator is away, until `stop`.
    pub(crate) async fn insist<M: Message, R: Message>(
        &self,
        path: &str,
        message: &M,
        stop: &CancellationToken,
    ) -> Result<R, ClientError> {
        retry(stop, path, || self.call(path, message, Duration::ZERO)).await
    }

    /// What the iterations of a lease go on from: so many values.
    pub(crate) async fn statistics(&self, request: &StatisticsRequest, values: usize) -> Result<Vec<f32>, ClientError> {
        let bytes = statistics_body_bytes(values);
        let request = self.post("worker/statistics", codec::encode(request)?, reading_time(bytes as u64))?;
        let body = read_bounded(self.execute(&request).await?, bytes).await?;
        read_statistics(&body, values).ok_or_else(|| {
            let problem = Problem::new(ErrorCode::Unavailable, "the statistics were damaged on the way");
            ClientError::Problem(Box::new(problem))
        })
    }

    /// The manifest of a bundle.
    pub(crate) async fn manifest(&self, hash: BlobHash) -> Result<BundleManifest, ClientError> {
        let request = self.request(Method::GET, &format!("bundles/{hash}"));
        let bytes = read_bounded(succeed(self.noted(answered(request).await)?).await?, MANIFEST_BYTES).await?;
        let manifest: BundleManifest =
            serde_json::from_slice(&bytes).map_err(|error| ClientError::Answer(error.to_string()))?;
        if manifest.hash() != hash {
            return Err(ClientError::Answer(format!(
                "the manifest of {hash} has hash {}",
                manifest.hash()
            )));
        }
        Ok(manifest)
    }

    /// The bytes of a file, piece by piece; the caller verifies them. They may come from the object store. If the file is
    /// `suspect`, the coordinator verifies it first.
    pub(crate) async fn blob(&self, hash: BlobHash, suspect: bool) -> Result<Response, ClientError> {
        let request = self.request(Method::GET, &format!("blobs/{hash}"));
        let request = match suspect {
            true => request.query(&[("suspect", true)]),
            false => request,
        };
        let response = self.noted(answered(request).await)?;
        if response.status() != StatusCode::TEMPORARY_REDIRECT {
            return succeed(response).await;
        }
        let place = response.headers().get(LOCATION).and_then(|place| place.to_str().ok());
        let url = place.ok_or_else(|| ClientError::Answer("a redirection to nowhere".into()))?;
        from_store(answered(self.store.get(url)).await)
    }

    /// Puts bytes to a signed URL.
    pub(crate) async fn put(&self, url: &str, bytes: Bytes) -> Result<(), ClientError> {
        let request = self.store.put(url).build()?;
        from_store(transfer::send(&self.store, request, bytes, SILENCE, |_| {}).await).map(drop)
    }
}

/// Sends a request without a body; its answer begins soon.
async fn answered(request: RequestBuilder) -> Result<Response, TransferError> {
    let late = |_| TransferError::Silent {
        silence: SILENCE,
        moved: 0,
    };
    Ok(tokio::time::timeout(SILENCE, request.send()).await.map_err(late)??)
}

/// How long a coordinator may read an image of so many bytes before it answers.
pub(crate) fn reading_time(bytes: u64) -> Duration {
    Duration::from_secs(bytes / READING)
}

/// Repeats a request that may succeed later, until `stop`. What it is shows in the log if it fails for longer.
pub(crate) async fn retry<T, F: Future<Output = Result<T, ClientError>>>(
    stop: &CancellationToken,
    what: &str,
    mut attempt: impl FnMut() -> F,
) -> Result<T, ClientError> {
    let mut backoff = Backoff::default();
    let mut notices = Notices::from(Instant::now(), PATIENCE);
    loop {
        let result = tokio::select! {
            result = attempt() => result,
            () = stop.cancelled() => return Err(ClientError::Stopping),
        };
        let error = match result {
            Err(error) if error.retryable() => error,
            other => return other,
        };
        let wait = backoff.next();
        tracing::debug!(%error, ?wait, "trying again");
        // That the coordinator cannot be reached at all is said once, not for each request.
        let reachable = !matches!(&error, ClientError::Away(error) if is_no_connection(error));
        let now = Instant::now();
        if reachable && notices.due(now) {
            tracing::warn!(
                "{what} fails for {} s and is tried again: {error}",
                notices.seconds(now)
            );
        }
        tokio::select! {
            () = tokio::time::sleep(wait) => {}
            () = stop.cancelled() => return Err(ClientError::Stopping),
        }
    }
}

/// An answer of the object store; its errors do not show the URL, which is a key.
fn from_store(response: Result<Response, TransferError>) -> Result<Response, ClientError> {
    let response = response.map_err(|error| ClientError::StoreAway(explain(&error)))?;
    if !response.status().is_success() {
        return Err(ClientError::Store(response.status()));
    }
    Ok(response)
}

async fn succeed(response: Response) -> Result<Response, ClientError> {
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let body = read_bounded(response, 1 << 16).await?;
    match serde_json::from_slice::<Problem>(&body) {
        Ok(problem) => Err(ClientError::Problem(Box::new(problem))),
        Err(_) if status.is_server_error() => {
            let problem = Problem::new(ErrorCode::Unavailable, format!("the answer is {status}"));
            Err(ClientError::Problem(Box::new(problem)))
        }
        Err(_) if status == StatusCode::PAYLOAD_TOO_LARGE => Err(ClientError::TooLarge(0)),
        Err(_) => Err(ClientError::Stranger(status)),
    }
}

async fn read_bounded(response: Response, limit: usize) -> Result<Vec<u8>, ClientError> {
    let mut bytes = Vec::new();
    let mut stream = std::pin::pin!(transfer::pieces(response, SILENCE));
    while let Some(piece) = stream.next().await {
        bytes.extend_from_slice(&piece?);
        if bytes.len() > limit {
            return Err(ClientError::Answer(format!("it has more than {limit} bytes")));
        }
    }
    Ok(bytes)
}
