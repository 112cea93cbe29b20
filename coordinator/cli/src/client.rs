//! A client of the coordinator's public interface that goes on through restarts.

use crate::events::Events;
use crate::say::tell;
use anyhow::{Context, Result, anyhow, bail};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};
use photonfarm_core::picture;
use photonfarm_proto::api::{
    BundleReply, EVENT_END, EVENT_STATUS, FARM, FarmFigures, Health, IDEMPOTENCY_KEY, JobLog, JobPage, Session,
    SetPriority, UPLOAD_OFFSET, UploadState, WorkerList, WorkerStatus,
};
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::{JobSpec, JobStatus};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::token::{NewToken, TokenList, TokenRequest};
use photonfarm_worker::transfer::{self, SILENCE, TransferError};
use photonfarm_worker::{Credentials, explain, is_lasting};
use reqwest::header::{CONTENT_TYPE, DATE, HeaderMap};
use reqwest::tls::TlsInfo;
use reqwest::{Method, RequestBuilder, Response, StatusCode, Url};
use serde::Serialize;
use std::cell::Cell;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::time::sleep;

/// How long the first answer may take: a coordinator that is just starting.
const FIRST_PATIENCE: Duration = Duration::from_secs(10);
/// How long a coordinator that has answered before may stay away.
pub(crate) const PATIENCE: Duration = Duration::from_secs(15 * 60);
/// How long a connection is kept for the next request: less than a coordinator keeps it.
const IDLE: Duration = Duration::from_secs(30);
/// Files of so many bytes are sent in parts that are kept, so that they go on where they broke.
const RESUMED: usize = 1 << 20;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest silence within an answer; event streams send comments more often than this.
const READ_TIMEOUT: Duration = Duration::from_secs(60);
/// How long the user hears nothing of a coordinator that is away.
const QUIET: Duration = Duration::from_secs(2);
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Jobs that are asked for at once: as many as a page has.
const PAGE: usize = 100;
/// Where the metadata of a picture end at the latest.
const HEAD_BYTES: usize = 4 << 20;

/// A coordinator.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    http: reqwest::Client,
    /// For long bodies: a limit on reading would go on while they are sent.
    uploads: reqwest::Client,
    base: Url,
    credentials: Credentials,
    /// The farm that answered first; answers of another one are refused.
    farm: Arc<OnceLock<String>>,
}

/// What was seen of a coordinator.
#[derive(Debug)]
pub(crate) struct Sighting {
    /// From the request to its answer.
    pub(crate) took: Duration,
    /// What its clock says, in whole seconds.
    pub(crate) server_time: Option<SystemTime>,
    /// What the clock here said then.
    pub(crate) local_time: SystemTime,
    /// Its certificate as DER, where the connection is encrypted.
    pub(crate) certificate: Option<Vec<u8>>,
    /// How it is.
    pub(crate) health: Health,
}

/// No coordinator has answered for as long as there is patience.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Unreachable(String);

/// Why a request has no answer.
enum Failure {
    /// It may have one later.
    Away(anyhow::Error),
    /// It will never have one.
    Refused(anyhow::Error),
}

impl Client {
    /// The coordinator at `url`.
    pub(crate) fn new(url: &str, credentials: Credentials) -> Result<Self> {
        let advice = "give the coordinator as http://HOST:PORT or https://HOST:PORT";
        let base = Url::parse(url).with_context(|| format!("`{url}` is not a URL: {advice}"))?;
        if !matches!(base.scheme(), "http" | "https") || base.host().is_none() {
            bail!("`{url}` cannot be a coordinator: {advice}");
        }
        credentials.warn_if_exposed(&base);
        let builder = || {
            let builder = credentials.trust(reqwest::Client::builder()).no_proxy();
            builder.connect_timeout(CONNECT_TIMEOUT).pool_idle_timeout(IDLE)
        };
        Ok(Self {
            http: builder().read_timeout(READ_TIMEOUT).tls_info(true).build()?,
            uploads: builder().build()?,
            base,
            credentials,
            farm: Arc::default(),
        })
    }

    /// Waits until the coordinator answers, and from then on refuses answers of other farms. Whether it takes the token shows
    /// at the first request that needs one.
    pub(crate) async fn connect(&self) -> Result<Health> {
        let health = self
            .retry(FIRST_PATIENCE, || {
                self.http.request(Method::GET, self.address("healthz"))
            })
            .await;
        let response = health.map_err(|error| {
            let base = &self.base;
            let what = match error.is::<Problem>() {
                true => format!("the farm at {base} is not ready"),
                false => format!("no coordinator answers at {base}; is `photonfarm serve` running there?"),
            };
            error.context(what)
        })?;
        let advice = "something answers there, but not a Photonfarm coordinator";
        let health: Health = response
            .json()
            .await
            .with_context(|| format!("{}: {advice}", self.base))?;
        if !health.farm.farm.is_empty() {
            self.farm.get_or_init(|| health.farm.farm.clone());
        }
        Ok(health)
    }

    /// Looks at the coordinator: what it says of itself, its clock and its certificate.
    pub(crate) async fn look(&self) -> Result<Sighting> {
        self.connect().await?;
        let started = Instant::now();
        let request = || self.http.request(Method::GET, self.address("healthz"));
        let response = self.retry(FIRST_PATIENCE, request).await?;
        let took = started.elapsed();
        let date = response.headers().get(DATE).and_then(|value| value.to_str().ok());
        let server_time = date.and_then(http_time);
        let tls = response.extensions().get::<TlsInfo>();
        let certificate = tls.and_then(TlsInfo::peer_certificate).map(<[u8]>::to_vec);
        Ok(Sighting {
            took,
            server_time,
            local_time: SystemTime::now(),
            certificate,
            health: response.json().await?,
        })
    }

    /// Who the farm takes the bearer of the token for.
    pub(crate) async fn session(&self) -> Result<Session> {
        let request = || self.request(Method::GET, "session");
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// What happened to a job.
    pub(crate) async fn job_log(&self, job: JobId) -> Result<JobLog> {
        let path = format!("jobs/{job}/log");
        let request = || self.request(Method::GET, &path);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// Announces a bundle; the answer says what is missing.
    pub(crate) async fn announce(&self, manifest: &BundleManifest) -> Result<BundleReply> {
        let body = serde_json::to_vec(manifest)?.into();
        let request = || {
            self.request(Method::POST, "bundles")
                .header(CONTENT_TYPE, "application/json")
        };
        let answer = self.transfer(request, &body, |_| {}).await?;
        let answer: Vec<Bytes> = transfer::pieces(answer, SILENCE).try_collect().await?;
        Ok(serde_json::from_slice(&answer.concat())?)
    }

    /// Sends a file of a bundle, however long that takes; `told` is told of how many bytes have moved so far.
    pub(crate) async fn upload(&self, hash: BlobHash, bytes: &Bytes, told: impl Fn(u64)) -> Result<()> {
        if bytes.len() >= RESUMED {
            match self.append(hash, bytes, &told).await {
                // It cannot be sent in parts there, or what was kept of it is of no use.
                Err(error) if is_for_whole_files(&error) => {}
                sent => return sent,
            }
        }
        let path = format!("blobs/{hash}");
        self.transfer(|| self.request(Method::PUT, &path), bytes, told).await?;
        Ok(())
    }

    /// Sends a file from where the farm has it, again and again. Patience begins anew with each byte that had not moved before.
    async fn append(&self, hash: BlobHash, bytes: &Bytes, told: impl Fn(u64)) -> Result<()> {
        let path = format!("blobs/{hash}/upload");
        let (started, furthest) = (Cell::new(Instant::now()), Cell::new(0));
        let send = async || {
            let kept = self.request(Method::GET, &path).send().await?;
            if !kept.status().is_success() || check_farm(kept.headers(), self.farm.get()).is_err() {
                return Ok(kept);
            }
            let kept: UploadState = kept.json().await?;
            let offset = kept.offset.min(bytes.len() as u64);
            let request = self.request(Method::PATCH, &path).header(UPLOAD_OFFSET, offset);
            let moved = |moved| {
                if offset + moved > furthest.get() {
                    furthest.set(offset + moved);
                    started.set(Instant::now());
                }
                told(offset + moved);
            };
            let rest = bytes.slice(offset as usize..);
            transfer::send(&self.uploads, request.build()?, rest, SILENCE, moved).await
        };
        self.repeat_since(PATIENCE, &started, send).await.map(drop)
    }

    /// Sends a long body.
    async fn transfer(
        &self,
        request: impl Fn() -> RequestBuilder,
        body: &Bytes,
        told: impl Fn(u64),
    ) -> Result<Response> {
        let send = async || {
            let request = request().build()?;
            transfer::send(&self.uploads, request, body.clone(), SILENCE, &told).await
        };
        self.repeat(PATIENCE, send).await
    }

    /// Creates a job. The key makes repetition harmless: a job is created once.
    pub(crate) async fn submit(&self, spec: &JobSpec, key: &str) -> Result<JobStatus> {
        let request = || {
            self.request(Method::POST, "jobs")
                .header(IDEMPOTENCY_KEY, key)
                .json(spec)
        };
        Ok(self.retry(PATIENCE, request).await?.json().await?)
    }

    /// A job's status.
    pub(crate) async fn status(&self, job: JobId) -> Result<JobStatus> {
        let path = format!("jobs/{job}");
        let request = || self.request(Method::GET, &path);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// The newest of the jobs that the farm finds by a query, newest first.
    pub(crate) async fn jobs(&self, limit: usize, query: &[(&str, &str)]) -> Result<Vec<JobStatus>> {
        let (mut found, mut cursor) = (Vec::new(), None);
        while found.len() < limit {
            let count = (limit - found.len()).min(PAGE).to_string();
            let page = [("limit", Some(count)), ("cursor", cursor.take())];
            let request = || self.request(Method::GET, "jobs").query(query).query(&page);
            let page: JobPage = self.retry(FIRST_PATIENCE, request).await?.json().await?;
            found.extend(page.jobs);
            cursor = page.next;
            if cursor.is_none() {
                break;
            }
        }
        Ok(found)
    }

    /// Steers a job; repetition is harmless.
    pub(crate) async fn post_job<T: Serialize>(&self, job: JobId, action: &str, body: &T) -> Result<JobStatus> {
        let path = format!("jobs/{job}/{action}");
        let request = || self.request(Method::POST, &path).json(body);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// Deletes a job. One that is gone when it is asked again was deleted: the answer was lost.
    pub(crate) async fn delete_job(&self, job: JobId) -> Result<()> {
        let path = format!("jobs/{job}");
        let asked = Cell::new(0);
        let request = || {
            asked.set(asked.get() + 1);
            self.request(Method::DELETE, &path)
        };
        match self.retry(FIRST_PATIENCE, request).await {
            Err(error) if asked.get() > 1 && is_gone(&error) => Ok(()),
            answer => answer.map(drop),
        }
    }

    /// Sets the priority of a job.
    pub(crate) async fn set_priority(&self, job: JobId, priority: &SetPriority) -> Result<JobStatus> {
        let path = format!("jobs/{job}/priority");
        let request = || self.request(Method::PUT, &path).json(priority);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// The workers of the farm.
    pub(crate) async fn workers(&self) -> Result<Vec<WorkerStatus>> {
        let request = || self.request(Method::GET, "workers");
        let list: WorkerList = self.retry(FIRST_PATIENCE, request).await?.json().await?;
        Ok(list.workers)
    }

    /// The farm in figures.
    pub(crate) async fn figures(&self) -> Result<FarmFigures> {
        let request = || self.request(Method::GET, "farm");
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// Puts a worker into quarantine or lets it out; repetition is harmless.
    pub(crate) async fn post_worker<T: Serialize>(&self, id: WorkerId, action: &str, body: &T) -> Result<WorkerStatus> {
        let path = format!("workers/{id}/{action}");
        let request = || self.request(Method::POST, &path).json(body);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// Makes a token.
    pub(crate) async fn create_token(&self, token: &TokenRequest) -> Result<NewToken> {
        let request = || self.request(Method::POST, "tokens").json(token);
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// The tokens of the farm.
    pub(crate) async fn tokens(&self) -> Result<TokenList> {
        let request = || self.request(Method::GET, "tokens");
        Ok(self.retry(FIRST_PATIENCE, request).await?.json().await?)
    }

    /// Revokes a token.
    pub(crate) async fn revoke_token(&self, name: &str) -> Result<()> {
        let path = format!("tokens/{name}");
        self.retry(FIRST_PATIENCE, || self.request(Method::DELETE, &path))
            .await?;
        Ok(())
    }

    /// The noise of a job's picture as it stands, which its first bytes say; nothing where it does not know.
    pub(crate) async fn noise(&self, job: JobId) -> Result<Option<f64>> {
        let path = format!("jobs/{job}/image.exr");
        let response = self.retry(FIRST_PATIENCE, || self.request(Method::GET, &path)).await?;
        let (mut head, mut pieces) = (Vec::new(), response.bytes_stream());
        while let Some(piece) = pieces.next().await {
            head.extend_from_slice(&piece?);
            if let Ok(metadata) = picture::read_metadata(&head) {
                return Ok(metadata.and_then(|metadata| metadata.noise));
            }
            if head.len() > HEAD_BYTES {
                break;
            }
        }
        Ok(None)
    }

    /// Follows a job to its end, however often the connection breaks, and tells `watch` of each status, which may
    /// refuse it.
    pub(crate) async fn follow(
        &self,
        job: JobId,
        mut watch: impl FnMut(&JobStatus) -> Result<()>,
    ) -> Result<JobStatus> {
        let path = format!("jobs/{job}/events");
        loop {
            let response = self.retry(PATIENCE, || self.request(Method::GET, &path)).await?;
            let mut events = Events::of(response);
            while let Some((name, data)) = events.next().await? {
                if name != EVENT_STATUS && name != EVENT_END {
                    continue;
                }
                let status: JobStatus = serde_json::from_str(&data).context("cannot read the job's status")?;
                watch(&status)?;
                if status.state.ended() {
                    return Ok(status);
                }
            }
            sleep(FIRST_PAUSE).await;
        }
    }

    /// Digits of the farm, or where it is, if it has not said them.
    pub(crate) fn farm_or_address(&self) -> &str {
        self.farm.get().map_or(self.base.as_str(), String::as_str)
    }

    /// A request to the coordinator, with the token.
    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.credentials.sign(self.http.request(method, self.address(path)))
    }

    fn address(&self, path: &str) -> String {
        let base = self.base.as_str().trim_end_matches('/');
        format!("{base}/v1/{path}")
    }

    /// Sends a short request again and again, until it is answered or refused.
    pub(crate) async fn retry(&self, patience: Duration, request: impl Fn() -> RequestBuilder) -> Result<Response> {
        self.repeat(patience, async || Ok(request().send().await?)).await
    }

    /// Sends a request again and again, with growing pauses, until it is answered or refused.
    async fn repeat(
        &self,
        patience: Duration,
        send: impl AsyncFn() -> Result<Response, TransferError>,
    ) -> Result<Response> {
        self.repeat_since(patience, &Cell::new(Instant::now()), send).await
    }

    /// As [`repeat`](Self::repeat); patience begins whenever `started` is set.
    async fn repeat_since(
        &self,
        patience: Duration,
        started: &Cell<Instant>,
        send: impl AsyncFn() -> Result<Response, TransferError>,
    ) -> Result<Response> {
        let mut pause = FIRST_PAUSE;
        let mut told = false;
        loop {
            match judge(send().await, self.farm.get()).await {
                Ok(response) => return Ok(response),
                Err(Failure::Refused(error)) => return Err(error),
                Err(Failure::Away(error)) if started.get().elapsed() + pause > patience => {
                    return Err(match error.is::<Problem>() {
                        true => error,
                        false => Unreachable(format!("{error:#}")).into(),
                    });
                }
                Err(Failure::Away(error)) if patience > FIRST_PATIENCE && !told && started.get().elapsed() > QUIET => {
                    let minutes = patience.as_secs() / 60;
                    tell(format_args!("trying again for {minutes} minutes: {error:#}"));
                    told = true;
                }
                Err(Failure::Away(error)) => tracing::debug!("the coordinator is away: {error:#}"),
            }
            sleep(pause).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }
}

/// A time of HTTP, such as `Sun, 06 Nov 1994 08:49:37 GMT` (RFC 9110, section 5.6.7).
fn http_time(text: &str) -> Option<SystemTime> {
    let time = chrono::DateTime::parse_from_rfc2822(text).ok()?;
    Some(UNIX_EPOCH + Duration::from_secs(time.timestamp().try_into().ok()?))
}

/// Whether a file that cannot be sent in parts may be sent as a whole.
fn is_for_whole_files(error: &anyhow::Error) -> bool {
    let codes = [
        ErrorCode::NotFound,
        ErrorCode::MethodNotAllowed,
        ErrorCode::Limit,
        ErrorCode::ContentMismatch,
    ];
    let problem = error.downcast_ref::<Problem>();
    problem.is_some_and(|problem| codes.contains(&problem.code))
}

fn is_gone(error: &anyhow::Error) -> bool {
    let problem = error.downcast_ref::<Problem>();
    problem.is_some_and(|problem| problem.code == ErrorCode::NotFound)
}

/// Whether an answer is one, or there may be one later; `farm` is to give it, where that is known.
async fn judge(answer: Result<Response, TransferError>, farm: Option<&String>) -> Result<Response, Failure> {
    let response = answer.map_err(|error| {
        let reason = anyhow!("{}", explain(&error));
        let builder = matches!(&error, TransferError::Http(http) if http.is_builder());
        match builder || is_lasting(&error) {
            true => Failure::Refused(reason),
            false => Failure::Away(reason),
        }
    })?;
    check_farm(response.headers(), farm).map_err(Failure::Refused)?;
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let text = response.text().await.map_err(|error| Failure::Away(error.into()))?;
    let busy = [
        StatusCode::BAD_GATEWAY,
        StatusCode::SERVICE_UNAVAILABLE,
        StatusCode::GATEWAY_TIMEOUT,
    ];
    match serde_json::from_str::<Problem>(&text) {
        // Somebody else went on with the upload: the next request goes on from there.
        Ok(problem) if problem.retryable || problem.code == ErrorCode::OffsetMismatch => {
            Err(Failure::Away(problem.into()))
        }
        Ok(problem) => Err(Failure::Refused(problem.into())),
        Err(_) if busy.contains(&status) => Err(Failure::Away(anyhow!("answered {status}"))),
        Err(_) if status == StatusCode::PAYLOAD_TOO_LARGE => Err(Failure::Refused(anyhow!(
            "something between here and the coordinator refuses bodies of this size ({status}): raise its limit (of nginx: \
             client_max_body_size)"
        ))),
        Err(_) => Err(Failure::Refused(anyhow!(
            "answered {status}: is this a Photonfarm coordinator?"
        ))),
    }
}

/// Refuses answers of a farm that is not the expected one.
fn check_farm(headers: &HeaderMap, expected: Option<&String>) -> Result<()> {
    let found = headers.get(FARM).and_then(|value| value.to_str().ok());
    match (found, expected) {
        (Some(found), Some(expected)) if found != expected => bail!(other_farm(found, expected)),
        _ => Ok(()),
    }
}

/// What is to be said where another farm answers than the one that was asked first.
pub(crate) fn other_farm(found: &str, expected: &str) -> String {
    format!(
        "another farm answers there ({found}) than the one that has the job ({expected}): give the address of that one as \
         --coordinator, or submit again to this one"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use reqwest::header::HeaderName;

    #[test]
    fn times_of_answers_are_read() {
        let time = http_time("Sun, 06 Nov 1994 08:49:37 GMT").unwrap();
        assert_eq!(time.duration_since(UNIX_EPOCH).unwrap().as_secs(), 784_111_777);
        assert_eq!(http_time("yesterday"), None);
    }

    #[test]
    fn answers_of_another_farm_are_refused() {
        let headers = |farm: &str| HeaderMap::from_iter([(HeaderName::from_static(FARM), farm.parse().unwrap())]);
        let (nobody, farm) = (HeaderMap::new(), "a".to_owned());
        check_farm(&headers("b"), None).unwrap();
        check_farm(&nobody, Some(&farm)).unwrap();
        check_farm(&headers("a"), Some(&farm)).unwrap();
        let error = check_farm(&headers("b"), Some(&farm)).unwrap_err().to_string();
        assert!(error.contains("another farm answers there (b)"), "{error}");
    }

    #[test]
    fn addresses_that_cannot_be_are_refused_with_advice() {
        for url in ["", "localhost:1", "ftp://farm", "127.0.0.1:80", "http://"] {
            let message = format!("{:#}", Client::new(url, Credentials::default()).unwrap_err());
            assert!(message.contains("http://HOST:PORT"), "{url}: {message}");
        }
    }
}
