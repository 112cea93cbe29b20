//! Real PostgreSQL and S3 servers, started and ended by tests.
