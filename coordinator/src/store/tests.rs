//! One conformance suite for every store, and what is special to each.

use super::memory::MemoryStore;
use super::*;
use crate::scheduler::record::{
    Counters, FailedAttempt, JobControl, JobHead, LeaseRecord, Loss, NodeRecord, Opinion, Origin, Principal, Renewal,
    Standing, WorkerRecord,
};
use photonfarm_core::settings::{IntegratorSettings, PppmSettings};
use photonfarm_proto::bundle::FileEntry;
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::job::{Attempt, BandwidthRange, FailureKind, JobSpec, JobState, Totals};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::schedule::{Checkpoint, Stop, StopReason};
use photonfarm_proto::token::{Quota, Role, Usage};
use photonfarm_test_servers::Postgres;
use std::path::Path;

fn spec() -> JobSpec {
    JobSpec {
        scene: BlobHash::of(b"bundle"),
        main: "scene.xml".into(),
        defines: [("a".to_owned(), "b".to_owned())].into(),
        sensor: None,
        integrator: IntegratorSettings::Pppm(PppmSettings::default()).into(),
        iterations: 9,
        seed: u64::MAX,
        schedule: Default::default(),
        layers: Vec::new(),
        name: String::new(),
        labels: Default::default(),
        after: None,
        webhook: None,
    }
}

pub(super) fn head(id: u64, key: Option<&str>) -> JobHead {
    JobHead {
        id: JobId(id),
        spec: spec(),
        owner: if id == 2 { String::new() } else { "ann".into() },
        key: key.map(str::to_owned),
        created_ms: 1_700_000_000_000 + id,
    }
}

fn token(number: u64) -> LeaseToken {
    LeaseToken {
        number,
        nonce: u64::MAX - number,
    }
}

fn lease(number: u64) -> LeaseRecord {
    LeaseRecord {
        token: token(number),
        job: JobId(1),
        node: NodeKey { level: 1, index: 2 },
        worker: WorkerId(1),
        serial: 3,
        attempt: 1,
        granted_ms: 5,
        expected_ms: number.is_multiple_of(2).then_some(7),
        verifies: number == 2,
        share: [number, 10 * number],
        until_ms: 9,
        restarts: 0,
    }
}

fn added(node: NodeKey) -> Change {
    let bandwidth = Some(BandwidthRange::one(0.1, None));
    let totals = Totals {
        bandwidth,
        ..Totals::default()
    };
    let digest = BlobHash::of(format!("{node}").as_bytes());
    Change::NodeAdded {
        job: JobId(1),
        node,
        record: NodeRecord {
            worker: Some(WorkerId(1)),
            totals: Some(totals),
            unread: true,
            copy: u64::MAX,
            ..NodeRecord::new(digest)
        },
        resolution: [3, 2],
    }
}

fn worker(id: u64) -> WorkerRecord {
    WorkerRecord {
        id: WorkerId(id),
        name: "w".into(),
        threads: 2,
        renderer: "1".into(),
        tags: ["gpu=no".to_owned()].into(),
        origin: Origin {
            token: "rack".into(),
            machine: "10.0.0.7".into(),
        },
        standing: Standing::default(),
    }
}

/// Every kind of change, in an order that a farm could make.
pub(super) fn history() -> Vec<Vec<Change>> {
    let job = JobId(1);
    let [left, right] = [NodeKey::leaf(0), NodeKey::leaf(1)];
    let attempt = |message: &str| FailedAttempt {
        attempt: Attempt {
            worker: WorkerId(1),
            kind: FailureKind::Render,
            message: message.into(),
            at_ms: 3,
        },
        principal: Principal(u64::MAX - 5),
        repeated: true,
    };
    vec![
        vec![Change::WorkerRegistered(worker(1)), Change::WorkerRegistered(worker(2))],
        vec![Change::WorkerJudged {
            worker: WorkerId(1),
            standing: Standing {
                verified: 2,
                faults: 1,
                quarantine: Some("why".into()),
                drained: true,
            },
        }],
        vec![Change::WorkerForgotten(WorkerId(2))],
        vec![Change::JobSubmitted(head(1, Some("key")).into())],
        vec![
            Change::JobSubmitted(head(2, None).into()),
            Change::JobSubmitted(head(3, None).into()),
        ],
        vec![Change::JobChanged {
            job,
            control: JobControl {
                iterations: 12,
                renderer: Some("1+x".into()),
                checkpoint: Some(Checkpoint {
                    iterations: 4,
                    noise: Some(0.25),
                }),
                ..JobControl::of(&spec())
            },
        }],
        vec![Change::LeaseGranted(lease(1)), Change::LeaseGranted(lease(2))],
        vec![Change::LeasesRenewed(vec![Renewal {
            job,
            token: token(2),
            until_ms: 11,
            restarts: 3,
        }])],
        vec![Change::LeaseEnded { job, token: token(1) }, added(left)],
        vec![added(right)],
        vec![
            Change::NodeMerged { job, node: left },
            Change::NodeMerged { job, node: right },
            added(NodeKey { level: 1, index: 0 }),
        ],
        vec![added(NodeKey::leaf(5)), added(NodeKey::leaf(6))],
        vec![Change::NodeLost {
            job,
            node: NodeKey::leaf(6),
            loss: Loss::Damaged,
        }],
        vec![Change::NodeJudged {
            job,
            node: NodeKey::leaf(5),
            record: NodeRecord {
                verified: true,
                opinions: vec![Opinion {
                    principal: Principal(9),
                    worker: WorkerId(1),
                    digest: BlobHash::of(b"5"),
                }],
                ..NodeRecord::new(BlobHash::of(b"other"))
            },
        }],
        vec![
            Change::LeafFailed {
                job,
                leaf: 3,
                attempt: attempt("first"),
            },
            Change::LeafFailed {
                job,
                leaf: 3,
                attempt: attempt("second"),
            },
        ],
        vec![Change::JobEnded {
            job: JobId(3),
            state: JobState::Failed,
            failure: Some("why".into()),
            ended_ms: 1_700_000_000_009,
        }],
        vec![Change::NodeLost {
            job,
            node: NodeKey { level: 1, index: 0 },
            loss: Loss::Untrusted,
        }],
        vec![reopened()],
        vec![
            Change::LeafFailed {
                job: JobId(3),
                leaf: 1,
                attempt: attempt("forgotten"),
            },
            Change::FailuresForgotten { job: JobId(3) },
        ],
        short_life(),
        vec![Change::JobDeleted {
            job: JobId(4),
            ended_ms: 1_700_000_000_010,
            owner: "ann".into(),
            iterations: 9,
        }],
    ]
}

/// Job 4 leaves something of everything behind, and ends.
pub(super) fn short_life() -> Vec<Change> {
    let job = JobId(4);
    let attempt = Attempt {
        worker: WorkerId(1),
        kind: FailureKind::Lost,
        message: "away".into(),
        at_ms: 3,
    };
    let attempt = FailedAttempt {
        attempt,
        principal: Principal(1),
        repeated: false,
    };
    vec![
        Change::JobSubmitted(head(4, Some("short")).into()),
        Change::NodeAdded {
            job,
            node: NodeKey::leaf(0),
            record: NodeRecord::new(BlobHash::of(b"short")),
            resolution: [3, 2],
        },
        Change::LeafFailed { job, leaf: 1, attempt },
        Change::JobEnded {
            job,
            state: JobState::Cancelled,
            failure: None,
            ended_ms: 1_700_000_000_010,
        },
    ]
}

/// Job 3 goes on with more iterations.
fn reopened() -> Change {
    let control = JobControl {
        iterations: 20,
        stop: Some(Stop {
            reason: StopReason::Noise,
            asked: 9,
        }),
        ..JobControl::of(&spec())
    };
    let record = JobRecord {
        control,
        share_ms: 0,
        head: head(3, None),
        state: JobState::Queued,
        failure: None,
        ended_ms: None,
        resolution: None,
        totals: Totals::default(),
        nodes: vec![],
        leases: vec![],
        failures: vec![],
    };
    Change::JobReopened {
        record: Box::new(record),
        ended_ms: 1_700_000_000_009,
    }
}

/// The state of a farm of the first version, as rows.
const FIRST_VERSION: &str = "
INSERT INTO worker VALUES (1, 'w', 2, '0.1.0');
INSERT INTO node VALUES (1, 1, 0, zeroblob(32), 1), (1, 0, 1, zeroblob(32), 0);
INSERT INTO lease VALUES (7, 1, 1, 1, 1, 2, 5, NULL);
INSERT INTO failure VALUES (1, 3, '{\"worker\": 1, \"kind\": \"lost\", \"message\": \"away\"}');
PRAGMA application_id = 0x5048464d; PRAGMA user_version = 1;
";

#[tokio::test]
async fn a_farm_of_the_first_version_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("farm.sqlite");
    let old = rusqlite::Connection::open(&path).unwrap();
    old.execute_batch(super::sqlite_schema::SCHEMA_1).unwrap();
    let (spec_text, totals) = (
        serde_json::to_string(&spec()),
        serde_json::to_string(&Totals::default()),
    );
    let insert = "INSERT INTO job (id, spec, created_ms, state, totals) VALUES (1, ?1, 5, '\"running\"', ?2)";
    old.execute(insert, [spec_text.unwrap(), totals.unwrap()]).unwrap();
    old.execute_batch(FIRST_VERSION).unwrap();
    drop(old);
    let store = SqliteStore::open(&path).unwrap();
    assert_eq!(store.tokens().await.unwrap(), []);
    let (_, snapshot) = store.load().await.unwrap();
    drop(store);
    let job = &snapshot.jobs[0];
    assert_eq!(
        (job.control.clone(), job.head.owner.as_str()),
        (JobControl::of(&spec()), "")
    );
    assert_eq!(
        (job.failures[0].0, job.failures[0].1.attempt.message.as_str()),
        (3, "away")
    );
    let node = |live| NodeRecord {
        live,
        ..NodeRecord::new(BlobHash([0; 32]))
    };
    let nodes = [
        (NodeKey::leaf(1), node(false)),
        (NodeKey { level: 1, index: 0 }, node(true)),
    ];
    assert_eq!(job.nodes, nodes);
    let lease = &job.leases[0];
    let old = LeaseToken { number: 7, nonce: 0 };
    assert_eq!((lease.token, lease.node), (old, NodeKey { level: 1, index: 1 }));
    assert_eq!((snapshot.workers[0].id, snapshot.workers[0].threads), (WorkerId(1), 2));
    SqliteStore::open(&path).unwrap();
}

async fn open_sqlite(folder: &Path) -> SqliteStore {
    SqliteStore::open(&folder.join("farm.sqlite")).unwrap()
}

async fn open_postgres(url: &str) -> PostgresStore {
    PostgresStore::open(url.parse().unwrap(), "the test's database")
        .await
        .unwrap()
}

/// A new store of every kind.
pub(super) async fn stores(folder: &Path) -> [Box<dyn StateStore>; 3] {
    [
        Box::new(open_sqlite(folder).await),
        Box::new(open_postgres(&Postgres::shared().database()).await),
        Box::<MemoryStore>::default(),
    ]
}

/// Where a farm is kept.
pub(super) enum Kept<'a> {
    Sqlite(&'a Path),
    Postgres(String),
}

impl Kept<'_> {
    pub(super) async fn open(&self) -> Box<dyn StateStore> {
        match self {
            Self::Sqlite(folder) => Box::new(open_sqlite(folder).await),
            Self::Postgres(url) => Box::new(open_postgres(url).await),
        }
    }
}

/// A store that is opened anew after every commit keeps the same as rows in memory.
#[tokio::test]
async fn the_database_keeps_what_it_commits() {
    let folder = tempfile::tempdir().unwrap();
    for kept in [
        Kept::Sqlite(folder.path()),
        Kept::Postgres(Postgres::shared().database()),
    ] {
        keeps_what_it_commits(kept).await;
    }
}

async fn keeps_what_it_commits(kept: Kept<'_>) {
    let model = MemoryStore::default();
    for changes in history() {
        let store = kept.open().await;
        let (sequence, _) = store.load().await.unwrap();
        let step = u64::from(store.is_shared());
        assert_eq!(
            store.commit(sequence, changes.clone()).await.unwrap(),
            Commit::Kept(sequence + step)
        );
        model.commit(0, changes).await.unwrap();
        store.close().await;
        let store = kept.open().await;
        assert_eq!(store.load().await.unwrap().1, model.load().await.unwrap().1);
        for id in 1..=4 {
            assert_eq!(store.job(JobId(id)).await.unwrap(), model.job(JobId(id)).await.unwrap());
        }
        let mut ended = [store.ended_jobs().await.unwrap(), model.ended_jobs().await.unwrap()];
        ended
            .iter_mut()
            .for_each(|jobs| jobs.sort_unstable_by_key(|job| job.id));
        assert_eq!(ended[0], ended[1]);
        let mut images = [store.live_images().await.unwrap(), model.live_images().await.unwrap()];
        images.iter_mut().for_each(|images| images.sort_unstable());
        assert_eq!(images[0], images[1]);
        store.close().await;
    }
    let store = kept.open().await;
    assert_eq!(
        store.load().await.unwrap().1.counters,
        Counters {
            job: 4,
            worker: 2,
            token: 2,
            share: 2
        }
    );
    for (behind, limit) in [(None, 2), (Some(JobId(3)), 5), (Some(JobId(1)), 5), (None, 0)] {
        let filter = JobFilter {
            behind,
            ..JobFilter::default()
        };
        let found = store.jobs(filter.clone(), limit).await.unwrap();
        assert_eq!(found, model.jobs(filter, limit).await.unwrap());
    }
    assert_eq!(store.job_by_key("key".into()).await.unwrap().unwrap().head.id, JobId(1));
    for key in ["other", "short"] {
        assert_eq!(store.job_by_key(key.into()).await.unwrap(), None);
    }
    store.close().await;
    assert!(store.load().await.is_err(), "a closed store answers no more");
}

#[tokio::test]
async fn a_commit_is_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    for kept in [
        Kept::Sqlite(folder.path()),
        Kept::Postgres(Postgres::shared().database()),
    ] {
        let store = kept.open().await;
        let submitted = vec![Change::JobSubmitted(head(1, Some("key")).into())];
        store.commit(0, submitted).await.unwrap();
        let (sequence, before) = store.load().await.unwrap();
        let changes = vec![
            Change::LeaseGranted(lease(1)),
            Change::JobSubmitted(head(2, Some("key")).into()),
        ];
        assert!(store.commit(sequence, changes).await.is_err());
        assert_eq!(store.load().await.unwrap(), (sequence, before));
    }
}

#[tokio::test]
async fn bundles_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let manifest = |bytes| BundleManifest {
            files: [(
                "a".to_owned(),
                FileEntry {
                    hash: BlobHash::of(b"x"),
                    bytes,
                },
            )]
            .into(),
        };
        for bytes in [1, 5, 1] {
            let owner = String::from("ann");
            let announced = store.put_bundle(manifest(bytes), owner, u64::MAX, 0).await.unwrap();
            let fresh = (bytes, announced.used) == (1, 1);
            assert_eq!(
                announced.fresh.contains(&BlobHash::of(b"x")),
                fresh,
                "only the first names it anew"
            );
        }
        assert_eq!(store.bundle(manifest(5).hash()).await.unwrap(), Some(manifest(5)));
        assert_eq!(store.bundle(BlobHash::of(b"")).await.unwrap(), None);
        assert_eq!(store.bundled_size(BlobHash::of(b"x")).await.unwrap(), Some(5));
        assert_eq!(store.bundled_size(BlobHash::of(b"y")).await.unwrap(), None);
    }
}

#[tokio::test]
async fn tokens_are_kept_under_their_names() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let token = |name: &str, secret: &[u8]| TokenRecord {
            name: name.into(),
            role: Role::Submit,
            hash: BlobHash::of(secret),
            created_ms: 5,
            expires_ms: Some(7),
            quota: Quota {
                jobs: Some(3),
                ..Quota::default()
            },
        };
        assert!(store.put_token(token("b", b"1")).await.unwrap());
        assert!(store.put_token(token("a", b"2")).await.unwrap());
        assert!(!store.put_token(token("a", b"3")).await.unwrap());
        assert_eq!(store.tokens().await.unwrap(), [token("a", b"2"), token("b", b"1")]);
        assert!(store.remove_token("a".into()).await.unwrap());
        assert!(!store.remove_token("a".into()).await.unwrap());
        assert_eq!(store.tokens().await.unwrap(), [token("b", b"1")]);
    }
}

#[tokio::test]
async fn use_is_counted_by_owner() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let mut sequence = 0;
        for changes in history() {
            let Commit::Kept(next) = store.commit(sequence, changes).await.unwrap() else {
                panic!("nobody else was there");
            };
            sequence = next;
        }
        let manifest = |files: &[(&str, u64)]| BundleManifest {
            files: files
                .iter()
                .map(|(name, bytes)| {
                    let hash = BlobHash::of(name.as_bytes());
                    ((*name).to_owned(), FileEntry { hash, bytes: *bytes })
                })
                .collect(),
        };
        let put = async |owner: &str, files: &[(&str, u64)], most| {
            let manifest = manifest(files);
            let announced = store.put_bundle(manifest, owner.into(), most, 0).await;
            announced.unwrap().used
        };
        assert_eq!(put("ann", &[("x", 5), ("y", 2)], 7).await, 7);
        assert_eq!(put("ann", &[("x", 5), ("z", 1)], 7).await, 8);
        assert_eq!(
            store.bundle(manifest(&[("x", 5), ("z", 1)]).hash()).await.unwrap(),
            None
        );
        assert_eq!(store.bundled_size(BlobHash::of(b"z")).await.unwrap(), None);
        assert_eq!(put("bob", &[("x", 5)], u64::MAX).await, 5);
        let usage = |jobs, bundle_bytes, iterations| Usage {
            jobs,
            bundle_bytes,
            iterations,
        };
        assert_eq!(
            store.usage("ann".into()).await.unwrap(),
            usage(2, 7, 32 + 9),
            "that of job 4 stays used"
        );
        assert_eq!(store.usage("bob".into()).await.unwrap(), usage(0, 5, 0));
        assert_eq!(store.usage(String::new()).await.unwrap(), usage(1, 0, 9));
    }
}

#[tokio::test]
async fn a_database_has_one_user() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("farm.sqlite");
    let first = SqliteStore::open(&path).unwrap();
    assert!(matches!(SqliteStore::open(&path), Err(StoreError::InUse(_))));
    first.commit(0, history().remove(0)).await.unwrap();
    assert!(matches!(SqliteStore::open(&path), Err(StoreError::InUse(_))));
    drop(first);
    SqliteStore::open(&path).unwrap();
}

#[tokio::test]
async fn a_file_that_was_restored_or_copied_begins_a_new_epoch_and_gives_no_number_twice() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [farm, saved, copied] = ["farm", "saved", "copied"].map(path);
    for folder in [&farm, &copied] {
        std::fs::create_dir(folder).unwrap();
    }
    let database = |folder: &Path| folder.join("farm.sqlite");
    let store = SqliteStore::open(&database(&farm)).unwrap();
    let first = store.identity();
    store
        .commit(0, vec![Change::JobSubmitted(head(1, None).into())])
        .await
        .unwrap();
    let state = StatePlace::Sqlite(database(&farm));
    let blobs = BlobPlace::Folder(farm.clone());
    let backup = back_up(&state, &blobs, &saved).await.unwrap();
    assert_eq!(backup, Backup::default(), "it was saved while it was open");
    assert!(matches!(
        back_up(&state, &blobs, &saved).await,
        Err(BackupError::NotEmpty(_))
    ));
    store
        .commit(0, vec![Change::JobSubmitted(head(2, None).into())])
        .await
        .unwrap();
    drop(store);
    assert_eq!(
        SqliteStore::open(&database(&farm)).unwrap().identity(),
        first,
        "nothing happened to it"
    );

    // A copy of all files, with their times.
    let status = std::process::Command::new("cp")
        .arg("-a")
        .arg(farm.join("."))
        .arg(&copied)
        .status();
    assert!(status.unwrap().success());
    for (folder, known) in [(&saved, 1), (&copied, 2)] {
        let store = SqliteStore::open(&database(folder)).unwrap();
        assert_eq!(
            store.identity(),
            FarmIdentity {
                epoch: first.epoch + 1,
                ..first.clone()
            }
        );
        let snapshot = store.load().await.unwrap().1;
        let (counters, year) = (snapshot.counters, 365 * 86_400_000);
        assert_eq!(snapshot.jobs.len(), known);
        assert!(
            counters.job > year && counters.worker > year && counters.token > year,
            "{counters:?}"
        );
    }
    assert_eq!(
        SqliteStore::open(&database(&farm)).unwrap().identity(),
        first,
        "others were copied"
    );

    // The saved files over those of the farm, which keep their places on the disk.
    let status = std::process::Command::new("cp")
        .arg("-a")
        .arg(copied.join("."))
        .arg(&farm)
        .status();
    assert!(status.unwrap().success());
    assert_eq!(
        SqliteStore::open(&database(&farm)).unwrap().identity().epoch,
        first.epoch + 2
    );
}

#[tokio::test]
async fn foreign_and_newer_databases_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, bytes: Option<&[u8]>, sql: &str| {
        let path = folder.path().join(name);
        match bytes {
            Some(bytes) => std::fs::write(&path, bytes).unwrap(),
            None => rusqlite::Connection::open(&path).unwrap().execute_batch(sql).unwrap(),
        }
        match SqliteStore::open(&path) {
            Err(StoreError::Foreign { reason, .. }) => reason,
            Err(other) => panic!("{name}: {other}"),
            Ok(_) => panic!("{name} was opened"),
        }
    };
    assert!(refused("text", Some(&[b'x'; 4096]), "").contains("not a database"));
    assert!(refused("other", None, "CREATE TABLE t (x);").contains("another program"));
    let newer = "PRAGMA application_id = 0x5048464d; PRAGMA user_version = 99; CREATE TABLE t (x);";
    assert!(refused("newer", None, newer).contains("schema 99"));
}

#[tokio::test]
async fn a_damaged_database_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("farm.sqlite");
    let store = SqliteStore::open(&path).unwrap();
    for changes in history() {
        store.commit(0, changes).await.unwrap();
    }
    drop(store);
    let mut bytes = std::fs::read(&path).unwrap();
    let page = 4096;
    bytes[page..3 * page].fill(0xab);
    std::fs::write(&path, bytes).unwrap();
    assert!(SqliteStore::open(&path).is_err());
}
