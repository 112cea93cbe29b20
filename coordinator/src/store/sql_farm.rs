//! Which farm an SQL database holds, and how far it has come.

use super::sql::{Queries, Statement, Value, ask, integer, one, text};
use super::sql_changes::raise_counter;
use super::{Sequence, StoreError};
use photonfarm_proto::api::FarmIdentity;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

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
