//! Sends spans to a collector: OTLP over HTTP, in its JSON encoding.
//!
//! The encoding is that of the OpenTelemetry Protocol Specification 1.x, section "OTLP/HTTP": the JSON of Protocol Buffers with
//! numbers of traces and spans in hexadecimal digits. Spans wait in a queue of bounded length; whoever ends a span never waits.

use crate::reach::explain;
use photonfarm_proto::VERSION;
use photonfarm_proto::hex::Hex;
use photonfarm_proto::trace::{Fact, Sink, Span, Tracer};
use reqwest::header::CONTENT_TYPE;
use reqwest::redirect::Policy;
use reqwest::{StatusCode, Url};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Spans that may wait: some four megabytes.
const QUEUE: usize = 8192;
/// Most spans of a request.
const BATCH: usize = 512;
/// How long spans are gathered for a request.
const GATHER: Duration = Duration::from_millis(500);
/// How long a collector may take to answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Wait after a collector could not be reached.
const RETRY: Duration = Duration::from_secs(5);
/// How long the end of the process may be put off by what still waits.
const FAREWELL: Duration = Duration::from_secs(2);

/// Not the address of a collector.
#[derive(Debug, Error)]
#[error("{url:?} is not the address of a collector of OTLP over HTTP, such as http://127.0.0.1:4318{why}")]
pub struct OtlpError {
    url: String,
    why: String,
}

/// Why a collector did not take spans.
enum Failure {
    /// It may later.
    Away(String),
    /// It will not take these.
    Refused(StatusCode),
}

/// Sends spans in the background until it is told to finish, or dropped.
pub struct Exporter {
    tracer: Tracer,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

/// The end of the queue that spans are put into.
struct Queue {
    spans: mpsc::Sender<Span>,
    dropped: Arc<AtomicU64>,
}

impl Sink for Queue {
    fn take(&self, span: Span) {
        if self.spans.try_send(span).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Exporter {
    /// Sends spans of a service to the collector at `url`, to which `/v1/traces` is added; `instance` tells the process from others of the
    /// service. It needs a runtime of tokio.
    ///
    /// # Errors
    /// Something that is no URL.
    pub fn start(url: &str, service: &str, instance: &str) -> Result<Self, OtlpError> {
        let refused = |why: String| OtlpError {
            url: url.to_owned(),
            why,
        };
        let mut place = Url::parse(url).map_err(|error| refused(format!(": {error}")))?;
        if !matches!(place.scheme(), "http" | "https") {
            return Err(refused(String::new()));
        }
        let path = place.path().trim_end_matches('/');
        let path = path.strip_suffix("/v1/traces").unwrap_or(path);
        place.set_path(&format!("{path}/v1/traces"));
        let http = reqwest::Client::builder().timeout(PATIENCE).no_proxy();
        let http = http.redirect(Policy::none()).build();
        let (sender, spans) = mpsc::channel(QUEUE);
        let (dropped, stop) = (Arc::new(AtomicU64::new(0)), CancellationToken::new());
        let courier = Courier {
            http: http.map_err(|error| refused(format!(": {error}")))?,
            resource: json!({"attributes": [
                attribute("service.name", &Fact::Text(service.to_owned())),
                attribute("service.version", &Fact::Text(VERSION.to_owned())),
                attribute("service.instance.id", &Fact::Text(instance.to_owned())),
            ]}),
            shown: place.host_str().unwrap_or_default().to_owned(),
            place,
            dropped: dropped.clone(),
            complained: false,
        };
        let queue = Queue { spans: sender, dropped };
        Ok(Self {
            tracer: Tracer::new(Arc::new(queue)),
            task: tokio::spawn(courier.carry(spans, stop.clone())),
            stop,
        })
    }

    /// Where spans are to be put.
    #[must_use]
    pub fn tracer(&self) -> Tracer {
        self.tracer.clone()
    }

    /// Sends what still waits, if the collector takes it soon.
    pub async fn finish(mut self) {
        self.stop.cancel();
        let _late = tokio::time::timeout(FAREWELL, &mut self.task).await;
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Takes spans from the queue to the collector.
struct Courier {
    http: reqwest::Client,
    place: Url,
    /// The collector's host, for the log: its URL may hold a password.
    shown: String,
    resource: Value,
    dropped: Arc<AtomicU64>,
    /// Whether it was said that the collector takes nothing.
    complained: bool,
}

impl Courier {
    async fn carry(mut self, mut spans: mpsc::Receiver<Span>, stop: CancellationToken) {
        let mut batch = Vec::new();
        while !stop.is_cancelled() {
            tokio::select! {
                _ = spans.recv_many(&mut batch, BATCH) => {}
                () = stop.cancelled() => break,
            }
            wait(GATHER, &stop).await;
            fill(&mut batch, &mut spans);
            while !batch.is_empty() && !stop.is_cancelled() {
                if self.deliver(&mut batch).await.is_err() {
                    wait(RETRY, &stop).await;
                }
            }
        }
        fill(&mut batch, &mut spans);
        while !batch.is_empty() && self.deliver(&mut batch).await.is_ok() {
            fill(&mut batch, &mut spans);
        }
    }

    /// Sends a batch, and empties it unless it is to be sent again.
    async fn deliver(&mut self, batch: &mut Vec<Span>) -> Result<(), ()> {
        let sent = self.send(batch).await;
        match &sent {
            Ok(()) if self.complained => {
                let dropped = self.dropped.swap(0, Ordering::Relaxed);
                tracing::info!(dropped, "the collector at {} takes spans again", self.shown);
                self.complained = false;
            }
            Ok(()) => {}
            Err(failure) => {
                if !std::mem::replace(&mut self.complained, true) {
                    self.complain(failure);
                }
            }
        }
        match sent {
            Err(Failure::Away(_)) => return Err(()),
            Err(Failure::Refused(_)) => _ = self.dropped.fetch_add(batch.len() as u64, Ordering::Relaxed),
            Ok(()) => {}
        }
        batch.clear();
        Ok(())
    }

    fn complain(&self, failure: &Failure) {
        let host = &self.shown;
        match failure {
            Failure::Away(why) => tracing::warn!(
                "spans cannot be sent to the collector at {host}: {why}; up to {QUEUE} are kept, and this is not said again \
                 until it takes some"
            ),
            Failure::Refused(status) => tracing::warn!(
                "the collector at {host} refuses spans with {status}; they are dropped, and this is not said again until it \
                 takes some"
            ),
        }
    }

    async fn send(&self, spans: &[Span]) -> Result<(), Failure> {
        let body = json!({"resourceSpans": [{
            "resource": self.resource,
            "scopeSpans": [{
                "scope": {"name": "photonfarm", "version": VERSION},
                "spans": spans.iter().map(encode).collect::<Vec<_>>(),
            }],
        }]});
        let request = self
            .http
            .post(self.place.clone())
            .header(CONTENT_TYPE, "application/json");
        let answer = request.body(body.to_string()).send().await;
        let status = answer.map_err(|error| Failure::Away(explain(&error.into())))?.status();
        let later =
            status.is_server_error() || matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::REQUEST_TIMEOUT);
        match status {
            _ if status.is_success() => Ok(()),
            _ if later => Err(Failure::Away(format!("it answers {status}"))),
            _ => Err(Failure::Refused(status)),
        }
    }
}

async fn wait(time: Duration, stop: &CancellationToken) {
    let _stopped = tokio::time::timeout(time, stop.cancelled()).await;
}

/// Fills a batch with what waits.
fn fill(batch: &mut Vec<Span>, spans: &mut mpsc::Receiver<Span>) {
    while batch.len() < BATCH
        && let Ok(span) = spans.try_recv()
    {
        batch.push(span);
    }
}

/// A span as JSON. Integers of 64 bits are texts in the JSON of Protocol Buffers.
fn encode(span: &Span) -> Value {
    let attributes = span.facts.iter().map(|(name, fact)| attribute(name, fact));
    let mut value = json!({
        "traceId": Hex(&span.context.trace).to_string(),
        "spanId": Hex(&span.context.span).to_string(),
        "name": span.name,
        "kind": 1,
        "startTimeUnixNano": span.start_ns.to_string(),
        "endTimeUnixNano": span.end_ns.to_string(),
        "attributes": attributes.collect::<Vec<_>>(),
    });
    if let Some(parent) = &span.parent {
        value["parentSpanId"] = Hex(parent).to_string().into();
    }
    if let Some(link) = &span.link {
        value["links"] = json!([{
            "traceId": Hex(&link.trace).to_string(),
            "spanId": Hex(&link.span).to_string(),
        }]);
    }
    if let Some(error) = &span.error {
        value["status"] = json!({"code": 2, "message": error});
    }
    value
}

fn attribute(name: &str, fact: &Fact) -> Value {
    let value = match fact {
        Fact::Text(text) => json!({"stringValue": text}),
        Fact::Count(count) => json!({"intValue": count.to_string()}),
    };
    json!({"key": name, "value": value})
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_proto::id::JobId;
    use photonfarm_proto::trace::Context;

    #[test]
    fn a_span_has_the_fields_that_the_protocol_names() {
        let context = Context {
            trace: [0x5b; 16],
            span: [0xee; 8],
        };
        let span = Span {
            context,
            parent: Some([1; 8]),
            link: Some(context),
            name: "lease",
            start_ns: 1_544_712_660_000_000_000,
            end_ns: u64::MAX,
            facts: vec![("attempt", 2.into()), ("worker.name", "a".to_owned().into())],
            error: Some("lost".into()),
        };
        let expected = json!({
            "traceId": "5b".repeat(16), "spanId": "ee".repeat(8), "parentSpanId": "01".repeat(8),
            "name": "lease", "kind": 1,
            "startTimeUnixNano": "1544712660000000000", "endTimeUnixNano": "18446744073709551615",
            "attributes": [
                {"key": "attempt", "value": {"intValue": "2"}},
                {"key": "worker.name", "value": {"stringValue": "a"}},
            ],
            "links": [{"traceId": "5b".repeat(16), "spanId": "ee".repeat(8)}],
            "status": {"code": 2, "message": "lost"},
        });
        assert_eq!(encode(&span), expected);
    }

    #[test]
    fn what_finds_no_room_is_dropped_and_counted_and_nobody_waits() {
        let (spans, mut waiting) = mpsc::channel(3);
        let dropped = Arc::new(AtomicU64::new(0));
        let tracer = Tracer::new(Arc::new(Queue {
            spans,
            dropped: dropped.clone(),
        }));
        for _ in 0..5 {
            drop(tracer.begin(Context::of_job("farm", JobId(1)), "iteration"));
        }
        let mut batch = Vec::new();
        fill(&mut batch, &mut waiting);
        assert_eq!((batch.len(), dropped.load(Ordering::Relaxed)), (3, 2));
    }

    #[tokio::test]
    async fn what_is_no_address_is_refused_by_name() {
        for url in ["", "collector:4318", "grpc://collector:4317", "http://"] {
            let error = Exporter::start(url, "test", "1").map(drop).unwrap_err().to_string();
            assert!(error.contains(&format!("{url:?} is not the address")), "{error}");
        }
    }
}
