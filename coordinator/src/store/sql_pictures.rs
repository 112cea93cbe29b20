//! Pictures of jobs that have ended, in an SQL database, and the names of all files that count.

use super::sql::{Queries, Row, Statement, Value, ask, integer};
use super::{PictureRecord, StoreError};
use crate::scheduler::record::{BlobName, Millis, NodeRecord};
use photonfarm_proto::id::JobId;

/// The picture of a job in this format.
pub(super) async fn picture(
    queries: &mut dyn Queries,
    job: JobId,
    format: &str,
) -> Result<Option<PictureRecord>, StoreError> {
    let sql = "SELECT etag, name, bytes FROM picture WHERE job = ?1 AND format = ?2";
    let found = ask(queries, sql, [integer(job.0)?, Value::Text(format.into())]).await?;
    found.into_iter().next().map(read_picture).transpose()
}

/// Keeps a picture of a job that ended at the time `ended_ms`. Returns what nothing names then: the picture that it
/// replaces, or itself if the job did not end at that time.
pub(super) async fn put_picture(
    queries: &mut dyn Queries,
    job: JobId,
    ended_ms: Millis,
    format: &str,
    picture: &PictureRecord,
) -> Result<Option<BlobName>, StoreError> {
    let sql = "SELECT id FROM job WHERE id = ?1 AND ended_ms = ?2";
    if ask(queries, sql, [integer(job.0)?, integer(ended_ms)?])
        .await?
        .is_empty()
    {
        return Ok(Some(picture.image));
    }
    let replaced = self::picture(queries, job, format).await?;
    let sql = "INSERT INTO picture (job, format, etag, name, bytes) VALUES (?1, ?2, ?3, ?4, ?5)
        ON CONFLICT (job, format) DO UPDATE SET etag = excluded.etag, name = excluded.name, bytes = excluded.bytes";
    let values = [
        integer(job.0)?,
        Value::Text(format.into()),
        Value::Text(picture.etag.clone()),
        Value::Text(picture.image.to_string()),
        integer(picture.bytes)?,
    ];
    queries.execute(Statement::new(sql, values)).await?;
    Ok(replaced.map(|picture| picture.image))
}

/// Names of all pictures, or of those of one job.
pub(super) async fn pictures(queries: &mut dyn Queries, job: Option<JobId>) -> Result<Vec<BlobName>, StoreError> {
    let found = match job {
        Some(job) => ask(queries, "SELECT name FROM picture WHERE job = ?1", [integer(job.0)?]).await?,
        None => ask(queries, "SELECT name FROM picture", []).await?,
    };
    found.into_iter().map(|mut row| read_name(&mut row)).collect()
}

/// Names of the images of all nodes that count, and of the pictures, of all jobs.
pub(super) async fn live_images(queries: &mut dyn Queries) -> Result<Vec<BlobName>, StoreError> {
    let found = ask(queries, "SELECT record FROM node WHERE live = 1", []).await?;
    let image = |mut row: Row| Ok(row.json::<NodeRecord>()?.image());
    let mut images: Vec<BlobName> = found.into_iter().map(image).collect::<Result<_, StoreError>>()?;
    images.extend(pictures(queries, None).await?);
    Ok(images)
}

fn read_picture(mut row: Row) -> Result<PictureRecord, StoreError> {
    Ok(PictureRecord {
        etag: row.text()?,
        image: read_name(&mut row)?,
        bytes: row.integer()?,
    })
}

fn read_name(row: &mut Row) -> Result<BlobName, StoreError> {
    let text = row.text()?;
    text.parse()
        .map_err(|_| StoreError::Damaged(format!("{text:?} names no picture")))
}
