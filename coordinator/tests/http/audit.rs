//! The audit log: what is in it of requests that came, and of those that were refused.

use crate::access::request;
use crate::support::Farm;
use photonfarm_proto::token::{NewToken, Role};
use reqwest::Method;
use serde_json::{Value, json};

#[tokio::test]
async fn each_change_is_written_with_who_asked_and_what_became_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("audit.jsonl");
    let farm = Farm::start_with(|config| config.audit_log = Some(path.clone())).await;
    let lines = || {
        let text = std::fs::read_to_string(&path).unwrap();
        let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
        lines.collect::<Vec<Value>>()
    };
    let last = || lines().pop().unwrap();
    let reply = farm
        .post_json("tokens", &json!({"name": "boss", "role": "admin"}))
        .await;
    let boss = reply.json::<NewToken>().await.unwrap().token;
    let made = last();
    assert_eq!(
        (&made["route"], &made["made"], &made["status"]),
        (&"/v1/tokens".into(), &"boss".into(), &201.into())
    );
    assert_eq!(
        (&made["token"], &made["role"]),
        (&"".into(), &"admin".into()),
        "nobody had a token"
    );

    let by = |token: &str, method: Method, path: &str| farm.request(method, path).bearer_auth(token);
    let ann = serde_json::to_value(request("ann", Role::Submit)).unwrap();
    let reply = by(&boss, Method::POST, "tokens").json(&ann).send().await.unwrap();
    let ann = reply.json::<NewToken>().await.unwrap().token;
    let cancel = by(&ann, Method::POST, "jobs/99/cancel").header("x-request-id", "mine-1");
    assert_eq!(cancel.send().await.unwrap().status().as_u16(), 404);
    let line = last();
    for (field, value) in [
        ("token", json!("ann")),
        ("role", json!("submit")),
        ("method", json!("POST")),
        ("route", json!("/v1/jobs/{id}/cancel")),
        ("path", json!("/v1/jobs/99/cancel")),
        ("job", json!(99)),
        ("status", json!(404)),
        ("request_id", json!("mine-1")),
        ("address", json!("127.0.0.1")),
    ] {
        assert_eq!(line[field], value, "{field}");
    }
    let refused = by(&ann, Method::DELETE, "tokens/boss").send().await.unwrap();
    assert_eq!((refused.status().as_u16(), &last()["status"]), (403, &json!(403)));
    let wrong = by("phf_wrong", Method::POST, "jobs/7/pause").send().await.unwrap();
    assert_eq!(wrong.status().as_u16(), 401);
    let line = last();
    assert_eq!(
        (&line["token"], &line["job"], &line["status"]),
        (&Value::Null, &json!(7), &json!(401))
    );

    let before = lines().len();
    for path in ["jobs", "workers", "healthz"] {
        by(&boss, Method::GET, path).send().await.unwrap();
    }
    assert_eq!(lines().len(), before, "who looks changes nothing");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(
        [&boss, &ann].iter().all(|token| !text.contains(token.as_str())),
        "no token is in it"
    );
}

#[tokio::test]
async fn a_job_that_was_made_is_named_and_a_file_that_cannot_be_opened_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("audit.jsonl");
    let farm = Farm::start_with(|config| config.audit_log = Some(path.clone())).await;
    let job = farm.submit(1).await;
    let text = std::fs::read_to_string(&path).unwrap();
    let line: Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert_eq!((&line["route"], &line["job"]), (&json!("/v1/jobs"), &json!(job)));

    let nowhere = folder.path().join("none/audit.jsonl");
    let mut config = photonfarm_coordinator::Config::new(folder.path().join("farm"));
    config.audit_log = Some(nowhere.clone());
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let error = photonfarm_coordinator::Coordinator::start(config, listener)
        .await
        .err()
        .unwrap();
    assert!(error.to_string().contains(nowhere.to_str().unwrap()), "{error}");
}
