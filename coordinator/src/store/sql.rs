//! What SQL databases share: queries, and how rows become records. Parameters are `?1`, `?2`, ...

use super::sql_bundles::owned_bytes;
use super::sql_changes::raise_counter;
use super::sql_pictures::pictures;
use super::{EndedJob, Sequence, StoreError, image_bytes};
use crate::access::TokenRecord;
use crate::scheduler::record::{
    BlobName, Counters, JobControl, JobHead, JobRecord, LeaseRecord, NodeRecord, Snapshot, WorkerRecord,
};
use async_trait::async_trait;
use photonfarm_proto::api::FarmIdentity;
use photonfarm_proto::id::{BlobHash, JobId};
use photonfarm_proto::job::JobSpec;
use photonfarm_proto::node::NodeKey;
use photonfarm_proto::token::Usage;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::pin::Pin;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A value of a column.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    /// Nothing.
    Null,
    /// 64 bits with a sign; ours stay far below it.
    Integer(i64),
    /// Text, often JSON.
    Text(String),
    /// A hash.
    Bytes(Vec<u8>),
}

/// A statement with its parameters.
#[derive(Clone, Debug)]
pub(super) struct Statement {
    pub(super) sql: &'static str,
    pub(super) values: Vec<Value>,
    /// Rows that it has to change, where another number of them means that something else happened meanwhile.
    pub(super) expected: Option<u64>,
}

impl Statement {
    pub(super) fn new<const N: usize>(sql: &'static str, values: [Value; N]) -> Self {
        Self {
            sql,
            values: values.into(),
            expected: None,
        }
    }
}

pub(super) fn integer(value: u64) -> Result<Value, StoreError> {
    i64::try_from(value)
        .map(Value::Integer)
        .map_err(|_| StoreError::Damaged(format!("{value} does not fit")))
}

pub(super) fn small(value: u32) -> Value {
    Value::Integer(value.into())
}

pub(super) fn flag(value: bool) -> Value {
    Value::Integer(value.into())
}

pub(super) fn text(value: &Option<String>) -> Value {
    value.clone().map_or(Value::Null, Value::Text)
}

pub(super) fn hash(value: BlobHash) -> Value {
    Value::Bytes(value.0.to_vec())
}

pub(super) fn json<T: Serialize>(value: &T) -> Result<Value, StoreError> {
    to_json(value).map(Value::Text)
}

pub(super) fn to_json<T: Serialize>(value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| StoreError::Damaged(error.to_string()))
}

pub(super) fn from_json<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| StoreError::Damaged(error.to_string()))
}

/// A row: its values in the order of the columns asked for.
#[derive(Debug)]
pub(super) struct Row(std::vec::IntoIter<Value>);

impl Row {
    pub(super) fn new(values: Vec<Value>) -> Self {
        Self(values.into_iter())
    }

    fn next(&mut self) -> Value {
        self.0.next().unwrap_or(Value::Null)
    }

    pub(super) fn optional_integer(&mut self) -> Result<Option<u64>, StoreError> {
        match self.next() {
            Value::Null => Ok(None),
            Value::Integer(value) => Ok(Some(
                u64::try_from(value).map_err(|_| StoreError::Damaged(format!("{value} is negative")))?,
            )),
            other => Err(unexpected("a number", &other)),
        }
    }

    pub(super) fn integer(&mut self) -> Result<u64, StoreError> {
        self.optional_integer()?
            .ok_or_else(|| unexpected("a number", &Value::Null))
    }

    fn small(&mut self) -> Result<u32, StoreError> {
        let value = self.integer()?;
        u32::try_from(value).map_err(|_| StoreError::Damaged(format!("{value} is too large")))
    }

    fn flag(&mut self) -> Result<bool, StoreError> {
        Ok(self.integer()? != 0)
    }

    pub(super) fn text(&mut self) -> Result<String, StoreError> {
        self.optional_text()?.ok_or_else(|| unexpected("text", &Value::Null))
    }

    fn optional_text(&mut self) -> Result<Option<String>, StoreError> {
        match self.next() {
            Value::Null => Ok(None),
            Value::Text(text) => Ok(Some(text)),
            other => Err(unexpected("text", &other)),
        }
    }

    fn resolution(&mut self) -> Result<Option<[u32; 2]>, StoreError> {
        Ok(match (self.optional_integer()?, self.optional_integer()?) {
            (Some(width), Some(height)) => Some([width as u32, height as u32]),
            _ => None,
        })
    }

    pub(super) fn hash(&mut self) -> Result<BlobHash, StoreError> {
        match self.next() {
            Value::Bytes(bytes) => {
                let hash = bytes.try_into().map(BlobHash);
                hash.map_err(|_| StoreError::Damaged("a hash has another length".into()))
            }
            other => Err(unexpected("a hash", &other)),
        }
    }

    pub(super) fn json<T: DeserializeOwned>(&mut self) -> Result<T, StoreError> {
        from_json(&self.text()?)
    }
}

fn unexpected(expected: &str, found: &Value) -> StoreError {
    StoreError::Damaged(format!("{expected} was expected, not {found:?}"))
}

/// Something that answers queries, all on the same state.
#[async_trait]
pub(super) trait Queries: Send {
    /// The rows.
    async fn query(&mut self, statement: Statement) -> Result<Vec<Row>, StoreError>;
    /// Changes rows; returns how many.
    async fn execute(&mut self, statement: Statement) -> Result<u64, StoreError>;
}

/// What is asked of a database: queries that become an answer.
pub(super) type Answer<'a, T> = Pin<Box<dyn Future<Output = Result<T, StoreError>> + Send + 'a>>;

pub(super) async fn ask<const N: usize>(
    queries: &mut dyn Queries,
    sql: &'static str,
    values: [Value; N],
) -> Result<Vec<Row>, StoreError> {
    queries.query(Statement::new(sql, values)).await
}

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

/// Up to `limit` jobs, newest first, below the job `before`.
pub(super) async fn jobs(
    queries: &mut dyn Queries,
    before: Option<JobId>,
    limit: u32,
) -> Result<Vec<JobRecord>, StoreError> {
    let before = before.and_then(|id| i64::try_from(id.0).ok()).unwrap_or(i64::MAX);
    let sql = "SELECT id, spec, key, created_ms, state, failure, ended_ms, width, height, totals, owner,
        control, share_ms FROM job WHERE id < ?1 ORDER BY id DESC LIMIT ?2";
    read_jobs(queries, sql, [Value::Integer(before), small(limit)]).await
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

pub(super) fn one(mut rows: Vec<Row>) -> Result<Row, StoreError> {
    rows.pop().ok_or_else(|| StoreError::Damaged("a row is missing".into()))
}

/// What an owner has used; `jobs` asks for the jobs that go on and the iterations of all that are there.
pub(super) async fn usage(queries: &mut dyn Queries, jobs: &'static str, owner: String) -> Result<Usage, StoreError> {
    let mut found = one(ask(queries, jobs, [Value::Text(owner.clone())]).await?)?;
    let deleted = "SELECT CAST(coalesce(sum(iterations), 0) AS BIGINT) FROM used WHERE owner = ?1";
    let deleted = one(ask(queries, deleted, [Value::Text(owner.clone())]).await?)?.integer()?;
    Ok(Usage {
        jobs: found.integer()?,
        bundle_bytes: owned_bytes(queries, owner).await?,
        iterations: found.integer()? + deleted,
    })
}

/// Keeps a token; returns false, and changes nothing, if there is one of that name.
pub(super) async fn put_token(queries: &mut dyn Queries, token: &TokenRecord) -> Result<bool, StoreError> {
    let sql = "INSERT INTO token (name, record) VALUES (?1, ?2) ON CONFLICT DO NOTHING";
    let statement = Statement::new(sql, [Value::Text(token.name.clone()), json(token)?]);
    Ok(queries.execute(statement).await? == 1)
}

/// All tokens, by name.
pub(super) async fn tokens(queries: &mut dyn Queries) -> Result<Vec<TokenRecord>, StoreError> {
    let found = ask(queries, "SELECT record FROM token", []).await?;
    let mut tokens: Vec<TokenRecord> = found.into_iter().map(|mut row| row.json()).collect::<Result<_, _>>()?;
    tokens.sort_unstable_by(|a, b| a.name.cmp(&b.name));
    Ok(tokens)
}

/// Forgets a token. Returns whether there was one.
pub(super) async fn remove_token(queries: &mut dyn Queries, name: String) -> Result<bool, StoreError> {
    let statement = Statement::new("DELETE FROM token WHERE name = ?1", [Value::Text(name)]);
    Ok(queries.execute(statement).await? == 1)
}

/// Names of the images of all nodes that count, and of the pictures, of all jobs.
pub(super) async fn live_images(queries: &mut dyn Queries) -> Result<Vec<BlobName>, StoreError> {
    let found = ask(queries, "SELECT record FROM node WHERE live = 1", []).await?;
    let image = |mut row: Row| Ok(row.json::<NodeRecord>()?.image());
    let mut images: Vec<BlobName> = found.into_iter().map(image).collect::<Result<_, StoreError>>()?;
    images.extend(pictures(queries, None).await?);
    Ok(images)
}

/// Who the farm is. `mark` is something that a restored or copied database does not share with the one that it comes
/// from; if it is another one than last time, a new epoch begins.
///
/// A backup does not know which numbers the farm has given since. So the numbers of jobs, workers and leases go on from
/// the time in milliseconds, which is beyond all of them: a farm cannot have given one in each millisecond since 2020.
pub(super) async fn identify(queries: &mut dyn Queries, mark: Option<String>) -> Result<FarmIdentity, StoreError> {
    let found = ask(queries, "SELECT farm, epoch, mark FROM identity", []).await?.pop();
    let Some(mut row) = found else {
        let farm = format!("{:016x}{:016x}", getrandom::u64()?, getrandom::u64()?);
        let insert = "INSERT INTO identity (farm, epoch, mark) VALUES (?1, 1, ?2)";
        let insert = Statement::new(insert, [Value::Text(farm.clone()), text(&mark)]);
        queries.execute(insert).await?;
        return Ok(FarmIdentity { farm, epoch: 1 });
    };
    let (farm, epoch, known) = (row.text()?, row.integer()?, row.optional_text()?);
    if known == mark {
        return Ok(FarmIdentity { farm, epoch });
    }
    let (epoch, floor) = (epoch + 1, since_2020_ms());
    for counter in ["job", "worker", "token"] {
        queries.execute(raise_counter(counter, floor)?).await?;
    }
    let begin = "UPDATE identity SET epoch = ?1, mark = ?2";
    queries
        .execute(Statement::new(begin, [integer(epoch)?, text(&mark)]))
        .await?;
    tracing::warn!(
        epoch,
        "the farm was restored or copied: new jobs have numbers beyond {floor}, so that none is used twice"
    );
    Ok(FarmIdentity { farm, epoch })
}

fn since_2020_ms() -> u64 {
    const BEGIN: Duration = Duration::from_secs(1_577_836_800);
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since_1970.saturating_sub(BEGIN).as_millis() as u64
}

/// The farm's place in the order of commits.
pub(super) async fn sequence(queries: &mut dyn Queries) -> Result<Sequence, StoreError> {
    one(ask(queries, "SELECT sequence FROM farm", []).await?)?.integer()
}

async fn read_jobs<const N: usize>(
    queries: &mut dyn Queries,
    sql: &'static str,
    values: [Value; N],
) -> Result<Vec<JobRecord>, StoreError> {
    let mut jobs = Vec::new();
    for row in ask(queries, sql, values).await? {
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
