//! What web pages may not do to a farm without tokens.
//!
//! Such a farm is open to programs of its machine. A browser on it is one as well, and does what the pages of strangers
//! tell it: it sends requests to 127.0.0.1, or to a name of theirs that they have let point there (DNS rebinding).
//! Browsers say so: by `Host` which name they were told, by `Origin` and `Sec-Fetch-Site` whose page it was.

use axum::http::{HeaderMap, HeaderName, Method, header};
use photonfarm_proto::problem::{ErrorCode, Problem};
use std::net::IpAddr;

/// What pages may send anywhere without being asked whether that is welcome (Fetch standard, "CORS-safelisted").
const FORMS: [&str; 3] = ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"];

/// Refuses a request that a page of somebody else may have made.
pub(super) fn check(method: &Method, headers: &HeaderMap) -> Result<(), Problem> {
    let read = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or("?"));
    let advice = "make a token with `photonfarm token create`";
    let host = read(header::HOST).unwrap_or_default();
    if headers.contains_key(header::HOST) && !names_this_machine(host) {
        let detail = format!("a farm without tokens answers to 127.0.0.1 and localhost, not to {host:?}: {advice}");
        return Err(Problem::new(ErrorCode::Forbidden, detail));
    }
    let own = |origin: &str| {
        origin
            .split_once("://")
            .is_some_and(|(_, rest)| rest.eq_ignore_ascii_case(host))
    };
    if let Some(origin) = read(header::ORIGIN).filter(|origin| !own(origin)) {
        let detail = format!("a farm without tokens takes nothing from web pages, such as {origin}: {advice}");
        return Err(Problem::new(ErrorCode::Forbidden, detail));
    }
    if method.is_safe() {
        return Ok(());
    }
    let site = read(HeaderName::from_static("sec-fetch-site"));
    if let Some(site) = site.filter(|site| !matches!(*site, "same-origin" | "none")) {
        let detail = format!("a farm without tokens takes nothing from web pages ({site}): {advice}");
        return Err(Problem::new(ErrorCode::Forbidden, detail));
    }
    let media = read(header::CONTENT_TYPE).unwrap_or_default();
    let essence = media.split(';').next().unwrap_or_default().trim();
    match FORMS.iter().any(|form| form.eq_ignore_ascii_case(essence)) {
        true => Err(Problem::new(
            ErrorCode::UnsupportedMediaType,
            format!(
                "a farm without tokens takes no {essence}, which web pages can send: leave the type out, or {advice}"
            ),
        )),
        false => Ok(()),
    }
}

/// Whether a `Host` header, which may end in a port, can only mean this machine.
fn names_this_machine(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => host,
    };
    let name = name.to_ascii_lowercase();
    let bare = name
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'))
        .unwrap_or(&name);
    let loopback = bare
        .parse()
        .is_ok_and(|address: IpAddr| address.to_canonical().is_loopback());
    loopback || name == "localhost" || name.ends_with(".localhost")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(method: Method, headers: &[(&'static str, &str)]) -> Option<ErrorCode> {
        let pairs = headers.iter().map(|(name, value)| {
            let name: HeaderName = name.parse().unwrap();
            (name, value.parse().unwrap())
        });
        check(&method, &pairs.collect()).err().map(|problem| problem.code)
    }

    #[test]
    fn only_names_of_this_machine_are_answered_to() {
        for host in [
            "127.0.0.1:7800",
            "127.8.8.8",
            "localhost:1",
            "LOCALHOST",
            "[::1]:7800",
            "[::ffff:127.0.0.1]",
        ] {
            assert_eq!(code(Method::GET, &[("host", host)]), None, "{host}");
        }
        let forbidden = Some(ErrorCode::Forbidden);
        for host in [
            "evil.example:7800",
            "10.0.0.1",
            "127.0.0.1.evil.example",
            "localhost.evil.example",
            "x",
            "",
            "[::2]:1",
        ] {
            assert_eq!(code(Method::GET, &[("host", host)]), forbidden, "{host}");
        }
    }

    #[test]
    fn pages_of_others_change_nothing() {
        let host = ("host", "127.0.0.1:7800");
        let post = |name, value| code(Method::POST, &[host, (name, value)]);
        let forbidden = Some(ErrorCode::Forbidden);
        assert_eq!(post("accept", "*/*"), None);
        assert_eq!(post("origin", "http://127.0.0.1:7800"), None);
        for origin in [
            "http://evil.example",
            "null",
            "http://127.0.0.1:80",
            "http://localhost:7800",
            "",
        ] {
            assert_eq!(post("origin", origin), forbidden, "{origin}");
            assert_eq!(code(Method::GET, &[host, ("origin", origin)]), forbidden, "{origin}");
        }
        for (site, expected) in [
            ("cross-site", forbidden),
            ("same-site", forbidden),
            ("same-origin", None),
            ("none", None),
        ] {
            assert_eq!(post("sec-fetch-site", site), expected, "{site}");
        }
        assert_eq!(
            code(Method::GET, &[host, ("sec-fetch-site", "cross-site")]),
            None,
            "a link"
        );
        for form in [
            "text/plain",
            "Text/Plain; charset=utf-8",
            "application/x-www-form-urlencoded",
            "multipart/form-data",
        ] {
            assert_eq!(
                post("content-type", form),
                Some(ErrorCode::UnsupportedMediaType),
                "{form}"
            );
        }
        assert_eq!(post("content-type", "application/json"), None);
    }
}
