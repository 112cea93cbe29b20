//! Workers that register as they should, and then do what they should not, while honest ones work.

use photonfarm_core::film::Node;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::check::Checking;
use photonfarm_proto::codec::{self, MESSAGE_MEDIA_TYPE, Message};
use photonfarm_proto::id::{BlobHash, JobId, LeaseToken, WorkerId};
use photonfarm_proto::job::{JobState, JobStatus, Totals};
use photonfarm_proto::node::{NodeHeader, NodeKey, encode_node};
use photonfarm_proto::problem::{ErrorCode, Problem};
use photonfarm_proto::worker::{
    Heartbeat, HeartbeatReply, Lease, LeaseProgress, LeaseReply, LeaseRequest, NodeUpload, Register, Registered,
    frame_upload,
};
use photonfarm_tests::farm::{Client, Farm, Job, Random, Reference};
use photonfarm_tests::processes::{Process, photonfarm, wait_for};
use reqwest::Method;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

const SIZE: u32 = 24;
/// Memory that a coordinator may use at most under attack [bytes].
const MEMORY: u64 = 256 << 20;

fn job(iterations: u32) -> Arc<Reference> {
    job_by("pppm", iterations)
}

fn job_by(integrator: &'static str, iterations: u32) -> Arc<Reference> {
    let job = Job {
        scene: "environment",
        integrator,
        size: SIZE,
        iterations,
        more: &["--set", "photons=20000"],
    };
    job.alone()
}

/// Counts requests for work, of all attackers together.
static SERIAL: AtomicU64 = AtomicU64::new(1);

/// A worker in the hands of an attacker.
struct Attacker {
    client: Client,
    worker: WorkerId,
}

impl Attacker {
    fn new(client: &Client, name: &str) -> Self {
        let register = Register {
            name: name.into(),
            threads: 1,
            renderer: photonfarm_proto::RENDERER.to_owned(),
            tags: Default::default(),
            memory_mb: None,
        };
        let Registered { worker, .. } = ask(client, "worker/register", &register).unwrap();
        let client = client.clone();
        Self { client, worker }
    }

    /// A lease; none if it gets none, in quarantine or where there is none left.
    fn lease(&self, held: &[LeaseToken]) -> Option<Lease> {
        let request = LeaseRequest {
            worker: self.worker,
            serial: SERIAL.fetch_add(1, Ordering::Relaxed),
            wait_ms: 0,
            held: held.into(),
        };
        let LeaseReply { assignment, .. } = ask(&self.client, "worker/lease", &request).unwrap();
        Some(assignment?.lease)
    }

    fn upload(&self, lease: &Lease, node: &Node) -> NodeUpload {
        NodeUpload {
            token: lease.token,
            worker: self.worker,
            job: lease.job,
            node: NodeKey {
                level: node.level,
                index: node.index,
            },
            width: node.width,
            height: node.height,
            digest: BlobHash::of(&encode_node(lease.job, node)),
            totals: Totals::default(),
            memory_mb: None,
        }
    }

    /// Delivers a node as it should be delivered.
    fn deliver(&self, lease: &Lease, node: &Node) -> Result<(), Problem> {
        self.deliver_as(&self.upload(lease, node), lease.job, node)
    }

    /// Delivers a node under another announcement.
    fn deliver_as(&self, upload: &NodeUpload, job: JobId, node: &Node) -> Result<(), Problem> {
        let planes = &encode_node(job, node)[NodeHeader::BYTES..];
        let body = [&frame_upload(upload).unwrap(), planes].concat();
        post(&self.client, "worker/nodes", body).map(drop)
    }
}

fn ask<M: Message, R: Message>(client: &Client, path: &str, message: &M) -> Result<R, Problem> {
    let answer = post(client, path, codec::encode(message).unwrap())?;
    Ok(codec::decode(&answer).unwrap())
}

/// The answer, or the problem of a request that was refused as it should be.
fn post(client: &Client, path: &str, body: Vec<u8>) -> Result<Vec<u8>, Problem> {
    let kind = [("content-type", MESSAGE_MEDIA_TYPE)];
    let (status, answer) = client
        .send(Method::POST, path, &kind, body)
        .expect("the coordinator answers");
    let text = String::from_utf8_lossy(&answer);
    assert!(
        status == 200 || (400..500).contains(&status),
        "{path} answered {status}: {text}"
    );
    if status == 200 {
        return Ok(answer);
    }
    Err(serde_json::from_slice(&answer).unwrap_or_else(|error| panic!("{path}: {error}: {text}")))
}

/// The sum of a lease's leaves, all pixels alike.
fn plain(node: NodeKey, size: u32, value: f32) -> Node {
    let leaf = Node::leaf(0, size, size, &vec![Spectrum::splat(value); (size * size) as usize]).unwrap();
    Node {
        level: node.level,
        index: node.index,
        ..leaf
    }
}

/// Whether somebody is in quarantine.
fn is_held(client: &Client, name: &str) -> bool {
    let workers = client.workers().expect("an answer").workers;
    workers
        .iter()
        .any(|worker| worker.name == name && worker.quarantine.is_some())
}

/// Every other worker is in good standing.
fn check_standing(client: &Client) {
    for worker in client.workers().expect("an answer").workers {
        let honest = worker.name.starts_with("worker-");
        assert!(
            !honest || worker.quarantine.is_none(),
            "an honest worker suffers: {worker:?}"
        );
    }
}

fn check_memory(farm: &mut Farm) {
    let memory = farm.servers[0].process().peak_memory().expect("the system tells");
    println!("the coordinator used {} MB at most", memory >> 20);
    assert!(memory < MEMORY, "the coordinator used {memory} bytes");
}

#[test]
fn images_that_cannot_be_are_refused_and_blamed() {
    let mut farm = Farm::start(&[]);
    farm.hire(2);
    let (first, second) = (farm.submit(&job(40)), farm.submit(&job(41)));
    let client = farm.client.clone();
    client.when_done(first, 2);
    client.when_done(second, 2);
    let mut refused = 0;
    for (number, value) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -f32::MIN_POSITIVE]
        .into_iter()
        .enumerate()
    {
        let attacker = Attacker::new(&client, &format!("pixel {number}"));
        let Some(lease) = attacker.lease(&[]) else { continue };
        for at in [4, 7] {
            let mut node = plain(lease.node, SIZE, 0.5);
            node.pixels[at] = value;
            let problem = attacker.deliver(&lease, &node).unwrap_err();
            assert!(
                matches!(problem.code, ErrorCode::Invalid | ErrorCode::StaleLease),
                "{value}: {problem:?}"
            );
            refused += 1;
        }
    }
    for (number, size) in [1, SIZE - 1, SIZE + 1, 1000].into_iter().enumerate() {
        let attacker = Attacker::new(&client, &format!("size {number}"));
        let Some(lease) = attacker.lease(&[]) else { continue };
        let problem = attacker.deliver(&lease, &plain(lease.node, size, 0.5)).unwrap_err();
        assert_eq!(problem.code, ErrorCode::Invalid, "{size}: {problem:?}");
        refused += 1;
    }
    assert!(refused > 8, "the job was over before anything was sent");
    let (coordinators, _) = farm.settle();
    assert!(!coordinators.contains("ERROR"), "{coordinators}");
}

#[test]
fn nodes_of_others_and_leases_of_yesterday_do_not_count() {
    let mut farm = Farm::start(&[]);
    let (first, second) = (job(16), job(17));
    let jobs = [farm.submit(&first), farm.submit(&second)];
    let client = farm.client.clone();
    let (attacker, accomplice) = (Attacker::new(&client, "attacker"), Attacker::new(&client, "accomplice"));
    let mine = attacker.lease(&[]).unwrap();
    let theirs = accomplice.lease(&[]).unwrap();
    assert_ne!(mine.token, theirs.token);
    let other_job = *jobs.iter().find(|job| **job != mine.job).unwrap();
    let node = plain(mine.node, SIZE, 0.5);
    let honest = attacker.upload(&mine, &node);
    let elsewhere = |job: JobId| BlobHash::of(&encode_node(job, &node));
    let forged = [
        (
            "a lease of another worker",
            NodeUpload {
                token: theirs.token,
                ..honest.clone()
            },
        ),
        (
            "the name of another worker",
            NodeUpload {
                worker: accomplice.worker,
                ..honest.clone()
            },
        ),
        (
            "a lease never given",
            NodeUpload {
                token: LeaseToken {
                    number: 1 << 40,
                    nonce: 0,
                },
                ..honest.clone()
            },
        ),
        (
            "a worker never seen",
            NodeUpload {
                worker: WorkerId(1 << 40),
                ..honest.clone()
            },
        ),
        (
            "another job",
            NodeUpload {
                job: other_job,
                digest: elsewhere(other_job),
                ..honest.clone()
            },
        ),
    ];
    for (what, upload) in forged {
        let problem = attacker.deliver_as(&upload, upload.job, &node).unwrap_err();
        assert_eq!(problem.code, ErrorCode::StaleLease, "{what}: {problem:?}");
    }
    let outside = plain(
        NodeKey {
            index: mine.node.index + 1,
            ..mine.node
        },
        SIZE,
        0.5,
    );
    let problem = attacker.deliver(&mine, &outside).unwrap_err();
    assert_eq!(problem.code, ErrorCode::Invalid, "{problem:?}");

    // The attacker asks for more without naming its lease, which ends with that; then it uses it all the same.
    attacker.lease(&[]).unwrap();
    let problem = attacker.deliver(&mine, &node).unwrap_err();
    assert_eq!(problem.code, ErrorCode::StaleLease, "{problem:?}");
    for job in jobs {
        assert_eq!(client.when_done(job, 0).iterations_done, 0);
    }
    farm.hire(2);
    let _logs = farm.settle();
}

#[test]
fn frames_that_are_none_change_nothing() {
    let mut farm = Farm::start(&[]);
    farm.hire(2);
    let job = farm.submit(&job(60));
    let client = farm.client.clone();
    client.when_done(job, 1);
    let attacker = Attacker::new(&client, "attacker");
    let lease = attacker.lease(&[]).expect("a lease");
    let node = plain(lease.node, SIZE, 0.5);
    let valid = [
        &frame_upload(&attacker.upload(&lease, &node)).unwrap(),
        &encode_node(lease.job, &node)[NodeHeader::BYTES..],
    ]
    .concat();
    let mut random = Random::new(1);
    let paths = [
        "worker/register",
        "worker/lease",
        "worker/heartbeat",
        "worker/nodes",
        "worker/nodes/place",
        "worker/nodes/stored",
        "worker/failures",
        "worker/release",
        "worker/leave",
    ];
    for path in paths {
        for length in [0, 3, 8, 200, 5000] {
            let garbage: Vec<u8> = (0..length).map(|_| random.number() as u8).collect();
            post(&client, path, garbage).unwrap_err();
        }
        for _ in 0..10 {
            let cut = random.below(valid.len() as u64) as usize;
            post(&client, path, valid[..cut].into()).unwrap_err();
        }
    }
    let status: JobStatus = client.get(&format!("jobs/{job}")).unwrap();
    assert_eq!(status.poisoned, [], "{status:?}");
    check_memory(&mut farm);
    let (coordinators, _) = farm.settle();
    assert!(!coordinators.contains("ERROR"), "{coordinators}");
}

#[test]
fn a_worker_that_keeps_what_it_was_lent_holds_nobody_up() {
    let mut farm = Farm::start(&[]);
    let job = farm.submit(&job(40));
    let client = farm.client.clone();
    let sloth = Attacker::new(&client, "sloth");
    let mut held = Vec::new();
    while let Some(lease) = sloth.lease(&held) {
        held.push(lease.token);
    }
    assert!(held.len() > 1, "it was lent {} blocks", held.len());
    farm.hire(2);
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) {
                let leases = held.iter().map(|token| LeaseProgress {
                    token: *token,
                    leaves_done: 0,
                });
                let heartbeat = Heartbeat {
                    worker: sloth.worker,
                    leases: leases.collect(),
                    checking: Checking::Not,
                };
                let _reply: HeartbeatReply = ask(&client, "worker/heartbeat", &heartbeat).unwrap();
                std::thread::sleep(Duration::from_millis(200));
            }
        });
        let done = client.when(job, "the end", |job| job.state.ended());
        ended.store(true, Ordering::Relaxed);
        assert_eq!(done.state, JobState::Done);
        println!(
            "it took {:.1} s",
            (done.ended_ms.unwrap() - done.created_ms) as f64 / 1e3
        );
    });
    assert_eq!(farm.failed_attempts(), 0, "nobody's lease ran out");
    let _logs = farm.settle();
}

/// Sends the head of an upload that announces `node`, and then bytes without end, at about the speed given, until it is
/// hung up on or `ended`.
fn drip(client: &Client, upload: &NodeUpload, bytes_per_second: u64, ended: &AtomicBool) {
    let address = client.url.trim_start_matches("http://");
    while !ended.load(Ordering::Relaxed) {
        let Ok(mut stream) = TcpStream::connect(address) else {
            continue;
        };
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let head = format!(
            "POST /v1/worker/nodes HTTP/1.1\r\nhost: localhost\r\ncontent-type: {MESSAGE_MEDIA_TYPE}\r\ntransfer-encoding: \
             chunked\r\n\r\n"
        );
        let frame = frame_upload(upload).unwrap();
        let chunk = |bytes: &[u8]| [format!("{:x}\r\n", bytes.len()).as_bytes(), bytes, b"\r\n"].concat();
        let mut sent = stream.write_all(&[head.as_bytes(), &chunk(&frame)].concat());
        let piece = chunk(&vec![0; (bytes_per_second / 20).clamp(1, 1 << 16) as usize]);
        while sent.is_ok() && !ended.load(Ordering::Relaxed) {
            if bytes_per_second < 20 << 16 {
                std::thread::sleep(Duration::from_millis(50));
            }
            sent = stream.write_all(&piece);
            if stream.read(&mut [0; 4096]).is_ok() {
                break;
            }
        }
    }
}

#[test]
fn slow_and_huge_uploads_hold_nobody_up() {
    let mut farm = Farm::start(&[]);
    let reference = job(30);
    let job = farm.submit(&reference);
    let client = farm.client.clone();
    let attacker = Attacker::new(&client, "attacker");
    let lease = attacker.lease(&[]).unwrap();
    let huge = |token: LeaseToken| NodeUpload {
        token,
        width: 8192,
        height: 8192,
        ..attacker.upload(&lease, &plain(lease.node, 1, 0.0))
    };
    let (with, without) = (
        huge(lease.token),
        huge(LeaseToken {
            number: 1 << 40,
            nonce: 0,
        }),
    );
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for upload in [&with, &without] {
            (0..8).for_each(|_| drop(scope.spawn(|| drip(&client, upload, 20_000, &ended))));
        }
        for _ in 0..2 {
            scope.spawn(|| drip(&client, &without, u64::MAX, &ended));
        }
        farm.hire(2);
        let done = wait_for("the end", || {
            let status: JobStatus = client.get(&format!("jobs/{job}"))?;
            status.state.ended().then_some(status)
        });
        ended.store(true, Ordering::Relaxed);
        println!(
            "it took {:.1} s",
            (done.ended_ms.unwrap() - done.created_ms) as f64 / 1e3
        );
    });
    check_memory(&mut farm);
    let _logs = farm.settle();
}

#[test]
fn a_first_image_of_another_size_is_found_out() {
    let mut farm = Farm::start(&["--verify", "10"]);
    let job = farm.submit(&job(24));
    let client = farm.client.clone();
    // With another worker about, what the attacker sends is to be repeated.
    let (attacker, _bystander) = (Attacker::new(&client, "attacker"), Attacker::new(&client, "bystander"));
    let lease = attacker.lease(&[]).unwrap();
    attacker.deliver(&lease, &plain(lease.node, 3, 0.5)).unwrap();
    assert_eq!(client.when_done(job, 1).resolution, Some([3; 2]));
    farm.hire(2);
    let done = client.when(job, "the end", |job| job.state.ended());
    assert_eq!(done.resolution, Some([SIZE; 2]), "{done:?}");
    assert!(is_held(&client, "attacker"));
    check_standing(&client);
    let _logs = farm.settle();
}

#[test]
fn wrong_bits_of_every_node_are_found_out() {
    let mut farm = Farm::start(&["--verify", "4294967295"]);
    let cache = farm.folder().join("liar");
    let _liar = Process::start("liar", &[&farm.client.url, "liar", cache.to_str().unwrap()]);
    let client = farm.client.clone();
    wait_for("the liar", || (client.workers()?.workers.len() == 1).then_some(()));
    let job = farm.submit(&job(30));
    client.when_done(job, 1);
    farm.hire(2);
    client.when(job, "the end", |job| job.state.ended());
    assert!(is_held(&client, "liar"));
    check_standing(&client);
    let _logs = farm.settle();
}

/// An attacker who is alone begins a chain with a lie, honest workers go on from it, and then the attacker is found out at
/// another job.
#[test]
fn what_honest_workers_built_on_a_lie_is_rendered_again() {
    let mut farm = Farm::start(&["--verify", "4294967295"]);
    let client = farm.client.clone();
    let [chain, other] = [("sppm", 64), ("pppm", 8)].map(|(by, iterations)| farm.submit(&job_by(by, iterations)));
    let attacker = Attacker::new(&client, "attacker");
    let first = attacker.lease(&[]).unwrap();
    assert_eq!((first.job, first.node), (chain, NodeKey::leaf(0)));
    let statistics = vec![0.01; (SIZE * SIZE * 2) as usize];
    let lie = plain(first.node, SIZE, 0.5).with_statistics(statistics).unwrap();
    attacker.deliver(&first, &lie).unwrap();
    let steer = |what: &str| {
        let id = chain.to_string();
        assert!(photonfarm(&[what, &id, "--coordinator", &client.url]).status.success());
    };
    steer("pause");
    let second = attacker.lease(&[]).unwrap();
    assert_eq!(second.job, other);
    steer("resume");
    farm.hire(2);
    client.when_done(chain, 3);
    steer("pause");
    attacker.deliver(&second, &plain(second.node, SIZE, 0.5)).unwrap();
    wait_for("the attacker's quarantine", || {
        is_held(&client, "attacker").then_some(())
    });
    let status = client.when(chain, "the loss of what was built", |job| job.iterations_done == 0);
    assert!(!status.state.ended());
    steer("resume");
    check_standing(&client);
    let _logs = farm.settle();
}
