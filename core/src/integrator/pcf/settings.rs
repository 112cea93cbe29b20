//! Settings of `pcf`.

pub use crate::density::KernelShape;
use crate::density::{Extent, LEAST_ANGLE, schedule};
use crate::integrator::bandwidth::{first_radius, first_radius_in_media};
use crate::integrator::{Bandwidth, Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::shared::{ALPHA, MAX_DEPTH, PHOTONS, SAMPLES, SAMPLING, SIGMA1};
use crate::settings::{Instead, Kind, Range, Setting};
use serde::{Deserialize, Serialize};
use std::ops::Bound::{Excluded, Included};

/// Photon cone focusing.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "pcf",
    summary: "Photon cone focusing",
    settings: &[
        PHOTONS,
        SAMPLES,
        SAMPLING,
        ALPHA,
        P,
        SIGMA1,
        THETA1,
        LOOKUP_VERTEX,
        SAMPLERS,
        MIS_BETA,
        NESTED,
        KERNEL,
        SIGMA_BY_LENGTH,
        THETA_GLOSSY,
        SURFACE_TEST,
        MEDIA,
        MAX_DEPTH,
    ],
    ignored: Ignored::Integers(&[]),
    statistics_per_pixel: 0,
};

/// Numbers above 0, up to 1.
const SHARE: Range = (Excluded(0.0), Included(1.0));

const P: Setting = Setting {
    name: "p",
    kind: Kind::Number((Included(1.0), Included(16.0))),
    instead: None,
    unit: "",
    help: "Order of the angular bandwidth theta1 (sigma / sigma1)^p",
};

/// Kernels are never narrower than [`LEAST_ANGLE`], 0.06 degrees.
const THETA1: Setting = Setting {
    name: "theta1",
    kind: Kind::Number((Included(0.1), Included(180.0))),
    instead: None,
    unit: "degrees",
    help: "First angular bandwidth: half the angle within which cones count",
};

const LOOKUP_VERTEX: Setting = Setting {
    name: "lookup_vertex",
    kind: Kind::Integer { least: 1, most: 64 },
    instead: Some(Instead::Word("auto")),
    unit: "",
    help: "Camera vertex at which the cone map is read; auto: the first that is rough enough for a density estimate",
};

const SAMPLERS: Setting = Setting {
    name: "samplers",
    kind: Kind::Choices {
        words: &["bsdf", "camera", "importon"],
        needed: &[],
    },
    instead: None,
    unit: "",
    help: "Techniques that choose a cone's direction: the material, a lobe about the direction to the camera, and the \
           directions in which camera paths near by need radiance",
};

const MIS_BETA: Setting = Setting {
    name: "mis_beta",
    kind: Kind::Number((Included(1.0), Included(16.0))),
    instead: None,
    unit: "",
    help: "Exponent of the power heuristic that combines the samplers",
};

const NESTED: Setting = Setting {
    name: "nested",
    kind: Kind::Truth,
    instead: None,
    unit: "",
    help: "Whether cones take the place of next-event estimation and of emission found by scattering",
};

const KERNEL: Setting = Setting {
    name: "kernel",
    kind: Kind::Choice(&["box", "epanechnikov"]),
    instead: None,
    unit: "",
    help: "How a cone's weight falls with its distance from the query",
};

const SIGMA_BY_LENGTH: Setting = Setting {
    name: "sigma_by_length",
    kind: Kind::Numbers { range: SHARE, most: 64 },
    instead: None,
    unit: "",
    help: "Shares of the spatial bandwidth for cones of light paths of one edge, two, and so on, the last share for all \
           longer ones; empty: the whole",
};

const THETA_GLOSSY: Setting = Setting {
    name: "theta_glossy",
    kind: Kind::Number(SHARE),
    instead: None,
    unit: "",
    help: "Share of the angular bandwidth on delta and glossy surfaces",
};

const SURFACE_TEST: Setting = Setting {
    name: "surface_test",
    kind: Kind::Truth,
    instead: None,
    unit: "",
    help: "Whether only cones near the query's surface count, and the kernel is clipped to it",
};

const MEDIA: Setting = Setting {
    name: "media",
    kind: Kind::Choice(&["paths", "cones"]),
    instead: None,
    unit: "",
    help: "How light is estimated that media scatter: by camera paths that are scattered there and connected with lights, or by cones that \
           light paths leave in media",
};

/// Settings of `pcf`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PcfSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Share of the cones that the shrinking bandwidth keeps, in (0, 1).
    pub alpha: f32,
    /// Order of the angular bandwidth t(sigma) = theta1 (sigma / sigma1)^p, at least 1.
    pub p: f32,
    /// First spatial bandwidth [scene units]; `None`: from the scene and the pixel footprint.
    pub sigma1: Option<f32>,
    /// First angular bandwidth \[degrees\].
    pub theta1: f32,
    /// Camera vertex at which the cone map is read.
    pub lookup_vertex: LookupVertex,
    /// Techniques that choose a cone's direction, combined by the power heuristic. Cones of delta materials are sampled from
    /// the material whatever this says: nothing else can.
    pub samplers: Vec<DirectionSampler>,
    /// Exponent of the power heuristic (thesis, equation 4.4).
    pub mis_beta: f32,
    /// Whether light that paths carry to a vertex before the lookup vertex is estimated by cones too, in place of next-event
    /// estimation and of emission found by scattering (thesis, section 3.6): no light, sensor or material is singular then.
    pub nested: bool,
    /// How a cone's weight falls with its distance from the query.
    pub kernel: KernelShape,
    /// Share of the spatial bandwidth within which cones of light paths with 1, 2, ... edges count, the last share for all
    /// longer ones (thesis, section 4.4: an initial bandwidth for each path length). Empty: the whole.
    pub sigma_by_length: Vec<f32>,
    /// Share of the angular bandwidth on delta and glossy surfaces (thesis, section 4.4).
    pub theta_glossy: f32,
    /// Whether a cone must lie in the query's tangent plane, about, to count, and the kernel is clipped to that surface.
    pub surface_test: bool,
    /// How light is estimated that media scatter towards the camera.
    pub media: ConesInMedia,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PcfSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 4,
            sampling: Sampling::Sobol,
            alpha: 0.2,
            p: 1.0,
            sigma1: None,
            theta1: 18.0,
            lookup_vertex: LookupVertex::Auto,
            samplers: vec![DirectionSampler::Bsdf, DirectionSampler::Camera],
            mis_beta: 2.0,
            nested: false,
            kernel: KernelShape::Box,
            sigma_by_length: Vec::new(),
            theta_glossy: 1.0,
            surface_test: false,
            media: ConesInMedia::Paths,
            max_depth: None,
        }
    }
}

/// Kernel sizes of an iteration.
#[derive(Clone, Copy, Debug)]
pub(in crate::integrator) struct Widths {
    pub(in crate::integrator) on_surfaces: Bandwidth,
    pub(in crate::integrator) in_media: Bandwidth,
}

impl PcfSettings {
    /// Kernel sizes of iteration `iteration` (1, 2, ...).
    pub(super) fn widths(&self, scene: &Scene, iteration: u32) -> Widths {
        let on_surfaces = self.on_surfaces(scene, iteration);
        let has_cones = self.media == ConesInMedia::Cones && scene.media.is_some();
        Widths {
            on_surfaces,
            in_media: match has_cones {
                true => {
                    let sigma1 = first_radius_in_media(scene, self.sigma1, self.photons, Extent::Ball.dimensions());
                    self.shrunk(sigma1, Extent::Ball, iteration)
                }
                false => on_surfaces,
            },
        }
    }

    fn on_surfaces(&self, scene: &Scene, iteration: u32) -> Bandwidth {
        let sigma1 = first_radius(scene, self.sigma1, self.photons);
        self.shrunk(sigma1, Extent::Disc, iteration)
    }

    /// The kernel that begins with the radius `sigma1`.
    fn shrunk(&self, sigma1: f32, extent: Extent, iteration: u32) -> Bandwidth {
        let theta1 = f64::from(self.theta1).to_radians();
        let p = f64::from(self.p);
        let ratio = schedule::pcf_sigma_ratio(iteration, f64::from(self.alpha), p, theta1, extent.dimensions());
        Bandwidth {
            sigma: (f64::from(sigma1) * ratio) as f32,
            theta: (schedule::pcf_theta(ratio, p, theta1) as f32).max(LEAST_ANGLE),
        }
    }
}

impl Estimator for PcfSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.max_depth
    }

    fn bandwidth(&self, scene: &Scene, iteration: u32) -> Option<Bandwidth> {
        Some(self.on_surfaces(scene, iteration))
    }

    /// Importons are the queries of all pixels, and points of the discs about queries are numbered through them.
    fn needs_all_pixels(&self) -> bool {
        self.surface_test || self.samplers.contains(&DirectionSampler::Importon)
    }

    fn render(&self, job: &Job, _before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, self, self.widths(job.at_rest, job.iteration), observer)
    }
}

/// How light is estimated that media scatter towards the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ConesInMedia {
    /// By camera paths that are scattered by media as by glossy surfaces, and connected with lights.
    #[default]
    Paths,
    /// By cones that light paths leave where media scatter them.
    Cones,
}

/// Camera vertex at which the cone map is read: a number of 1 or more, or `"auto"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "serde_json::Value", into = "serde_json::Value")]
pub enum LookupVertex {
    /// Always the k-th vertex.
    Fixed(u32),
    /// The first vertex whose material is rough enough for a density estimate.
    Auto,
}

/// A technique that chooses a cone's direction (thesis, section 4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DirectionSampler {
    /// Sample the material.
    Bsdf,
    /// Sample a lobe about the direction to the camera.
    Camera,
    /// Sample the directions in which camera paths near by need radiance.
    Importon,
}

impl TryFrom<serde_json::Value> for LookupVertex {
    type Error = String;

    fn try_from(value: serde_json::Value) -> Result<Self, String> {
        LOOKUP_VERTEX.check(&value).map_err(|error| error.to_string())?;
        Ok(value.as_u64().map_or(Self::Auto, |k| Self::Fixed(k as u32)))
    }
}

impl From<LookupVertex> for serde_json::Value {
    fn from(vertex: LookupVertex) -> Self {
        match vertex {
            LookupVertex::Fixed(k) => k.into(),
            LookupVertex::Auto => "auto".into(),
        }
    }
}
