//! What is special to PostgreSQL: several users at once, tables that are not ours, and a server that goes away.

use super::tests::{head, history};
use super::*;
use photonfarm_proto::job::Totals;
use photonfarm_test_servers::Postgres;
use std::time::{Duration, Instant};

async fn open(url: &str) -> Result<PostgresStore, StoreError> {
    PostgresStore::open(url.parse().unwrap(), "the test's database").await
}

fn forgotten(worker: u64) -> Vec<Change> {
    vec![Change::WorkerForgotten(WorkerId(worker))]
}

#[tokio::test]
async fn who_decided_on_an_old_state_learns_the_news_first() {
    let url = Postgres::shared().database();
    let [a, b] = [open(&url).await.unwrap(), open(&url).await.unwrap()];
    let first = history().remove(0);
    assert_eq!(a.commit(0, first.clone()).await.unwrap(), Commit::Kept(1));
    assert_eq!(b.commit(0, forgotten(1)).await.unwrap(), Commit::Behind);
    assert_eq!(b.load().await.unwrap().1.workers.len(), 2, "nothing was forgotten");
    assert_eq!(b.news(0).await.unwrap(), News::Changes(1, first));
    assert_eq!(b.commit(1, forgotten(1)).await.unwrap(), Commit::Kept(2));
    assert_eq!(a.news(1).await.unwrap(), News::Changes(2, forgotten(1)));
    assert_eq!(a.news(2).await.unwrap(), News::Changes(2, vec![]));
    Postgres::shared().execute(&url, "DELETE FROM change WHERE sequence = 1");
    assert_eq!(a.news(0).await.unwrap(), News::Forgotten);
    assert_eq!(a.news(1).await.unwrap(), News::Changes(2, forgotten(1)));
}

#[tokio::test]
async fn commits_of_many_are_one_after_the_other() {
    const EACH: u64 = 40;
    let url = Postgres::shared().database();
    let commit_all = async |name: u64| {
        let store = open(&url).await.unwrap();
        let mut sequence = 0;
        for number in 0..EACH {
            loop {
                match store.commit(sequence, forgotten(1000 * name + number)).await.unwrap() {
                    Commit::Kept(next) => {
                        assert_eq!(next, sequence + 1);
                        sequence = next;
                        break;
                    }
                    Commit::Behind => {
                        let News::Changes(newer, changes) = store.news(sequence).await.unwrap() else {
                            panic!("nothing is forgotten yet");
                        };
                        assert_eq!(changes.len() as u64, newer - sequence);
                        sequence = newer;
                    }
                }
            }
        }
    };
    tokio::join!(commit_all(1), commit_all(2), commit_all(3), commit_all(4));
    let store = open(&url).await.unwrap();
    let News::Changes(sequence, mut changes) = store.news(0).await.unwrap() else {
        panic!("nothing is forgotten yet");
    };
    assert_eq!(sequence, 4 * EACH);
    changes.sort_by_key(|change| format!("{change:?}"));
    changes.dedup();
    assert_eq!(changes.len() as u64, 4 * EACH, "every commit once");
}

#[tokio::test]
async fn news_are_heard_at_once() {
    let url = Postgres::shared().database();
    let [a, b] = [open(&url).await.unwrap(), open(&url).await.unwrap()];
    a.commit(0, forgotten(1)).await.unwrap();
    // The listener may not listen yet: then the wait ends by itself after a second.
    b.wait_for_news(0).await;
    let started = Instant::now();
    a.commit(1, forgotten(2)).await.unwrap();
    b.wait_for_news(1).await;
    assert!(
        started.elapsed() < Duration::from_millis(900),
        "{:?}",
        started.elapsed()
    );
}

#[tokio::test]
async fn signs_of_life_are_shared() {
    let url = Postgres::shared().database();
    let [a, b] = [open(&url).await.unwrap(), open(&url).await.unwrap()];
    let beat = |worker, at_ms| Beat {
        worker: WorkerId(worker),
        at_ms,
        leases: vec![],
    };
    assert_eq!(a.share_beats(vec![beat(1, 100_000)]).await.unwrap(), [beat(1, 100_000)]);
    let mut heard = b.share_beats(vec![beat(1, 90_000), beat(2, 101_000)]).await.unwrap();
    heard.sort_by_key(|beat| beat.worker);
    assert_eq!(heard, [beat(1, 100_000), beat(2, 101_000)], "older news change nothing");
    assert_eq!(a.share_beats(vec![beat(3, 120_000)]).await.unwrap().len(), 3);
    assert_eq!(b.share_beats(vec![]).await.unwrap().len(), 3);
    let minutes = "UPDATE beat SET written_ms = written_ms - 600000 WHERE worker < 3";
    Postgres::shared().execute(&url, minutes);
    assert_eq!(
        b.share_beats(vec![]).await.unwrap(),
        [beat(3, 120_000)],
        "old ones are told once"
    );
    // One coordinator could not reach the database for a while: what it heard long before is new to the other.
    a.share_beats(vec![beat(4, 30_000)]).await.unwrap();
    let mut heard = b.share_beats(vec![]).await.unwrap();
    heard.sort_by_key(|beat| beat.worker);
    assert_eq!(heard, [beat(3, 120_000), beat(4, 30_000)]);
}

#[tokio::test]
async fn one_leads_until_it_ends() {
    let url = Postgres::shared().database();
    let [a, b] = [open(&url).await.unwrap(), open(&url).await.unwrap()];
    assert!(a.leads().await.unwrap() && a.leads().await.unwrap());
    assert!(!b.leads().await.unwrap());
    a.close().await;
    let started = Instant::now();
    while !b.leads().await.unwrap() {
        assert!(started.elapsed() < Duration::from_secs(60), "nobody leads");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let other = open(&Postgres::shared().database()).await.unwrap();
    assert!(other.leads().await.unwrap(), "another farm has another leader");
}

#[tokio::test]
async fn clocks_agree_with_the_database() {
    let store = open(&Postgres::shared().database()).await.unwrap();
    let database = store.time_ms().await.unwrap().unwrap();
    let here = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap();
    let here = here.as_millis() as Millis;
    assert!(database.abs_diff(here) < 10_000, "both run on this machine");
}

#[tokio::test]
async fn sessions_end_what_is_left_lying() {
    let store = open(&Postgres::shared().database()).await.unwrap();
    for (name, expected) in [
        ("lock_timeout", "10s"),
        ("statement_timeout", "20s"),
        ("idle_in_transaction_session_timeout", "10s"),
    ] {
        assert_eq!(store.setting(name).await, expected);
    }
}

#[tokio::test]
async fn tables_that_are_not_as_they_should_be_are_refused() {
    let cluster = Postgres::shared();
    let refused = async |sql: &str, ours: bool| {
        let url = cluster.database();
        if ours {
            open(&url).await.unwrap().close().await;
        }
        cluster.execute(&url, sql);
        match open(&url).await {
            Err(StoreError::Foreign { reason, .. }) => reason,
            Err(other) => panic!("{sql}: {other}"),
            Ok(_) => panic!("{sql}: was opened"),
        }
    };
    let newer = refused("UPDATE farm SET schema_version = 99", true).await;
    assert!(newer.contains("schema 99"), "{newer}");
    let broken = refused("ALTER TABLE node DROP COLUMN digest", true).await;
    assert!(broken.contains("node has no column digest"), "{broken}");
    let empty = refused("DELETE FROM farm", true).await;
    assert!(empty.contains("farm has 0 rows"), "{empty}");
    let foreign = refused("CREATE TABLE farm (cows INTEGER)", false).await;
    assert!(foreign.contains("another program"), "{foreign}");
    let foreign = refused("CREATE TABLE job (boss TEXT)", false).await;
    assert!(foreign.contains("another program"), "{foreign}");
    let away = match open("postgres:///farm?host=/nowhere&user=me").await {
        Err(error) => error.to_string(),
        Ok(_) => panic!("opened"),
    };
    assert!(away.contains("database"), "{away}");
}

/// Before the sixth version labels were in the specification of a job alone.
#[tokio::test]
async fn a_database_of_the_fifth_version_keeps_names_and_labels() {
    let cluster = Postgres::shared();
    let url = cluster.database();
    for migration in &super::postgres_schema::MIGRATIONS[..5] {
        cluster.execute(&url, migration);
    }
    let mut named = head(1, None).spec;
    named.name = "it's a name".into();
    named.labels = [("shot".into(), "s 07".into()), ("note".into(), "\"ü\"".into())].into();
    let totals = serde_json::to_string(&Totals::default()).unwrap();
    for (id, spec) in [(1, &named), (2, &head(2, None).spec)] {
        let spec = serde_json::to_string(spec).unwrap().replace('\'', "''");
        let insert = format!(
            "INSERT INTO job (id, spec, owner, created_ms, state, totals) VALUES ({id}, '{spec}', 'ann', {id}, '\"running\"', '{totals}')"
        );
        cluster.execute(&url, &insert);
    }
    cluster.execute(&url, "UPDATE farm SET schema_version = 5");
    let store = open(&url).await.unwrap();
    let found = async |filter| {
        let jobs = store.jobs(filter, 10).await.unwrap();
        jobs.iter().map(|job| job.head.id.0).collect::<Vec<u64>>()
    };
    let labelled = |name: &str, value: Option<&str>| JobFilter {
        labels: vec![(name.into(), value.map(str::to_owned))],
        ..JobFilter::default()
    };
    let titled = |name: &str| JobFilter {
        name: Some(name.into()),
        ..JobFilter::default()
    };
    assert_eq!(found(JobFilter::default()).await, [2, 1]);
    assert_eq!(found(labelled("shot", Some("s 07"))).await, [1]);
    assert_eq!(found(labelled("note", Some("\"ü\""))).await, [1]);
    assert_eq!(found(labelled("note", None)).await, [1]);
    assert_eq!(found(labelled("shot", Some("s 08"))).await, [0; 0]);
    assert_eq!(found(titled("it's")).await, [1]);
    assert_eq!(
        found(titled("scene.xml")).await,
        [2],
        "the file's name, where a job has no other"
    );
    let jobs = store.load().await.unwrap().1.jobs;
    assert!(jobs.iter().any(|job| job.head.spec == named), "{jobs:?}");
    store.close().await;
    open(&url).await.expect("it is of the newest version now");
}

#[tokio::test]
async fn a_database_that_was_restored_begins_a_new_epoch_and_gives_no_number_twice() {
    let cluster = Postgres::shared();
    let url = cluster.database();
    let store = open(&url).await.unwrap();
    let first = store.identity();
    store.commit(0, history().remove(3)).await.unwrap();
    let again = open(&url).await.unwrap();
    assert_eq!(again.identity(), first, "nothing happened to it");
    let restored = open(&cluster.restored(&url)).await.unwrap();
    assert_eq!(
        restored.identity(),
        FarmIdentity {
            epoch: first.epoch + 1,
            ..first
        }
    );
    let (sequence, snapshot) = restored.load().await.unwrap();
    assert_eq!((sequence, snapshot.jobs.len()), (2, 1));
    let (counters, year) = (snapshot.counters, 365 * 86_400_000);
    assert!(
        counters.job > year && counters.worker > year && counters.token > year,
        "{counters:?}"
    );
}

#[tokio::test]
async fn several_may_make_the_tables_at_once() {
    let url = Postgres::shared().database();
    let (a, b, c) = tokio::join!(open(&url), open(&url), open(&url));
    for store in [a, b, c] {
        assert_eq!(store.unwrap().load().await.unwrap().0, 0);
    }
}

#[tokio::test]
async fn a_restart_of_the_server_is_survived() {
    let cluster = Postgres::start();
    let store = open(&cluster.database()).await.unwrap();
    assert_eq!(store.commit(0, history().remove(0)).await.unwrap(), Commit::Kept(1));
    assert!(store.leads().await.unwrap());
    cluster.stop();
    for _ in 0..10 {
        let error = store.load().await.unwrap_err();
        assert!(error.retryable(), "{error}");
        assert!(store.commit(1, forgotten(1)).await.unwrap_err().retryable());
    }
    assert!(store.leads().await.is_err(), "nobody knows who leads");
    cluster.resume();
    assert_eq!(store.load().await.unwrap().0, 1);
    assert_eq!(store.commit(1, forgotten(1)).await.unwrap(), Commit::Kept(2));
    assert!(store.leads().await.unwrap());
}
