//! Settings of `sppm`.

use crate::integrator::bandwidth::first_radius;
use crate::integrator::pppm::settings::{PppmSettings, SETTINGS};
use crate::integrator::{Bandwidth, Estimator, Ignored, Integrator, Iteration, Job, Observer, RenderError};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::STATISTICS_PER_PIXEL;
use serde::{Deserialize, Serialize};

/// Stochastic progressive photon mapping. Mitsuba 0.6 has a plugin of this name, whose settings are left out.
pub(in crate::integrator) const INTEGRATOR: Integrator = Integrator {
    name: "sppm",
    summary: "Stochastic progressive photon mapping: one worker at a time",
    settings: SETTINGS,
    ignored: Ignored::All,
    statistics_per_pixel: STATISTICS_PER_PIXEL,
};

/// Settings of `sppm`: those of `pppm`, whose `sigma1` is the first radius of every pixel here.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct SppmSettings(pub PppmSettings);

impl SppmSettings {
    /// Radius of every pixel's disc in the first iteration [scene units].
    fn radius(&self, scene: &Scene) -> f32 {
        first_radius(scene, self.0.sigma1, self.0.photons)
    }
}

impl Estimator for SppmSettings {
    fn integrator(&self) -> &'static Integrator {
        &INTEGRATOR
    }

    fn sampling(&self) -> Sampling {
        self.0.sampling
    }

    fn max_depth(&self) -> Option<u32> {
        self.0.max_depth
    }

    fn bandwidth(&self, scene: &Scene, _iteration: u32) -> Option<Bandwidth> {
        Some(Bandwidth::of_photons(self.radius(scene)))
    }

    fn render(&self, job: &Job, before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError> {
        super::render(job, &self.0, self.radius(job.at_rest), before, observer)
    }
}
