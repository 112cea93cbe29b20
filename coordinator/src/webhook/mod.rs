//! URLs that are told when jobs end: which may be named, and how they are reached.

mod address;
mod send;

use crate::scheduler::record::Millis;
use address::PublicAddresses;
use photonfarm_proto::problem::{ErrorCode, Problem};
use reqwest::{Client, Url};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Longest URL [bytes].
const URL_BYTES: usize = 2000;
/// Shortest secret [bytes].
const SECRET_BYTES: usize = 16;
/// Longest time of a delivery, from the search for the address to the head of the answer.
const ANSWER: Duration = Duration::from_secs(10);
/// Longest wait for a connection.
const CONNECT: Duration = Duration::from_secs(5);

/// What deliveries are signed with. It is never shown.
#[derive(Clone, PartialEq, Eq)]
pub struct WebhookSecret(Arc<[u8]>);

impl WebhookSecret {
    /// A secret of these bytes, without white space around them.
    ///
    /// # Errors
    /// It is too short to be one.
    pub fn new(bytes: &[u8]) -> Result<Self, WebhookError> {
        let bytes = bytes.trim_ascii();
        match bytes.len() >= SECRET_BYTES {
            true => Ok(Self(bytes.into())),
            false => Err(WebhookError::ShortSecret),
        }
    }
}

impl fmt::Debug for WebhookSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WebhookSecret")
    }
}

/// When deliveries that fail are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retries {
    /// Pause after the first failure; each further one doubles it.
    pub first: Duration,
    /// Longest pause.
    pub longest: Duration,
    /// Time since the job ended after which a delivery is given up.
    pub within: Duration,
}

impl Default for Retries {
    fn default() -> Self {
        Self {
            first: Duration::from_secs(5),
            longest: Duration::from_secs(3600),
            within: Duration::from_secs(24 * 3600),
        }
    }
}

impl Retries {
    /// How long to wait after so many failures: up to half of the pause is left out at random, so that what failed together does not
    /// come back together.
    pub(crate) fn pause_ms(&self, failures: u32) -> Millis {
        let doubled = self.first.saturating_mul(1 << failures.saturating_sub(1).min(20));
        let pause = doubled.min(self.longest).as_millis() as u64;
        // Without random numbers of the system it comes on time.
        pause - getrandom::u64().unwrap_or_default() % (pause / 2 + 1)
    }
}

/// Which URLs a farm tells.
#[derive(Clone, Debug, Default)]
pub struct WebhookConfig {
    /// What deliveries are signed with; without it none are sent.
    pub secret: Option<WebhookSecret>,
    /// URLs that are told of every job. The operator may name any.
    pub urls: Vec<String>,
    /// Whether jobs may name URLs of this machine and of private networks.
    pub private_addresses: bool,
    /// How others reach the farm, for links to jobs; by default where it listens.
    pub public_url: Option<String>,
    /// When deliveries that fail are sent again.
    pub retries: Retries,
}

/// Why a farm cannot tell URLs.
#[derive(Debug, Error)]
pub enum WebhookError {
    /// A secret that can be guessed.
    #[error("the secret of webhooks has fewer than {SECRET_BYTES} bytes: make one with `openssl rand -hex 32`")]
    ShortSecret,
    /// URLs without anything to sign with.
    #[error(
        "webhooks need a secret, so that who is told can tell that it is this farm: give one with --webhook-secret-file"
    )]
    NoSecret,
    /// A URL that cannot be told.
    #[error("webhook {url:?}: {reason}")]
    Url {
        /// The URL.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The client failed.
    #[error("no client for webhooks: {0}")]
    Client(#[from] reqwest::Error),
}

/// The URLs that a farm tells, and the clients that it does so with.
pub(crate) struct Webhooks {
    secret: ring::hmac::Key,
    /// URLs of the farm.
    pub(crate) urls: Vec<String>,
    private_addresses: bool,
    pub(crate) retries: Retries,
    /// What links to jobs begin with.
    pub(crate) farm_url: String,
    /// For URLs that the operator has named.
    anywhere: Client,
    /// For URLs that jobs have named.
    outside: Client,
}

impl Webhooks {
    /// What the configuration says; none where there is no secret. `url` is where the farm listens.
    pub(crate) fn new(config: WebhookConfig, url: &str) -> Result<Option<Self>, WebhookError> {
        let Some(WebhookSecret(secret)) = config.secret else {
            return match config.urls.is_empty() {
                true => Ok(None),
                false => Err(WebhookError::NoSecret),
            };
        };
        for url in &config.urls {
            read(url).map_err(|reason| WebhookError::Url {
                url: url.clone(),
                reason,
            })?;
        }
        // Whoever is told is reached without a proxy, so that the address that is looked at is the one that is used.
        let client = || {
            Client::builder()
                .no_proxy()
                .redirect(reqwest::redirect::Policy::none())
                .pool_max_idle_per_host(0)
                .connect_timeout(CONNECT)
                .timeout(ANSWER)
                .user_agent(concat!("photonfarm/", env!("CARGO_PKG_VERSION")))
        };
        let anywhere = client().build()?;
        let outside = match config.private_addresses {
            true => anywhere.clone(),
            false => client().dns_resolver(Arc::new(PublicAddresses)).build()?,
        };
        let farm_url = config.public_url.as_deref().unwrap_or(url);
        Ok(Some(Self {
            secret: ring::hmac::Key::new(ring::hmac::HMAC_SHA256, &secret),
            urls: config.urls,
            private_addresses: config.private_addresses,
            retries: config.retries,
            farm_url: farm_url.trim_end_matches('/').to_owned(),
            anywhere,
            outside,
        }))
    }

    /// Checks a URL that a job names.
    pub(crate) fn check(&self, url: &str) -> Result<(), Problem> {
        let refused = |reason: String| {
            let detail = format!("webhook: {reason}");
            Problem::new(ErrorCode::Invalid, detail).at("webhook", None)
        };
        let url = read(url).map_err(refused)?;
        match address::literal(&url) {
            Some(address) if !self.private_addresses && !address::is_public(address) => Err(refused(format!(
                "{address} is an address of this machine or of a private network, which jobs on this farm cannot name"
            ))),
            _ => Ok(()),
        }
    }
}

/// Reads a URL, or says what is wrong with it.
fn read(text: &str) -> Result<Url, String> {
    if text.len() > URL_BYTES {
        return Err(format!("a URL has at most {URL_BYTES} bytes, this one {}", text.len()));
    }
    let url: Url = text.parse().map_err(|error| format!("not a URL: {error}"))?;
    if !matches!(url.scheme(), "http" | "https") || url.host_str().is_none_or(str::is_empty) {
        return Err("a URL that is told begins with http:// or https:// and names a host".into());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("a URL that is told has no user and no password in it: deliveries are signed".into());
    }
    Ok(url)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn webhooks(private_addresses: bool) -> Webhooks {
        let config = WebhookConfig {
            secret: Some(WebhookSecret::new(&[7; 16]).unwrap()),
            private_addresses,
            ..WebhookConfig::default()
        };
        Webhooks::new(config, "http://127.0.0.1:1/").unwrap().unwrap()
    }

    #[test]
    fn urls_of_jobs_lie_outside() {
        let (outside, anywhere) = (webhooks(false), webhooks(true));
        for url in [
            "http://127.0.0.1:80/x",
            "http://10.1.2.3/",
            "https://[::1]/",
            "http://[::ffff:192.168.0.1]/",
            "http://169.254.169.254/latest/meta-data",
            // Forms that URLs take for the same: they are read as 127.0.0.1.
            "http://2130706433/",
            "http://0x7f.1/",
            "http://127.1/",
        ] {
            let problem = outside.check(url).expect_err(url);
            assert_eq!(problem.field.as_deref(), Some("webhook"), "{url}");
            assert!(problem.detail.contains("private network"), "{url}: {problem}");
            anywhere.check(url).unwrap();
        }
        for url in [
            "https://example.org/hook?a=b",
            "http://93.184.216.34/",
            "http://[2606:4700::1]:8080/",
        ] {
            outside.check(url).unwrap();
        }
    }

    #[test]
    fn what_is_no_url_is_refused_with_the_reason() {
        let long = format!("http://example.org/{}", "x".repeat(URL_BYTES));
        for (url, reason) in [
            ("", "not a URL"),
            ("example.org", "not a URL"),
            ("ftp://example.org/", "http:// or https://"),
            ("file:///etc/passwd", "http:// or https://"),
            ("http://ann:secret@example.org/", "no user"),
            (&long, "2000 bytes"),
        ] {
            let problem = webhooks(true).check(url).unwrap_err();
            assert!(problem.detail.contains(reason), "{url}: {problem}");
        }
    }

    #[test]
    fn a_farm_that_tells_urls_has_a_secret_that_it_does_not_show() {
        let named = WebhookConfig {
            urls: vec!["http://example.org/".into()],
            ..WebhookConfig::default()
        };
        assert!(matches!(Webhooks::new(named.clone(), ""), Err(WebhookError::NoSecret)));
        assert!(Webhooks::new(WebhookConfig::default(), "").unwrap().is_none());
        assert!(WebhookSecret::new(b"  fifteen letters  \n").is_err());
        let secret = WebhookSecret::new(b"sixteen letters!\n").unwrap();
        let config = WebhookConfig {
            secret: Some(secret),
            urls: vec!["gopher://example.org/".into()],
            ..named
        };
        assert!(!format!("{config:?}").contains("sixteen"));
        assert!(matches!(Webhooks::new(config, ""), Err(WebhookError::Url { .. })));
    }

    #[test]
    fn pauses_double_up_to_the_longest_and_differ() {
        let retries = Retries::default();
        for (failures, most) in [
            (1, 5_000),
            (2, 10_000),
            (5, 80_000),
            (12, 3_600_000),
            (u32::MAX, 3_600_000),
        ] {
            let pauses: Vec<Millis> = (0..50).map(|_| retries.pause_ms(failures)).collect();
            assert!(
                pauses.iter().all(|pause| (most / 2..=most).contains(pause)),
                "{pauses:?}"
            );
            assert!(pauses.iter().any(|pause| *pause != pauses[0]), "{pauses:?}");
        }
    }
}
