//! State in a SQLite file: write-ahead log, synced at every commit, locked for one process.

use super::{StateStore, StoreError};
use crate::access::TokenRecord;
use crate::scheduler::record::{
    Change, Counters, JobControl, JobHead, JobRecord, LeaseRecord, NodeRecord, Renewal, Snapshot, WorkerRecord,
};
use async_trait::async_trait;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::{Attempt, JobState};
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::token::Usage;
use rusqlite::{Connection, ErrorCode, OptionalExtension, Row, Transaction, params};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// "PHFM": marks the file as ours.
const APPLICATION_ID: i32 = 0x5048_464d;
/// What makes each version of the schema from the one before; the first makes it from nothing.
const MIGRATIONS: &[&str] = &[SCHEMA_1, SCHEMA_2, SCHEMA_3];

pub(super) const SCHEMA_1: &str = "
CREATE TABLE counter (name TEXT PRIMARY KEY, value INTEGER NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE worker (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, threads INTEGER NOT NULL, renderer TEXT NOT NULL) STRICT;
CREATE TABLE bundle (hash BLOB PRIMARY KEY, manifest TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE bundle_blob (blob BLOB, bytes INTEGER, PRIMARY KEY (blob, bytes)) STRICT, WITHOUT ROWID;
CREATE TABLE job (
    id INTEGER PRIMARY KEY, spec TEXT NOT NULL, key TEXT UNIQUE, created_ms INTEGER NOT NULL,
    state TEXT NOT NULL, failure TEXT, ended_ms INTEGER, width INTEGER, height INTEGER, totals TEXT NOT NULL) STRICT;
CREATE INDEX job_going_on ON job (id) WHERE ended_ms IS NULL;
CREATE TABLE node (
    job INTEGER NOT NULL REFERENCES job, level INTEGER NOT NULL, place INTEGER NOT NULL, digest BLOB NOT NULL,
    live INTEGER NOT NULL, PRIMARY KEY (job, level, place)) STRICT, WITHOUT ROWID;
CREATE TABLE lease (
    token INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, level INTEGER NOT NULL, place INTEGER NOT NULL,
    worker INTEGER NOT NULL, attempt INTEGER NOT NULL, granted_ms INTEGER NOT NULL, expected_ms INTEGER) STRICT;
CREATE INDEX lease_of_job ON lease (job);
CREATE TABLE failure (
    job INTEGER NOT NULL REFERENCES job, leaf INTEGER NOT NULL, attempt TEXT NOT NULL) STRICT;
CREATE INDEX failure_of_job ON failure (job);
";

/// Tokens, and whose jobs and files there are.
const SCHEMA_2: &str = "
CREATE TABLE token (name TEXT PRIMARY KEY, record TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE owned_blob (
    owner TEXT, blob BLOB, bytes INTEGER NOT NULL, PRIMARY KEY (owner, blob)) STRICT, WITHOUT ROWID;
ALTER TABLE job ADD COLUMN owner TEXT NOT NULL DEFAULT '';
CREATE INDEX job_of_owner ON job (owner);
";

/// How jobs go on; workers, nodes and leases with all that is kept of them, as JSON.
const SCHEMA_3: &str = "
ALTER TABLE job ADD COLUMN control TEXT;
ALTER TABLE job ADD COLUMN share_ms INTEGER NOT NULL DEFAULT 0;
ALTER TABLE worker ADD COLUMN record TEXT;
UPDATE worker SET record = json_object('id', id, 'name', name, 'threads', threads, 'renderer', renderer);
ALTER TABLE node ADD COLUMN record TEXT;
UPDATE node SET record = json_object(
    'digest', lower(hex(digest)), 'live', json(CASE live WHEN 0 THEN 'false' ELSE 'true' END));
ALTER TABLE lease ADD COLUMN record TEXT;
UPDATE lease SET record = json_object(
    'token', token, 'job', job, 'node', json_object('level', level, 'index', place), 'worker', worker,
    'attempt', attempt, 'granted_ms', granted_ms, 'expected_ms', expected_ms);
";

/// The state of a farm in one file.
#[derive(Clone)]
pub struct SqliteStore {
    /// None once closed.
    connection: Arc<Mutex<Option<Connection>>>,
}

impl SqliteStore {
    /// Opens or makes the file. It stays locked until the store is dropped or the process ends.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let opened = |error: rusqlite::Error| match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StoreError::InUse(path.to_owned()),
            Some(ErrorCode::NotADatabase) => foreign(path, "not a database".into()),
            Some(ErrorCode::DatabaseCorrupt) => foreign(path, format!("the database is damaged: {error}")),
            _ => StoreError::Database(error),
        };
        let mut connection = Connection::open(path).map_err(opened)?;
        connection.busy_timeout(Duration::ZERO)?;
        connection
            .pragma_update(None, "locking_mode", "EXCLUSIVE")
            .map_err(opened)?;
        connection.pragma_update(None, "journal_mode", "WAL").map_err(opened)?;
        connection.pragma_update(None, "synchronous", "FULL").map_err(opened)?;
        connection.pragma_update(None, "foreign_keys", true).map_err(opened)?;
        let transaction = connection
            .transaction_with_behavior(rusqlite::TransactionBehavior::Exclusive)
            .map_err(opened)?;
        prepare_schema(&transaction, path)?;
        transaction.commit().map_err(opened)?;
        Ok(Self {
            connection: Arc::new(Mutex::new(Some(connection))),
        })
    }

    async fn with<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Connection) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let connection = self.connection.clone();
        let run = move || {
            let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
            work(connection.as_mut().ok_or(StoreError::Stopped)?)
        };
        tokio::task::spawn_blocking(run)
            .await
            .map_err(|_| StoreError::Stopped)?
    }
}

fn foreign(path: &Path, reason: String) -> StoreError {
    StoreError::Foreign {
        path: path.to_owned(),
        reason,
    }
}

fn prepare_schema(transaction: &Transaction, path: &Path) -> Result<(), StoreError> {
    let pragma = |name: &str| transaction.pragma_query_value(None, name, |row| row.get::<_, i32>(0));
    let tables: i64 = transaction.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    let found = match (pragma("application_id")?, pragma("user_version")?) {
        (0, 0) if tables == 0 => 0,
        (APPLICATION_ID, version @ 1..) => version as usize,
        _ => return Err(foreign(path, "a database of another program".into())),
    };
    let current = MIGRATIONS.len();
    if found > current {
        let reason = format!("made by a newer version: schema {found}, this program has {current}");
        return Err(foreign(path, reason));
    }
    let check: String = transaction.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
    if check != "ok" {
        return Err(foreign(path, format!("the database is damaged: {check}")));
    }
    for migration in &MIGRATIONS[found..] {
        transaction.execute_batch(migration)?;
    }
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.pragma_update(None, "user_version", current as i32)?;
    Ok(())
}

fn to_json<T: Serialize>(value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::Damaged(error.to_string()))
}

fn from_json<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| StoreError::Damaged(error.to_string()))
}

/// SQLite has signed integers only; ours stay far below the sign bit.
fn signed(value: u64) -> Result<i64, StoreError> {
    i64::try_from(value).map_err(|_| StoreError::Damaged(format!("{value} does not fit")))
}

fn unsigned(value: i64) -> Result<u64, StoreError> {
    u64::try_from(value).map_err(|_| StoreError::Damaged(format!("{value} is negative")))
}

fn raise_counter(transaction: &Transaction, name: &str, value: u64) -> Result<(), StoreError> {
    transaction
        .prepare_cached(
            "INSERT INTO counter VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET value = max(value, excluded.value)",
        )?
        .execute(params![name, signed(value)?])?;
    Ok(())
}

fn apply(transaction: &Transaction, change: &Change) -> Result<(), StoreError> {
    let run = |sql: &str, values: &[&dyn rusqlite::ToSql]| -> Result<(), StoreError> {
        transaction.prepare_cached(sql)?.execute(values)?;
        Ok(())
    };
    match change {
        Change::WorkerRegistered(record) => {
            raise_counter(transaction, "worker", record.id.0)?;
            run(
                "INSERT OR REPLACE INTO worker VALUES (?1, ?2, ?3, ?4, ?5)",
                params![
                    signed(record.id.0)?,
                    record.name,
                    record.threads,
                    record.renderer,
                    to_json(record)?
                ],
            )
        }
        Change::WorkerJudged { worker, standing } => run(
            "UPDATE worker SET record = json_set(record, '$.standing', json(?2)) WHERE id = ?1",
            params![signed(worker.0)?, to_json(standing)?],
        ),
        Change::WorkerForgotten(worker) => run("DELETE FROM worker WHERE id = ?1", params![signed(worker.0)?]),
        Change::JobSubmitted(JobHead {
            id,
            spec,
            owner,
            key,
            created_ms,
        }) => {
            raise_counter(transaction, "job", id.0)?;
            run(
                "INSERT INTO job (id, spec, key, created_ms, state, totals, owner) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                params![
                    signed(id.0)?,
                    to_json(spec)?,
                    key,
                    signed(*created_ms)?,
                    to_json(&JobState::Queued)?,
                    to_json(&photonfarm_proto::job::Totals::default())?,
                    owner
                ],
            )
        }
        Change::JobChanged { job, control } => run(
            "UPDATE job SET control = ?2 WHERE id = ?1",
            params![signed(job.0)?, to_json(control)?],
        ),
        Change::JobReopened { record, ended_ms } => reopen_job(transaction, record, *ended_ms),
        Change::LeaseGranted(lease) => grant_lease(transaction, lease),
        Change::LeaseEnded { token, .. } => run("DELETE FROM lease WHERE token = ?1", params![signed(token.0)?]),
        Change::LeasesRenewed(renewals) => renewals
            .iter()
            .try_for_each(|renewal| renew_lease(transaction, renewal)),
        Change::NodeAdded {
            job,
            node,
            record,
            resolution,
        } => {
            write_node(transaction, *job, *node, record)?;
            let [width, height] = resolution;
            run(
                "UPDATE job SET width = ?2, height = ?3 WHERE id = ?1",
                params![signed(job.0)?, width, height],
            )
        }
        Change::NodeJudged { job, node, record } => write_node(transaction, *job, *node, record),
        Change::NodeMerged { job, node } => run(
            "UPDATE node SET live = 0, record = json_set(record, '$.live', json('false'), '$.totals', NULL) \
             WHERE job = ?1 AND level = ?2 AND place = ?3",
            params![signed(job.0)?, node.level, node.index],
        ),
        Change::NodeLost { job, node, .. } => run(
            "DELETE FROM node WHERE job = ?1 AND level <= ?2 AND place >> (?2 - level) = ?3",
            params![signed(job.0)?, node.level, node.index],
        ),
        Change::LeafFailed { job, leaf, attempt } => run(
            "INSERT INTO failure VALUES (?1, ?2, ?3)",
            params![signed(job.0)?, leaf, to_json(attempt)?],
        ),
        Change::JobEnded {
            job,
            state,
            failure,
            ended_ms,
        } => {
            run("DELETE FROM lease WHERE job = ?1", params![signed(job.0)?])?;
            run(
                "UPDATE job SET state = ?2, failure = ?3, ended_ms = ?4 WHERE id = ?1",
                params![signed(job.0)?, to_json(state)?, failure, signed(*ended_ms)?],
            )
        }
    }
}

fn grant_lease(transaction: &Transaction, lease: &LeaseRecord) -> Result<(), StoreError> {
    raise_counter(transaction, "token", lease.token.0)?;
    let job = signed(lease.job.0)?;
    transaction
        .prepare_cached("INSERT OR REPLACE INTO lease VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)")?
        .execute(params![
            signed(lease.token.0)?,
            job,
            lease.node.level,
            lease.node.index,
            signed(lease.worker.0)?,
            lease.attempt,
            signed(lease.granted_ms)?,
            lease.expected_ms.map(signed).transpose()?,
            to_json(lease)?,
        ])?;
    raise_counter(transaction, "share", lease.share[0])?;
    transaction
        .prepare_cached("UPDATE job SET state = ?2, share_ms = ?3 WHERE id = ?1")?
        .execute(params![job, to_json(&JobState::Running)?, signed(lease.share[1])?])?;
    Ok(())
}

fn renew_lease(transaction: &Transaction, renewal: &Renewal) -> Result<(), StoreError> {
    transaction
        .prepare_cached(
            "UPDATE lease SET record = json_set(record, '$.until_ms', ?2, '$.restarts', ?3) WHERE token = ?1",
        )?
        .execute(params![
            signed(renewal.token.0)?,
            signed(renewal.until_ms)?,
            renewal.restarts
        ])?;
    Ok(())
}

fn write_node(transaction: &Transaction, job: JobId, node: NodeKey, record: &NodeRecord) -> Result<(), StoreError> {
    transaction
        .prepare_cached("INSERT OR REPLACE INTO node VALUES (?1, ?2, ?3, ?4, ?5, ?6)")?
        .execute(params![
            signed(job.0)?,
            node.level,
            node.index,
            record.digest.0,
            record.live,
            to_json(record)?
        ])?;
    Ok(())
}

/// A job that had ended goes on; what it consists of is in its rows already.
fn reopen_job(transaction: &Transaction, record: &JobRecord, ended_ms: u64) -> Result<(), StoreError> {
    let reopened = transaction
        .prepare_cached(
            "UPDATE job SET state = ?3, failure = NULL, ended_ms = NULL, control = ?4 WHERE id = ?1 AND ended_ms = ?2",
        )?
        .execute(params![
            signed(record.head.id.0)?,
            signed(ended_ms)?,
            to_json(&record.state)?,
            to_json(&record.control)?
        ])?;
    if reopened != 1 {
        return Err(StoreError::Damaged(format!(
            "job {} ended anew meanwhile",
            record.head.id
        )));
    }
    Ok(())
}

fn rows<T>(
    connection: &Connection,
    sql: &str,
    values: &[&dyn rusqlite::ToSql],
    read: impl Fn(&Row) -> Result<T, StoreError>,
) -> Result<Vec<T>, StoreError> {
    let mut statement = connection.prepare_cached(sql)?;
    let mut rows = statement.query(values)?;
    let mut found = Vec::new();
    while let Some(row) = rows.next()? {
        found.push(read(row)?);
    }
    Ok(found)
}

fn hash_at(row: &Row, column: usize) -> Result<BlobHash, StoreError> {
    Ok(BlobHash(row.get(column)?))
}

const JOB_COLUMNS: &str = "SELECT id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner, \
                           control, share_ms FROM job";

fn read_job(connection: &Connection, row: &Row) -> Result<JobRecord, StoreError> {
    let number: i64 = row.get(0)?;
    let id = JobId(unsigned(number)?);
    let size: (Option<u32>, Option<u32>) = (row.get(7)?, row.get(8)?);
    let failure = |row: &Row| Ok((row.get(0)?, from_json::<Attempt>(&row.get::<_, String>(1)?)?));
    let spec = from_json(&row.get::<_, String>(1)?)?;
    let control = row.get::<_, Option<String>>(11)?.map(|text| from_json(&text));
    Ok(JobRecord {
        control: control.transpose()?.unwrap_or_else(|| JobControl::of(&spec)),
        share_ms: unsigned(row.get(12)?)?,
        head: JobHead {
            id,
            spec,
            owner: row.get(10)?,
            key: row.get(2)?,
            created_ms: unsigned(row.get(3)?)?,
        },
        state: from_json(&row.get::<_, String>(4)?)?,
        failure: row.get(5)?,
        ended_ms: row.get::<_, Option<i64>>(6)?.map(unsigned).transpose()?,
        resolution: size.0.zip(size.1).map(|(width, height)| [width, height]),
        totals: from_json(&row.get::<_, String>(9)?)?,
        nodes: rows(
            connection,
            "SELECT level, place, record FROM node WHERE job = ?1",
            params![number],
            read_node,
        )?,
        leases: rows(
            connection,
            "SELECT record FROM lease WHERE job = ?1 ORDER BY token",
            params![number],
            read_lease,
        )?,
        failures: rows(
            connection,
            "SELECT leaf, attempt FROM failure WHERE job = ?1 ORDER BY rowid",
            params![number],
            failure,
        )?,
    })
}

fn read_node(row: &Row) -> Result<(NodeKey, NodeRecord), StoreError> {
    let key = NodeKey {
        level: row.get(0)?,
        index: row.get(1)?,
    };
    Ok((key, from_json(&row.get::<_, String>(2)?)?))
}

fn read_lease(row: &Row) -> Result<LeaseRecord, StoreError> {
    from_json(&row.get::<_, String>(0)?)
}

fn read_jobs(
    connection: &Connection,
    condition: &str,
    values: &[&dyn rusqlite::ToSql],
) -> Result<Vec<JobRecord>, StoreError> {
    rows(connection, &format!("{JOB_COLUMNS} {condition}"), values, |row| {
        read_job(connection, row)
    })
}

fn read_counter(connection: &Connection, name: &str) -> Result<u64, StoreError> {
    let query = "SELECT value FROM counter WHERE name = ?1";
    let value = connection.query_row(query, [name], |row| row.get(0)).optional()?;
    unsigned(value.unwrap_or(0))
}

fn owned_bytes(connection: &Connection, owner: &str) -> Result<u64, StoreError> {
    let query = "SELECT coalesce(sum(bytes), 0) FROM owned_blob WHERE owner = ?1";
    unsigned(connection.query_row(query, [owner], |row| row.get(0))?)
}

fn read_worker(row: &Row) -> Result<WorkerRecord, StoreError> {
    from_json(&row.get::<_, String>(0)?)
}

#[async_trait]
impl StateStore for SqliteStore {
    async fn load(&self) -> Result<Snapshot, StoreError> {
        self.with(|connection| {
            let counter = |name| read_counter(connection, name);
            Ok(Snapshot {
                counters: Counters {
                    job: counter("job")?,
                    worker: counter("worker")?,
                    token: counter("token")?,
                    share: counter("share")?,
                },
                workers: rows(connection, "SELECT record FROM worker ORDER BY id", &[], read_worker)?,
                jobs: read_jobs(connection, "WHERE ended_ms IS NULL ORDER BY id", &[])?,
            })
        })
        .await
    }

    async fn commit(&self, changes: Vec<Change>) -> Result<(), StoreError> {
        self.with(move |connection| {
            let transaction = connection.transaction_with_behavior(rusqlite::TransactionBehavior::Immediate)?;
            changes.iter().try_for_each(|change| apply(&transaction, change))?;
            Ok(transaction.commit()?)
        })
        .await
    }

    async fn close(&self) {
        let connection = self.connection.clone();
        let close = move || drop(connection.lock().unwrap_or_else(PoisonError::into_inner).take());
        if tokio::task::spawn_blocking(close).await.is_err() {
            tracing::warn!("the database was not closed");
        }
    }

    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError> {
        let Ok(id) = signed(id.0) else { return Ok(None) };
        self.with(move |connection| Ok(read_jobs(connection, "WHERE id = ?1", params![id])?.pop()))
            .await
    }

    async fn jobs(&self, before: Option<JobId>, limit: u32) -> Result<Vec<JobRecord>, StoreError> {
        let before = before.map_or(i64::MAX, |id| i64::try_from(id.0).unwrap_or(i64::MAX));
        self.with(move |connection| {
            read_jobs(
                connection,
                "WHERE id < ?1 ORDER BY id DESC LIMIT ?2",
                params![before, limit],
            )
        })
        .await
    }

    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError> {
        self.with(move |connection| Ok(read_jobs(connection, "WHERE key = ?1", params![key])?.pop()))
            .await
    }

    async fn put_bundle(
        &self,
        hash: BlobHash,
        manifest: BundleManifest,
        owner: String,
        most: u64,
    ) -> Result<u64, StoreError> {
        self.with(move |connection| {
            let transaction = connection.transaction_with_behavior(rusqlite::TransactionBehavior::Immediate)?;
            transaction
                .prepare_cached("INSERT OR IGNORE INTO bundle VALUES (?1, ?2)")?
                .execute(params![hash.0, to_json(&manifest)?])?;
            for (blob, bytes) in manifest.blobs() {
                transaction
                    .prepare_cached("INSERT OR IGNORE INTO bundle_blob VALUES (?1, ?2)")?
                    .execute(params![blob.0, signed(bytes)?])?;
                transaction
                    .prepare_cached(
                        "INSERT INTO owned_blob VALUES (?1, ?2, ?3) ON CONFLICT DO UPDATE SET bytes = max(bytes, excluded.bytes)",
                    )?
                    .execute(params![owner, blob.0, signed(bytes)?])?;
            }
            let used = owned_bytes(&transaction, &owner)?;
            if used <= most {
                transaction.commit()?;
            }
            Ok(used)
        })
        .await
    }

    async fn usage(&self, owner: String) -> Result<Usage, StoreError> {
        self.with(move |connection| {
            let query = "SELECT count(*) FILTER (WHERE ended_ms IS NULL), \
                         coalesce(sum(json_extract(coalesce(control, spec), '$.iterations')), 0) FROM job WHERE owner = ?1";
            let (jobs, iterations) = connection.query_row(query, [&owner], |row| Ok((row.get(0)?, row.get(1)?)))?;
            Ok(Usage {
                jobs: unsigned(jobs)?,
                bundle_bytes: owned_bytes(connection, &owner)?,
                iterations: unsigned(iterations)?,
            })
        })
        .await
    }

    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError> {
        self.with(move |connection| {
            let new = connection
                .prepare_cached("INSERT OR IGNORE INTO token VALUES (?1, ?2)")?
                .execute(params![token.name, to_json(&token)?])?;
            Ok(new == 1)
        })
        .await
    }

    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        self.with(|connection| {
            rows(connection, "SELECT record FROM token ORDER BY name", &[], |row| {
                from_json(&row.get::<_, String>(0)?)
            })
        })
        .await
    }

    async fn remove_token(&self, name: String) -> Result<bool, StoreError> {
        self.with(move |connection| {
            let gone = connection
                .prepare_cached("DELETE FROM token WHERE name = ?1")?
                .execute([name])?;
            Ok(gone == 1)
        })
        .await
    }

    async fn bundle(&self, hash: BlobHash) -> Result<Option<BundleManifest>, StoreError> {
        self.with(move |connection| {
            let query = "SELECT manifest FROM bundle WHERE hash = ?1";
            let text: Option<String> = connection.query_row(query, [hash.0], |row| row.get(0)).optional()?;
            text.map(|text| from_json(&text)).transpose()
        })
        .await
    }

    async fn bundled_size(&self, blob: BlobHash) -> Result<Option<u64>, StoreError> {
        self.with(move |connection| {
            let query = "SELECT max(bytes) FROM bundle_blob WHERE blob = ?1";
            let bytes: Option<i64> = connection.query_row(query, [blob.0], |row| row.get(0))?;
            bytes.map(unsigned).transpose()
        })
        .await
    }

    async fn live_digests(&self) -> Result<Vec<BlobHash>, StoreError> {
        self.with(|connection| {
            rows(connection, "SELECT digest FROM node WHERE live = 1", &[], |row| {
                hash_at(row, 0)
            })
        })
        .await
    }
}
