//! The tables of an SQLite file: made and migrated at every start.

use super::StoreError;
use rusqlite::Transaction;
use std::path::Path;

/// "PHFM": marks the file as ours.
const APPLICATION_ID: i32 = 0x5048_464d;

/// What makes each version of the schema from the one before; the first makes it from nothing.
const MIGRATIONS: &[&str] = &[
    SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5, SCHEMA_6, SCHEMA_7, SCHEMA_8, SCHEMA_9,
];

/// The version that this program has.
pub(super) const VERSION: usize = MIGRATIONS.len();

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

/// Columns as every SQL database can have them: what changes of a record on its own is a column of its own.
const SCHEMA_4: &str = "
ALTER TABLE worker DROP COLUMN name;
ALTER TABLE worker DROP COLUMN threads;
ALTER TABLE worker DROP COLUMN renderer;
ALTER TABLE worker ADD COLUMN standing TEXT;
UPDATE worker SET standing = json_extract(record, '$.standing');
ALTER TABLE lease DROP COLUMN level;
ALTER TABLE lease DROP COLUMN place;
ALTER TABLE lease DROP COLUMN worker;
ALTER TABLE lease DROP COLUMN attempt;
ALTER TABLE lease DROP COLUMN granted_ms;
ALTER TABLE lease DROP COLUMN expected_ms;
ALTER TABLE lease ADD COLUMN until_ms INTEGER NOT NULL DEFAULT 0;
ALTER TABLE lease ADD COLUMN restarts INTEGER NOT NULL DEFAULT 0;
UPDATE lease SET until_ms = coalesce(json_extract(record, '$.until_ms'), 0),
    restarts = coalesce(json_extract(record, '$.restarts'), 0);
ALTER TABLE failure RENAME TO old_failure;
DROP INDEX failure_of_job;
CREATE TABLE failure (
    number INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job, leaf INTEGER NOT NULL, attempt TEXT NOT NULL)
    STRICT;
CREATE INDEX failure_of_job ON failure (job);
INSERT INTO failure (job, leaf, attempt) SELECT job, leaf, attempt FROM old_failure ORDER BY rowid;
DROP TABLE old_failure;
";

/// Which farm it is.
const SCHEMA_5: &str = "CREATE TABLE identity (farm TEXT NOT NULL, epoch INTEGER NOT NULL, mark TEXT) STRICT;";

/// What deletion needs: which scene each job names, when each bundle was last named by a client, and what deleted jobs
/// used of quotas.
const SCHEMA_6: &str = "
ALTER TABLE job ADD COLUMN scene BLOB;
UPDATE job SET scene = unhex(json_extract(spec, '$.scene'));
CREATE INDEX job_of_scene ON job (scene);
ALTER TABLE bundle ADD COLUMN named_ms INTEGER NOT NULL DEFAULT 0;
UPDATE bundle SET named_ms = CAST(unixepoch('subsec') * 1000 AS INTEGER);
CREATE TABLE used (owner TEXT PRIMARY KEY, iterations INTEGER NOT NULL) STRICT, WITHOUT ROWID;
";

/// Pictures of jobs that have ended.
const SCHEMA_7: &str = "
CREATE TABLE picture (
    job INTEGER NOT NULL REFERENCES job, format TEXT NOT NULL, etag TEXT NOT NULL, name TEXT NOT NULL,
    bytes INTEGER NOT NULL, PRIMARY KEY (job, format)) STRICT, WITHOUT ROWID;
";

/// What URLs are to be told, and what became of it.
const SCHEMA_8: &str = "
CREATE TABLE notice (
    id TEXT PRIMARY KEY, job INTEGER NOT NULL, url TEXT NOT NULL, trusted INTEGER NOT NULL, body TEXT NOT NULL,
    created_ms INTEGER NOT NULL, attempts INTEGER NOT NULL, due_ms INTEGER, ended_ms INTEGER, error TEXT)
    STRICT, WITHOUT ROWID;
CREATE INDEX notice_due ON notice (due_ms) WHERE due_ms IS NOT NULL;
CREATE INDEX notice_ended ON notice (ended_ms) WHERE ended_ms IS NOT NULL;
CREATE INDEX notice_of_job ON notice (job, id);
";

/// What jobs are found by.
const SCHEMA_9: &str = "
ALTER TABLE job ADD COLUMN title TEXT NOT NULL DEFAULT '';
UPDATE job SET title = coalesce(nullif(json_extract(spec, '$.name'), ''), json_extract(spec, '$.main'), '');
CREATE TABLE label (
    job INTEGER NOT NULL REFERENCES job, name TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (job, name))
    STRICT, WITHOUT ROWID;
INSERT INTO label SELECT job.id, entry.key, entry.value FROM job, json_each(job.spec, '$.labels') AS entry;
CREATE INDEX label_named ON label (name, value, job);
CREATE INDEX job_of_state ON job (state, id);
CREATE INDEX job_created ON job (created_ms);
";

/// A file that is not a farm of this version.
pub(super) fn foreign(path: &Path, reason: String) -> StoreError {
    StoreError::Foreign {
        place: path.display().to_string(),
        reason,
    }
}

/// Makes or migrates the tables.
pub(super) fn prepare_schema(transaction: &Transaction, path: &Path) -> Result<(), StoreError> {
    let pragma = |name: &str| transaction.pragma_query_value(None, name, |row| row.get::<_, i32>(0));
    let tables: i64 = transaction.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    let found = match (pragma("application_id")?, pragma("user_version")?) {
        (0, 0) if tables == 0 => 0,
        (APPLICATION_ID, version @ 1..) => version as usize,
        _ => return Err(foreign(path, "a database of another program".into())),
    };
    let current = VERSION;
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
