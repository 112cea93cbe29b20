//! State in a SQLite file: write-ahead log, synced at every commit, for one process.
//!
//! A file beside it is locked for as long as it is open, so that nobody else serves the farm; others may read the
//! database meanwhile, as a backup does. That file also tells whether the farm was restored or copied: whatever copies
//! it cannot copy the time of its last change (`ctime`).

use super::room::room_at;
use super::sql::{Answer, Queries, Row, Statement, Value};
use super::sql_changes::apply;
use super::sqlite_schema::{VERSION, foreign, prepare_schema};
use super::{
    Announced, Commit, EndedJob, JobFilter, NoticeRecord, PictureRecord, Room, Sequence, StateStore, StoreError,
    TokenRecord, check_file, not_writable, sql_bundles, sql_farm, sql_jobs, sql_notices, sql_pictures, sql_tokens,
};
use crate::background::in_background;
use crate::scheduler::record::{BlobName, Change, JobRecord, Millis, Snapshot};
use async_trait::async_trait;
use futures_util::FutureExt;
use photonfarm_proto::api::FarmIdentity;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::token::Usage;
use rusqlite::types::{ToSqlOutput, ValueRef};
use rusqlite::{Connection, ErrorCode, OpenFlags, ToSql, TransactionBehavior, params_from_iter};
use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Longest wait for others that have the database open, such as a backup that ends.
const BUSY: Duration = Duration::from_secs(5);

/// The state of a farm in one file.
#[derive(Clone)]
pub struct SqliteStore {
    /// None once closed.
    open: Arc<Mutex<Option<Open>>>,
    identity: FarmIdentity,
    path: PathBuf,
}

/// An open database. The lock ends after the connection.
struct Open {
    connection: Connection,
    _lock: Lock,
}

/// What a copy of the database names.
pub(super) struct Named {
    pub(super) files: BTreeSet<BlobHash>,
    pub(super) images: Vec<BlobName>,
}

impl SqliteStore {
    /// Opens or makes the file. It is this process's until the store is dropped or the process ends.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let lock = lock(path)?;
        let opened = |error: rusqlite::Error| match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => StoreError::InUse(path.to_owned()),
            Some(ErrorCode::NotADatabase) => foreign(path, "not a database".into()),
            Some(ErrorCode::DatabaseCorrupt) => foreign(path, format!("the database is damaged: {error}")),
            _ => StoreError::Sqlite(error),
        };
        check_file(path)?;
        let (known, left_open) = (path.exists(), left_open(path));
        let mut connection = Connection::open(path).map_err(opened)?;
        connection.busy_timeout(BUSY)?;
        connection.pragma_update(None, "journal_mode", "WAL").map_err(opened)?;
        connection.pragma_update(None, "synchronous", "FULL").map_err(opened)?;
        connection.pragma_update(None, "foreign_keys", true).map_err(opened)?;
        let transaction = connection
            .transaction_with_behavior(TransactionBehavior::Exclusive)
            .map_err(opened)?;
        prepare_schema(&transaction, path)?;
        transaction.commit().map_err(opened)?;
        let shown = path.display();
        match known {
            true if left_open => tracing::warn!(
                "{shown} was not closed last time: its program or the machine ended without warning; all that was \
                 acknowledged is there"
            ),
            true => tracing::info!("{shown} was closed properly last time"),
            false => tracing::debug!("{shown} is new"),
        }
        connection.execute_batch("BEGIN IMMEDIATE")?;
        let mut queries = Ready(&mut connection);
        let identity = at_once(Box::pin(sql_farm::identify(&mut queries, mark(&lock.0))))?;
        connection.execute_batch("COMMIT")?;
        let open = Open {
            connection,
            _lock: lock,
        };
        Ok(Self {
            open: Arc::new(Mutex::new(Some(open))),
            identity,
            path: path.to_owned(),
        })
    }

    /// Copies the database as it stands at one instant, whoever uses it. Returns what the copy names.
    pub(super) fn copy(from: &Path, to: &Path) -> Result<Named, StoreError> {
        let io = |source| StoreError::Io {
            path: from.to_owned(),
            source,
        };
        std::fs::metadata(from).map_err(io)?;
        let fresh = to.with_extension("new");
        let name = fresh
            .to_str()
            .ok_or_else(|| foreign(to, "its name is not UTF-8".into()))?;
        let database = Connection::open_with_flags(from, OpenFlags::SQLITE_OPEN_READ_WRITE)?;
        database.busy_timeout(BUSY)?;
        let version: i32 = database.pragma_query_value(None, "user_version", |row| row.get(0))?;
        if version as usize != VERSION {
            let reason = format!("schema {version}, this program has {VERSION}: start the farm with it first");
            return Err(foreign(from, reason));
        }
        database.execute("VACUUM INTO ?1", [name])?;
        drop(database);
        let mut copy = Connection::open(&fresh)?;
        let mut queries = Ready(&mut copy);
        let named = Named {
            files: at_once(Box::pin(sql_bundles::bundled_files(&mut queries)))?,
            images: at_once(Box::pin(sql_pictures::live_images(&mut queries)))?,
        };
        drop(copy);
        let sync = |path: &Path| File::open(path).and_then(|file| file.sync_all());
        let folder = to.parent().filter(|folder| !folder.as_os_str().is_empty());
        sync(&fresh)
            .and_then(|()| std::fs::rename(&fresh, to))
            .and_then(|()| sync(folder.unwrap_or(Path::new("."))))
            .map_err(io)?;
        Ok(named)
    }

    async fn with<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Connection) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let open = self.open.clone();
        let run = move || {
            let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
            work(&mut open.as_mut().ok_or(StoreError::Stopped)?.connection)
        };
        in_background(run).await.map_err(|_| StoreError::Stopped)?
    }

    /// Answers by queries that never wait.
    async fn ask<T: Send + 'static>(
        &self,
        question: impl for<'a> FnOnce(&'a mut dyn Queries) -> Answer<'a, T> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.with(move |connection| at_once(question(&mut Ready(connection))))
            .await
    }

    /// Changes rows in one transaction, which is undone unless the answer says otherwise.
    async fn change<T: Send + 'static>(
        &self,
        question: impl for<'a> FnOnce(&'a mut dyn Queries) -> Answer<'a, (T, bool)> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.with(move |connection| {
            connection.execute_batch("BEGIN IMMEDIATE")?;
            let answer = at_once(question(&mut Ready(connection)));
            let kept = matches!(answer, Ok((_, true))).then(|| connection.execute_batch("COMMIT"));
            if !matches!(kept, Some(Ok(()))) && !connection.is_autocommit() {
                connection.execute_batch("ROLLBACK")?;
            }
            kept.transpose()?;
            Ok(answer?.0)
        })
        .await
    }
}

/// Whether the process that used the file last did not come to close it: then its log was not taken into it.
fn left_open(path: &Path) -> bool {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    Path::new(&log).metadata().is_ok_and(|log| log.len() > 0)
}

/// A file that is locked until this ends. The lock is given up before the file is closed, since a program that is being
/// started has a copy of every open file for a moment, and with it the lock.
struct Lock(File);

impl Drop for Lock {
    fn drop(&mut self) {
        if let Err(error) = self.0.unlock() {
            tracing::warn!(%error, "the lock of the database ends with the file");
        }
    }
}

/// Locks the file beside the database for this process.
fn lock(database: &Path) -> Result<Lock, StoreError> {
    let mut path = database.as_os_str().to_owned();
    path.push("-lock");
    let path = PathBuf::from(path);
    let file = File::options().create(true).truncate(false).write(true).open(&path);
    let file = file.map_err(|error| not_writable(database, &error))?;
    match file.try_lock() {
        Ok(()) => Ok(Lock(file)),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse(database.to_owned())),
        Err(TryLockError::Error(source)) => Err(StoreError::Io { path, source }),
    }
}

/// What a copy of the file does not share with it.
#[cfg(unix)]
fn mark(file: &File) -> Option<String> {
    use std::os::unix::fs::MetadataExt;
    let file = file.metadata().ok()?;
    Some(format!("{} {}.{:09}", file.ino(), file.ctime(), file.ctime_nsec()))
}

/// Nothing is known that a copy would not share.
#[cfg(not(unix))]
fn mark(_: &File) -> Option<String> {
    None
}

fn at_once<T>(answer: Answer<'_, T>) -> Result<T, StoreError> {
    answer.now_or_never().unwrap_or(Err(StoreError::Stopped))
}

/// A connection whose answers are ready at once.
struct Ready<'a>(&'a mut Connection);

#[async_trait]
impl Queries for Ready<'_> {
    async fn query(&mut self, Statement { sql, values, .. }: Statement) -> Result<Vec<Row>, StoreError> {
        let mut statement = self.0.prepare_cached(&sql)?;
        let columns = statement.column_count();
        let mut rows = statement.query(params_from_iter(&values))?;
        let mut found = Vec::new();
        while let Some(row) = rows.next()? {
            let values = (0..columns).map(|column| value(row.get_ref(column)?));
            found.push(Row::new(values.collect::<Result<_, StoreError>>()?));
        }
        Ok(found)
    }

    async fn execute(&mut self, Statement { sql, values, .. }: Statement) -> Result<u64, StoreError> {
        Ok(self.0.prepare_cached(&sql)?.execute(params_from_iter(&values))? as u64)
    }
}

fn value(value: ValueRef) -> Result<Value, StoreError> {
    Ok(match value {
        ValueRef::Null => Value::Null,
        ValueRef::Integer(value) => Value::Integer(value),
        ValueRef::Real(value) => return Err(StoreError::Damaged(format!("{value} is no whole number"))),
        ValueRef::Text(bytes) => {
            let text = std::str::from_utf8(bytes).map_err(|error| StoreError::Damaged(error.to_string()))?;
            Value::Text(text.to_owned())
        }
        ValueRef::Blob(bytes) => Value::Bytes(bytes.to_vec()),
    })
}

impl ToSql for Value {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match self {
            Self::Null => ValueRef::Null,
            Self::Integer(value) => ValueRef::Integer(*value),
            Self::Text(text) => ValueRef::Text(text.as_bytes()),
            Self::Bytes(bytes) => ValueRef::Blob(bytes),
        }))
    }
}

#[async_trait]
impl StateStore for SqliteStore {
    fn identity(&self) -> FarmIdentity {
        self.identity.clone()
    }

    async fn load(&self) -> Result<(Sequence, Snapshot), StoreError> {
        Ok((0, self.ask(|queries| Box::pin(sql_jobs::load(queries))).await?))
    }

    async fn commit(&self, _expected: Sequence, changes: Vec<Change>) -> Result<Commit, StoreError> {
        self.change(move |queries| {
            Box::pin(async move {
                for change in &changes {
                    apply(queries, change).await?;
                }
                Ok((Commit::Kept(0), true))
            })
        })
        .await
    }

    async fn close(&self) {
        let open = self.open.clone();
        let close = move || drop(open.lock().unwrap_or_else(PoisonError::into_inner).take());
        if in_background(close).await.is_err() {
            tracing::warn!("the database was not closed");
        }
    }

    async fn job(&self, id: JobId) -> Result<Option<JobRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_jobs::job(queries, id))).await
    }

    async fn jobs(&self, filter: JobFilter, limit: u32) -> Result<Vec<JobRecord>, StoreError> {
        self.ask(move |queries| Box::pin(async move { sql_jobs::jobs(queries, &filter, limit).await }))
            .await
    }

    async fn ended_jobs(&self) -> Result<Vec<EndedJob>, StoreError> {
        self.ask(|queries| Box::pin(sql_jobs::ended_jobs(queries))).await
    }

    async fn job_by_key(&self, key: String) -> Result<Option<JobRecord>, StoreError> {
        self.ask(move |queries| Box::pin(sql_jobs::job_by_key(queries, key)))
            .await
    }

    async fn put_bundle(
        &self,
        manifest: BundleManifest,
        owner: String,
        most: u64,
        now: Millis,
    ) -> Result<Announced, StoreError> {
        self.change(move |queries| {
            Box::pin(async move { sql_bundles::put_bundle(queries, &manifest, owner, most, now).await })
        })
        .await
    }

    async fn name_bundle(&self, hash: BlobHash, now: Millis) -> Result<Option<BundleManifest>, StoreError> {
        self.change(move |queries| {
            Box::pin(async move { Ok((sql_bundles::name_bundle(queries, hash, now).await?, true)) })
        })
        .await
    }

    async fn forget_bundles(&self, before: Millis) -> Result<usize, StoreError> {
        self.change(move |queries| {
            Box::pin(async move { Ok((sql_bundles::forget_bundles(queries, before).await?, true)) })
        })
        .await
    }

    async fn bundled_files(&self) -> Result<BTreeSet<BlobHash>, StoreError> {
        self.ask(|queries| Box::pin(sql_bundles::bundled_files(queries))).await
    }

    async fn usage(&self, owner: String) -> Result<Usage, StoreError> {
        let jobs = "SELECT count(*) FILTER (WHERE ended_ms IS NULL),
            coalesce(sum(json_extract(coalesce(control, spec), '$.iterations')), 0) FROM job WHERE owner = ?1";
        self.ask(move |queries| Box::pin(sql_tokens::usage(queries, jobs, owner)))
            .await
    }

    async fn put_token(&self, token: TokenRecord) -> Result<bool, StoreError> {
        self.ask(move |queries| Box::pin(async move { sql_tokens::put_token(queries, &token).await }))
            .await
    }

    async fn tokens(&self) -> Result<Vec<TokenRecord>, StoreError> {
        self.ask(|queries| Box::pin(sql_tokens::tokens(queries))).await
    }

    async fn remove_token(&self, name: String) -> Result<bool, StoreError> {
        self.ask(move |queries| Box::pin(sql_tokens::remove_token(queries, name)))
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
        self.change(move |queries| {
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
        self.ask(move |queries| Box::pin(sql_notices::notices(queries, job, before, limit)))
            .await
    }

    async fn keep_attempt(&self, record: NoticeRecord) -> Result<(), StoreError> {
        self.change(move |queries| {
            Box::pin(async move { Ok((sql_notices::keep_attempt(queries, &record).await?, true)) })
        })
        .await
    }

    async fn forget_notices(&self, before: Millis) -> Result<u64, StoreError> {
        self.change(move |queries| Box::pin(async move { Ok((sql_notices::forget(queries, before).await?, true)) }))
            .await
    }

    async fn room(&self) -> Result<Option<Room>, StoreError> {
        room_at(self.path.clone()).await
    }
}
