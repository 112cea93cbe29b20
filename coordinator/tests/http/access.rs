//! Tokens: roles, quotas, rates.

use crate::support::{Farm, SCENE, expect_problem};
use photonfarm_coordinator::access::Tokens;
use photonfarm_coordinator::{Config, Coordinator, StartError, open_stores};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::check::{CheckAnswer, CheckResult, CheckToken, Checking};
use photonfarm_proto::codec::{MESSAGE_MEDIA_TYPE, Message, decode, encode};
use photonfarm_proto::id::{BlobHash, CheckId};
use photonfarm_proto::job::{FailureKind, JobState};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::rest::{Rest, RestReason};
use photonfarm_proto::token::{NewToken, Quota, Role, TokenList, TokenRequest};
use photonfarm_proto::worker::{
    FailureReport, Heartbeat, HeartbeatReply, LeaseProgress, LeaseReply, LeaseRequest, Leave, NodeUpload, Register,
    Registered, Release, StatisticsRequest, frame_upload,
};
use reqwest::{Method, RequestBuilder, Response, StatusCode};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use tokio::net::TcpListener;

pub(crate) fn request(name: &str, role: Role) -> TokenRequest {
    TokenRequest {
        name: name.into(),
        role,
        expires_in_s: None,
        quota: Quota::default(),
    }
}

/// A farm with an administrator's token.
pub(crate) struct Closed {
    pub(crate) farm: Farm,
    admin: String,
}

impl Closed {
    pub(crate) async fn start() -> Self {
        let farm = Farm::start().await;
        let reply = farm
            .post_json("tokens", &json!({"name": "boss", "role": "admin"}))
            .await;
        assert_eq!(reply.status(), StatusCode::CREATED);
        let admin = reply.json::<NewToken>().await.unwrap().token;
        Self { farm, admin }
    }

    pub(crate) fn admin(&self) -> &str {
        &self.admin
    }

    pub(crate) async fn token(&self, request: &TokenRequest) -> String {
        let reply = self.by(&self.admin, Method::POST, "tokens").json(request);
        let reply = reply.send().await.unwrap();
        assert_eq!(reply.status(), StatusCode::CREATED);
        reply.json::<NewToken>().await.unwrap().token
    }

    pub(crate) fn by(&self, token: &str, method: Method, path: &str) -> RequestBuilder {
        self.farm.request(method, path).bearer_auth(token)
    }

    pub(crate) async fn submit(&self, token: &str, iterations: u32) -> Response {
        self.submit_by("path", token, iterations).await
    }

    async fn submit_by(&self, integrator: &str, token: &str, iterations: u32) -> Response {
        let files = [("scene.xml".to_owned(), FileEntry::of(SCENE))].into();
        let manifest = BundleManifest { files };
        let reply = self.by(token, Method::POST, "bundles").json(&manifest).send().await;
        assert_eq!(reply.unwrap().status(), StatusCode::OK);
        let path = format!("blobs/{}", BlobHash::of(SCENE));
        let put = self.by(token, Method::PUT, &path).body(SCENE).send().await;
        assert!(put.unwrap().status().is_success());
        let spec = json!({"scene": manifest.hash(), "main": "scene.xml", "integrator": {"type": integrator},
            "iterations": iterations});
        self.by(token, Method::POST, "jobs").json(&spec).send().await.unwrap()
    }
}

const LOOKS: &[Role] = &[Role::Read, Role::Submit];
const FETCHES: &[Role] = &[Role::Read, Role::Submit, Role::Worker];
const SENDS: &[Role] = &[Role::Submit];
const WORKS: &[Role] = &[Role::Worker];
const RULES: &[Role] = &[];

/// Whom each route is for, besides `admin`. Every route of the router must be here.
const ROUTES: [(&str, &str, &[Role]); 55] = [
    ("GET", "/metrics", LOOKS),
    ("GET", "/v1/jobs", LOOKS),
    ("GET", "/v1/jobs/{id}", LOOKS),
    ("GET", "/v1/jobs/{id}/image.exr", LOOKS),
    ("GET", "/v1/jobs/{id}/image.png", LOOKS),
    ("GET", "/v1/jobs/{id}/image.jpg", LOOKS),
    ("GET", "/v1/jobs/{id}/image.raw", LOOKS),
    ("GET", "/v1/jobs/{id}/events", LOOKS),
    ("GET", "/v1/jobs/{id}/history", LOOKS),
    ("GET", "/v1/jobs/{id}/log", LOOKS),
    ("GET", "/v1/events", LOOKS),
    ("GET", "/v1/farm", LOOKS),
    ("GET", "/v1/session", LOOKS),
    ("POST", "/v1/session", LOOKS),
    ("DELETE", "/v1/session", LOOKS),
    ("GET", "/v1/workers", LOOKS),
    ("GET", "/v1/openapi.json", LOOKS),
    ("GET", "/v1/docs", LOOKS),
    ("GET", "/v1/bundles/{hash}", FETCHES),
    ("GET", "/v1/blobs/{hash}", FETCHES),
    ("POST", "/v1/bundles", SENDS),
    ("PUT", "/v1/blobs/{hash}", SENDS),
    ("GET", "/v1/blobs/{hash}/upload", SENDS),
    ("PATCH", "/v1/blobs/{hash}/upload", SENDS),
    ("POST", "/v1/jobs", SENDS),
    ("DELETE", "/v1/jobs/{id}", SENDS),
    ("POST", "/v1/jobs/{id}/cancel", SENDS),
    ("POST", "/v1/jobs/{id}/pause", SENDS),
    ("POST", "/v1/jobs/{id}/resume", SENDS),
    ("POST", "/v1/jobs/{id}/extend", SENDS),
    ("POST", "/v1/jobs/{id}/retry", SENDS),
    ("PUT", "/v1/jobs/{id}/priority", SENDS),
    ("POST", "/v1/checks", SENDS),
    ("GET", "/v1/checks/{id}", SENDS),
    ("POST", "/v1/worker/register", WORKS),
    ("POST", "/v1/worker/lease", WORKS),
    ("POST", "/v1/worker/rest", WORKS),
    ("POST", "/v1/worker/heartbeat", WORKS),
    ("POST", "/v1/worker/nodes", WORKS),
    ("POST", "/v1/worker/nodes/place", WORKS),
    ("POST", "/v1/worker/nodes/stored", WORKS),
    ("POST", "/v1/worker/statistics", WORKS),
    ("POST", "/v1/worker/scene", WORKS),
    ("POST", "/v1/worker/check", WORKS),
    ("POST", "/v1/worker/failures", WORKS),
    ("POST", "/v1/worker/release", WORKS),
    ("POST", "/v1/worker/leave", WORKS),
    ("POST", "/v1/tokens", RULES),
    ("GET", "/v1/tokens", RULES),
    ("DELETE", "/v1/tokens/{name}", RULES),
    ("GET", "/v1/webhooks", RULES),
    ("POST", "/v1/workers/{id}/quarantine", RULES),
    ("POST", "/v1/workers/{id}/release", RULES),
    ("POST", "/v1/workers/{id}/drain", RULES),
    ("POST", "/v1/workers/{id}/resume", RULES),
];

#[test]
fn every_route_of_the_router_is_tried() {
    let served: BTreeSet<_> = photonfarm_coordinator::routes()
        .into_iter()
        .filter(|route| route.roles.is_some())
        .map(|route| (route.method, route.path))
        .collect();
    let tried: BTreeSet<_> = ROUTES.iter().map(|(method, path, _)| (*method, *path)).collect();
    assert_eq!(served, tried);
}

/// A farm for some of the routes each: a visitor may not ask for all of them at once.
#[tokio::test]
async fn every_route_asks_for_its_role() {
    for routes in ROUTES.chunks(ROUTES.len() / 2) {
        ask_for_roles(routes).await;
    }
}

async fn ask_for_roles(routes: &[(&str, &str, &[Role])]) {
    let closed = Closed::start().await;
    let mut tokens = vec![(Role::Admin, closed.admin.clone())];
    for role in [Role::Read, Role::Submit, Role::Worker] {
        tokens.push((role, closed.token(&request(&role.to_string(), role)).await));
    }
    for (method, path, roles) in routes {
        let method: Method = method.parse().unwrap();
        let path = path
            .replace("{id}", "99")
            .replace("{hash}", "00")
            .replace("{name}", "none");
        let url = format!("{}{path}", closed.farm.coordinator.url());
        let bare = closed.farm.http.request(method.clone(), &url).send().await.unwrap();
        assert_eq!(bare.headers()["www-authenticate"], "Bearer");
        let problem = expect_problem(bare, ErrorCode::Unauthorized).await;
        assert!(problem.detail.contains("Authorization: Bearer"), "{problem}");
        for (role, token) in &tokens {
            let reply = closed.farm.http.request(method.clone(), &url).bearer_auth(token);
            let reply = reply.send().await.unwrap();
            if *role == Role::Admin || roles.contains(role) {
                let status = reply.status();
                assert!(
                    ![StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&status),
                    "{role} {path}"
                );
                continue;
            }
            let problem = expect_problem(reply, ErrorCode::Forbidden).await;
            let needed = roles.first().unwrap_or(&Role::Admin);
            assert!(problem.detail.contains(&format!("`{needed}`")), "{problem}");
            assert!(problem.detail.contains(&format!("the role `{role}`")), "{problem}");
        }
    }
    assert_eq!(closed.farm.get("healthz").await.status(), StatusCode::OK);
}

/// Programs of this machine may use a farm without tokens; pages that its browsers show may not.
#[tokio::test]
async fn web_pages_do_not_reach_a_farm_without_tokens() {
    let farm = Farm::start().await;
    let job = farm.submit(1).await;
    let cancel = format!("jobs/{job}/cancel");
    let post = |name: &str, value: &str| farm.request(Method::POST, &cancel).header(name, value).send();
    for (name, value, code) in [
        ("host", "rebound.example", ErrorCode::Forbidden),
        ("origin", "http://evil.example", ErrorCode::Forbidden),
        ("sec-fetch-site", "cross-site", ErrorCode::Forbidden),
        ("content-type", "text/plain", ErrorCode::UnsupportedMediaType),
        (
            "content-type",
            "application/x-www-form-urlencoded",
            ErrorCode::UnsupportedMediaType,
        ),
    ] {
        expect_problem(post(name, value).await.unwrap(), code).await;
    }
    let read = farm.request(Method::GET, "jobs").header("host", "rebound.example");
    let problem = expect_problem(read.send().await.unwrap(), ErrorCode::Forbidden).await;
    assert!(problem.detail.contains("token create"), "{problem}");
    assert_eq!(farm.status(job).await.state, JobState::Queued);
    let own = farm.request(Method::POST, &cancel).send().await.unwrap();
    assert_eq!(own.status(), StatusCode::OK);
    let closed = Closed::start().await;
    let named = closed
        .by(&closed.admin, Method::GET, "jobs")
        .header("host", "farm.example");
    assert_eq!(
        named.send().await.unwrap().status(),
        StatusCode::OK,
        "a token is enough"
    );
}

/// Sends a message of the worker protocol with a token.
async fn tell<M: Message>(closed: &Closed, token: &str, path: &str, message: &M) -> Response {
    let request = closed.by(token, Method::POST, &format!("worker/{path}"));
    let request = request.header("content-type", MESSAGE_MEDIA_TYPE);
    request.body(encode(message).unwrap()).send().await.unwrap()
}

#[tokio::test]
async fn nobody_speaks_for_a_worker_of_another_token() {
    let closed = Closed::start().await;
    let mine = closed.token(&request("rack", Role::Worker)).await;
    let other = closed.token(&request("other", Role::Worker)).await;
    let register = Register {
        name: "w".into(),
        threads: 1,
        renderer: photonfarm_proto::RENDERER.into(),
        tags: Default::default(),
        memory_mb: None,
    };
    let registered = tell(&closed, &mine, "register", &register).await.bytes().await.unwrap();
    let worker = decode::<Registered>(&registered).unwrap().worker;
    assert_eq!(closed.submit(&closed.admin, 4).await.status(), StatusCode::CREATED);
    let mut ask = LeaseRequest {
        worker,
        serial: 1,
        held: vec![],
        wait_ms: 0,
    };
    let reply = tell(&closed, &mine, "lease", &ask).await.bytes().await.unwrap();
    let lease = decode::<LeaseReply>(&reply).unwrap().assignment.unwrap().lease;
    let (token, job) = (lease.token, lease.job);
    ask.serial = 2;
    let upload = NodeUpload {
        token,
        worker,
        job,
        node: lease.node,
        width: 1,
        height: 1,
        digest: BlobHash::of(b""),
        totals: Default::default(),
        memory_mb: None,
    };
    let report = FailureReport {
        token,
        worker,
        job,
        leaf: 0,
        kind: FailureKind::Scene,
        message: "no".into(),
        shortage: None,
    };
    let beat = |leases| Heartbeat {
        worker,
        leases,
        checking: Checking::Not,
    };
    let result = CheckResult {
        token: CheckToken {
            id: CheckId(1),
            nonce: 1,
        },
        worker,
        answer: CheckAnswer::Elsewhere("no".into()),
    };
    let leases = vec![LeaseProgress { token, leaves_done: 1 }];
    let rest = Rest {
        worker,
        serial: 2,
        held: vec![],
        reason: RestReason::Hours,
        until_ms: None,
    };
    let raw = closed.by(&other, Method::POST, "worker/nodes");
    let raw = raw.header("content-type", MESSAGE_MEDIA_TYPE);
    let replies = [
        tell(&closed, &other, "lease", &ask).await,
        tell(&closed, &other, "heartbeat", &beat(leases)).await,
        tell(&closed, &other, "rest", &rest).await,
        tell(&closed, &other, "check", &result).await,
        tell(&closed, &other, "nodes/place", &upload).await,
        tell(&closed, &other, "nodes/stored", &upload).await,
        tell(&closed, &other, "statistics", &StatisticsRequest { token, worker, job }).await,
        tell(&closed, &other, "failures", &report).await,
        tell(&closed, &other, "release", &Release { token, worker, job }).await,
        tell(&closed, &other, "leave", &Leave { worker }).await,
        raw.body(frame_upload(&upload).unwrap()).send().await.unwrap(),
    ];
    for reply in replies {
        let problem = expect_problem(reply, ErrorCode::Forbidden).await;
        assert!(problem.detail.contains("another token"), "{problem}");
    }
    let beat = beat(vec![LeaseProgress { token, leaves_done: 1 }]);
    let reply = tell(&closed, &mine, "heartbeat", &beat).await.bytes().await.unwrap();
    assert_eq!(decode::<HeartbeatReply>(&reply).unwrap().lost, [], "nothing came of it");
}

#[tokio::test]
async fn metrics_tell_the_work_that_is_left() {
    let closed = Closed::start().await;
    let read = closed.token(&request("reader", Role::Read)).await;
    let url = format!("{}/metrics", closed.farm.coordinator.url());
    expect_problem(
        closed.farm.http.get(&url).send().await.unwrap(),
        ErrorCode::Unauthorized,
    )
    .await;
    let figure = async |name: &str| {
        let reply = closed.farm.http.get(&url).bearer_auth(&read).send().await.unwrap();
        assert_eq!(
            reply.headers()["content-type"],
            "text/plain; version=0.0.4; charset=utf-8"
        );
        let text = reply.text().await.unwrap();
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix(&format!("photonfarm_{name} ")));
        line.unwrap_or_else(|| panic!("{name} is not in {text}"))
            .parse::<u64>()
            .unwrap()
    };
    assert_eq!(figure("pending_leases").await, 0);
    assert_eq!(closed.submit(&closed.admin, 9).await.status(), StatusCode::CREATED);
    assert_eq!(
        (figure("pending_iterations").await, figure("pending_leases").await),
        (9, 9)
    );
    assert_eq!((figure("jobs_queued").await, figure("jobs_running").await), (1, 0));
    assert_eq!(figure("jobs_waiting{reason=\"no-worker\"}").await, 1);
    assert_eq!(figure("jobs_waiting{reason=\"disk-full\"}").await, 0);
    assert_eq!(
        figure("store_failures_total{part=\"images\",reason=\"disk-full\"}").await,
        0
    );
    let chain = closed.submit_by("sppm", &closed.admin, 5).await;
    assert_eq!(chain.status(), StatusCode::CREATED);
    assert_eq!(
        (figure("pending_iterations").await, figure("pending_leases").await),
        (14, 10),
        "one worker at a time renders a chain"
    );
    let cancel = closed.by(&closed.admin, Method::POST, "jobs/2/cancel").send().await;
    assert_eq!(cancel.unwrap().status(), StatusCode::OK);
    let worker = closed.token(&request("rack", Role::Worker)).await;
    assert_eq!(figure("workers").await, 0);
    let cancel = closed
        .by(&closed.admin, Method::POST, "jobs/1/cancel")
        .send()
        .await
        .unwrap();
    assert_eq!(cancel.status(), StatusCode::OK);
    assert_eq!(
        (figure("pending_iterations").await, figure("jobs_queued").await),
        (0, 0)
    );
    let reply = closed.farm.http.get(&url).bearer_auth(&worker).send().await.unwrap();
    expect_problem(reply, ErrorCode::Forbidden).await;
}

#[tokio::test]
async fn tokens_that_are_not_valid_are_refused() {
    let closed = Closed::start().await;
    let read = closed.token(&request("reader", Role::Read)).await;
    let brief = TokenRequest {
        expires_in_s: Some(0),
        ..request("brief", Role::Read)
    };
    let expired = closed.token(&brief).await;
    let longer = format!("{read}0");
    for bad in ["", "phf_00", &read[..read.len() - 1], &longer, &read.to_uppercase()] {
        let reply = closed.by(bad, Method::GET, "jobs").send().await.unwrap();
        expect_problem(reply, ErrorCode::Unauthorized).await;
    }
    let reply = closed.by(&expired, Method::GET, "jobs").send().await.unwrap();
    assert!(
        expect_problem(reply, ErrorCode::Unauthorized)
            .await
            .detail
            .contains("expired")
    );
    let jobs = |token: String| closed.by(&token, Method::GET, "jobs").send();
    assert_eq!(jobs(read.clone()).await.unwrap().status(), StatusCode::OK);
    let revoke = closed.by(&closed.admin, Method::DELETE, "tokens/reader").send();
    assert_eq!(revoke.await.unwrap().status(), StatusCode::NO_CONTENT);
    expect_problem(jobs(read).await.unwrap(), ErrorCode::Unauthorized).await;
}

#[tokio::test]
async fn a_farm_keeps_an_administrator_and_no_secrets() {
    let farm = Farm::start().await;
    let reply = farm.post_json("tokens", &json!({"name": "w", "role": "worker"})).await;
    expect_problem(reply, ErrorCode::Invalid).await;
    let closed = Closed::start().await;
    let twice = closed.by(&closed.admin, Method::POST, "tokens");
    let twice = twice.json(&request("boss", Role::Read)).send().await.unwrap();
    assert_eq!(
        expect_problem(twice, ErrorCode::Invalid).await.field.as_deref(),
        Some("name")
    );
    let last = closed
        .by(&closed.admin, Method::DELETE, "tokens/boss")
        .send()
        .await
        .unwrap();
    expect_problem(last, ErrorCode::Invalid).await;
    let none = closed
        .by(&closed.admin, Method::DELETE, "tokens/none")
        .send()
        .await
        .unwrap();
    expect_problem(none, ErrorCode::NotFound).await;
    let list = closed.by(&closed.admin, Method::GET, "tokens").send().await.unwrap();
    let text = list.text().await.unwrap();
    assert!(!text.contains(&closed.admin[4..]));
    assert_eq!(serde_json::from_str::<TokenList>(&text).unwrap().tokens.len(), 1);
    let folder = closed.farm._folder.path().to_owned();
    closed.farm.coordinator.shutdown().await;
    let contains = |bytes: &[u8]| bytes.windows(32).any(|part| part == &closed.admin.as_bytes()[4..36]);
    for file in ["farm.sqlite", "farm.sqlite-wal"] {
        let bytes = std::fs::read(folder.join(file)).unwrap_or_default();
        assert!(!contains(&bytes), "{file} holds the token in clear");
    }
}

#[tokio::test]
async fn quotas_hold_and_say_how_much_is_used() {
    let closed = Closed::start().await;
    let quota = Quota {
        jobs: Some(2),
        bundle_bytes: Some(SCENE.len() as u64 + 3),
        iterations: Some(10),
    };
    let ann = closed
        .token(&TokenRequest {
            quota,
            ..request("ann", Role::Submit)
        })
        .await;
    assert_eq!(closed.submit(&ann, 4).await.status(), StatusCode::CREATED);
    let problem = expect_problem(closed.submit(&ann, 7).await, ErrorCode::Quota).await;
    assert!(problem.detail.contains("`iterations`") && problem.detail.contains("is 10; this would make 11"));
    assert_eq!(closed.submit(&ann, 5).await.status(), StatusCode::CREATED);
    let problem = expect_problem(closed.submit(&ann, 1).await, ErrorCode::Quota).await;
    assert!(problem.detail.contains("`jobs`"), "{problem}");
    let cancel = closed.by(&ann, Method::POST, "jobs/1/cancel").send().await.unwrap();
    assert_eq!(cancel.status(), StatusCode::OK);
    assert_eq!(closed.submit(&ann, 1).await.status(), StatusCode::CREATED);
    let more = json!({"files": {"more": {"hash": BlobHash::of(b"more"), "bytes": 4}}});
    let reply = closed
        .by(&ann, Method::POST, "bundles")
        .json(&more)
        .send()
        .await
        .unwrap();
    let problem = expect_problem(reply, ErrorCode::Quota).await;
    assert!(problem.detail.contains("`bundle_bytes`"), "{problem}");
    assert_eq!(closed.submit(&closed.admin, 50).await.status(), StatusCode::CREATED);
    let list = closed.by(&closed.admin, Method::GET, "tokens").send().await.unwrap();
    let list: TokenList = list.json().await.unwrap();
    let ann = &list.tokens[0];
    assert_eq!((ann.usage.jobs, ann.usage.iterations), (2, 10));
    assert_eq!(ann.usage.bundle_bytes, SCENE.len() as u64);
}

#[tokio::test]
async fn a_job_is_steered_by_its_owner_or_an_administrator() {
    let closed = Closed::start().await;
    let ann = closed.token(&request("ann", Role::Submit)).await;
    let bob = closed.token(&request("bob", Role::Submit)).await;
    for _ in 0..2 {
        assert_eq!(closed.submit(&ann, 4).await.status(), StatusCode::CREATED);
    }
    for (method, path) in [(Method::POST, "jobs/1/cancel"), (Method::DELETE, "jobs/1")] {
        let reply = closed.by(&bob, method, path).send().await.unwrap();
        expect_problem(reply, ErrorCode::Forbidden).await;
    }
    for (token, path) in [(&ann, "jobs/1"), (&closed.admin, "jobs/2")] {
        let cancel = closed.by(token, Method::POST, &format!("{path}/cancel")).send();
        assert_eq!(
            cancel.await.unwrap().json::<Value>().await.unwrap()["state"],
            "cancelled"
        );
        expect_problem(
            closed.by(&bob, Method::DELETE, path).send().await.unwrap(),
            ErrorCode::Forbidden,
        )
        .await;
        let reply = closed.by(token, Method::DELETE, path).send().await.unwrap();
        assert_eq!(reply.status(), StatusCode::NO_CONTENT);
    }
}

#[tokio::test]
async fn idempotency_keys_of_two_tokens_never_meet() {
    let closed = Closed::start().await;
    let mut ids = Vec::new();
    for name in ["ann", "bob", "ann"] {
        let known = closed
            .farm
            .http
            .get(format!("{}/v1/healthz", closed.farm.coordinator.url()));
        assert!(known.send().await.is_ok());
        let token = match ids.len() {
            2 => ids.first().map(|(token, _): &(String, u64)| token.clone()).unwrap(),
            _ => closed.token(&request(name, Role::Submit)).await,
        };
        closed.submit(&token, 1).await;
        let files = [("scene.xml".to_owned(), FileEntry::of(SCENE))].into();
        let spec = json!({"scene": BundleManifest { files }.hash(), "main": "scene.xml",
            "integrator": {"type": "path"}, "iterations": 2});
        let reply = closed
            .by(&token, Method::POST, "jobs")
            .header("idempotency-key", "same");
        let job: Value = reply.json(&spec).send().await.unwrap().json().await.unwrap();
        ids.push((token, job["id"].as_u64().unwrap()));
    }
    assert_ne!(ids[0].1, ids[1].1);
    assert_eq!(ids[0].1, ids[2].1);
}

#[tokio::test]
async fn requests_beyond_the_rate_wait() {
    let farm = Farm::start_with(|config| config.rate = 3).await;
    let reply = farm
        .post_json("tokens", &json!({"name": "boss", "role": "admin"}))
        .await;
    let admin = reply.json::<NewToken>().await.unwrap().token;
    let mut refused = None;
    for _ in 0..100 {
        let reply = farm
            .request(Method::GET, "jobs")
            .bearer_auth(&admin)
            .send()
            .await
            .unwrap();
        if reply.status() == StatusCode::TOO_MANY_REQUESTS {
            refused = Some(reply);
            break;
        }
    }
    let refused = refused.expect("a hundred requests were answered at once");
    assert_eq!(refused.headers()["retry-after"], "1");
    let problem = expect_problem(refused, ErrorCode::TooManyRequests).await;
    assert!(problem.retryable && problem.detail.contains("\"boss\""), "{problem}");
    let mut guesses = 0;
    while farm
        .request(Method::GET, "jobs")
        .bearer_auth("phf_0")
        .send()
        .await
        .unwrap()
        .status()
        == 401
    {
        guesses += 1;
        assert!(guesses < 1000, "guesses are not limited");
    }
}

#[tokio::test]
async fn a_farm_without_tokens_stays_on_its_machine() {
    let folder = tempfile::tempdir().unwrap();
    let listener = async || TcpListener::bind("0.0.0.0:0").await.unwrap();
    let bare = Coordinator::start(Config::new(folder.path()), listener().await).await;
    assert!(matches!(bare, Err(StartError::NoToken(_))));
    drop(bare);
    let stores = open_stores(&Config::new(folder.path())).await.unwrap();
    let made = Tokens::new(stores.state.clone())
        .create(request("boss", Role::Admin))
        .await
        .unwrap();
    drop(stores);
    let coordinator = Coordinator::start(Config::new(folder.path()), listener().await)
        .await
        .unwrap();
    let url = format!("http://127.0.0.1:{}/v1/jobs", coordinator.address().port());
    let http = reqwest::Client::builder().no_proxy().build().unwrap();
    let reply = http.get(&url).send().await.unwrap();
    expect_problem(reply, ErrorCode::Unauthorized).await;
    let reply = http.get(&url).bearer_auth(&made.token).send().await.unwrap();
    assert_eq!(reply.status(), StatusCode::OK);
    coordinator.shutdown().await;
}

#[tokio::test]
async fn a_worker_cannot_look_around() {
    let closed = Closed::start().await;
    let worker = closed.token(&request("w", Role::Worker)).await;
    let reply = closed.by(&worker, Method::POST, "worker/register");
    let reply = reply
        .header("content-type", MESSAGE_MEDIA_TYPE)
        .body("x")
        .send()
        .await
        .unwrap();
    expect_problem(reply, ErrorCode::Malformed).await;
    let reply = closed.by(&worker, Method::GET, "jobs").send().await.unwrap();
    expect_problem(reply, ErrorCode::Forbidden).await;
}
