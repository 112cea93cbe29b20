//! A name for each request: it is in the answer, in the problem if the answer is one, and in every line of the log about it.

use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::Response;
use tracing::Instrument;

/// The header that carries the name: of the request if its sender, or a proxy before the farm, has given one; of the answer always.
const HEADER: HeaderName = HeaderName::from_static("x-request-id");

/// The longest name that is taken over from a sender [bytes].
const LONGEST: usize = 64;

tokio::task_local! {
    static NAME: String;
}

/// Names a request.
pub(super) async fn name(request: Request, next: Next) -> Response {
    let given = request.headers().get(HEADER).and_then(|given| given.to_str().ok());
    let name = match given.filter(|given| is_plain(given)) {
        Some(given) => given.to_owned(),
        None => fresh(),
    };
    let span = tracing::info_span!("request", id = name);
    let value = HeaderValue::try_from(&name);
    let mut response = NAME.scope(name, next.run(request)).instrument(span).await;
    if let Ok(value) = value {
        response.headers_mut().insert(HEADER, value);
    }
    response
}

/// The name of the request that is being answered.
pub(super) fn current() -> Option<String> {
    NAME.try_with(Clone::clone).ok()
}

/// Whether a name may stand in the log: letters, digits and what is usual between them.
fn is_plain(name: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.:/+=".contains(&byte);
    (1..=LONGEST).contains(&name.len()) && name.bytes().all(plain)
}

/// 16 random digits.
fn fresh() -> String {
    // Without random numbers of the system a request goes on under a name that others have too.
    format!("{:016x}", getrandom::u64().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_forge_lines_of_the_log() {
        assert!(is_plain("0af7651916cd43dd8448eb211c80319c") && is_plain("proxy-1:42"));
        for name in ["", "a b", "a\nb", "a\u{1b}[31m", "ä", &"x".repeat(LONGEST + 1)] {
            assert!(!is_plain(name), "{name:?}");
        }
        assert_ne!(fresh(), fresh());
    }
}
