//! The cones and queries of an iteration on surfaces, for measurements of maps.

use super::Pass;
use crate::density::Cone;
use crate::integrator::{Bandwidth, Batches, Counts, Job, RenderError, Unobserved};
use crate::math::Vec3;
use crate::scene::Scene;
use crate::settings::{IntegratorSettings, PcfSettings};

/// What an iteration's map is built from and asked for.
#[derive(Debug)]
pub struct Workload {
    /// Every cone, in the order of light paths.
    pub cones: Vec<Vec<Cone>>,
    /// The cones that some query may count, in the same order: what is stored.
    pub stored: Vec<Vec<Cone>>,
    /// Position and unit direction of each query, in the order of pixels.
    pub queries: Vec<(Vec3, Vec3)>,
    /// Kernel sizes.
    pub bandwidth: Bandwidth,
}

impl Workload {
    /// The workload of iteration `iteration` (1, 2, ...). All pixels and light paths are taken at once.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(scene: &Scene, settings: &PcfSettings, seed: u64, iteration: u32) -> Result<Self, RenderError> {
        let whole = IntegratorSettings::Pcf(settings.clone());
        whole.validate()?;
        let widths = settings.widths(scene, iteration);
        let job = Job {
            scene,
            at_rest: scene,
            seed,
            iteration,
            sampling: settings.sampling,
            batches: Batches::default(),
        };
        let mut counts = Counts::default();
        let pixels = 0..job.pixel_count();
        let pass = Pass::trace_camera(&job, settings, widths, pixels, &Unobserved, &mut counts)?;
        let occupancies = pass.occupancies();
        let light = |occupancies| -> Result<_, RenderError> {
            let records = pass.trace_light(0..settings.photons, occupancies, &Unobserved, &mut Counts::default())?;
            Ok(records.into_iter().next().unwrap_or_default())
        };
        let queries = pass
            .gatherings
            .iter()
            .take(1)
            .flat_map(|gathering| gathering.queries.iter());
        Ok(Self {
            cones: light(None)?,
            stored: light(Some(&occupancies))?,
            queries: queries.map(|q| (q.position, q.direction)).collect(),
            bandwidth: widths.on_surfaces,
        })
    }
}
