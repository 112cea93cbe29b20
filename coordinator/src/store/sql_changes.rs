//! What each change does to the rows of an SQL database.

use super::sql::{Queries, Statement, Value, flag, hash, integer, json, small, text};
use super::{StoreError, sql_notices};
use crate::scheduler::record::{Change, JobHead, JobRecord, LeaseRecord, Millis, NodeRecord, Renewal, WorkerRecord};
use photonfarm_proto::id::JobId;
use photonfarm_proto::job::{JobState, Totals};
use photonfarm_proto::node::NodeKey;

/// A counter never falls.
pub(super) fn raise_counter(name: &str, value: u64) -> Result<Statement, StoreError> {
    let sql = "INSERT INTO counter (name, value) VALUES (?1, ?2)
        ON CONFLICT (name) DO UPDATE SET value = excluded.value WHERE counter.value < excluded.value";
    Ok(Statement::new(sql, [Value::Text(name.into()), integer(value)?]))
}

/// Applies a change to the rows.
pub(super) async fn apply(queries: &mut dyn Queries, change: &Change) -> Result<(), StoreError> {
    for statement in statements(change)? {
        let expected = statement.expected;
        let changed = queries.execute(statement).await?;
        if expected.is_some_and(|expected| expected != changed) {
            return Err(StoreError::TooLate);
        }
    }
    Ok(())
}

/// What a change does to the rows.
fn statements(change: &Change) -> Result<Vec<Statement>, StoreError> {
    Ok(match change {
        Change::WorkerRegistered(worker) => register(worker)?,
        Change::WorkerJudged { worker, standing } => vec![Statement::new(
            "UPDATE worker SET standing = ?2 WHERE id = ?1",
            [integer(worker.0)?, json(standing)?],
        )],
        Change::WorkerForgotten(worker) => {
            vec![Statement::new("DELETE FROM worker WHERE id = ?1", [integer(worker.0)?])]
        }
        Change::JobSubmitted(head) => submit(head)?,
        Change::JobChanged { job, control } => vec![Statement::new(
            "UPDATE job SET control = ?2 WHERE id = ?1",
            [integer(job.0)?, json(control)?],
        )],
        Change::JobReopened { record, ended_ms } => vec![forget_pictures(record.head.id)?, reopen(record, *ended_ms)?],
        Change::JobDeleted {
            job,
            ended_ms,
            owner,
            iterations,
        } => delete(*job, *ended_ms, owner, *iterations)?,
        Change::LeaseGranted(lease) => grant(lease)?,
        Change::LeaseEnded { token, .. } => {
            vec![Statement::new(
                "DELETE FROM lease WHERE token = ?1",
                [integer(token.number)?],
            )]
        }
        Change::LeasesRenewed(renewals) => renewals.iter().map(renew).collect::<Result<_, _>>()?,
        Change::NodeAdded {
            job,
            node,
            record,
            resolution: [width, height],
        } => {
            let sql = "UPDATE job SET width = ?2, height = ?3 WHERE id = ?1";
            let size = [integer(job.0)?, small(*width), small(*height)];
            vec![write_node(*job, *node, record)?, Statement::new(sql, size)]
        }
        Change::NodeJudged { job, node, record } => vec![write_node(*job, *node, record)?],
        Change::NodeMerged { job, node } => vec![at_node(
            "UPDATE node SET live = 0 WHERE job = ?1 AND level = ?2 AND place = ?3",
            *job,
            *node,
        )?],
        Change::NodeLost { job, node, .. } => vec![at_node(
            "DELETE FROM node WHERE job = ?1 AND level <= ?2 AND place >> CAST(?2 - level AS INTEGER) = ?3",
            *job,
            *node,
        )?],
        Change::LeafFailed { job, leaf, attempt } => {
            let sql = "INSERT INTO failure (job, leaf, attempt) VALUES (?1, ?2, ?3)";
            vec![Statement::new(sql, [integer(job.0)?, small(*leaf), json(attempt)?])]
        }
        Change::FailuresForgotten { job } => {
            let sql = "DELETE FROM failure WHERE job = ?1";
            vec![Statement::new(sql, [integer(job.0)?])]
        }
        Change::JobEnded {
            job,
            state,
            failure,
            ended_ms,
        } => {
            let sql = "UPDATE job SET state = ?2, failure = ?3, ended_ms = ?4 WHERE id = ?1";
            let values = [integer(job.0)?, json(state)?, text(failure), integer(*ended_ms)?];
            vec![
                Statement::new("DELETE FROM lease WHERE job = ?1", [integer(job.0)?]),
                Statement::new(sql, values),
            ]
        }
        Change::NoticeAdded(notice) => vec![sql_notices::add(notice)?],
    })
}

fn register(worker: &WorkerRecord) -> Result<Vec<Statement>, StoreError> {
    let sql = "INSERT INTO worker (id, record, standing) VALUES (?1, ?2, ?3)
        ON CONFLICT (id) DO UPDATE SET record = excluded.record, standing = excluded.standing";
    let values = [integer(worker.id.0)?, json(worker)?, json(&worker.standing)?];
    Ok(vec![raise_counter("worker", worker.id.0)?, Statement::new(sql, values)])
}

fn grant(lease: &LeaseRecord) -> Result<Vec<Statement>, StoreError> {
    let sql = "INSERT INTO lease (token, job, record, until_ms, restarts) VALUES (?1, ?2, ?3, ?4, ?5)";
    let values = [
        integer(lease.token.number)?,
        integer(lease.job.0)?,
        json(lease)?,
        integer(lease.until_ms)?,
        small(lease.restarts),
    ];
    let running = "UPDATE job SET state = ?2, share_ms = ?3 WHERE id = ?1";
    let about_job = [
        integer(lease.job.0)?,
        json(&JobState::Running)?,
        integer(lease.share[1])?,
    ];
    Ok(vec![
        raise_counter("token", lease.token.number)?,
        raise_counter("share", lease.share[0])?,
        Statement::new(sql, values),
        Statement::new(running, about_job),
    ])
}

fn renew(renewal: &Renewal) -> Result<Statement, StoreError> {
    let values = [
        integer(renewal.token.number)?,
        integer(renewal.until_ms)?,
        small(renewal.restarts),
    ];
    Ok(Statement::new(
        "UPDATE lease SET until_ms = ?2, restarts = ?3 WHERE token = ?1",
        values,
    ))
}

fn forget_pictures(job: JobId) -> Result<Statement, StoreError> {
    Ok(Statement::new("DELETE FROM picture WHERE job = ?1", [integer(job.0)?]))
}

/// A job that had ended goes on; what it consists of is in its rows already.
fn reopen(record: &JobRecord, ended_ms: Millis) -> Result<Statement, StoreError> {
    let sql =
        "UPDATE job SET state = ?3, failure = NULL, ended_ms = NULL, control = ?4 WHERE id = ?1 AND ended_ms = ?2";
    let values = [
        integer(record.head.id.0)?,
        integer(ended_ms)?,
        json(&record.state)?,
        json(&record.control)?,
    ];
    Ok(Statement {
        expected: Some(1),
        ..Statement::new(sql, values)
    })
}

/// A job that had ended is gone; the iterations that it used of its owner's quota stay used.
fn delete(job: JobId, ended_ms: Millis, owner: &str, iterations: u32) -> Result<Vec<Statement>, StoreError> {
    let used = "INSERT INTO used (owner, iterations) VALUES (?1, ?2)
        ON CONFLICT (owner) DO UPDATE SET iterations = used.iterations + excluded.iterations";
    let rows = [
        "DELETE FROM failure WHERE job = ?1",
        "DELETE FROM lease WHERE job = ?1",
        "DELETE FROM node WHERE job = ?1",
        "DELETE FROM label WHERE job = ?1",
    ];
    let id = integer(job.0)?;
    let used = Statement::new(used, [Value::Text(owner.into()), small(iterations)]);
    let mut statements = vec![used, forget_pictures(job)?];
    statements.extend(rows.map(|sql| Statement::new(sql, [id.clone()])));
    let sql = "DELETE FROM job WHERE id = ?1 AND ended_ms = ?2";
    statements.push(Statement {
        expected: Some(1),
        ..Statement::new(sql, [id, integer(ended_ms)?])
    });
    Ok(statements)
}

fn submit(head: &JobHead) -> Result<Vec<Statement>, StoreError> {
    let sql = "INSERT INTO job (id, spec, key, created_ms, state, totals, owner, scene, title)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)";
    let name = &head.spec.name;
    let title = if name.is_empty() { &head.spec.main } else { name };
    let values = [
        integer(head.id.0)?,
        json(&head.spec)?,
        text(&head.key),
        integer(head.created_ms)?,
        json(&JobState::Queued)?,
        json(&Totals::default())?,
        Value::Text(head.owner.clone()),
        hash(head.spec.scene),
        Value::Text(title.clone()),
    ];
    let mut statements = vec![raise_counter("job", head.id.0)?, Statement::new(sql, values)];
    for (name, value) in &head.spec.labels {
        let sql = "INSERT INTO label (job, name, value) VALUES (?1, ?2, ?3)";
        let values = [
            integer(head.id.0)?,
            Value::Text(name.clone()),
            Value::Text(value.clone()),
        ];
        statements.push(Statement::new(sql, values));
    }
    Ok(statements)
}

fn at_node(sql: &'static str, job: JobId, node: NodeKey) -> Result<Statement, StoreError> {
    Ok(Statement::new(
        sql,
        [integer(job.0)?, small(node.level), small(node.index)],
    ))
}

fn write_node(job: JobId, node: NodeKey, record: &NodeRecord) -> Result<Statement, StoreError> {
    let sql = "INSERT INTO node (job, level, place, digest, live, record) VALUES (?1, ?2, ?3, ?4, ?5, ?6)
        ON CONFLICT (job, level, place) DO UPDATE
        SET digest = excluded.digest, live = excluded.live, record = excluded.record";
    let values = [
        integer(job.0)?,
        small(node.level),
        small(node.index),
        hash(record.digest),
        flag(record.live),
        json(record)?,
    ];
    Ok(Statement::new(sql, values))
}
