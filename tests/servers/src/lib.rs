//! Real PostgreSQL and S3 servers, and a collector of spans, started and ended by tests.
//!
//! A server that cannot be started is a failure of the test, never a reason to skip it.

mod collector;
mod postgres;
mod s3;

pub use collector::Collector;
pub use postgres::Postgres;
pub use s3::S3;
