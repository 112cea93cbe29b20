//! A transaction of a PostgreSQL database as something that answers queries.

use super::StoreError;
use super::sql::{Queries, Row, Statement, Value};
use async_trait::async_trait;
use bytes::BytesMut;
use tokio_postgres::types::{FromSql, IsNull, ToSql, Type};

/// A transaction.
pub(super) struct Session<'a>(pub(super) &'a deadpool_postgres::Transaction<'a>);

#[async_trait]
impl Queries for Session<'_> {
    async fn query(&mut self, Statement { sql, values, .. }: Statement) -> Result<Vec<Row>, StoreError> {
        let statement = self.0.prepare_cached(&sql.replace('?', "$")).await?;
        let values: Vec<&(dyn ToSql + Sync)> = values.iter().map(|value| value as _).collect();
        let rows = self.0.query(&statement, &values).await?;
        let read = |row: &tokio_postgres::Row| {
            let values = (0..row.len()).map(|column| row.try_get::<_, Value>(column));
            Ok(Row::new(values.collect::<Result<_, _>>()?))
        };
        rows.iter().map(read).collect()
    }

    async fn execute(&mut self, Statement { sql, values, .. }: Statement) -> Result<u64, StoreError> {
        let statement = self.0.prepare_cached(&sql.replace('?', "$")).await?;
        let values: Vec<&(dyn ToSql + Sync)> = values.iter().map(|value| value as _).collect();
        Ok(self.0.execute(&statement, &values).await?)
    }
}

type ValueError = Box<dyn std::error::Error + Sync + Send>;

impl ToSql for Value {
    fn to_sql(&self, kind: &Type, out: &mut BytesMut) -> Result<IsNull, ValueError> {
        match self {
            Self::Null => Ok(IsNull::Yes),
            Self::Integer(value) => value.to_sql(kind, out),
            Self::Text(text) => text.to_sql(kind, out),
            Self::Bytes(bytes) => bytes.to_sql(kind, out),
        }
    }

    fn accepts(kind: &Type) -> bool {
        matches!(*kind, Type::INT8 | Type::TEXT | Type::BYTEA)
    }

    tokio_postgres::types::to_sql_checked!();
}

impl<'a> FromSql<'a> for Value {
    fn from_sql(kind: &Type, raw: &'a [u8]) -> Result<Self, ValueError> {
        Ok(match *kind {
            Type::INT8 => Self::Integer(i64::from_sql(kind, raw)?),
            Type::TEXT => Self::Text(String::from_sql(kind, raw)?),
            _ => Self::Bytes(Vec::from_sql(kind, raw)?),
        })
    }

    fn from_sql_null(_: &Type) -> Result<Self, ValueError> {
        Ok(Self::Null)
    }

    fn accepts(kind: &Type) -> bool {
        <Self as ToSql>::accepts(kind)
    }
}
