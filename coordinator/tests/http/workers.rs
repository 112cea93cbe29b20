//! What workers send right, wrong and twice.

use crate::support::{Farm, expect_problem};
use photonfarm_core::film::Node;
use photonfarm_core::settings::{IntegratorSettings, PathSettings, PppmSettings};
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::api::WorkerList;
use photonfarm_proto::codec::{decode, encode};
use photonfarm_proto::history::{JobHistory, LeaseOutcome};
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::job::{JobState, Totals};
use photonfarm_proto::node::{NodeHeader, NodeKey, encode_node};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::waiting::Waiting;
use photonfarm_proto::worker::{
    Acknowledged, Assignment, Lease, LeaseRequest, MOST_WARNINGS, NodeReply, NodeUpload, Register, SceneReport,
    StatisticsRequest, frame_upload, read_statistics,
};
use reqwest::{Method, StatusCode};
use serde_json::json;

fn leaf(index: u32, value: f32) -> Node {
    Node::leaf(index, 2, 2, &[Spectrum::splat(value); 4]).unwrap()
}

fn upload(assignment: &Assignment, node: &Node) -> (NodeUpload, Vec<u8>) {
    let image = encode_node(assignment.lease.job, node);
    let announcement = NodeUpload {
        token: assignment.lease.token,
        worker: assignment.lease.worker,
        job: assignment.lease.job,
        node: NodeKey {
            level: node.level,
            index: node.index,
        },
        width: node.width,
        height: node.height,
        digest: BlobHash::of(&image),
        totals: Totals::default(),
    };
    (announcement, image[NodeHeader::BYTES..].to_vec())
}

fn body((announcement, planes): &(NodeUpload, Vec<u8>)) -> Vec<u8> {
    [frame_upload(announcement).unwrap().as_slice(), planes].concat()
}

#[tokio::test]
async fn images_come_at_any_time_and_are_named_by_their_tag() {
    let farm = Farm::start().await;
    let job = farm.submit(3).await;
    expect_problem(farm.get(&format!("jobs/{job}/image.png")).await, ErrorCode::NoImageYet).await;
    expect_problem(farm.get("jobs/9/image.png").await, ErrorCode::NotFound).await;
    let worker = farm.register().await;
    let assignment = farm.lease(worker).await;
    let sent = farm.send("nodes", body(&upload(&assignment, &leaf(0, 0.5)))).await;
    assert_eq!(sent.status(), StatusCode::OK);
    for (name, magic) in [
        ("image.exr", b"\x76\x2f\x31\x01"),
        ("image.png", b"\x89PNG"),
        ("image.raw", b"phot"),
    ] {
        let path = format!("jobs/{job}/{name}");
        let reply = farm.get(&path).await;
        let tag = reply.headers()["etag"].clone();
        assert_eq!(reply.bytes().await.unwrap()[..4], magic[..]);
        let same = farm
            .request(Method::GET, &path)
            .header("if-none-match", &tag)
            .send()
            .await
            .unwrap();
        assert_eq!(same.status(), StatusCode::NOT_MODIFIED);
        let other = farm
            .request(Method::GET, &path)
            .header("if-none-match", "\"x\"")
            .send()
            .await
            .unwrap();
        assert_eq!(other.status(), StatusCode::OK);
    }
    let history: JobHistory = farm.get(&format!("jobs/{job}/history")).await.json().await.unwrap();
    let counted: Vec<u64> = history.progress.iter().map(|sample| sample.iterations).collect();
    assert_eq!(
        (counted, history.noise.len()),
        (vec![0, 1], 0),
        "one iteration has no noise"
    );
    let lease = &history.leases[0];
    assert_eq!((lease.worker, lease.name.as_str(), lease.first), (worker, "test", 1));
    assert_eq!(lease.outcome, LeaseOutcome::Delivered);
    expect_problem(farm.get("jobs/9/history").await, ErrorCode::NotFound).await;
    let cancel = farm.request(Method::POST, &format!("jobs/{job}/cancel")).send();
    assert_eq!(cancel.await.unwrap().status(), StatusCode::OK);
    for name in ["image.exr", "image.png", "image.raw"] {
        let mut answers = Vec::new();
        for _ in 0..2 {
            let reply = farm.get(&format!("jobs/{job}/{name}")).await;
            let length = reply.content_length().unwrap();
            let tag = reply.headers()["etag"].clone();
            let bytes = reply.bytes().await.unwrap();
            assert_eq!(bytes.len() as u64, length);
            answers.push((tag, bytes));
        }
        assert!(answers[0] == answers[1], "{name}: made, then kept");
        let (tag, whole) = &answers[0];
        fetched_in_parts(&farm, &format!("jobs/{job}/{name}"), tag.to_str().unwrap(), whole).await;
    }
}

/// Asks for parts of the picture under this path, which is `whole` and has this tag.
async fn fetched_in_parts(farm: &Farm, path: &str, tag: &str, whole: &[u8]) {
    assert!(tag.starts_with('"'), "a strong tag, of these bytes: {tag}");
    let ask = async |method: Method, headers: &[(&'static str, &str)]| {
        let mut request = farm.request(method, path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        request.send().await.unwrap()
    };
    let length = whole.len();
    for (range, part) in [
        ("bytes=0-", 0..length),
        ("bytes=7-", 7..length),
        ("bytes=2-5", 2..6),
        ("bytes=-3", length - 3..length),
    ] {
        for headers in [&[("range", range)][..], &[("range", range), ("if-range", tag)]] {
            let reply = ask(Method::GET, headers).await;
            assert_eq!(reply.status(), StatusCode::PARTIAL_CONTENT, "{range}");
            let of = format!("bytes {}-{}/{length}", part.start, part.end - 1);
            assert_eq!(reply.headers()["content-range"], of);
            assert_eq!(reply.headers()["etag"], tag);
            assert_eq!(reply.content_length(), Some(part.len() as u64));
            assert_eq!(reply.bytes().await.unwrap(), whole[part.clone()], "{range}");
        }
    }
    for (method, headers) in [
        (Method::GET, &[("range", "bytes=7-"), ("if-range", "\"other\"")][..]),
        (Method::GET, &[("range", "bytes=0-1,4-5")]),
        (Method::HEAD, &[("range", "bytes=7-")]),
    ] {
        let reply = ask(method, headers).await;
        assert_eq!(reply.status(), StatusCode::OK, "{headers:?}");
        assert_eq!(reply.headers()["accept-ranges"], "bytes");
        assert_eq!(reply.headers()["content-length"], length.to_string());
    }
    let known = ask(Method::GET, &[("range", "bytes=7-"), ("if-none-match", tag)]).await;
    assert_eq!(known.status(), StatusCode::NOT_MODIFIED);
    let beyond = ask(Method::GET, &[("range", &format!("bytes={length}-"))]).await;
    assert_eq!(beyond.headers()["content-range"], format!("bytes */{length}"));
    let problem = expect_problem(beyond, ErrorCode::RangeNotSatisfiable).await;
    assert!(problem.detail.contains(&length.to_string()), "{problem}");
}

#[tokio::test]
async fn nodes_count_once_and_stale_tokens_never() {
    let farm = Farm::start().await;
    let job = farm.submit(2).await;
    let worker = farm.register().await;
    let first = farm.lease(worker).await;
    assert_eq!(first.lease.node, NodeKey::leaf(0));
    let good = body(&upload(&first, &leaf(0, 0.5)));
    for duplicate in [false, true, true] {
        let reply = farm.send("nodes", good.clone()).await;
        assert_eq!(
            decode::<NodeReply>(&reply.bytes().await.unwrap()).unwrap(),
            NodeReply { duplicate }
        );
    }
    let other = body(&upload(&first, &leaf(0, 0.75)));
    expect_problem(farm.send("nodes", other).await, ErrorCode::ResultConflict).await;
    let second = farm.lease(worker).await;
    let (mut forged, planes) = upload(&second, &leaf(1, 0.5));
    forged.token.number += 5;
    expect_problem(farm.send("nodes", body(&(forged, planes))).await, ErrorCode::StaleLease).await;
    assert_eq!(farm.status(job).await.iterations_done, 1);
    let last = body(&upload(&second, &leaf(1, 0.25)));
    assert_eq!(farm.send("nodes", last.clone()).await.status(), StatusCode::OK);
    while farm.status(job).await.state != JobState::Done {
        tokio::task::yield_now().await;
    }
    assert_eq!(
        farm.send("nodes", last).await.status(),
        StatusCode::OK,
        "a repeat after the end is known, too"
    );
    assert_eq!(farm.send("nodes", good).await.status(), StatusCode::OK);
}

#[tokio::test]
async fn damaged_nodes_are_refused_and_nothing_counts() {
    let farm = Farm::start().await;
    let job = farm.submit(2).await;
    let worker = farm.register().await;
    let lease = farm.lease(worker).await;
    let (good, planes) = upload(&lease, &leaf(0, 0.5));
    let send = async |change: &dyn Fn(&mut NodeUpload), planes: &[u8]| {
        let mut announcement = good.clone();
        change(&mut announcement);
        farm.send("nodes", body(&(announcement, planes.to_vec()))).await
    };
    expect_problem(farm.send("nodes", vec![]).await, ErrorCode::Malformed).await;
    expect_problem(farm.send("nodes", vec![0xff; 40]).await, ErrorCode::Malformed).await;
    expect_problem(send(&|_| {}, &planes[1..]).await, ErrorCode::Malformed).await;
    expect_problem(send(&|_| {}, &[&planes[..], &[0]].concat()).await, ErrorCode::Malformed).await;
    let mut flipped = planes.clone();
    flipped[5] ^= 1;
    expect_problem(send(&|_| {}, &flipped).await, ErrorCode::ContentMismatch).await;
    expect_problem(send(&|u| u.width = u32::MAX, &planes).await, ErrorCode::Limit).await;
    expect_problem(send(&|u| u.width = 0, &planes).await, ErrorCode::Invalid).await;
    expect_problem(
        send(&|u| u.node = NodeKey { level: 40, index: 0 }, &planes).await,
        ErrorCode::Invalid,
    )
    .await;
    expect_problem(send(&|u| u.node = NodeKey::leaf(2), &planes).await, ErrorCode::Invalid).await;
    expect_problem(send(&|u| u.job = JobId(77), &planes).await, ErrorCode::NotFound).await;
    expect_problem(
        send(&|u| u.totals.seconds.other = f64::NAN, &planes).await,
        ErrorCode::Invalid,
    )
    .await;
    let whole = body(&(good.clone(), planes.clone()));
    for length in (4..whole.len()).step_by(7) {
        expect_problem(farm.send("nodes", whole[..length].to_vec()).await, ErrorCode::Malformed).await;
    }
    assert_eq!(farm.status(job).await.iterations_done, 0);
    assert_eq!(send(&|_| {}, &planes).await.status(), StatusCode::OK);
    let next = farm.lease(worker).await;
    let bigger = Node::leaf(1, 3, 2, &[Spectrum::ONE; 6]).unwrap();
    let problem = expect_problem(
        farm.send("nodes", body(&upload(&next, &bigger))).await,
        ErrorCode::Invalid,
    )
    .await;
    assert!(problem.detail.contains("3 x 2"), "{problem}");
    let mut poisoned = leaf(1, 0.5);
    poisoned.pixels[2] = f32::NAN;
    let poisoned = body(&upload(&next, &poisoned));
    expect_problem(farm.send("nodes", poisoned.clone()).await, ErrorCode::Invalid).await;
    expect_problem(farm.send("nodes", poisoned).await, ErrorCode::StaleLease).await;
    assert_eq!(farm.status(job).await.iterations_done, 1);
}

#[tokio::test]
async fn workers_of_another_version_and_garbage_are_refused() {
    let farm = Farm::start().await;
    let register = Register {
        name: "w".into(),
        threads: 1,
        renderer: "0.0.0+other".into(),
        tags: Default::default(),
    };
    let mut frame = encode(&register).unwrap();
    expect_problem(farm.send("register", frame.clone()).await, ErrorCode::VersionMismatch).await;
    frame[4] = 99;
    let problem = expect_problem(farm.send("register", frame.clone()).await, ErrorCode::VersionMismatch).await;
    assert!(problem.detail.contains("99"), "{problem}");
    for path in ["register", "lease", "heartbeat", "failures", "release", "leave"] {
        expect_problem(farm.send(path, b"garbage!".to_vec()).await, ErrorCode::Malformed).await;
        expect_problem(farm.send(path, vec![]).await, ErrorCode::Malformed).await;
        let json = farm.post_json(&format!("worker/{path}"), &json!({})).await;
        expect_problem(json, ErrorCode::UnsupportedMediaType).await;
    }
    let request = LeaseRequest {
        worker: WorkerId(5),
        serial: 1,
        held: vec![],
        wait_ms: 0,
    };
    expect_problem(
        farm.send("lease", encode(&request).unwrap()).await,
        ErrorCode::UnknownWorker,
    )
    .await;
    assert!(
        farm.get("workers")
            .await
            .json::<WorkerList>()
            .await
            .unwrap()
            .workers
            .is_empty()
    );
    farm.register().await;
    let workers = farm.get("workers").await.json::<WorkerList>().await.unwrap().workers;
    assert_eq!((workers.len(), workers[0].name.as_str()), (1, "test"));
}

#[tokio::test]
async fn what_a_lease_of_a_chain_goes_on_from_is_for_its_worker() {
    let farm = Farm::start().await;
    let mut spec = farm.spec(3).await;
    spec["integrator"] = json!({"type": "sppm"});
    assert_eq!(farm.post_json("jobs", &spec).await.status(), StatusCode::CREATED);
    let worker = farm.register().await;
    let ask = async |assignment: &Assignment, worker| {
        let request = StatisticsRequest {
            token: assignment.lease.token,
            worker,
            job: assignment.lease.job,
        };
        farm.send("statistics", encode(&request).unwrap()).await
    };
    let first = farm.lease(worker).await;
    expect_problem(ask(&first, worker).await, ErrorCode::Invalid).await;
    let bare = body(&upload(&first, &leaf(0, 0.5)));
    expect_problem(farm.send("nodes", bare).await, ErrorCode::Malformed).await;
    let statistics: Vec<f32> = (1..=8).map(|value| value as f32).collect();
    let node = leaf(0, 0.5).with_statistics(statistics.clone()).unwrap();
    let sent = farm.send("nodes", body(&upload(&first, &node))).await;
    assert_eq!(sent.status(), StatusCode::OK);
    let second = farm.lease(worker).await;
    assert_eq!(second.lease.node, NodeKey::leaf(1));
    let reply = ask(&second, worker).await;
    assert_eq!(reply.status(), StatusCode::OK);
    let found = read_statistics(&reply.bytes().await.unwrap(), 8);
    assert_eq!(found, Some(statistics));
    expect_problem(ask(&first, worker).await, ErrorCode::StaleLease).await;
    let other = farm.register().await;
    expect_problem(ask(&second, other).await, ErrorCode::StaleLease).await;
}

/// What one worker says of a scene can be wrong, and so can what another one says: neither is to blame.
#[tokio::test]
async fn workers_that_disagree_about_settings_are_not_blamed_and_the_job_says_so() {
    let farm = Farm::start().await;
    let job = farm.submit(8).await;
    let of_depth = |max_depth| {
        IntegratorSettings::Path(PathSettings {
            max_depth,
            ..PathSettings::default()
        })
    };
    let report = |lease: &Lease, integrator: IntegratorSettings| SceneReport {
        token: lease.token,
        worker: lease.worker,
        job,
        integrator,
        warnings: vec!["scene.xml:2: <medium> is left out".into()],
    };
    let first = farm.lease(farm.register().await).await.lease;
    // Whoever is alone may say something else.
    for depth in [Some(3), Some(4)] {
        let _: Acknowledged = farm.call("scene", &report(&first, of_depth(depth))).await;
    }
    let second = farm.lease(farm.register().await).await.lease;
    let refused = farm
        .send("scene", encode(&report(&second, of_depth(Some(5)))).unwrap())
        .await;
    expect_problem(refused, ErrorCode::ResultConflict).await;
    let status = farm.status(job).await;
    assert_eq!(status.waiting_reason, Some(Waiting::Dispute));
    assert!(status.waiting.unwrap().contains("submit it with all settings"));
    let figures = farm.http.get(format!("{}/metrics", farm.coordinator.url())).send();
    let figures = figures.await.unwrap().text().await.unwrap();
    assert!(
        figures.contains("photonfarm_jobs_waiting{reason=\"dispute\"} 1"),
        "{figures}"
    );
    let version = photonfarm_proto::VERSION;
    assert!(
        figures.contains(&format!("photonfarm_build_info{{version=\"{version}\",")),
        "{figures}"
    );
    assert_eq!(status.integrator, Some(of_depth(Some(4))));
    assert_eq!(status.warnings, ["scene.xml:2: <medium> is left out"]);
    assert_eq!((status.poisoned, status.workers), (vec![], 2));
    let _: Acknowledged = farm.call("scene", &report(&second, of_depth(Some(4)))).await;
    let other = IntegratorSettings::Pppm(PppmSettings::default());
    let refused = farm.send("scene", encode(&report(&second, other)).unwrap()).await;
    expect_problem(refused, ErrorCode::Invalid).await;
    let talkative = SceneReport {
        warnings: vec![String::new(); MOST_WARNINGS + 1],
        ..report(&second, of_depth(Some(4)))
    };
    let refused = farm.send("scene", encode(&talkative).unwrap()).await;
    expect_problem(refused, ErrorCode::Invalid).await;
}
