//! Sends deliveries: signed, without following redirects, and without reading what is answered.

use super::{Webhooks, address};
use crate::scheduler::record::{Millis, Notice};
use photonfarm_proto::hex::Hex;
use photonfarm_proto::webhook::{DELIVERY, SIGNATURE, TIMESTAMP};
use photonfarm_proto::worker::cut_text;
use reqwest::Url;
use reqwest::header::CONTENT_TYPE;
use ring::hmac;
use std::error::Error;

impl Webhooks {
    /// Sends a notice. The error says, for people, why it has not arrived.
    pub(crate) async fn send(&self, notice: &Notice, now: Millis) -> Result<(), String> {
        let url: Url = notice.url.parse().map_err(|error| format!("not a URL: {error}"))?;
        let anywhere = notice.trusted || self.private_addresses;
        // A client looks up hosts alone.
        if let Some(address) = address::literal(&url).filter(|address| !anywhere && !address::is_public(*address)) {
            return Err(format!("{address} is no address of the public network"));
        }
        let client = if anywhere { &self.anywhere } else { &self.outside };
        let timestamp = (now / 1000).to_string();
        let request = client
            .post(url)
            .header(CONTENT_TYPE, "application/json")
            .header(DELIVERY, &notice.id)
            .header(SIGNATURE, sign(&self.secret, &timestamp, &notice.body))
            .header(TIMESTAMP, timestamp)
            .body(notice.body.clone());
        match request.send().await {
            Ok(answer) if answer.status().is_success() => Ok(()),
            Ok(answer) => Err(format!("it was answered with {}", answer.status())),
            Err(error) => Err(cut_text(in_words(&error.without_url()))),
        }
    }
}

/// The signature of a body that is sent at a time.
fn sign(secret: &hmac::Key, timestamp: &str, body: &str) -> String {
    let mut context = hmac::Context::with_key(secret);
    for part in [timestamp, ".", body] {
        context.update(part.as_bytes());
    }
    format!("sha256={}", Hex(context.sign().as_ref()))
}

/// An error with what caused it.
fn in_words(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text += &format!(": {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computed by Python's `hmac`.
    #[test]
    fn signatures_are_those_of_the_standard() {
        let key = hmac::Key::new(hmac::HMAC_SHA256, b"sixteen letters!");
        let digits = "cd4af26de2e91baf197c9862a743aac84d0e3a5994df52489443bfcdf2841dc9";
        let signed = sign(&key, "1700000000", "{\"job\":7}");
        assert_eq!(signed, format!("sha256={digits}"));
    }
}
