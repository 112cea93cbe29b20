//! State in PostgreSQL, which several coordinators share.
//!
//! Every commit locks the one row of the table `farm`, and is kept only if the farm still stands where the coordinator
//! decided; what it changed is written to the table `change` as well, from which the others learn it.

use super::postgres_connection::{CONNECT, POLL, bound, get, listen};
use super::postgres_schema::prepare;
use super::postgres_session::Session;
use super::postgres_tls::connector;
use super::sql::{self, Answer, Queries};
use super::sql_changes::apply;
use super::{
    Announced, Beat, Commit, EndedJob, JobFilter, News, NoticeRecord, PictureRecord, Sequence, StateStore, StoreError,
    TokenRecord, sql_bundles, sql_farm, sql_jobs, sql_notices, sql_pictures, sql_tokens,
};
use crate::scheduler::record::{BlobName, Change, JobRecord, Millis, Snapshot};
use async_trait::async_trait;
use deadpool_postgres::{GenericClient, Manager, ManagerConfig, Object, Pool, RecyclingMethod, Runtime};
use photonfarm_proto::api::FarmIdentity;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId, WorkerId};
use photonfarm_proto::token::Usage;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{Mutex, watch};
use tokio::task::JoinHandle;
use tokio_postgres::{Config, IsolationLevel};

/// Connections of one coordinator, besides those that listen and lead.
const CONNECTIONS: usize = 8;
/// Longest time that anything may take, whatever the server or the network does; longer than the server's own limits.
const DEADLINE: Duration = Duration::from_secs(30);
/// Commits that the table `change` remembers.
const REMEMBERED: Sequence = 16_384;
/// Commits between two removals of what is remembered no more.
const PRUNE_EVERY: Sequence = 256;
/// Age at which a sign of life is of no use to anyone \[ms\].
const BEAT_AGE: i64 = 86_400_000;
/// Time from the writing of signs of life to their commit, at most \[ms\]: for so long they may be told twice, and never not
/// at all. When they were heard does not matter, which may have been long before.
const BEAT_MARGIN: Millis = 60_000;
/// Names what the leader locks.
const LEADER: i64 = 0x5048_464d_0001;
/// Names what is locked while bundles come and go.
const BUNDLES: i64 = 0x5048_464d_0003;
/// The database's clock [ms since 1970].
const NOW: &str = "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)";

/// The state of a farm in a PostgreSQL database.
pub struct PostgresStore {
    pool: Pool,
    identity: FarmIdentity,
    /// The highest place in the order of commits that was heard of.
    heard: watch::Receiver<Sequence>,
    listener: JoinHandle<()>,
    /// The connection that holds the leader's lock.
    leader: Mutex<Option<Object>>,
    beats_seen_ms: AtomicU64,
}

impl PostgresStore {
    /// Connects, and makes or migrates the tables. `place` names the database in errors, without its password.
    pub async fn open(mut config: Config, place: &str) -> Result<Self, StoreError> {
        bound(&mut config);
        let recycling_method = RecyclingMethod::Fast;
        let tls = connector(&mut config, place)?;
        let manager = Manager::from_config(config.clone(), tls.clone(), ManagerConfig { recycling_method });
        let pool = Pool::builder(manager)
            .max_size(CONNECTIONS)
            .runtime(Runtime::Tokio1)
            .wait_timeout(Some(CONNECT))
            .create_timeout(Some(CONNECT))
            .build()
            .map_err(|error| StoreError::Connection(error.to_string()))?;
        let mut client = get(&pool).await.map_err(|error| match error {
            StoreError::Connection(reason) => StoreError::Foreign {
                place: place.into(),
                reason,
            },
            other => other,
        })?;
        let identity = prepare(&mut client, place).await?;
        drop(client);
        let (tell, heard) = watch::channel(0);
        Ok(Self {
            pool,
            identity,
            heard,
            listener: tokio::spawn(listen(config, tls, tell)),
            leader: Mutex::default(),
            beats_seen_ms: AtomicU64::new(0),
        })
    }

    /// What is asked of the database, within the deadline. Connections that were asked in vain are used no more.
    async fn within<T>(&self, work: impl Future<Output = Result<T, StoreError>>) -> Result<T, StoreError> {
        match tokio::time::timeout(DEADLINE, work).await {
            Ok(result) => result,
            Err(_) => {
                self.pool.retain(|_, _| false);
                let seconds = DEADLINE.as_secs();
                Err(StoreError::Connection(format!("no answer within {seconds} s")))
            }
        }
    }

    /// Answers by queries on one state. Where a connection turns out to be dead, another one is asked.
    async fn ask<T: Send>(
        &self,
        question: impl for<'a> Fn(&'a mut dyn Queries) -> Answer<'a, T> + Send + Sync,
    ) -> Result<T, StoreError> {
        for _ in 0..CONNECTIONS {
            match self.within(self.ask_once(&question)).await {
                Err(StoreError::Postgres(error)) if error.is_closed() => {}
                other => return other,
            }
        }
        self.within(self.ask_once(&question)).await
    }

    async fn ask_once<T: Send>(
        &self,
        question: &(impl for<'a> Fn(&'a mut dyn Queries) -> Answer<'a, T> + Send + Sync),
    ) -> Result<T, StoreError> {
        let mut client = get(&self.pool).await?;
        let transaction = client
            .build_transaction()
            .isolation_level(IsolationLevel::RepeatableRead)
            .read_only(true)
            .start()
            .await?;
        let answer = question(&mut Session(&transaction)).await?;
        transaction.commit().await?;
        Ok(answer)
    }

    /// Changes rows in one transaction, which is undone unless the answer says otherwise; while no other transaction has
    /// the same lock, if it names one.
    async fn change<T: Send>(
        &self,
        lock: Option<i64>,
        question: impl for<'a> FnOnce(&'a mut dyn Queries) -> Answer<'a, (T, bool)> + Send,
    ) -> Result<T, StoreError> {
        self.within(async {
            let mut client = get(&self.pool).await?;
            let transaction = client.transaction().await?;
            if let Some(lock) = lock {
                transaction
                    .execute("SELECT pg_advisory_xact_lock($1)", &[&lock])
                    .await?;
            }
            let (answer, kept) = question(&mut Session(&transaction)).await?;
            if kept {
                transaction.commit().await?;
            } else {
                transaction.rollback().await?;
            }
            Ok(answer)
        })
        .await
    }

    async fn try_lead(&self) -> Result<bool, StoreError> {
        let mut leader = self.leader.lock().await;
        if let Some(client) = leader.as_ref() {
            match tokio::time::timeout(CONNECT, client.simple_query("")).await {
                Ok(Ok(_)) => return Ok(true),
                // The lock went with the connection, or will.
                _ => drop(leader.take().map(Object::take)),
            }
        }
        let client = get(&self.pool).await?;
        let locked: bool = client
            .query_one("SELECT pg_try_advisory_lock($1)", &[&LEADER])
            .await?
            .get(0);
        if locked {
            *leader = Some(client);
        }
        Ok(locked)
    }
}

#[cfg(test)]
impl PostgresStore {
    /// What a setting of its sessions is.
    pub(super) async fn setting(&self, name: &str) -> String {
        let client = get(&self.pool).await.unwrap();
        client.query_one(&format!("SHOW {name}"), &[]).await.unwrap().get(0)
    }
}

impl Drop for PostgresStore {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

fn signed(sequence: Sequence) -> i64 {
    sequence.try_into().unwrap_or(i64::MAX)
}

fn unsigned(value: i64) -> u64 {
    value.try_into().unwrap_or_default()
}

#[async_trait]
impl StateStore for PostgresStore {
    fn identity(&self) -> FarmIdentity {
        self.identity.clone()
    }

    async fn load(&self) -> Result<(Sequence, Snapshot), StoreError> {
        self.ask(|queries| {
            Box::pin(async move {
                let sequence = sql_farm::sequence(queries).await?;
                Ok((sequence, sql_jobs::load(queries).await?))
            })
        })
        .await
    }

    async fn commit(&self, expected: Sequence, changes: Vec<Change>) -> Result<Commit, StoreError> {
        self.within(async {
            let mut client = get(&self.pool).await?;
            let transaction = client.transaction().await?;
            let lock = transaction
                .prepare_cached("SELECT sequence FROM farm FOR UPDATE")
                .await?;
            if unsigned(transaction.query_one(&lock, &[]).await?.try_get(0)?) != expected {
                transaction.rollback().await?;
                return Ok(Commit::Behind);
            }
            let mut session = Session(&transaction);
            for change in &changes {
                apply(&mut session, change).await?;
            }
            let next = expected + 1;
            let step = "WITH told AS (INSERT INTO change (sequence, changes) VALUES ($1, $2)),
            stepped AS (UPDATE farm SET sequence = $1)
            SELECT pg_notify('photonfarm', CAST($1 AS TEXT))";
            let step = transaction.prepare_cached(step).await?;
            transaction
                .query_one(&step, &[&signed(next), &sql::to_json(&changes)?])
                .await?;
            if next.is_multiple_of(PRUNE_EVERY) {
                let forgotten = signed(next.saturating_sub(REMEMBERED));
                transaction
                    .execute("DELETE FROM change WHERE sequence <= $1", &[&forgotten])
                    .await?;
            }
            transaction.commit().await?;
            Ok(Commit::Kept(next))
        })
        .await
    }

    async fn news(&self, since: Sequence) -> Result<News, StoreError> {
        self.within(async {
            let client = get(&self.pool).await?;
            let query = "SELECT farm.sequence, change.changes FROM farm
            LEFT JOIN change ON change.sequence > $1 ORDER BY change.sequence";
            let query = client.prepare_cached(query).await?;
            let rows = client.query(&query, &[&signed(since)]).await?;
            let Some(first) = rows.first() else {
                return Err(StoreError::Damaged("the table `farm` has no row".into()));
            };
            let sequence = unsigned(first.try_get(0)?);
            let texts: Result<Vec<Option<String>>, _> = rows.iter().map(|row| row.try_get(1)).collect();
            let texts: Vec<String> = texts?.into_iter().flatten().collect();
            if since + texts.len() as u64 != sequence {
                return Ok(News::Forgotten);
            }
            let changes: Result<Vec<Vec<Change>>, StoreError> = texts.iter().map(|text| sql::from_json(text)).collect();
            Ok(News::Changes(sequence, changes?.concat()))
        })
        .await
    }

    async fn wait_for_news(&self, since: Sequence) {
        let mut heard = self.heard.clone();
        let newer = heard.wait_for(|sequence| *sequence > since);
        let _either = tokio::time::timeout(POLL, newer).await;
    }

    async fn share_beats(&self, heard: Vec<Beat>) -> Result<Vec<Beat>, StoreError> {
        self.within(async {
            let client = get(&self.pool).await?;
            if !heard.is_empty() {
                let workers: Vec<i64> = heard.iter().map(|beat| signed(beat.worker.0)).collect();
                let times: Vec<i64> = heard.iter().map(|beat| signed(beat.at_ms)).collect();
                let leases: Result<Vec<String>, _> = heard.iter().map(|beat| sql::to_json(&beat.leases)).collect();
                let upsert = "INSERT INTO beat (worker, at_ms, leases, written_ms)
                SELECT *, CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)
                FROM unnest(CAST($1 AS BIGINT[]), CAST($2 AS BIGINT[]), CAST($3 AS TEXT[]))
                ON CONFLICT (worker) DO UPDATE
                SET at_ms = excluded.at_ms, leases = excluded.leases, written_ms = excluded.written_ms
                WHERE beat.at_ms < excluded.at_ms";
                let upsert = client.prepare_cached(upsert).await?;
                client.execute(&upsert, &[&workers, &times, &leases?]).await?;
            }
            let seen = self.beats_seen_ms.load(Ordering::Relaxed);
            let query = "SELECT worker, at_ms, leases, written_ms FROM beat WHERE written_ms > $1";
            let query = client.prepare_cached(query).await?;
            let since = signed(seen.saturating_sub(BEAT_MARGIN));
            let (mut beats, mut newest) = (Vec::new(), seen);
            for row in client.query(&query, &[&since]).await? {
                newest = newest.max(unsigned(row.try_get(3)?));
                beats.push(Beat {
                    worker: WorkerId(unsigned(row.try_get(0)?)),
                    at_ms: unsigned(row.try_get(1)?),
                    leases: sql::from_json(row.try_get(2)?)?,
                });
            }
            self.beats_seen_ms.fetch_max(newest, Ordering::Relaxed);
            Ok(beats)
        })
        .await
    }

    async fn leads(&self) -> Result<bool, StoreError> {
        self.within(async {
            let before = self.leader.lock().await.is_some();
            let leads = self.try_lead().await?;
            if leads && !before {
                tracing::info!("this coordinator leads: it expires leases, merges nodes and removes garbage");
                let client = get(&self.pool).await?;
                let old =
                    "DELETE FROM beat WHERE at_ms < CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT) - $1";
                client.execute(old, &[&BEAT_AGE]).await?;
            }
            Ok(leads)
        })
        .await
    }

    fn is_shared(&self) -> bool {
        true
    }

    async fn time_ms(&self) -> Result<Option<Millis>, StoreError> {
        let ask = async {
            let client = get(&self.pool).await?;
            Ok(Some(unsigned(client.query_one(NOW, &[]).await?.try_get(0)?)))
        };
        self.within(ask).await
    }

    async fn close(&self) {
        self.listener.abort();
        drop(self.leader.lock().await.take().map(Object::take));
        self.pool.close();
    }

    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_jobs::job(queries, id))).await
    }

    async fn jobs(&self, filter: JobFilter, limit: u32) -> Result<Vec<JobRecord>, StoreError> {
        self.ask(move |queries| {
            let filter = filter.clone();
            Box::pin(async move { sql_jobs::jobs(queries, &filter, limit).await })
        })
        .await
    }

    async fn ended_jobs(&self) -> Result<Vec<EndedJob>, StoreError> {
        self.ask(|queries| Box::pin(sql_jobs::ended_jobs(queries))).await
    }

    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_jobs::job_by_key(queries, key.clone())))
            .await
    }

    async fn put_bundle(
        &self,
        manifest: BundleManifest,
        owner: String,
        most: u64,
        now: Millis,
    ) -> Result<Announced, StoreError> {
        self.change(Some(BUNDLES), move |queries| {
            Box::pin(async move { sql_bundles::put_bundle(queries, &manifest, owner, most, now).await })
        })
        .await
    }

    async fn name_bundle(&self, hash: BlobHash, now: Millis) -> Result<Option<BundleManifest>, StoreError> {
        self.change(Some(BUNDLES), move |queries| {
            Box::pin(async move { Ok((sql_bundles::name_bundle(queries, hash, now).await?, true)) })
        })
        .await
    }

    async fn forget_bundles(&self, before: Millis) -> Result<usize, StoreError> {
        self.change(Some(BUNDLES), move |queries| {
            Box::pin(async move { Ok((sql_bundles::forget_bundles(queries, before).await?, true)) })
        })
        .await
    }

    async fn bundled_files(&self) -> Result<BTreeSet<BlobHash>, StoreError> {
        self.ask(|queries| Box::pin(sql_bundles::bundled_files(queries))).await
    }

    async fn usage(&self, owner: String) -> Result<Usage, StoreError> {
        let jobs = "SELECT count(*) FILTER (WHERE ended_ms IS NULL), CAST(coalesce(sum(
            CAST(CAST(coalesce(control, spec) AS JSON) ->> 'iterations' AS BIGINT)), 0) AS BIGINT)
            FROM job WHERE owner = ?1";
        self.ask(move |queries| Box::pin(sql_tokens::usage(queries, jobs, owner.clone())))
            .await
    }

    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError> {
        self.change(None, move |queries| {
            Box::pin(async move { Ok((sql_tokens::put_token(queries, &token).await?, true)) })
        })
        .await
    }

    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        self.ask(|queries| Box::pin(sql_tokens::tokens(queries))).await
    }

    async fn remove_token(&self, name: String) -> Result<bool, StoreError> {
        self.change(None, move |queries| {
            Box::pin(async move { Ok((sql_tokens::remove_token(queries, name).await?, true)) })
        })
        .await
    }

    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError> {
        self.ask(move |queries| Box::pin(sql_bundles::bundle(queries, hash)))
            .await
    }

    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError> {
        self.ask(move |queries| Box::pin(sql_bundles::bundled_size(queries, blob)))
            .await
    }

    async fn picture(&self, job: JobId, format: &'static str) -> Result<Option<PictureRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_pictures::picture(queries, job, format)))
            .await
    }

    async fn put_picture(
        &self,
        job: JobId,
        ended_ms: Millis,
        format: &'static str,
        picture: PictureRecord,
    ) -> Result<Option<BlobName>, StoreError> {
        self.change(None, move |queries| {
            Box::pin(async move {
                let unnamed = sql_pictures::put_picture(queries, job, ended_ms, format, &picture).await?;
                Ok((unnamed, true))
            })
        })
        .await
    }

    async fn pictures(&self, job: JobId) -> Result<Vec<BlobName>, StoreError> {
        self.ask(move |queries| Box::pin(sql_pictures::pictures(queries, Some(job))))
            .await
    }

    async fn live_images(&self) -> Result<Vec<BlobName>, StoreError> {
        self.ask(|queries| Box::pin(sql_pictures::live_images(queries))).await
    }

    async fn due_notices(&self, now: Millis, limit: u32) -> Result<Vec<NoticeRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_notices::due(queries, now, limit)))
            .await
    }

    async fn notices(
        &self,
        job: Option<JobId>,
        before: Option<String>,
        limit: u32,
    ) -> Result<Vec<NoticeRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_notices::notices(queries, job, before.clone(), limit)))
            .await
    }

    async fn keep_attempt(&self, record: NoticeRecord) -> Result<(), StoreError> {
        self.change(None, move |queries| {
            Box::pin(async move { Ok((sql_notices::keep_attempt(queries, &record).await?, true)) })
        })
        .await
    }

    async fn forget_notices(&self, before: Millis) -> Result<u64, StoreError> {
        self.change(None, move |queries| {
            Box::pin(async move { Ok((sql_notices::forget(queries, before).await?, true)) })
        })
        .await
    }
}
