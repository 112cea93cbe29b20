//! Two coordinators of one farm, request by request: whatever one of them grants, the other knows.

use super::*;
use crate::access::Caller;
use crate::scheduler::record::Origin;
use crate::store::{self, FolderStore, PostgresStore};
use axum::body::Bytes;
use photonfarm_core::settings::{IntegratorSettings, PathSettings};
use photonfarm_proto::RENDERER;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::{LeaseToken, WorkerId};
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::worker::{Heartbeat, LeaseProgress, LeaseRequest, Register, Release};
use photonfarm_test_servers::Postgres;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

async fn open(url: &str, folder: &Path) -> Arc<Service> {
    let state = PostgresStore::open(url.parse().unwrap(), "the test's database").await;
    let blobs = |name: &str| Arc::new(FolderStore::open(&folder.join(name), true).unwrap());
    let stores = Stores {
        state: Arc::new(state.unwrap()),
        scenes: blobs("scenes"),
        nodes: blobs("nodes"),
    };
    let scheduler = SchedulerConfig {
        lease_ttl_ms: 60_000,
        ..SchedulerConfig::default()
    };
    Service::open(Limits::default(), scheduler, stores, None, Tracer::default())
        .await
        .unwrap()
}

async fn submit(service: &Arc<Service>, iterations: u32) -> JobId {
    let files = [("scene.xml".to_owned(), FileEntry::of(b"scene"))].into();
    let bundle = service.submit_bundle(BundleManifest { files }, &Caller::anyone()).await;
    store::put(&*service.stores.scenes, Bytes::from_static(b"scene"), 0)
        .await
        .unwrap();
    let spec = JobSpec {
        scene: bundle.unwrap().bundle,
        main: "scene.xml".into(),
        defines: Default::default(),
        sensor: None,
        integrator: IntegratorSettings::Path(PathSettings::default()).into(),
        iterations,
        seed: 0,
        schedule: Default::default(),
        layers: Vec::new(),
        crop: None,
        name: String::new(),
        labels: Default::default(),
        after: None,
        webhook: None,
    };
    service.submit_job(spec, None, &Caller::anyone()).await.unwrap().0.id
}

async fn register(service: &Arc<Service>) -> WorkerId {
    let register = Register {
        name: "w".into(),
        threads: 1,
        renderer: RENDERER.into(),
        tags: Default::default(),
        memory_mb: None,
    };
    service.register(register, Origin::default()).await.unwrap()
}

static SERIAL: AtomicU64 = AtomicU64::new(1);

fn ask(worker: WorkerId, held: &[LeaseToken], wait_ms: u64) -> LeaseRequest {
    LeaseRequest {
        worker,
        serial: SERIAL.fetch_add(1, Ordering::Relaxed),
        held: held.to_vec(),
        wait_ms,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_one_grants_the_other_knows() {
    let (folder, url) = (tempfile::tempdir().unwrap(), Postgres::shared().database());
    let (a, b) = (open(&url, folder.path()).await, open(&url, folder.path()).await);
    assert!(a.leads() && !b.leads());
    let worker = register(&a).await;
    let job = submit(&b, 4).await;
    let first = b.lease(ask(worker, &[], 0)).await.unwrap().assignment.unwrap().lease;
    let beat = |token| Heartbeat {
        worker,
        leases: vec![LeaseProgress { token, leaves_done: 0 }],
        checking: Default::default(),
    };
    assert_eq!(
        a.heartbeat(&beat(first.token)).await.unwrap(),
        [],
        "a lease of the other is no lost one"
    );
    let other = register(&b).await;
    let second = a.lease(ask(other, &[], 0)).await.unwrap().assignment.unwrap().lease;
    assert!(
        second.token > first.token && second.node != first.node,
        "no leaf is lent twice"
    );
    let release = Release {
        token: first.token,
        worker,
        job,
    };
    a.release(release).await.unwrap();
    assert!(b.catch_up(&mut *b.farm.lock().await).await.unwrap(), "there are news");
    assert_eq!(
        b.heartbeat(&beat(first.token)).await.unwrap(),
        [first.token],
        "it is over everywhere"
    );
    assert_eq!(a.status(job).await.unwrap().iterations_done, 0);
    assert_eq!(
        b.cancel_job(job).await.unwrap().state,
        photonfarm_proto::job::JobState::Cancelled
    );
    let error = a.lease(ask(WorkerId(99), &[], 0)).await.unwrap_err().into_problem();
    assert_eq!(error.code, ErrorCode::UnknownWorker);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_waits_at_one_gets_the_job_that_the_other_takes() {
    let (folder, url) = (tempfile::tempdir().unwrap(), Postgres::shared().database());
    let (a, b) = (open(&url, folder.path()).await, open(&url, folder.path()).await);
    let running = tokio::spawn(b.clone().run(Duration::from_millis(20), Keep::default()));
    let worker = register(&b).await;
    let waiting = tokio::spawn({
        let b = b.clone();
        async move { b.lease(ask(worker, &[], 30_000)).await }
    });
    submit(&a, 4).await;
    let work = waiting.await.unwrap().unwrap();
    assert!(work.assignment.is_some(), "the wait ends with work");
    b.stop();
    running.await.unwrap();
}

/// The clocks of two machines drift apart, or one is set: both follow the database's.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clocks_are_measured_again() {
    let (folder, url) = (tempfile::tempdir().unwrap(), Postgres::shared().database());
    let (a, b) = (open(&url, folder.path()).await, open(&url, folder.path()).await);
    a.watch_clock().await.unwrap();
    let now = a.clock.now();
    a.clock.set(now, now + 7_200_000, now);
    a.watch_clock().await.unwrap();
    assert!(a.clock.now().abs_diff(b.clock.now()) < 60_000, "two hours are gone");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn signs_of_life_at_one_keep_a_lease_at_the_other_which_leads_next() {
    let (folder, url) = (tempfile::tempdir().unwrap(), Postgres::shared().database());
    let (a, b) = (open(&url, folder.path()).await, open(&url, folder.path()).await);
    let worker = register(&a).await;
    let job = submit(&a, 4).await;
    let lease = a.lease(ask(worker, &[], 0)).await.unwrap().assignment.unwrap().lease;
    let progress = [LeaseProgress {
        token: lease.token,
        leaves_done: 1,
    }];
    let leases = progress.to_vec();
    b.catch_up(&mut *b.farm.lock().await).await.unwrap();
    let before = b.farm.lock().await.farm.job(job).unwrap().leases_held()[0].expires_ms;
    tokio::time::sleep(Duration::from_millis(20)).await;
    let checking = Default::default();
    a.heartbeat(&Heartbeat {
        worker,
        leases,
        checking,
    })
    .await
    .unwrap();
    a.exchange_beats().await.unwrap();
    b.exchange_beats().await.unwrap();
    let held = b.farm.lock().await.farm.job(job).unwrap().leases_held();
    assert!(held[0].expires_ms > before, "renewed at the other");
    assert_eq!(held[0].leaves_done, 1);
    a.close().await;
    let started = Instant::now();
    while !b.take_lead().await.unwrap() {
        assert!(started.elapsed() < Duration::from_secs(60), "nobody leads");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert!(b.leads());
    assert!(a.status(job).await.is_ok(), "what is remembered can be told");
    assert!(a.cancel_job(job).await.unwrap_err().into_problem().retryable);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_is_deleted_once_whoever_is_asked() {
    let (folder, url) = (tempfile::tempdir().unwrap(), Postgres::shared().database());
    let (a, b) = (open(&url, folder.path()).await, open(&url, folder.path()).await);
    let job = submit(&a, 4).await;
    b.catch_up(&mut *b.farm.lock().await).await.unwrap();
    a.cancel_job(job).await.unwrap();
    let (first, second) = tokio::join!(a.delete_job(job), b.delete_job(job));
    let refused: Vec<ErrorCode> = [first, second]
        .into_iter()
        .filter_map(|outcome| Some(outcome.err()?.into_problem().code))
        .collect();
    assert_eq!(refused, [ErrorCode::NotFound]);
    for service in [&a, &b] {
        service.catch_up(&mut *service.farm.lock().await).await.unwrap();
        assert_eq!(
            service.status(job).await.unwrap_err().into_problem().code,
            ErrorCode::NotFound
        );
        assert!(submit(service, 4).await > job, "no number is used twice");
    }
}
