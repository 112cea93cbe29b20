//! What Photonfarm's coordinator, workers and clients say to each other.
//!
//! Public messages are JSON with OpenAPI schemas; worker messages are bincode in a frame with a magic number and a
//! version ([`codec`]); images of the reduction tree are a header and raw planes ([`node`]). Everything that arrives
//! is checked against [`limits::Limits`] before it is believed or allocated for.

pub mod api;
pub mod bundle;
pub mod codec;
pub mod id;
pub mod job;
pub mod limits;
pub mod node;
pub mod problem;
pub mod token;
pub mod worker;
