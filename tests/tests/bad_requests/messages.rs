//! Messages of workers, damaged or untrue.

use super::{JSON, Target};
use photonfarm_core::film::Node;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::check::{CheckAnswer, CheckResult, CheckToken, Checking};
use photonfarm_proto::codec::{self, MESSAGE_MEDIA_TYPE};
use photonfarm_proto::id::{BlobHash, CheckId, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{FailureKind, JobStatus, Totals};
use photonfarm_proto::node::{NodeHeader, NodeKey, encode_node};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::worker::{
    FailureReport, Heartbeat, LeaseProgress, LeaseReply, LeaseRequest, NodeReply, NodeUpload, Register, Registered,
    Release, StatisticsRequest, frame_upload,
};
use reqwest::Method;

/// Every worker message, valid in form.
fn messages() -> Vec<(&'static str, Vec<u8>)> {
    let (worker, token, job) = (WorkerId(1), LeaseToken { number: 1, nonce: 1 }, JobId(1));
    let leases = vec![LeaseProgress { token, leaves_done: 0 }];
    let report = FailureReport {
        token,
        worker,
        job,
        leaf: 0,
        kind: FailureKind::Render,
        message: "m".into(),
        shortage: None,
    };
    let result = CheckResult {
        token: CheckToken {
            id: CheckId(1),
            nonce: 1,
        },
        worker,
        answer: CheckAnswer::Elsewhere("e".into()),
    };
    let register = Register {
        name: "a".into(),
        threads: 1,
        renderer: "0".into(),
        tags: Default::default(),
        memory_mb: None,
    };
    vec![
        ("/v1/worker/register", codec::encode(&register).unwrap()),
        (
            "/v1/worker/lease",
            codec::encode(&LeaseRequest {
                worker,
                serial: 1,
                wait_ms: 0,
                held: Vec::new(),
            })
            .unwrap(),
        ),
        (
            "/v1/worker/heartbeat",
            codec::encode(&Heartbeat {
                worker,
                leases,
                checking: Checking::Ready,
            })
            .unwrap(),
        ),
        (
            "/v1/worker/nodes",
            frame_upload(&upload(worker, token, job, NodeKey::leaf(0))).unwrap(),
        ),
        (
            "/v1/worker/statistics",
            codec::encode(&StatisticsRequest { token, worker, job }).unwrap(),
        ),
        ("/v1/worker/check", codec::encode(&result).unwrap()),
        ("/v1/worker/failures", codec::encode(&report).unwrap()),
        (
            "/v1/worker/release",
            codec::encode(&Release { token, worker, job }).unwrap(),
        ),
    ]
}

fn upload(worker: WorkerId, token: LeaseToken, job: JobId, node: NodeKey) -> NodeUpload {
    let (digest, totals) = (BlobHash::of(b""), Totals::default());
    NodeUpload {
        token,
        worker,
        job,
        node,
        width: 2,
        height: 2,
        digest,
        totals,
        memory_mb: None,
    }
}

#[test]
fn damaged_worker_messages() {
    let target = Target::start();
    for (path, valid) in messages() {
        for end in 0..valid.len() {
            target.refused_message(path, &valid[..end]);
        }
        for bit in 0..valid.len() * 8 {
            let mut damaged = valid.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            // Some of these are valid requests, which may be granted; none is a fault of the service.
            let (status, _) = target.send(Method::POST, path, MESSAGE_MEDIA_TYPE, &damaged);
            assert!(status < 500, "{path} answered {status} with bit {bit} flipped");
        }
        // From the eighth byte on there are counts and lengths: all of them huge.
        let huge = [&valid[..8.min(valid.len())], &[0xff; 64]].concat();
        target.refused_message(path, &huge);
        target.refused_message(path, &[valid.as_slice(), &[0]].concat());
        target.refused_message(path, &[0; 4096]);
        let problem = target.refused(Method::POST, path, JSON, &valid);
        assert_eq!(problem.code, ErrorCode::UnsupportedMediaType);
    }
    target.finish();
}

fn planes(job: JobId, node: &Node) -> Vec<u8> {
    encode_node(job, node)[NodeHeader::BYTES..].to_vec()
}

fn image(value: f32) -> Node {
    Node::leaf(0, 2, 2, &[Spectrum::splat(value); 4]).unwrap()
}

#[test]
fn uploads_that_must_not_count() {
    let target = Target::start();
    let job = target.submit(4);
    let register = Register {
        name: "test".into(),
        threads: 1,
        renderer: photonfarm_proto::RENDERER.to_owned(),
        tags: Default::default(),
        memory_mb: None,
    };
    let Registered { worker, .. } = target.ask("/v1/worker/register", &register);
    let request = LeaseRequest {
        worker,
        serial: 1,
        wait_ms: 0,
        held: Vec::new(),
    };
    let LeaseReply { assignment, .. } = target.ask("/v1/worker/lease", &request);
    let lease = assignment.unwrap().lease;
    let good = image(0.5);
    let digest = BlobHash::of(&encode_node(job, &good));
    let valid = NodeUpload {
        digest,
        ..upload(worker, lease.token, job, NodeKey::leaf(0))
    };
    let body = |upload: &NodeUpload, planes: &[u8]| [frame_upload(upload).unwrap(), planes.to_vec()].concat();
    let good_planes = planes(job, &good);

    let mut bad_totals = valid.clone();
    bad_totals.totals.seconds.other = f64::NAN;
    for (what, body) in [
        ("no planes", body(&valid, b"")),
        ("short planes", body(&valid, &good_planes[..good_planes.len() - 1])),
        ("long planes", body(&valid, &[good_planes.as_slice(), &[0]].concat())),
        (
            "another hash",
            body(
                &NodeUpload {
                    digest: BlobHash::of(b"?"),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a huge image",
            body(
                &NodeUpload {
                    width: u32::MAX,
                    height: u32::MAX,
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "no pixels",
            body(
                &NodeUpload {
                    width: 0,
                    ..valid.clone()
                },
                b"",
            ),
        ),
        (
            "a node beyond the job",
            body(
                &NodeUpload {
                    node: NodeKey::leaf(4),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a level beyond all",
            body(
                &NodeUpload {
                    node: NodeKey { level: 63, index: 0 },
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "an unknown job",
            body(
                &NodeUpload {
                    job: JobId(99),
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        (
            "a lease never given",
            body(
                &NodeUpload {
                    token: LeaseToken {
                        number: u64::MAX,
                        nonce: 0,
                    },
                    ..valid.clone()
                },
                &good_planes,
            ),
        ),
        ("bad totals", body(&bad_totals, &good_planes)),
    ] {
        let problem = target.refused_message("/v1/worker/nodes", &body);
        assert_ne!(problem.code, ErrorCode::Internal, "{what}");
    }
    let (_, answer) = target.send(Method::GET, &format!("/v1/jobs/{job}"), JSON, b"");
    assert_eq!(serde_json::from_slice::<JobStatus>(&answer).unwrap().iterations_done, 0);

    for duplicate in [false, true] {
        let (status, answer) = target.send(
            Method::POST,
            "/v1/worker/nodes",
            MESSAGE_MEDIA_TYPE,
            &body(&valid, &good_planes),
        );
        assert_eq!(status, 200, "{}", String::from_utf8_lossy(&answer));
        assert_eq!(codec::decode::<NodeReply>(&answer).unwrap(), NodeReply { duplicate });
    }
    let other = image(0.25);
    let conflict = NodeUpload {
        digest: BlobHash::of(&encode_node(job, &other)),
        ..valid
    };
    let problem = target.refused_message("/v1/worker/nodes", &body(&conflict, &planes(job, &other)));
    assert_eq!(problem.code, ErrorCode::ResultConflict);

    let LeaseReply { assignment, .. } = target.ask("/v1/worker/lease", &request);
    let lease = assignment.unwrap().lease;
    let mut bad_pixel = Node::leaf(lease.node.index, 2, 2, &[Spectrum::splat(0.5); 4]).unwrap();
    bad_pixel.pixels[4] = f32::NAN;
    let of_bad_pixel = NodeUpload {
        digest: BlobHash::of(&encode_node(job, &bad_pixel)),
        ..upload(worker, lease.token, job, lease.node)
    };
    let of_bad_pixel = body(&of_bad_pixel, &planes(job, &bad_pixel));
    for code in [ErrorCode::Invalid, ErrorCode::StaleLease] {
        let problem = target.refused_message("/v1/worker/nodes", &of_bad_pixel);
        assert_eq!(problem.code, code, "a failure ends the lease");
    }
    target.finish();
}
