//! Signing in from a browser: a token in a cookie that scripts cannot read.
//!
//! A browser sends the cookie along with whatever the pages of strangers have it send. `SameSite=Strict` keeps it from that, and what a
//! browser says of a request is looked at besides.

use super::guard::By;
use super::{ApiError, App};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use photonfarm_proto::api::Session;
use photonfarm_proto::problem::{ErrorCode, Problem};

/// Name of the cookie.
const COOKIE: &str = "photonfarm-token";

/// Who the farm takes you for.
#[utoipa::path(
    get, path = "/v1/session", operation_id = "get_session",
    responses((status = 200, body = Session), (status = "4XX", body = Problem))
)]
pub(super) async fn show(State(_): State<App>, By(caller): By) -> Json<Session> {
    Json(Session {
        name: caller.name,
        role: caller.role,
    })
}

/// Has a browser keep the token of this request, as a cookie that no script can read. Requests without a token of their own then have it.
#[utoipa::path(
    post, path = "/v1/session", operation_id = "create_session",
    responses((status = 200, body = Session, description = "with the header `Set-Cookie`"), (status = "4XX", body = Problem))
)]
pub(super) async fn create(State(_): State<App>, By(caller): By, headers: HeaderMap) -> Result<Response, ApiError> {
    let token = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
    let token = token
        .and_then(|value| value.split_once(' '))
        .map(|(_, token)| token.trim());
    let session = Json(Session {
        name: caller.name,
        role: caller.role,
    });
    let Some(token) = token else {
        // A farm without tokens has nothing to be kept.
        return Ok(session.into_response());
    };
    Ok(([(header::SET_COOKIE, cookie(token, "", &headers))], session).into_response())
}

/// Has a browser forget the token.
#[utoipa::path(
    delete, path = "/v1/session", operation_id = "delete_session",
    responses((status = 204, description = "with the header `Set-Cookie`"), (status = "4XX", body = Problem))
)]
pub(super) async fn end(State(_): State<App>, headers: HeaderMap) -> Response {
    let gone = [(header::SET_COOKIE, cookie("", "; Max-Age=0", &headers))];
    (StatusCode::NO_CONTENT, gone).into_response()
}

/// The cookie belongs to the folder of this route, wherever a proxy has put it.
fn cookie(token: &str, more: &str, headers: &HeaderMap) -> String {
    let origin = text(headers, header::ORIGIN).unwrap_or_default();
    let secure = if origin.starts_with("https://") { "; Secure" } else { "" };
    format!("{COOKIE}={token}; HttpOnly; SameSite=Strict{secure}{more}")
}

/// The `Authorization` header that a request's cookie stands for, where it has none of its own.
///
/// # Errors
/// The page of somebody else may have made the request.
pub(super) fn authorization(method: &Method, headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let cookies = headers
        .get_all(header::COOKIE)
        .iter()
        .filter_map(|value| value.to_str().ok());
    let mut pairs = cookies
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.trim().split_once('='));
    let Some((_, token)) = pairs.find(|(name, token)| *name == COOKIE && !token.is_empty()) else {
        return Ok(None);
    };
    check_origin(method, headers)?;
    Ok(Some(format!("Bearer {token}")))
}

fn check_origin(method: &Method, headers: &HeaderMap) -> Result<(), Problem> {
    let host = text(headers, header::HOST).unwrap_or_default();
    let own = match (
        text(headers, HeaderName::from_static("sec-fetch-site")),
        text(headers, header::ORIGIN),
    ) {
        (Some(site), _) => site == "same-origin" || (site == "none" && method.is_safe()),
        // Browsers leave the other header out where a connection is not encrypted.
        (None, Some(origin)) => origin
            .split_once("://")
            .is_some_and(|(_, rest)| rest.eq_ignore_ascii_case(host)),
        (None, None) => method.is_safe(),
    };
    match own {
        true => Ok(()),
        false => Err(Problem::new(
            ErrorCode::Forbidden,
            "a browser that is signed in may send this from the farm's own page alone",
        )),
    }
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).map(|value| value.to_str().unwrap_or("?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(method: Method, headers: &[(&'static str, &str)]) -> Result<Option<String>, ErrorCode> {
        let pairs = headers.iter().map(|(name, value)| {
            let name: HeaderName = name.parse().unwrap();
            (name, value.parse().unwrap())
        });
        authorization(&method, &pairs.collect()).map_err(|problem| problem.code)
    }

    #[test]
    fn a_cookie_stands_for_the_token_on_the_farms_own_page_alone() {
        let (host, cookie) = (("host", "farm:7800"), ("cookie", "a=b; photonfarm-token=phf_1; c=d"));
        let token = Ok(Some("Bearer phf_1".to_owned()));
        assert_eq!(given(Method::GET, &[host]), Ok(None));
        assert_eq!(given(Method::GET, &[host, ("cookie", "photonfarm-token=")]), Ok(None));
        assert_eq!(given(Method::GET, &[host, cookie]), token);
        for own in [("sec-fetch-site", "same-origin"), ("origin", "https://farm:7800")] {
            assert_eq!(given(Method::POST, &[host, cookie, own]), token, "{own:?}");
        }
        for (method, stranger) in [
            (Method::GET, ("sec-fetch-site", "cross-site")),
            (Method::GET, ("sec-fetch-site", "same-site")),
            (Method::POST, ("sec-fetch-site", "none")),
            (Method::POST, ("origin", "https://elsewhere")),
            (Method::POST, ("origin", "null")),
            (Method::DELETE, ("accept", "any")),
        ] {
            let refused = given(method, &[host, cookie, stranger]);
            assert_eq!(refused, Err(ErrorCode::Forbidden), "{stranger:?}");
        }
    }

    #[test]
    fn the_cookie_is_out_of_reach_for_scripts_and_other_sites() {
        let made = cookie(
            "phf_1",
            "",
            &HeaderMap::from_iter([(header::ORIGIN, "https://farm".parse().unwrap())]),
        );
        assert_eq!(made, "photonfarm-token=phf_1; HttpOnly; SameSite=Strict; Secure");
    }
}
