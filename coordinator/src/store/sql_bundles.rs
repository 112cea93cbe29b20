//! Bundles in an SQL database: which there are, what they name, and for whom that counts.

use super::sql::{Queries, Row, Statement, Value, ask, hash, integer, json, one};
use super::{Announced, StoreError};
use crate::scheduler::record::Millis;
use photonfarm_proto::bundle::BundleManifest;
use photonfarm_proto::id::BlobHash;
use std::collections::BTreeSet;

/// Keeps a manifest, which the owner names at the time `now`, and counts its blobs for the owner. Also returns whether
/// the owner has at most `most` bytes then: otherwise all of it is to be undone.
pub(super) async fn put_bundle(
    queries: &mut dyn Queries,
    manifest: &BundleManifest,
    owner: String,
    most: u64,
    now: Millis,
) -> Result<(Announced, bool), StoreError> {
    let bundle = "INSERT INTO bundle (hash, manifest, named_ms) VALUES (?1, ?2, ?3) ON CONFLICT (hash) DO UPDATE
        SET named_ms = excluded.named_ms WHERE bundle.named_ms < excluded.named_ms";
    let values = [hash(manifest.hash()), json(manifest)?, integer(now)?];
    queries.execute(Statement::new(bundle, values)).await?;
    let mut fresh = BTreeSet::new();
    for (blob, bytes) in manifest.blobs() {
        if bundled_size(queries, blob).await?.is_none() {
            fresh.insert(blob);
        }
        let size = "INSERT INTO bundle_blob (blob, bytes) VALUES (?1, ?2) ON CONFLICT DO NOTHING";
        queries
            .execute(Statement::new(size, [hash(blob), integer(bytes)?]))
            .await?;
        let owned =
            "INSERT INTO owned_blob (owner, blob, bytes) VALUES (?1, ?2, ?3) ON CONFLICT (owner, blob) DO UPDATE
            SET bytes = excluded.bytes WHERE owned_blob.bytes < excluded.bytes";
        let values = [Value::Text(owner.clone()), hash(blob), integer(bytes)?];
        queries.execute(Statement::new(owned, values)).await?;
    }
    let used = owned_bytes(queries, owner).await?;
    Ok((Announced { used, fresh }, used <= most))
}

/// The manifest of a bundle, which somebody names at the time `now`.
pub(super) async fn name_bundle(
    queries: &mut dyn Queries,
    name: BlobHash,
    now: Millis,
) -> Result<Option<BundleManifest>, StoreError> {
    let sql = "UPDATE bundle SET named_ms = ?2 WHERE hash = ?1 AND named_ms < ?2";
    let named = Statement::new(sql, [hash(name), integer(now)?]);
    queries.execute(named).await?;
    bundle(queries, name).await
}

/// Forgets bundles that no job names, and that nobody has named since the time `before`, with the blobs that only they
/// name. Returns the number of bundles.
pub(super) async fn forget_bundles(queries: &mut dyn Queries, before: Millis) -> Result<usize, StoreError> {
    let sql = "DELETE FROM bundle WHERE named_ms < ?1
        AND NOT EXISTS (SELECT 1 FROM job WHERE job.scene = bundle.hash) RETURNING manifest";
    let forgotten = read_manifests(ask(queries, sql, [integer(before)?]).await?)?;
    if forgotten.is_empty() {
        return Ok(0);
    }
    let left = read_manifests(ask(queries, "SELECT manifest FROM bundle", []).await?)?;
    let blobs = |manifests: &[BundleManifest]| -> BTreeSet<BlobHash> {
        let blobs = manifests.iter().flat_map(BundleManifest::blobs);
        blobs.map(|(blob, _)| blob).collect()
    };
    for blob in blobs(&forgotten).difference(&blobs(&left)) {
        for sql in [
            "DELETE FROM bundle_blob WHERE blob = ?1",
            "DELETE FROM owned_blob WHERE blob = ?1",
        ] {
            queries.execute(Statement::new(sql, [hash(*blob)])).await?;
        }
    }
    Ok(forgotten.len())
}

fn read_manifests(rows: Vec<Row>) -> Result<Vec<BundleManifest>, StoreError> {
    rows.into_iter().map(|mut row| row.json()).collect()
}

pub(super) async fn owned_bytes(queries: &mut dyn Queries, owner: String) -> Result<u64, StoreError> {
    let sql = "SELECT CAST(coalesce(sum(bytes), 0) AS BIGINT) FROM owned_blob WHERE owner = ?1";
    one(ask(queries, sql, [Value::Text(owner)]).await?)?.integer()
}

/// The manifest of a bundle.
pub(super) async fn bundle(queries: &mut dyn Queries, name: BlobHash) -> Result<Option<BundleManifest>, StoreError> {
    let sql = "SELECT manifest FROM bundle WHERE hash = ?1";
    let found = ask(queries, sql, [hash(name)]).await?.pop();
    found.map(|mut row| row.json()).transpose()
}

/// The largest size that a bundle gives for a blob.
pub(super) async fn bundled_size(queries: &mut dyn Queries, blob: BlobHash) -> Result<Option<u64>, StoreError> {
    let sql = "SELECT max(bytes) FROM bundle_blob WHERE blob = ?1";
    one(ask(queries, sql, [hash(blob)]).await?)?.optional_integer()
}

/// Hashes of the files that bundles name.
pub(super) async fn bundled_files(queries: &mut dyn Queries) -> Result<BTreeSet<BlobHash>, StoreError> {
    let found = ask(queries, "SELECT DISTINCT blob FROM bundle_blob", []).await?;
    found.into_iter().map(|mut row| row.hash()).collect()
}
