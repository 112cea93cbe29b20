//! What the tests that cross crates share.

pub mod farm;
pub mod fuzz;
pub mod processes;
pub mod proxy;
pub mod render;
pub mod scenes;
pub mod statistics;
