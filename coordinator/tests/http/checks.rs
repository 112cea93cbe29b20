//! Checks over HTTP: what is asked, who may ask, and what workers say.

use crate::access::{Closed, request};
use crate::support::{Farm, expect_problem};
use photonfarm_proto::check::{
    ANSWER_BYTES, CheckAnswer, CheckAssignment, CheckError, CheckFailure, CheckResult, CheckState, CheckStatus,
    Checking,
};
use photonfarm_proto::codec::encode;
use photonfarm_proto::id::WorkerId;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::token::Role;
use photonfarm_proto::waiting::Waiting;
use photonfarm_proto::worker::{Acknowledged, Heartbeat, HeartbeatReply, LeaseReply, LeaseRequest, Leave};
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};

impl Farm {
    async fn check_spec(&self) -> Value {
        json!({"scene": self.bundle().await, "main": "scene.xml", "integrator": {"type": "path"}})
    }

    async fn ask_check(&self) -> CheckStatus {
        let reply = self.post_json("checks", &self.check_spec().await).await;
        assert_eq!(reply.status(), StatusCode::ACCEPTED);
        reply.json().await.unwrap()
    }

    async fn check(&self, asked: &CheckStatus) -> CheckStatus {
        self.get(&format!("checks/{}", asked.id)).await.json().await.unwrap()
    }

    async fn take_check(&self, worker: WorkerId, serial: u64) -> Option<CheckAssignment> {
        let request = LeaseRequest {
            worker,
            serial,
            held: vec![],
            wait_ms: 0,
        };
        self.call::<_, LeaseReply>("lease", &request).await.check
    }
}

fn failure(message: String) -> CheckAnswer {
    CheckAnswer::Failure(CheckFailure::one(CheckError {
        message,
        file: Some("scene.xml".into()),
        line: Some(3),
        field: None,
    }))
}

#[tokio::test]
async fn a_check_goes_before_jobs_and_its_answer_is_shown() {
    let farm = Farm::start().await;
    let job = farm.submit(3).await;
    let asked = farm.ask_check().await;
    assert_eq!(
        (asked.state, asked.waiting_reason),
        (CheckState::Waiting, Some(Waiting::NoWorker))
    );
    let worker = farm.register().await;
    let waiting = farm.check(&asked).await;
    assert_eq!(waiting.waiting_reason, Some(Waiting::Turn));
    let check = farm.take_check(worker, 1).await.unwrap();
    assert_eq!((check.token.id, check.spec.main.as_str()), (asked.id, "scene.xml"));
    assert_eq!(farm.check(&asked).await.state, CheckState::Checking);
    assert_eq!(farm.take_check(worker, 2).await, None, "the job's turn has come");
    let mut result = CheckResult {
        token: check.token,
        worker,
        answer: failure("x".repeat(ANSWER_BYTES)),
    };
    expect_problem(farm.send("check", encode(&result).unwrap()).await, ErrorCode::Limit).await;
    result.answer = failure("scene.xml:3: no".into());
    // Whoever waits hears of the answer at once.
    let path = format!("checks/{}?wait_ms=30000", asked.id);
    let told = async {
        let _: Acknowledged = farm.call("check", &result).await;
    };
    let (reply, ()) = tokio::join!(farm.get(&path), told);
    let done: CheckStatus = reply.json().await.unwrap();
    assert_eq!((done.state, done.waiting_reason), (CheckState::Done, None));
    assert_eq!(done.failure.unwrap().errors[0].line, Some(3));
    expect_problem(
        farm.send("check", encode(&result).unwrap()).await,
        ErrorCode::StaleLease,
    )
    .await;
    assert_eq!(farm.status(job).await.iterations_rendered, 0);
}

#[tokio::test]
async fn a_worker_at_work_is_lent_a_check_by_a_heartbeat_and_one_that_goes_gives_it_back() {
    let farm = Farm::start().await;
    let asked = farm.ask_check().await;
    let (busy, other) = (farm.register().await, farm.register().await);
    let beat = async |worker, checking| {
        let leases = vec![];
        let heartbeat = Heartbeat {
            worker,
            leases,
            checking,
        };
        farm.call::<_, HeartbeatReply>("heartbeat", &heartbeat).await.check
    };
    assert_eq!(beat(busy, Checking::Not).await, None);
    let check = loop {
        if let Some(check) = beat(busy, Checking::Ready).await {
            break check;
        }
        tokio::task::yield_now().await;
    };
    assert_eq!(check.token.id, asked.id);
    assert_eq!(beat(busy, Checking::At(check.token)).await, None);
    assert_eq!(farm.take_check(other, 1).await, None);
    let _: Acknowledged = farm.call("leave", &Leave { worker: busy }).await;
    let again = farm.take_check(other, 2).await.unwrap();
    assert_eq!(again.token.id, asked.id);
    assert_ne!(again.token, check.token);
}

#[tokio::test]
async fn checks_that_cannot_be_are_refused_as_jobs_are() {
    let farm = Farm::start().await;
    let good = farm.check_spec().await;
    for (field, value, code) in [
        ("main", json!("other.xml"), ErrorCode::Invalid),
        ("scene", json!("0".repeat(64)), ErrorCode::Invalid),
        ("integrator", json!({"type": "path", "samples": 0}), ErrorCode::Invalid),
        ("layers", json!(["moon"]), ErrorCode::Invalid),
        ("iterations", json!(4), ErrorCode::Invalid),
        ("defines", json!({"x": "y".repeat(2000)}), ErrorCode::Limit),
    ] {
        let mut bad = good.clone();
        bad[field] = value;
        expect_problem(farm.post_json("checks", &bad).await, code).await;
    }
    expect_problem(farm.get("checks/7").await, ErrorCode::NotFound).await;
    let asked = farm.ask_check().await;
    let path = format!("checks/{}?wait_ms=30001", asked.id);
    let problem = expect_problem(farm.get(&path).await, ErrorCode::Invalid).await;
    assert_eq!(problem.field.as_deref(), Some("wait_ms"));
    let path = format!("checks/{}?wait_ms=soon", asked.id);
    expect_problem(farm.get(&path).await, ErrorCode::Malformed).await;
}

#[tokio::test]
async fn a_check_is_for_whoever_asked_for_it() {
    let closed = Closed::start().await;
    let ann = closed.token(&request("ann", Role::Submit)).await;
    let bob = closed.token(&request("bob", Role::Submit)).await;
    let job: Value = closed.submit(&ann, 2).await.json().await.unwrap();
    let spec = json!({"scene": job["spec"]["scene"], "main": "scene.xml", "integrator": {"type": "path"}});
    let asked = closed
        .by(&ann, Method::POST, "checks")
        .json(&spec)
        .send()
        .await
        .unwrap();
    let asked: CheckStatus = asked.json().await.unwrap();
    let look = |token: &str| closed.by(token, Method::GET, &format!("checks/{}", asked.id)).send();
    assert_eq!(look(&ann).await.unwrap().status(), StatusCode::OK);
    assert_eq!(look(closed.admin()).await.unwrap().status(), StatusCode::OK);
    expect_problem(look(&bob).await.unwrap(), ErrorCode::Forbidden).await;
}
