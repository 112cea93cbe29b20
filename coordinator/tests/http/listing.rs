//! Lists of jobs: filters, and pages that stay right while jobs come and go.

use crate::support::{Farm, expect_problem};
use photonfarm_proto::api::JobPage;
use photonfarm_proto::problem::ErrorCode;
use reqwest::{Method, StatusCode};
use serde_json::json;

async fn page(farm: &Farm, query: &str) -> (Vec<u64>, Option<String>) {
    let reply = farm.get(&format!("jobs?{query}")).await;
    assert_eq!(reply.status(), StatusCode::OK, "{query}");
    let page: JobPage = reply.json().await.unwrap();
    (page.jobs.iter().map(|job| job.id.0).collect(), page.next)
}

async fn act(farm: &Farm, method: Method, path: &str) {
    let reply = farm.request(method, path).json(&json!({})).send().await.unwrap();
    assert!(reply.status().is_success(), "{path}: {}", reply.status());
}

#[tokio::test]
async fn pages_go_on_where_they_ended_while_jobs_come_and_go() {
    let farm = Farm::start().await;
    for _ in 0..6 {
        farm.submit(1).await;
    }
    let (first, next) = page(&farm, "limit=2").await;
    let (oldest, next_oldest) = page(&farm, "limit=2&order=oldest").await;
    assert_eq!((first, oldest), (vec![6, 5], vec![1, 2]));
    // The jobs at which both pages ended, and others around them.
    for job in [5, 4, 2] {
        act(&farm, Method::POST, &format!("jobs/{job}/cancel")).await;
        act(&farm, Method::DELETE, &format!("jobs/{job}")).await;
    }
    assert_eq!(farm.submit(1).await.0, 7);
    let (cursor, oldest_cursor) = (next.unwrap(), next_oldest.unwrap());
    assert_eq!(
        page(&farm, &format!("limit=2&cursor={cursor}")).await,
        (vec![3, 1], None)
    );
    let (rest, last) = page(&farm, &format!("limit=2&order=oldest&cursor={oldest_cursor}")).await;
    assert_eq!(rest, [3, 6]);
    let last = format!("limit=2&order=oldest&cursor={}", last.unwrap());
    assert_eq!(page(&farm, &last).await, (vec![7], None));
    let other = farm.get(&format!("jobs?cursor={oldest_cursor}")).await;
    let problem = expect_problem(other, ErrorCode::Malformed).await;
    assert_eq!(problem.field.as_deref(), Some("cursor"));
}

#[tokio::test]
async fn jobs_are_found_by_what_they_are() {
    let farm = Farm::start().await;
    let before = photonfarm_proto::time::rfc3339(1000);
    for (name, labels) in [
        ("sea & sand", json!({"shot": "7"})),
        ("", json!({"shot": "8", "draft": ""})),
        ("sea", json!({})),
    ] {
        let mut spec = farm.spec(4).await;
        (spec["name"], spec["labels"]) = (json!(name), labels);
        assert_eq!(farm.post_json("jobs", &spec).await.status(), StatusCode::CREATED);
    }
    act(&farm, Method::POST, "jobs/1/pause").await;
    act(&farm, Method::POST, "jobs/2/cancel").await;
    for (query, found) in [
        ("", vec![3, 2, 1]),
        ("state=paused", vec![1]),
        ("state=queued", vec![3]),
        ("state=cancelled&state=queued", vec![3, 2]),
        ("name=sea", vec![3, 1]),
        ("name=sea+%26+s", vec![1]),
        ("name=scene.xml", vec![2]),
        ("label=shot", vec![2, 1]),
        ("label=shot%3D7", vec![1]),
        ("label=shot&label=draft%3D", vec![2]),
        ("owner=", vec![3, 2, 1]),
        ("owner=ann", vec![]),
        (&format!("created_after={before}"), vec![3, 2, 1]),
        (&format!("created_before={before}"), vec![]),
        ("order=oldest&state=paused&state=queued", vec![1, 3]),
    ] {
        assert_eq!(page(&farm, query).await, (found, None), "{query}");
    }
    let first = farm.register().await;
    farm.lease(first).await;
    assert_eq!(page(&farm, "state=running").await.0, [3]);
    act(&farm, Method::POST, "jobs/3/pause").await;
    assert_eq!(page(&farm, "state=running").await.0, [0; 0]);
    assert_eq!(page(&farm, "state=paused").await.0, [3, 1]);
    for query in [
        "state=ended",
        "created_after=now",
        "order=best",
        "label=%3D",
        "limit=1000",
    ] {
        let problem = expect_problem(farm.get(&format!("jobs?{query}")).await, ErrorCode::Invalid).await;
        assert_eq!(problem.field.as_deref(), query.split('=').next());
    }
}
