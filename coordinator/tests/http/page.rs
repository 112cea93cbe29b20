//! The page: its files, the stream that it follows, and signing in.

use crate::access::{Closed, request};
use crate::support::{Farm, expect_problem};
use photonfarm_proto::api::{FarmFigures, FarmNews, Session};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::token::Role;
use reqwest::{Method, Response, StatusCode};

#[tokio::test]
async fn the_page_is_served_to_everybody_and_runs_nothing_of_others() {
    let closed = Closed::start().await;
    let url = closed.farm.coordinator.url();
    let get = async |path: &str| closed.farm.http.get(format!("{url}{path}")).send().await.unwrap();
    let page = get("/").await;
    assert_eq!(page.status(), StatusCode::OK);
    let rules = page.headers()["content-security-policy"].to_str().unwrap().to_owned();
    assert!(
        rules.contains("default-src 'none'") && !rules.contains("unsafe"),
        "{rules}"
    );
    let etag = page.headers()["etag"].clone();
    assert!(page.text().await.unwrap().contains("page/main.js"));
    let script = get("/page/main.js").await;
    assert_eq!(script.headers()["content-type"], "text/javascript; charset=utf-8");
    let again = closed
        .farm
        .http
        .get(format!("{url}/"))
        .header("if-none-match", etag)
        .send();
    assert_eq!(again.await.unwrap().status(), StatusCode::NOT_MODIFIED);
    for missing in ["/page/index.html", "/page/..%2fmod.rs", "/page/"] {
        assert_eq!(get(missing).await.status(), StatusCode::NOT_FOUND, "{missing}");
    }
}

/// The next event of a stream.
async fn news(stream: &mut Response) -> FarmNews {
    let mut text = String::new();
    while !text.ends_with("\n\n") {
        text += std::str::from_utf8(&stream.chunk().await.unwrap().unwrap()).unwrap();
    }
    let data = text.lines().find_map(|line| line.strip_prefix("data:"));
    serde_json::from_str(data.unwrap_or_else(|| panic!("{text}"))).unwrap()
}

#[tokio::test]
async fn a_stream_tells_the_whole_farm_and_then_what_changes() {
    let farm = Farm::start().await;
    let job = farm.submit(3).await;
    let mut stream = farm.get("events").await;
    let first = news(&mut stream).await;
    assert!(first.whole && first.workers == Some(Vec::new()) && first.jobs[0].id == job);
    let figures: FarmFigures = farm.get("farm").await.json().await.unwrap();
    assert_eq!(figures, first.figures);
    let asked = (figures.jobs_queued, figures.jobs_running, figures.pending_iterations);
    assert_eq!((asked, figures.stores.len()), ((1, 0, 3), 3));
    let worker = farm.register().await;
    let second = news(&mut stream).await;
    assert!(!second.whole && second.gone.is_empty());
    assert_eq!(second.workers.unwrap()[0].id, worker);
    // It waits for something else now that somebody is there.
    assert_ne!(second.jobs[0].waiting, first.jobs[0].waiting);
    farm.post_json(&format!("jobs/{job}/cancel"), &serde_json::json!({}))
        .await;
    let third = news(&mut stream).await;
    assert_eq!((third.jobs[0].state, third.workers), (JobState::Cancelled, None));
    let delete = farm.request(Method::DELETE, &format!("jobs/{job}")).send();
    assert_eq!(delete.await.unwrap().status(), StatusCode::NO_CONTENT);
    assert_eq!(news(&mut stream).await.gone, [job]);
}

/// A browser keeps the token as a cookie, which counts on the farm's own page alone.
#[tokio::test]
async fn a_browser_signs_in_by_a_cookie() {
    let closed = Closed::start().await;
    let token = closed.token(&request("ann", Role::Submit)).await;
    let job: JobId = closed
        .submit(&token, 1)
        .await
        .json::<serde_json::Value>()
        .await
        .unwrap()["id"]
        .as_u64()
        .map(JobId)
        .unwrap();
    expect_problem(closed.farm.get("session").await, ErrorCode::Unauthorized).await;
    let reply = closed.by(&token, Method::POST, "session").send().await.unwrap();
    let cookie = reply.headers()["set-cookie"].to_str().unwrap().to_owned();
    assert!(cookie.contains("; HttpOnly; SameSite=Strict"), "{cookie}");
    let cookie = cookie.split(';').next().unwrap().to_owned();
    let by = |method: Method, path: &str| closed.farm.request(method, path).header("cookie", &cookie);
    let session: Session = by(Method::GET, "session").send().await.unwrap().json().await.unwrap();
    assert_eq!((session.name.as_str(), session.role), ("ann", Role::Submit));
    let cancel = || by(Method::POST, &format!("jobs/{job}/cancel"));
    for (name, value) in [("origin", "https://evil.example"), ("sec-fetch-site", "cross-site")] {
        let refused = cancel().header(name, value).send().await.unwrap();
        let problem = expect_problem(refused, ErrorCode::Forbidden).await;
        assert!(problem.detail.contains("own page"), "{problem}");
    }
    let origin = closed.farm.coordinator.url();
    let own = cancel().header("origin", origin).send().await.unwrap();
    assert_eq!(own.status(), StatusCode::OK);
    let out = by(Method::DELETE, "session")
        .header("sec-fetch-site", "same-origin")
        .send();
    let out = out.await.unwrap();
    assert!(out.headers()["set-cookie"].to_str().unwrap().contains("Max-Age=0"));
    let broken = closed
        .farm
        .request(Method::GET, "jobs")
        .header("cookie", "photonfarm-token=phf_none");
    expect_problem(broken.send().await.unwrap(), ErrorCode::Unauthorized).await;
}
