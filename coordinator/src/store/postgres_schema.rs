//! The tables of a PostgreSQL database: made, migrated and checked at every start, by one coordinator at a time.

use super::postgres_session::Session;
use super::{StoreError, sql_farm};
use deadpool_postgres::{Object, Transaction};
use photonfarm_proto::api::FarmIdentity;

/// Names what is locked while tables are made.
const SCHEMA: i64 = 0x5048_464d_0002;

/// What makes each version of the schema from the one before; the first makes it from nothing.
pub(super) const MIGRATIONS: &[&str] = &[SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5, SCHEMA_6];

const SCHEMA_1: &str = "
CREATE TABLE farm (
    singular BOOLEAN PRIMARY KEY DEFAULT true CHECK (singular), schema_version BIGINT NOT NULL, sequence BIGINT NOT NULL);
INSERT INTO farm (schema_version, sequence) VALUES (1, 0);
CREATE TABLE change (sequence BIGINT PRIMARY KEY, changes TEXT NOT NULL);
CREATE TABLE beat (worker BIGINT PRIMARY KEY, at_ms BIGINT NOT NULL, leases TEXT NOT NULL);
CREATE TABLE counter (name TEXT PRIMARY KEY, value BIGINT NOT NULL);
CREATE TABLE worker (id BIGINT PRIMARY KEY, record TEXT NOT NULL, standing TEXT);
CREATE TABLE bundle (hash BYTEA PRIMARY KEY, manifest TEXT NOT NULL);
CREATE TABLE bundle_blob (blob BYTEA, bytes BIGINT, PRIMARY KEY (blob, bytes));
CREATE TABLE owned_blob (owner TEXT, blob BYTEA, bytes BIGINT NOT NULL, PRIMARY KEY (owner, blob));
CREATE TABLE token (name TEXT PRIMARY KEY, record TEXT NOT NULL);
CREATE TABLE job (
    id BIGINT PRIMARY KEY, spec TEXT NOT NULL, owner TEXT NOT NULL, key TEXT UNIQUE, created_ms BIGINT NOT NULL,
    state TEXT NOT NULL, failure TEXT, ended_ms BIGINT, width BIGINT, height BIGINT, totals TEXT NOT NULL,
    control TEXT, share_ms BIGINT NOT NULL DEFAULT 0);
CREATE INDEX job_going_on ON job (id) WHERE ended_ms IS NULL;
CREATE INDEX job_of_owner ON job (owner);
CREATE TABLE node (
    job BIGINT NOT NULL REFERENCES job, level BIGINT NOT NULL, place BIGINT NOT NULL, digest BYTEA NOT NULL,
    live BIGINT NOT NULL, record TEXT NOT NULL, PRIMARY KEY (job, level, place));
CREATE INDEX node_live ON node (job) WHERE live = 1;
CREATE TABLE lease (
    token BIGINT PRIMARY KEY, job BIGINT NOT NULL REFERENCES job, record TEXT NOT NULL,
    until_ms BIGINT NOT NULL, restarts BIGINT NOT NULL);
CREATE INDEX lease_of_job ON lease (job);
CREATE TABLE failure (
    number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY, job BIGINT NOT NULL REFERENCES job, leaf BIGINT NOT NULL,
    attempt TEXT NOT NULL);
CREATE INDEX failure_of_job ON failure (job);
";

/// Which farm it is; when signs of life were written, which may be long after they were heard.
const SCHEMA_2: &str = "
CREATE TABLE identity (farm TEXT NOT NULL, epoch BIGINT NOT NULL, mark TEXT);
ALTER TABLE beat ADD COLUMN written_ms BIGINT NOT NULL DEFAULT 0;
";

/// What deletion needs: which scene each job names, when each bundle was last named by a client, and what deleted jobs
/// used of quotas.
const SCHEMA_3: &str = "
ALTER TABLE job ADD COLUMN scene BYTEA;
UPDATE job SET scene = decode(CAST(spec AS JSON) ->> 'scene', 'hex');
CREATE INDEX job_of_scene ON job (scene);
ALTER TABLE bundle ADD COLUMN named_ms BIGINT NOT NULL DEFAULT 0;
UPDATE bundle SET named_ms = CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT);
CREATE TABLE used (owner TEXT PRIMARY KEY, iterations BIGINT NOT NULL);
";

/// Pictures of jobs that have ended.
const SCHEMA_4: &str = "
CREATE TABLE picture (
    job BIGINT NOT NULL REFERENCES job, format TEXT NOT NULL, etag TEXT NOT NULL, name TEXT NOT NULL,
    bytes BIGINT NOT NULL, PRIMARY KEY (job, format));
";

/// What URLs are to be told, and what became of it.
const SCHEMA_5: &str = "
CREATE TABLE notice (
    id TEXT PRIMARY KEY, job BIGINT NOT NULL, url TEXT NOT NULL, trusted BIGINT NOT NULL, body TEXT NOT NULL,
    created_ms BIGINT NOT NULL, attempts BIGINT NOT NULL, due_ms BIGINT, ended_ms BIGINT, error TEXT);
CREATE INDEX notice_due ON notice (due_ms) WHERE due_ms IS NOT NULL;
CREATE INDEX notice_ended ON notice (ended_ms) WHERE ended_ms IS NOT NULL;
CREATE INDEX notice_of_job ON notice (job, id);
";

/// What jobs are found by.
const SCHEMA_6: &str = "
ALTER TABLE job ADD COLUMN title TEXT NOT NULL DEFAULT '';
UPDATE job SET title = coalesce(nullif(CAST(spec AS JSON) ->> 'name', ''), CAST(spec AS JSON) ->> 'main', '');
CREATE TABLE label (
    job BIGINT NOT NULL REFERENCES job, name TEXT NOT NULL, value TEXT NOT NULL, PRIMARY KEY (job, name));
INSERT INTO label
    SELECT job.id, entry.key, entry.value FROM job, json_each_text(CAST(job.spec AS JSON) -> 'labels') AS entry;
CREATE INDEX label_named ON label (name, value, job);
DROP INDEX job_of_owner;
CREATE INDEX job_of_owner ON job (owner, id);
CREATE INDEX job_of_state ON job (state, id);
CREATE INDEX job_created ON job (created_ms);
";

/// What a restored or copied database does not share with the one that it comes from: the cluster, its history (which forks
/// when an older state, or another server, takes over), the database and its tables.
const MARK: &str =
    "SELECT concat_ws(' ', system_identifier, timeline_id, pg_database.oid, CAST('farm' AS regclass)::oid)
    FROM pg_control_system(), pg_control_checkpoint(), pg_database WHERE datname = current_database()";

/// What each table has to have.
const COLUMNS: &[(&str, &str)] = &[
    ("farm", "schema_version sequence"),
    ("change", "sequence changes"),
    ("beat", "worker at_ms leases written_ms"),
    ("identity", "farm epoch mark"),
    ("counter", "name value"),
    ("worker", "id record standing"),
    ("bundle", "hash manifest named_ms"),
    ("bundle_blob", "blob bytes"),
    ("owned_blob", "owner blob bytes"),
    ("token", "name record"),
    ("used", "owner iterations"),
    ("picture", "job format etag name bytes"),
    (
        "notice",
        "id job url trusted body created_ms attempts due_ms ended_ms error",
    ),
    (
        "job",
        "id spec owner key created_ms state failure ended_ms width height totals control share_ms scene title",
    ),
    ("label", "job name value"),
    ("node", "job level place digest live record"),
    ("lease", "token job record until_ms restarts"),
    ("failure", "number job leaf attempt"),
];

/// Makes or migrates the tables, and checks that they are as they should be. Returns which farm they are of.
pub(super) async fn prepare(client: &mut Object, place: &str) -> Result<FarmIdentity, StoreError> {
    let transaction = client.transaction().await?;
    transaction
        .execute("SELECT pg_advisory_xact_lock($1)", &[&SCHEMA])
        .await?;
    let foreign = |reason: String| StoreError::Foreign {
        place: place.into(),
        reason,
    };
    let found = version(&transaction).await?.map_err(foreign)?;
    let current = MIGRATIONS.len();
    if found > current {
        let reason = format!("made by a newer version: schema {found}, this program has {current}");
        return Err(foreign(reason));
    }
    for migration in &MIGRATIONS[found..] {
        transaction.batch_execute(migration).await?;
    }
    for (table, columns) in COLUMNS {
        for column in columns.split(' ') {
            let query = "SELECT 1 FROM information_schema.columns
                WHERE table_schema = current_schema() AND table_name = $1 AND column_name = $2";
            if transaction.query_opt(query, &[table, &column]).await?.is_none() {
                let reason = format!("the tables are damaged: {table} has no column {column}");
                return Err(foreign(reason));
            }
        }
    }
    let version = i64::try_from(current).unwrap_or_default();
    transaction
        .execute("UPDATE farm SET schema_version = $1", &[&version])
        .await?;
    let mark: String = transaction.query_one(MARK, &[]).await?.try_get(0)?;
    let known = "SELECT epoch FROM identity";
    let before: Option<i64> = transaction.query_opt(known, &[]).await?.map(|row| row.get(0));
    let identity = sql_farm::identify(&mut Session(&transaction), Some(mark)).await?;
    if before.is_some_and(|before| before as u64 != identity.epoch) {
        // Whoever has the farm's state in memory is to load it again.
        transaction
            .execute("UPDATE farm SET sequence = sequence + 1", &[])
            .await?;
    }
    transaction.commit().await?;
    Ok(identity)
}

/// The version of the tables: 0 in an empty database; or why there is none.
async fn version(transaction: &Transaction<'_>) -> Result<Result<usize, String>, StoreError> {
    let query = "SELECT table_name FROM information_schema.tables WHERE table_schema = current_schema()";
    let tables = transaction.query(query, &[]).await?;
    let tables: Result<Vec<String>, _> = tables.iter().map(|row| row.try_get(0)).collect();
    let tables = tables?;
    if !tables.iter().any(|table| table == "farm") {
        let ours = |table: &&String| COLUMNS.iter().any(|(name, _)| name == *table);
        return Ok(match tables.iter().find(ours) {
            Some(table) => Err(format!(
                "a database of another program: it has a table {table}, and none named farm"
            )),
            None => Ok(0),
        });
    }
    let query = "SELECT column_name FROM information_schema.columns
        WHERE table_schema = current_schema() AND table_name = 'farm' AND column_name = 'schema_version'";
    if transaction.query_opt(query, &[]).await?.is_none() {
        return Ok(Err("a database of another program: its table farm is not ours".into()));
    }
    let versions = transaction.query("SELECT schema_version FROM farm", &[]).await?;
    let [row] = versions.as_slice() else {
        return Ok(Err(format!("the tables are damaged: farm has {} rows", versions.len())));
    };
    let version: i64 = row.try_get(0)?;
    Ok(usize::try_from(version).map_err(|_| format!("the tables are damaged: schema {version}")))
}
