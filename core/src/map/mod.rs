//! Maps of photons and cones.
