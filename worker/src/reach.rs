//! Whether the coordinator can be reached, and why not, in words.

use crate::notices::Notices;
use crate::transfer::TransferError;
use std::error::Error;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Where the documentation tells how a certificate is made.
const RECIPE: &str = "docs/FARM.md, \"A certificate of your own\"";

/// What is known of the way to the coordinator. It is logged when the way breaks, again at ever longer intervals, and
/// when it is whole again.
#[derive(Clone, Debug)]
pub(crate) struct Reach {
    coordinator: Arc<str>,
    absence: Arc<Mutex<Option<Absence>>>,
}

#[derive(Debug)]
struct Absence {
    notices: Notices,
    reason: String,
}

impl Reach {
    /// Nothing is known yet of the way to the coordinator at this URL.
    pub(crate) fn to(coordinator: &str) -> Self {
        Self {
            coordinator: coordinator.into(),
            absence: Arc::default(),
        }
    }

    /// A request had no answer.
    pub(crate) fn broken(&self, error: &TransferError) {
        let now = Instant::now();
        let mut absence = self.absence.lock().unwrap_or_else(PoisonError::into_inner);
        let absence = absence.get_or_insert_with(|| Absence {
            notices: Notices::from(now, Duration::ZERO),
            reason: String::new(),
        });
        absence.reason = explain(error);
        if absence.notices.due(now) {
            let (coordinator, reason) = (&self.coordinator, &absence.reason);
            match absence.notices.seconds(now) {
                0 => tracing::warn!(
                    "cannot reach the coordinator at {coordinator}: {reason}; trying again until it answers"
                ),
                seconds => tracing::warn!("cannot reach the coordinator at {coordinator} for {seconds} s: {reason}"),
            }
        }
    }

    /// A request was answered.
    pub(crate) fn whole(&self) {
        let ended = self.absence.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(absence) = ended {
            let seconds = absence.notices.seconds(Instant::now());
            tracing::info!("the coordinator at {} answers, after {seconds} s", self.coordinator);
        }
    }

    /// Why the coordinator cannot be reached, if it cannot.
    pub(crate) fn reason(&self) -> Option<String> {
        let absence = self.absence.lock().unwrap_or_else(PoisonError::into_inner);
        absence.as_ref().map(|absence| absence.reason.clone())
    }
}

/// Whether there was no connection for a request.
pub(crate) fn is_no_connection(error: &TransferError) -> bool {
    matches!(error, TransferError::Http(error) if error.is_connect())
}

/// Whether a request will have no answer later either, as where a certificate is not trusted.
#[must_use]
pub fn is_lasting(error: &TransferError) -> bool {
    let TransferError::Http(error) = error else {
        return false;
    };
    let texts: Vec<String> = causes(error).iter().map(ToString::to_string).collect();
    encryption(&|text| texts.iter().any(|cause| cause.contains(text))).is_some()
}

/// Why a request had no answer, and what to do about it where that is known.
#[must_use]
pub fn explain(error: &TransferError) -> String {
    match error {
        TransferError::Http(error) => explain_http(error),
        silent @ TransferError::Silent { .. } => silent.to_string(),
    }
}

fn explain_http(error: &reqwest::Error) -> String {
    let causes = causes(error);
    let texts: Vec<String> = causes.iter().map(ToString::to_string).collect();
    let says = |text: &str| texts.iter().any(|cause| cause.contains(text));
    if let Some(advice) = encryption(&says) {
        return advice;
    }
    if says("dns error") || says("failed to lookup address") {
        return format!("its name is unknown: {}", last(&texts));
    }
    let kind = causes
        .iter()
        .find_map(|cause| cause.downcast_ref::<io::Error>().map(io::Error::kind));
    match kind {
        Some(io::ErrorKind::ConnectionRefused) => "the connection was refused: nothing listens there".into(),
        Some(io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionAborted) => {
            "the connection was cut".into()
        }
        Some(io::ErrorKind::HostUnreachable | io::ErrorKind::NetworkUnreachable) => {
            "there is no way to that host".into()
        }
        _ if error.is_timeout() => "it does not answer in time".into(),
        _ if texts.is_empty() => error.to_string(),
        _ => last(&texts),
    }
}

/// What lies behind an error, the innermost last.
fn causes(error: &reqwest::Error) -> Vec<&(dyn Error + 'static)> {
    let mut causes: Vec<&(dyn Error + 'static)> = Vec::new();
    let mut next = error.source();
    while let Some(cause) = next {
        causes.push(cause);
        // What an `io::Error` wraps is not its source, but the source of what it wraps is.
        let wrapped = cause.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        next = match wrapped {
            Some(inner) => Some(inner as &(dyn Error + 'static)),
            None => cause.source(),
        };
    }
    causes
}

fn last(texts: &[String]) -> String {
    texts.last().cloned().unwrap_or_default()
}

/// What goes wrong with encrypted connections, by the words of rustls and hyper.
fn encryption(says: &dyn Fn(&str) -> bool) -> Option<String> {
    let told = |text: &str| Some(format!("{text} ({RECIPE})"));
    if says("CaUsedAsEndEntity") {
        return told(
            "its certificate is that of an authority (`CA:TRUE`, as `openssl req -x509` makes it by itself), which no server \
             may show: make one with `CA:FALSE`",
        );
    }
    if says("UnknownIssuer") {
        return told(
            "its certificate comes from an authority that is not trusted here: give the authority's certificate with --ca",
        );
    }
    if says("certificate not valid for name") || says("NotValidForName") {
        return told("its certificate is for another name than that of the URL");
    }
    if says("certificate expired") || says("Expired") {
        return told("its certificate has expired, or the clock here is wrong");
    }
    if says("invalid peer certificate") {
        return None;
    }
    if says("InvalidContentType") || says("wrong version number") {
        return told("it does not speak TLS there: write http:// instead of https://");
    }
    if says("invalid HTTP version parsed") || says("invalid HTTP status-code parsed") {
        return told("it does not speak plain HTTP there: if it has a certificate, write https:// instead of http://");
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn refused(url: &str) -> String {
        let client = reqwest::Client::builder().no_proxy().build().unwrap();
        explain_http(&client.get(url).send().await.unwrap_err())
    }

    #[tokio::test]
    async fn reasons_are_in_words() {
        let port = std::net::TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port();
        let message = refused(&format!("http://127.0.0.1:{port}")).await;
        assert!(message.contains("refused"), "{message}");
        let message = refused("http://farm.invalid:1").await;
        assert!(message.contains("name is unknown"), "{message}");
    }

    #[tokio::test]
    async fn what_does_not_speak_http_is_named() {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        // A TLS alert, which is what a TLS server answers to a request in clear text.
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                let _ = stream.read(&mut [0; 16]).await;
                let _ = stream.write_all(&[0x15, 3, 3, 0, 2, 2, 50]).await;
            }
        });
        let message = refused(&format!("http://127.0.0.1:{port}")).await;
        assert!(message.contains("https://"), "{message}");
        let message = refused(&format!("https://127.0.0.1:{port}")).await;
        assert!(!message.is_empty(), "{message}");
    }
}
