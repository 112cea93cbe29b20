//! Tokens in an SQL database, and what their owners have used.

use super::sql::{Queries, Statement, Value, ask, json, one};
use super::sql_bundles::owned_bytes;
use super::{StoreError, TokenRecord};
use photonfarm_proto::token::Usage;

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
