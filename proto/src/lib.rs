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
pub mod planes;
pub mod problem;
pub mod schedule;
pub mod token;
pub mod worker;

/// Version of this program: coordinator and workers must have the same.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Name of this build's renderer: the version, and a digest of the renderer's sources, of what they depend on, and of
/// what they are compiled for. Results of renderers with different names are not mixed in one job.
pub const RENDERER: &str = concat!(env!("CARGO_PKG_VERSION"), "+", env!("PHOTONFARM_BUILD"));

/// The version within the name of a renderer.
#[must_use]
pub fn version_of(renderer: &str) -> &str {
    renderer.split_once('+').map_or(renderer, |(version, _)| version)
}
