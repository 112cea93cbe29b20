//! Real PostgreSQL and S3 servers, started and ended by tests.
//!
//! A server that cannot be started is a failure of the test, never a reason to skip it.

mod postgres;
mod s3;

pub use postgres::Postgres;
pub use s3::S3;
