//! What clients ask of jobs and workers while they are at work.

use crate::support::{Farm, expect_problem};
use photonfarm_proto::api::WorkerStatus;
use photonfarm_proto::job::{JobState, JobStatus};
use photonfarm_proto::problem::ErrorCode;
use reqwest::{Method, Response, StatusCode};
use serde_json::{Value, json};

async fn status(reply: Response) -> JobStatus {
    assert_eq!(reply.status(), StatusCode::OK);
    reply.json().await.unwrap()
}

async fn put_priority(farm: &Farm, priority: u32) -> Response {
    let request = farm.request(Method::PUT, "jobs/1/priority");
    request.json(&json!({"priority": priority})).send().await.unwrap()
}

#[tokio::test]
async fn jobs_are_paused_extended_and_put_in_order_as_often_as_asked() {
    let farm = Farm::start().await;
    farm.submit(4).await;
    let post = async |path: &str, body: Value| farm.post_json(path, &body).await;
    for _ in 0..2 {
        let paused = status(post("jobs/1/pause", json!({})).await).await;
        assert!(paused.spec.schedule.paused && paused.waiting.as_deref() == Some("it is paused"));
    }
    for _ in 0..2 {
        assert!(
            !status(post("jobs/1/resume", json!({})).await)
                .await
                .spec
                .schedule
                .paused
        );
        let extended = status(post("jobs/1/extend", json!({"iterations": 9})).await).await;
        assert_eq!(extended.spec.iterations, 9);
        assert_eq!(status(put_priority(&farm, 70).await).await.spec.schedule.priority, 70);
    }
    let fewer = expect_problem(
        post("jobs/1/extend", json!({"iterations": 8})).await,
        ErrorCode::Invalid,
    )
    .await;
    assert!(fewer.detail.contains("has 9 iterations"), "{fewer}");
    expect_problem(
        post("jobs/1/extend", json!({"iterations": 101})).await,
        ErrorCode::Limit,
    )
    .await;
    expect_problem(
        post("jobs/1/extend", json!({"iterations": 0})).await,
        ErrorCode::Invalid,
    )
    .await;
    expect_problem(put_priority(&farm, 101).await, ErrorCode::Invalid).await;
    // Nothing was given up.
    status(post("jobs/1/retry", json!({})).await).await;
    for path in ["jobs/7/pause", "jobs/7/resume", "jobs/7/retry"] {
        expect_problem(post(path, json!({})).await, ErrorCode::NotFound).await;
    }
    expect_problem(
        post("jobs/7/extend", json!({"iterations": 3})).await,
        ErrorCode::NotFound,
    )
    .await;
    assert_eq!(
        status(post("jobs/1/cancel", json!({})).await).await.state,
        JobState::Cancelled
    );
    expect_problem(post("jobs/1/pause", json!({})).await, ErrorCode::JobEnded).await;
    expect_problem(post("jobs/1/retry", json!({})).await, ErrorCode::JobEnded).await;
    expect_problem(
        post("jobs/1/extend", json!({"iterations": 20})).await,
        ErrorCode::JobEnded,
    )
    .await;
    expect_problem(put_priority(&farm, 5).await, ErrorCode::JobEnded).await;
}

#[tokio::test]
async fn schedules_that_cannot_be_are_refused_by_their_field() {
    let farm = Farm::start().await;
    for (field, value) in [
        ("priority", json!(0)),
        ("noise_target", json!(-1.0)),
        ("tags", json!(["a b"])),
    ] {
        let mut spec = farm.spec(4).await;
        spec["schedule"] = json!({field: value});
        let problem = expect_problem(farm.post_json("jobs", &spec).await, ErrorCode::Invalid).await;
        assert_eq!(problem.field.as_deref(), Some(format!("schedule.{field}").as_str()));
    }
    let mut spec = farm.spec(4).await;
    spec["schedule"] = json!({"colour": "red"});
    expect_problem(farm.post_json("jobs", &spec).await, ErrorCode::Invalid).await;
}

#[tokio::test]
async fn workers_go_into_quarantine_and_out_of_it() {
    let farm = Farm::start().await;
    let worker = farm.register().await;
    let path = |action: &str| format!("workers/{worker}/{action}");
    for _ in 0..2 {
        let reply = farm.post_json(&path("quarantine"), &json!({"reason": "smoke"})).await;
        let status: WorkerStatus = reply.json().await.unwrap();
        assert_eq!(status.quarantine.as_deref(), Some("smoke"));
    }
    for _ in 0..2 {
        let reply = farm.post_json(&path("release"), &json!({})).await;
        let status: WorkerStatus = reply.json().await.unwrap();
        assert_eq!(status.quarantine, None);
    }
    for (action, drained) in [("drain", true), ("resume", false)] {
        for _ in 0..2 {
            let status: WorkerStatus = farm.post_json(&path(action), &json!({})).await.json().await.unwrap();
            assert_eq!(status.drained, drained);
        }
    }
    for action in ["release", "drain", "resume"] {
        let unknown = farm.post_json(&format!("workers/99/{action}"), &json!({})).await;
        expect_problem(unknown, ErrorCode::UnknownWorker).await;
    }
}

#[tokio::test]
async fn a_job_is_deleted_once_it_has_ended_and_its_number_is_not_used_again() {
    let farm = Farm::start().await;
    let job = farm.submit(4).await;
    let path = format!("jobs/{job}");
    let delete = async || farm.request(Method::DELETE, &path).send().await.unwrap();
    let problem = expect_problem(delete().await, ErrorCode::JobGoesOn).await;
    assert!(problem.detail.contains("cancel it first"), "{problem}");
    status(farm.post_json(&format!("{path}/cancel"), &json!({})).await).await;
    assert_eq!(delete().await.status(), StatusCode::NO_CONTENT);
    for answer in [
        delete().await,
        farm.get(&path).await,
        farm.get(&format!("{path}/image.exr")).await,
        farm.get(&format!("{path}/events")).await,
        farm.post_json(&format!("{path}/extend"), &json!({"iterations": 9}))
            .await,
    ] {
        expect_problem(answer, ErrorCode::NotFound).await;
    }
    let list: Value = farm.get("jobs").await.json().await.unwrap();
    assert_eq!(list["jobs"], json!([]));
    assert!(farm.submit(4).await > job);
}
