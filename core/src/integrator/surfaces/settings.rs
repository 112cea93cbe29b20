//! Settings of `surfaces`.

use crate::integrator::bidirectional::LIGHT_PATHS;
use crate::integrator::{Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::settings::shared::{MAX_DEPTH, SAMPLES, SAMPLING};
use crate::settings::{Kind, Setting};
use serde::{Deserialize, Serialize};

/// Photon surfaces.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "surfaces",
    summary: "Photon surfaces in media, without blur",
    settings: &[LIGHT_PATHS, SAMPLES, SAMPLING, SURFACES, WEIGHTS, MAX_DEPTH],
    ignored: Ignored::Integers(&[]),
    statistics_per_pixel: 0,
};

const SURFACES: Setting = Setting {
    name: "surfaces",
    kind: Kind::Choices {
        words: &[
            "planes",
            "spheres",
            "inner_spheres",
            "cones",
            "cylinders",
            "discs",
            "toroids",
            "hyperboloids",
            "connections",
            "light_copies",
            "light_planes",
            "turned_planes",
            "light_circles",
            "light_arcs",
        ],
        needed: &[],
    },
    instead: None,
    unit: "",
    help: "Surfaces that light paths sweep out in media, and that camera rays cross: a surface for two lengths of the light path, for a direction, for a length and \
           an angle about the way before, for an earlier length and that angle, for a length and the other angle, and so on; and connections of camera rays with light paths. \
           Those of the names `light_...` and `turned_planes` are swept out by the places of area lights; all but copies need rectangles. Light \
           that is scattered once needs spheres, cones, connections or surfaces of lights",
};

const WEIGHTS: Setting = Setting {
    name: "weights",
    kind: Kind::Choice(&["balance", "average"]),
    instead: None,
    unit: "",
    help: "How surfaces that find the same light share it: by the balance heuristic, or evenly",
};

/// Settings of `surfaces`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfacesSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Surfaces that are used. Light that was scattered once needs spheres, cones, connections or surfaces of lights.
    pub surfaces: Vec<SurfaceKind>,
    /// How surfaces that find the same light share it.
    pub weights: Weights,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

/// A kind of photon surface, by what of the light path is swept over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceKind {
    /// Two of the last three lengths.
    Planes,
    /// The last direction.
    Spheres,
    /// The direction before the last.
    InnerSpheres,
    /// The last length, and the last direction about the one before.
    Cones,
    /// The last length but one, and the last direction about the one before.
    Cylinders,
    /// The last length, and the angle between the last two directions.
    Discs,
    /// The angles about the two directions before the last.
    Toroids,
    /// The last length, and the angle about the direction before the last but one.
    Hyperboloids,
    /// The last direction and length: a place on a camera ray is connected with a light path.
    Connections,
    /// The place on an area light: the surface is a copy of the light.
    LightCopies,
    /// One coordinate of the place on a rectangular light, and the length.
    LightPlanes,
    /// The same in a random direction on the light.
    TurnedPlanes,
    /// One coordinate of the place on a rectangular light, and the angle about its normal.
    LightCircles,
    /// One coordinate of the place on a rectangular light, and the angle with its normal.
    LightArcs,
}

impl SurfaceKind {
    /// Whether area lights sweep them out.
    pub(super) fn is_of_lights(self) -> bool {
        use SurfaceKind::{LightArcs, LightCircles, LightCopies, LightPlanes, TurnedPlanes};
        matches!(
            self,
            LightCopies | LightPlanes | TurnedPlanes | LightCircles | LightArcs
        )
    }
}

/// How techniques that find the same light share it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Weights {
    /// By the balance heuristic.
    #[default]
    Balance,
    /// Evenly.
    Average,
}

impl Default for SurfacesSettings {
    fn default() -> Self {
        use SurfaceKind::{Cones, Connections, Cylinders, Planes, Spheres};
        Self {
            photons: 20,
            samples: 1,
            sampling: Sampling::Sobol,
            surfaces: vec![Planes, Spheres, Cones, Cylinders, Connections],
            weights: Weights::Balance,
            max_depth: None,
        }
    }
}

impl Estimator for SurfacesSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.max_depth
    }

    fn render(&self, job: &Job, _before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, self, observer)
    }
}
