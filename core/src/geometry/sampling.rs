//! Points sampled on shapes, for lights.
