//! Jobs and workers in an SQL database: how rows become records.

use super::sql::{Queries, Row, Value, ask, from_json, integer};
use super::{EndedJob, JobFilter, StoreError, image_bytes};
use crate::scheduler::record::{
    Counters, JobControl, JobHead, JobRecord, LeaseRecord, NodeRecord, Snapshot, WorkerRecord,
};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::node::NodeKey;

/// The state to go on from.
pub(super) async fn load(queries: &mut dyn Queries) -> Result<Snapshot, StoreError> {
    let mut counters = Counters::default();
    for (name, counter) in [
        ("job", &mut counters.job),
        ("worker", &mut counters.worker),
        ("token", &mut counters.token),
        ("share", &mut counters.share),
    ] {
        let sql = "SELECT value FROM counter WHERE name = ?1";
        let mut found = ask(queries, sql, [Value::Text(name.into())]).await?;
        *counter = found.pop().map_or(Ok(0), |mut row| row.integer())?;
    }
    let workers = ask(queries, "SELECT record, standing FROM worker ORDER BY id", []).await?;
    let workers = workers.into_iter().map(read_worker).collect::<Result<_, _>>()?;
    let sql = "SELECT id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner,
        control, share_ms FROM job WHERE ended_ms IS NULL ORDER BY id";
    Ok(Snapshot {
        counters,
        workers,
        jobs: read_jobs(queries, sql, []).await?,
    })
}

/// A job, whether it has ended or not.
pub(super) async fn job(queries: &mut dyn Queries, id: JobId) -> Result<Option<JobRecord>, StoreError> {
    let Ok(id) = integer(id.0) else { return Ok(None) };
    let sql = "SELECT id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner,
        control, share_ms FROM job WHERE id = ?1";
    Ok(read_jobs(queries, sql, [id]).await?.pop())
}

/// Up to `limit` jobs.
pub(super) async fn jobs(
    queries: &mut dyn Queries,
    filter: &JobFilter,
    limit: u32,
) -> Result<Vec<JobRecord>, StoreError> {
    let columns = "id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner,
        control, share_ms";
    let rows = queries.query(filter.query(columns, limit)?).await?;
    read_all(queries, rows).await
}

/// The jobs that have ended.
pub(super) async fn ended_jobs(queries: &mut dyn Queries) -> Result<Vec<EndedJob>, StoreError> {
    let sql = "SELECT id, ended_ms, spec, width, height,
        (SELECT count(*) FROM node WHERE node.job = job.id AND node.live = 1),
        (SELECT CAST(coalesce(sum(bytes), 0) AS BIGINT) FROM picture WHERE picture.job = job.id)
        FROM job WHERE ended_ms IS NOT NULL";
    ask(queries, sql, []).await?.into_iter().map(read_ended_job).collect()
}

fn read_ended_job(mut row: Row) -> Result<EndedJob, StoreError> {
    let (id, ended_ms) = (JobId(row.integer()?), row.integer()?);
    let spec: JobSpec = row.json()?;
    let image = image_bytes(&spec, row.resolution()?);
    Ok(EndedJob {
        id,
        ended_ms,
        scene: spec.scene,
        bytes: row.integer()? * image + row.integer()?,
    })
}

/// The job that was submitted with an idempotency key.
pub(super) async fn job_by_key(queries: &mut dyn Queries, key: String) -> Result<Option<JobRecord>, StoreError> {
    let sql = "SELECT id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner,
        control, share_ms FROM job WHERE key = ?1";
    Ok(read_jobs(queries, sql, [Value::Text(key)]).await?.pop())
}

async fn read_jobs<const N: usize>(
    queries: &mut dyn Queries,
    sql: &'static str,
    values: [Value; N],
) -> Result<Vec<JobRecord>, StoreError> {
    let rows = ask(queries, sql, values).await?;
    read_all(queries, rows).await
}

/// The jobs of these rows.
async fn read_all(queries: &mut dyn Queries, rows: Vec<Row>) -> Result<Vec<JobRecord>, StoreError> {
    let mut jobs = Vec::new();
    for row in rows {
        let mut job = read_job(row)?;
        let id = [integer(job.head.id.0)?];
        let nodes = "SELECT level, place, live, record FROM node WHERE job = ?1 ORDER BY level, place";
        let nodes = ask(queries, nodes, id.clone()).await?;
        job.nodes = nodes.into_iter().map(read_node).collect::<Result<_, _>>()?;
        let leases = "SELECT until_ms, restarts, record FROM lease WHERE job = ?1 ORDER BY token";
        let leases = ask(queries, leases, id.clone()).await?;
        job.leases = leases.into_iter().map(read_lease).collect::<Result<_, _>>()?;
        let failures = ask(
            queries,
            "SELECT leaf, attempt FROM failure WHERE job = ?1 ORDER BY number",
            id,
        );
        let failures = failures
            .await?
            .into_iter()
            .map(|mut row| Ok((row.small()?, row.json()?)));
        job.failures = failures.collect::<Result<_, StoreError>>()?;
        jobs.push(job);
    }
    Ok(jobs)
}

fn read_job(mut row: Row) -> Result<JobRecord, StoreError> {
    let id = JobId(row.integer()?);
    let spec = row.json()?;
    let (key, created_ms) = (row.optional_text()?, row.integer()?);
    let (state, failure, ended_ms) = (row.json()?, row.optional_text()?, row.optional_integer()?);
    let resolution = row.resolution()?;
    let (totals, owner) = (row.json()?, row.text()?);
    let control = row.optional_text()?.map(|text| from_json(&text)).transpose()?;
    Ok(JobRecord {
        control: control.unwrap_or_else(|| JobControl::of(&spec)),
        head: JobHead {
            id,
            spec,
            owner,
            key,
            created_ms,
        },
        share_ms: row.integer()?,
        state,
        failure,
        ended_ms,
        resolution,
        totals,
        nodes: Vec::new(),
        leases: Vec::new(),
        failures: Vec::new(),
    })
}

fn read_worker(mut row: Row) -> Result<WorkerRecord, StoreError> {
    let mut worker: WorkerRecord = row.json()?;
    if let Some(standing) = row.optional_text()? {
        worker.standing = from_json(&standing)?;
    }
    Ok(worker)
}

fn read_lease(mut row: Row) -> Result<LeaseRecord, StoreError> {
    Ok(LeaseRecord {
        until_ms: row.integer()?,
        restarts: row.small()?,
        ..row.json()?
    })
}

/// Whether a node counts on its own changes without its record being written anew; what it took is forgotten then.
fn read_node(mut row: Row) -> Result<(NodeKey, NodeRecord), StoreError> {
    let (level, index, live) = (row.small()?, row.small()?, row.flag()?);
    let mut record: NodeRecord = row.json()?;
    record.live = live;
    record.totals = record.totals.filter(|_| live);
    Ok((NodeKey { level, index }, record))
}
