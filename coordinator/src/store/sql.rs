//! What is asked of SQL databases and what they answer: statements, values and rows. Parameters are `?1`, `?2`, ...

use super::StoreError;
use async_trait::async_trait;
use photonfarm_proto::id::BlobHash;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::borrow::Cow;
use std::pin::Pin;

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
    pub(super) sql: Cow<'static, str>,
    pub(super) values: Vec<Value>,
    /// Rows that it has to change, where another number of them means that something else happened meanwhile.
    pub(super) expected: Option<u64>,
}

impl Statement {
    pub(super) fn new(sql: impl Into<Cow<'static, str>>, values: impl Into<Vec<Value>>) -> Self {
        Self {
            sql: sql.into(),
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

pub(super) fn optional(value: Option<u64>) -> Result<Value, StoreError> {
    value.map_or(Ok(Value::Null), integer)
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

    pub(super) fn small(&mut self) -> Result<u32, StoreError> {
        let value = self.integer()?;
        u32::try_from(value).map_err(|_| StoreError::Damaged(format!("{value} is too large")))
    }

    pub(super) fn flag(&mut self) -> Result<bool, StoreError> {
        Ok(self.integer()? != 0)
    }

    pub(super) fn text(&mut self) -> Result<String, StoreError> {
        self.optional_text()?.ok_or_else(|| unexpected("text", &Value::Null))
    }

    pub(super) fn optional_text(&mut self) -> Result<Option<String>, StoreError> {
        match self.next() {
            Value::Null => Ok(None),
            Value::Text(text) => Ok(Some(text)),
            other => Err(unexpected("text", &other)),
        }
    }

    pub(super) fn resolution(&mut self) -> Result<Option<[u32; 2]>, StoreError> {
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

/// The rows of a query with these parameters.
pub(super) async fn ask<const N: usize>(
    queries: &mut dyn Queries,
    sql: &'static str,
    values: [Value; N],
) -> Result<Vec<Row>, StoreError> {
    queries.query(Statement::new(sql, values)).await
}

/// The row of a query that has one.
pub(super) fn one(mut rows: Vec<Row>) -> Result<Row, StoreError> {
    rows.pop().ok_or_else(|| StoreError::Damaged("a row is missing".into()))
}
