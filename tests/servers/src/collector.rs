//! A collector of spans (OTLP over HTTP, in JSON) on the loopback interface.

use axum::Json;
use axum::Router;
use axum::extract::State;
use axum::routing::post;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// A collector that keeps every span, as JSON with the name of its service as `service`. It ends when it is dropped.
#[derive(Debug)]
pub struct Collector {
    address: SocketAddr,
    spans: Arc<watch::Sender<Vec<Value>>>,
    server: JoinHandle<()>,
}

impl Collector {
    /// Starts a collector on a free port, on the current runtime.
    ///
    /// # Panics
    /// Where it cannot be started.
    pub async fn start() -> Self {
        let spans = Arc::new(watch::Sender::default());
        let router = Router::new().route("/v1/traces", post(take)).with_state(spans.clone());
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let server = tokio::spawn(async move { axum::serve(listener, router).await.expect("the collector serves") });
        Self { address, spans, server }
    }

    /// URL for `--otlp`.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Waits until what has arrived satisfies a condition.
    ///
    /// # Panics
    /// Where the collector ends meanwhile.
    pub async fn until(&self, condition: impl Fn(&[Value]) -> bool) -> Vec<Value> {
        let mut arrived = self.spans.subscribe();
        let spans = arrived.wait_for(|spans| condition(spans)).await;
        spans.expect("the collector is there").clone()
    }

    /// What has arrived.
    #[must_use]
    pub fn spans(&self) -> Vec<Value> {
        self.spans.borrow().clone()
    }
}

impl Drop for Collector {
    fn drop(&mut self) {
        self.server.abort();
    }
}

async fn take(State(spans): State<Arc<watch::Sender<Vec<Value>>>>, Json(request): Json<Value>) -> Json<Value> {
    let mut arrived = Vec::new();
    for resource in list(&request["resourceSpans"]) {
        let attributes = list(&resource["resource"]["attributes"]).iter();
        let mut names = attributes.filter(|attribute| attribute["key"] == "service.name");
        let service = names.next().map(|attribute| attribute["value"]["stringValue"].clone());
        for span in list(&resource["scopeSpans"])
            .iter()
            .flat_map(|scope| list(&scope["spans"]))
        {
            let mut span = span.clone();
            span["service"] = service.clone().unwrap_or_default();
            arrived.push(span);
        }
    }
    spans.send_modify(|spans| spans.extend(arrived));
    Json(json!({}))
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}
