//! The setting by which an integrator estimates light in media.

use crate::settings::{Kind, Setting};
use serde::{Deserialize, Serialize};

/// How light is estimated that media scatter.
pub(in crate::integrator) const MEDIA: Setting = Setting {
    name: "media",
    kind: Kind::Choice(&["paths", "points", "radiance", "beams", "short_beams"]),
    instead: None,
    unit: "",
    help: "How light is estimated that media scatter: by camera paths that are scattered there and connected with lights, by photons about one point of a \
           camera ray, by photons along the whole ray, or by photon beams along it, which end at surfaces or where light is scattered",
};

/// How light is estimated that media scatter towards the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MediaEstimator {
    /// By camera paths that are scattered by media as by glossy surfaces, and connected with lights.
    #[default]
    Paths,
    /// By photons where light collides, in a ball about one point of each camera ray.
    Points,
    /// By photons where light collides, along the whole camera ray (Jarosz, Zwicker and Jensen 2008: the beam radiance estimate).
    Radiance,
    /// By photon beams up to the next surface, along the whole camera ray (Jarosz et al. 2011).
    Beams,
    /// As [`Self::Beams`], but up to where light is scattered.
    ShortBeams,
}

impl MediaEstimator {
    /// Dimensions over which its kernel blurs; `None` for an estimator without a kernel.
    pub(super) fn dimensions(self) -> Option<u32> {
        match self {
            Self::Paths => None,
            Self::Points => Some(3),
            Self::Radiance => Some(2),
            Self::Beams | Self::ShortBeams => Some(1),
        }
    }

    /// Whether light paths leave beams.
    pub(super) fn has_beams(self) -> bool {
        matches!(self, Self::Beams | Self::ShortBeams)
    }
}
