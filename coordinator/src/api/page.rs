//! The page for people, at `/`. It is made of plain files that are part of the program.

use super::ApiError;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::problem::{ErrorCode, Problem};

/// A file by its name, media type and content.
macro_rules! file {
    ($name:literal, $media_type:literal) => {
        ($name, $media_type, include_str!(concat!("../page/", $name)))
    };
}

/// The media type of pages.
pub(super) const HTML: &str = "text/html; charset=utf-8";

const FILES: [(&str, &str, &str); 25] = [
    file!("index.html", "text/html; charset=utf-8"),
    file!("main.js", "text/javascript; charset=utf-8"),
    file!("farm.js", "text/javascript; charset=utf-8"),
    file!("jobs.js", "text/javascript; charset=utf-8"),
    file!("job.js", "text/javascript; charset=utf-8"),
    file!("workers.js", "text/javascript; charset=utf-8"),
    file!("words.js", "text/javascript; charset=utf-8"),
    file!("pages.js", "text/javascript; charset=utf-8"),
    file!("layers.js", "text/javascript; charset=utf-8"),
    file!("lamps.js", "text/javascript; charset=utf-8"),
    file!("raw.js", "text/javascript; charset=utf-8"),
    file!("tone.js", "text/javascript; charset=utf-8"),
    file!("viewer.js", "text/javascript; charset=utf-8"),
    file!("compare.js", "text/javascript; charset=utf-8"),
    file!("plots.js", "text/javascript; charset=utf-8"),
    file!("timeline.js", "text/javascript; charset=utf-8"),
    file!("history.js", "text/javascript; charset=utf-8"),
    file!("commands.js", "text/javascript; charset=utf-8"),
    file!("overview.js", "text/javascript; charset=utf-8"),
    file!("drop.js", "text/javascript; charset=utf-8"),
    file!("check.js", "text/javascript; charset=utf-8"),
    file!("archive.js", "text/javascript; charset=utf-8"),
    file!("blake3.js", "text/javascript; charset=utf-8"),
    file!("style.css", "text/css; charset=utf-8"),
    file!("icon.svg", "image/svg+xml"),
];

/// What browsers keep to: nothing from elsewhere, no script but the files', in no frame of another page.
pub(super) const RULES: [(HeaderName, HeaderValue); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        HeaderValue::from_static(
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
             form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
        ),
    ),
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
];

/// The page itself.
pub(super) async fn index(headers: HeaderMap) -> Response {
    let (_, media_type, content) = FILES[0];
    answer(media_type, content, &headers)
}

/// What the page consists of besides.
pub(super) async fn file(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, ApiError> {
    let found = FILES[1..].iter().find(|(known, ..)| *known == name);
    let (_, media_type, content) =
        found.ok_or_else(|| Problem::new(ErrorCode::NotFound, "the page has no such file"))?;
    Ok(answer(media_type, content, &headers))
}

fn answer(media_type: &'static str, content: &'static str, headers: &HeaderMap) -> Response {
    let etag = format!("\"{}\"", &BlobHash::of(content.as_bytes()).to_string()[..16]);
    let known = headers
        .get(header::IF_NONE_MATCH)
        .is_some_and(|known| known.as_bytes() == etag.as_bytes());
    let head = (RULES, [(header::ETAG, etag)]);
    match known {
        true => (StatusCode::NOT_MODIFIED, head).into_response(),
        false => (head, [(header::CONTENT_TYPE, media_type)], content).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Files name each other, and nothing that is not there or lies elsewhere.
    #[test]
    fn the_page_is_whole_and_needs_nothing_else() {
        let names: Vec<&str> = FILES.iter().map(|(name, ..)| *name).collect();
        let mut named = 0;
        for (file, _, content) in FILES {
            for part in content.split(['"', '\'']) {
                let other = part.strip_prefix("./").or_else(|| part.strip_prefix("page/"));
                if let Some(other) = other {
                    assert!(names.contains(&other), "{file} names {other}");
                    named += 1;
                }
            }
            let outside = content.replace("http://www.w3.org/2000/svg", "");
            assert!(!outside.contains("http://") && !outside.contains("https://"), "{file}");
            assert!(
                !content.contains("innerHTML") && !content.contains("style=\""),
                "{file}"
            );
        }
        assert!(named > 10, "{named}");
    }
}
