//! The renderer of Photonfarm.
//!
//! Everything here is pure and synchronous: no sockets, no clocks, no global state. The one function the farm
//! calls is [`integrator::render_iteration`]: the same scene, settings, seed and iteration index give the same
//! bits on any machine and with any number of threads.

#[cfg(test)]
pub(crate) mod chi_square;
pub mod density;
pub mod film;
pub mod geometry;
pub mod integrator;
pub mod light;
pub mod material;
pub mod math;
pub mod medium;
mod meter;
mod motion;
mod path;
pub mod picture;
pub mod random;
pub mod scene;
pub mod sensor;
pub mod settings;
pub mod spectrum;
pub mod texture;
pub mod tree;
