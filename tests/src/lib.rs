//! What the tests that cross crates share.

pub mod processes;
pub mod statistics;
