//! Settings that several integrators have.

use super::setting::{Instead, Kind, Setting};
use std::ops::Bound::{Excluded, Unbounded};

/// Light paths of an iteration. At half a dozen records each, the map of 10 million takes about 4 GB.
pub(crate) const PHOTONS: Setting = Setting {
    name: "photons",
    kind: Kind::Integer {
        least: 1,
        most: 10_000_000,
    },
    instead: None,
    unit: "",
    help: "Light paths per iteration",
};

/// Camera paths of an iteration.
pub(crate) const SAMPLES: Setting = Setting {
    name: "samples",
    kind: Kind::Integer { least: 1, most: 65_536 },
    instead: None,
    unit: "",
    help: "Camera samples per pixel and iteration",
};

/// Random numbers of an iteration's paths.
pub(crate) const SAMPLING: Setting = Setting {
    name: "sampling",
    kind: Kind::Choice(&["sobol", "independent"]),
    instead: None,
    unit: "",
    help: "How the random numbers of paths relate to each other: points of a Sobol' sequence have less noise",
};

/// How fast kernels shrink.
pub(crate) const ALPHA: Setting = Setting {
    name: "alpha",
    kind: Kind::Number((Excluded(0.0), Excluded(1.0))),
    instead: None,
    unit: "",
    help: "Share of the photons or cones that the shrinking kernel keeps",
};

/// The first spatial bandwidth.
pub(crate) const SIGMA1: Setting = Setting {
    name: "sigma1",
    kind: Kind::Number((Excluded(0.0), Unbounded)),
    instead: Some(Instead::Null(&["auto"])),
    unit: "scene units",
    help: "First radius of the disc in which photons or cones count; auto: by the scene and the pixel footprint",
};

/// The longest paths.
pub(crate) const MAX_DEPTH: Setting = Setting {
    name: "max_depth",
    kind: Kind::Integer {
        least: 1,
        most: u32::MAX,
    },
    instead: Some(Instead::Null(&["none", "-1"])),
    unit: "",
    help: "Most edges of a light path, camera to light; none or -1: no limit",
};
