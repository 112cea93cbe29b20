//! What URLs are to be told, in an SQL database, and what became of it.

use super::sql::{Queries, Row, Statement, Value, ask, flag, integer, optional, small, text};
use super::{NoticeRecord, StoreError};
use crate::scheduler::record::{Millis, Notice};
use photonfarm_proto::id::JobId;

/// Keeps a notice that is to be sent at once.
pub(super) fn add(notice: &Notice) -> Result<Statement, StoreError> {
    let sql = "INSERT INTO notice (id, job, url, trusted, body, created_ms, attempts, due_ms)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, 0, ?6)";
    let values = [
        Value::Text(notice.id.clone()),
        integer(notice.job.0)?,
        Value::Text(notice.url.clone()),
        flag(notice.trusted),
        Value::Text(notice.body.clone()),
        integer(notice.created_ms)?,
    ];
    Ok(Statement::new(sql, values))
}

/// Up to `limit` notices that are to be sent by now: those to URLs of the farm first, then those that are due for longest.
pub(super) async fn due(queries: &mut dyn Queries, now: Millis, limit: u32) -> Result<Vec<NoticeRecord>, StoreError> {
    let sql = "SELECT id, job, url, trusted, body, created_ms, attempts, due_ms, ended_ms, error FROM notice
        WHERE due_ms <= ?1 ORDER BY trusted DESC, due_ms, id LIMIT ?2";
    let found = ask(queries, sql, [integer(now)?, small(limit)]).await?;
    found.into_iter().map(read).collect()
}

/// Up to `limit` notices, newest first, below the notice `before`; those about one job if it is named.
pub(super) async fn notices(
    queries: &mut dyn Queries,
    job: Option<JobId>,
    before: Option<String>,
    limit: u32,
) -> Result<Vec<NoticeRecord>, StoreError> {
    let columns = "id, job, url, trusted, body, created_ms, attempts, due_ms, ended_ms, error";
    let mut values = vec![small(limit)];
    let mut conditions = Vec::new();
    if let Some(Ok(job)) = job.map(|job| integer(job.0)) {
        values.push(job);
        conditions.push(format!("job = ?{}", values.len()));
    }
    if let Some(before) = before {
        values.push(Value::Text(before));
        conditions.push(format!("id < ?{}", values.len()));
    }
    let only = match conditions.is_empty() {
        true => String::new(),
        false => format!("WHERE {}", conditions.join(" AND ")),
    };
    let sql = format!("SELECT {columns} FROM notice {only} ORDER BY id DESC LIMIT ?1");
    let found = queries.query(Statement::new(sql, values)).await?;
    found.into_iter().map(read).collect()
}

/// Keeps what became of an attempt.
pub(super) async fn keep_attempt(queries: &mut dyn Queries, record: &NoticeRecord) -> Result<(), StoreError> {
    let sql = "UPDATE notice SET attempts = ?2, due_ms = ?3, ended_ms = ?4, error = ?5 WHERE id = ?1";
    let values = [
        Value::Text(record.notice.id.clone()),
        small(record.attempts),
        optional(record.due_ms)?,
        optional(record.ended_ms)?,
        text(&record.error),
    ];
    queries.execute(Statement::new(sql, values)).await?;
    Ok(())
}

/// Forgets notices that arrived or were given up before a time. Returns how many.
pub(super) async fn forget(queries: &mut dyn Queries, before: Millis) -> Result<u64, StoreError> {
    let sql = "DELETE FROM notice WHERE ended_ms < ?1";
    queries.execute(Statement::new(sql, [integer(before)?])).await
}

fn read(mut row: Row) -> Result<NoticeRecord, StoreError> {
    Ok(NoticeRecord {
        notice: Notice {
            id: row.text()?,
            job: JobId(row.integer()?),
            url: row.text()?,
            trusted: row.flag()?,
            body: row.text()?,
            created_ms: row.integer()?,
        },
        attempts: row.small()?,
        due_ms: row.optional_integer()?,
        ended_ms: row.optional_integer()?,
        error: row.optional_text()?,
    })
}
