//! URLs that are told when jobs end.

use crate::access::{Closed, request};
use crate::support::{Farm, expect_problem};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode as Status};
use photonfarm_coordinator::{Config, Retries, WebhookConfig, WebhookSecret};
use photonfarm_proto::api::JobPage;
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobState;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::token::Role;
use photonfarm_proto::webhook::{DELIVERY, DeliveryPage, DeliveryState, JobNotice, SIGNATURE, TIMESTAMP};
use reqwest::{Method, StatusCode};
use ring::digest::{SHA256, digest};
use serde_json::json;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

const SECRET: &[u8] = b"a secret of this test";

type Told = (HeaderMap, String);

/// A server that is told, and answers as it is asked to: with the statuses that are left, then with 200.
struct Receiver {
    url: String,
    told: mpsc::UnboundedReceiver<Told>,
}

#[derive(Clone)]
struct Answers {
    tell: mpsc::UnboundedSender<Told>,
    left: Arc<Mutex<VecDeque<Status>>>,
}

async fn receive(
    State(answers): State<Answers>,
    headers: HeaderMap,
    body: String,
) -> (Status, [(&'static str, &'static str); 1]) {
    answers.tell.send((headers, body)).unwrap();
    let next = answers.left.lock().unwrap().pop_front();
    // Whoever follows redirects tells twice.
    (next.unwrap_or(Status::OK), [("location", "/hook")])
}

impl Receiver {
    async fn start(answers: &[Status]) -> Self {
        let (tell, told) = mpsc::unbounded_channel();
        let left = Arc::new(Mutex::new(answers.iter().copied().collect()));
        let router = axum::Router::new()
            .route("/hook", axum::routing::any(receive))
            .with_state(Answers { tell, left });
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/hook", listener.local_addr().unwrap());
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self { url, told }
    }

    /// The next that it is told: with a signature that is right, by a construction of its own (RFC 2104).
    async fn next(&mut self) -> (HeaderMap, JobNotice) {
        let (headers, body) = tokio::time::timeout(Duration::from_secs(60), self.told.recv())
            .await
            .unwrap()
            .unwrap();
        let header = |name: &str| headers[name].to_str().unwrap();
        let mut block = [0; 64];
        block[..SECRET.len()].copy_from_slice(SECRET);
        let [inner, outer] = [0x36, 0x5c].map(|pad| block.map(|byte| byte ^ pad));
        let message = format!("{}.{body}", header(TIMESTAMP));
        let inner = digest(&SHA256, &[&inner[..], message.as_bytes()].concat());
        let outer = digest(&SHA256, &[&outer[..], inner.as_ref()].concat());
        let digits: String = outer.as_ref().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(header(SIGNATURE), format!("sha256={digits}"));
        assert_eq!(header("content-type"), "application/json");
        let notice: JobNotice = serde_json::from_str(&body).unwrap();
        assert_eq!(header(DELIVERY), notice.delivery);
        (headers, notice)
    }
}

fn config(urls: &[&str], first: Duration) -> WebhookConfig {
    WebhookConfig {
        secret: Some(WebhookSecret::new(SECRET).unwrap()),
        urls: urls.iter().map(|url| (*url).to_owned()).collect(),
        retries: Retries {
            first,
            ..Retries::default()
        },
        ..WebhookConfig::default()
    }
}

async fn cancel(farm: &Farm, job: JobId) {
    let reply = farm.post_json(&format!("jobs/{job}/cancel"), &json!({})).await;
    assert_eq!(reply.status(), StatusCode::OK);
}

/// The deliveries once none is pending.
async fn settled(farm: &Farm) -> DeliveryPage {
    loop {
        let page: DeliveryPage = farm.get("webhooks").await.json().await.unwrap();
        if page
            .deliveries
            .iter()
            .all(|delivery| delivery.state != DeliveryState::Pending)
        {
            return page;
        }
        tokio::task::yield_now().await;
    }
}

#[tokio::test]
async fn a_url_is_told_again_until_it_answers_well() {
    let mut farms = Receiver::start(&[Status::INTERNAL_SERVER_ERROR, Status::FOUND]).await;
    let mut jobs = Receiver::start(&[]).await;
    let farm = Farm::start_with(|settings| {
        settings.webhooks = WebhookConfig {
            private_addresses: true,
            public_url: Some("https://farm.example/".into()),
            ..config(&[&farms.url], Duration::from_millis(1))
        };
    })
    .await;
    let mut spec = farm.spec(3).await;
    spec["webhook"] = json!(jobs.url);
    spec["name"] = json!("shot 7");
    spec["labels"] = json!({"show": "x"});
    let reply = farm.post_json("jobs", &spec).await;
    assert_eq!(reply.status(), StatusCode::CREATED);
    let job = JobId(1);
    cancel(&farm, job).await;

    let (_, told) = jobs.next().await;
    assert_eq!(
        (told.event.as_str(), told.state, told.job),
        ("job.cancelled", JobState::Cancelled, job)
    );
    assert_eq!((told.name.as_str(), told.labels["show"].as_str()), ("shot 7", "x"));
    assert_eq!(told.link, "https://farm.example/v1/jobs/1");
    assert_eq!(Some(told.at_ms), farm.status(job).await.ended_ms);
    let mut deliveries = Vec::new();
    for _ in 0..3 {
        deliveries.push(farms.next().await.1);
    }
    assert!(
        deliveries.iter().all(|again| *again == deliveries[0]),
        "the same at every attempt"
    );
    assert_ne!(deliveries[0].delivery, told.delivery);

    let page = settled(&farm).await;
    let mut attempts: Vec<_> = page
        .deliveries
        .iter()
        .map(|it| (it.of_farm, it.attempts, it.state))
        .collect();
    attempts.sort_by_key(|(of_farm, ..)| *of_farm);
    let delivered = DeliveryState::Delivered;
    assert_eq!(attempts, [(false, 1, delivered), (true, 3, delivered)]);
    assert!(page.deliveries.iter().all(|it| it.error.is_none() && it.job == job));
    let first: DeliveryPage = farm.get("webhooks?limit=1").await.json().await.unwrap();
    assert_eq!(first.deliveries, page.deliveries[..1]);
    let rest = format!("webhooks?job=1&cursor={}", first.next.unwrap());
    let rest: DeliveryPage = farm.get(&rest).await.json().await.unwrap();
    assert_eq!((rest.deliveries, rest.next), (page.deliveries[1..].to_vec(), None));
    let none: DeliveryPage = farm.get("webhooks?job=2").await.json().await.unwrap();
    assert_eq!(none.deliveries, []);
    let figures = farm.http.get(format!("{}/metrics", farm.coordinator.url())).send();
    let figures = figures.await.unwrap().text().await.unwrap();
    for (outcome, count) in [("delivered", 2), ("failed", 2), ("given_up", 0)] {
        let line = format!("photonfarm_webhook_attempts_total{{outcome=\"{outcome}\"}} {count}");
        assert!(figures.contains(&line), "{figures}");
    }
}

/// The coordinator is told to stop, and another one begins with what it left.
#[tokio::test]
async fn what_is_to_be_told_outlives_the_coordinator() {
    let mut receiver = Receiver::start(&[Status::SERVICE_UNAVAILABLE]).await;
    let url = receiver.url.clone();
    let tells = |settings: &mut Config| settings.webhooks = config(&[&url], Duration::from_secs(1));
    let farm = Farm::start_with(tells).await;
    let job = farm.submit(1).await;
    cancel(&farm, job).await;
    let (_, first) = receiver.next().await;
    let farm = farm.restart_with(tells).await;
    let (_, second) = receiver.next().await;
    assert_eq!(first, second);
    assert_eq!((second.job, second.state), (job, JobState::Cancelled));
    let page = settled(&farm).await;
    assert_eq!(page.deliveries.len(), 1);
    assert_eq!(page.deliveries[0].state, DeliveryState::Delivered);
}

#[tokio::test]
async fn what_nobody_takes_is_given_up_and_says_why() {
    // Nobody listens there.
    let closed = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let url = format!("http://{closed}/hook?token=secret");
    let farm = Farm::start_with(|settings| {
        settings.webhooks = config(&[&url], Duration::from_millis(1));
        settings.webhooks.retries.within = Duration::ZERO;
    })
    .await;
    cancel(&farm, farm.submit(1).await).await;
    let page = settled(&farm).await;
    let given_up = &page.deliveries[0];
    assert_eq!(
        (given_up.state, given_up.attempts, given_up.due_ms),
        (DeliveryState::GivenUp, 1, None)
    );
    let error = given_up.error.as_ref().unwrap();
    assert!(error.contains("refused") && !error.contains("secret"), "{error}");
}

#[tokio::test]
async fn jobs_name_urls_only_where_the_farm_tells_them_and_outside_of_it() {
    let silent = Farm::start().await;
    let refused = async |farm: &Farm, url: &str| {
        let mut spec = farm.spec(1).await;
        spec["webhook"] = json!(url);
        let problem = expect_problem(farm.post_json("jobs", &spec).await, ErrorCode::Invalid).await;
        assert_eq!(problem.field.as_deref(), Some("webhook"));
        problem.detail
    };
    assert!(refused(&silent, "https://example.org/").await.contains("tells no URLs"));
    let farm = Farm::start_with(|settings| settings.webhooks = config(&[], Duration::from_secs(1))).await;
    for (url, reason) in [
        ("http://127.0.0.1:9/", "private network"),
        ("http://[::ffff:10.0.0.1]/", "private network"),
        ("mailto:ann@example.org", "http:// or https://"),
        ("example.org", "not a URL"),
    ] {
        let detail = refused(&farm, url).await;
        assert!(detail.contains(reason), "{url}: {detail}");
    }
    let jobs: JobPage = farm.get("jobs").await.json().await.unwrap();
    assert_eq!(jobs.jobs, []);

    // A name is looked up when it is told, and what is found is looked at.
    let mut spec = farm.spec(1).await;
    spec["webhook"] = json!("http://localhost:9/");
    assert_eq!(farm.post_json("jobs", &spec).await.status(), StatusCode::CREATED);
    cancel(&farm, JobId(1)).await;
    let delivery = loop {
        let page: DeliveryPage = farm.get("webhooks").await.json().await.unwrap();
        if page.deliveries[0].attempts > 0 {
            break page.deliveries.into_iter().next().unwrap();
        }
        tokio::task::yield_now().await;
    };
    assert_eq!(delivery.state, DeliveryState::Pending);
    let error = delivery.error.unwrap();
    assert!(error.contains("no address of the public network"), "{error}");
    for (query, code) in [
        ("limit=0", ErrorCode::Invalid),
        ("limit=101", ErrorCode::Invalid),
        ("cursor=zz", ErrorCode::Malformed),
        ("job=x", ErrorCode::Malformed),
        ("colour=red", ErrorCode::Malformed),
    ] {
        expect_problem(farm.get(&format!("webhooks?{query}")).await, code).await;
    }
}

#[tokio::test]
async fn deliveries_are_for_administrators() {
    let closed = Closed::start().await;
    let token = closed.token(&request("ann", Role::Submit)).await;
    let reply = closed.by(&token, Method::GET, "webhooks").send().await.unwrap();
    expect_problem(reply, ErrorCode::Forbidden).await;
}
