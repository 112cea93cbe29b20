//! The cones and queries of an iteration, for measurements of maps.

use super::Pass;
use crate::density::Cone;
use crate::integrator::{Bandwidth, Batches, Counts, Job, RenderError, Unobserved, bandwidth};
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
        let bandwidth = bandwidth(scene, &whole, iteration).expect("pcf has a bandwidth");
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
        let pass = Pass::trace_camera(&job, settings, bandwidth, pixels, &Unobserved, &mut counts)?;
        let occupancy = pass.queries.occupancy(pass.kernel.reach());
        let light = |occupancy| pass.trace_light(0..settings.photons, occupancy, &Unobserved, &mut Counts::default());
        Ok(Self {
            cones: light(None)?,
            stored: light(Some(&occupancy))?,
            queries: pass.queries.iter().map(|q| (q.position, q.direction)).collect(),
            bandwidth,
        })
    }
}
