//! Averages of iterations, with what they took.

use super::picture::Pixels;
use anyhow::Result;
use photonfarm_core::integrator::{Counts, Iteration};
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_tests::render;
use rustix::time::{ClockId, clock_gettime};

/// An average of iterations that grows.
pub(super) struct Sum {
    size: [u32; 2],
    channels: Vec<[f64; 3]>,
    /// Iterations in it.
    pub(super) iterations: u32,
    /// What they counted.
    pub(super) counts: Counts,
}

impl Sum {
    pub(super) fn new(scene: &Scene) -> Self {
        let size = scene.film.resolution;
        Self {
            size,
            channels: vec![[0.0; 3]; size[0] as usize * size[1] as usize],
            iterations: 0,
            counts: Counts::default(),
        }
    }

    pub(super) fn add(&mut self, iteration: &Iteration) {
        self.iterations += 1;
        self.counts += iteration.counts;
        for (sum, pixel) in self.channels.iter_mut().zip(&iteration.pixels) {
            for (sum, value) in sum.iter_mut().zip(pixel.to_rgb()) {
                *sum += f64::from(value);
            }
        }
    }

    /// The average.
    pub(super) fn mean(&self) -> Pixels {
        let mean = |sum: f64| (sum / f64::from(self.iterations)) as f32;
        Pixels {
            size: self.size,
            values: self.channels.iter().map(|c| Spectrum::from_rgb(c.map(mean))).collect(),
        }
    }
}

/// Iterations `1..=iterations` under one seed; `watch` sees each.
pub(super) fn average(
    scene: &Scene,
    settings: &IntegratorSettings,
    seed: u64,
    iterations: u32,
    mut watch: impl FnMut(&Iteration),
) -> Result<Sum> {
    let mut sum = Sum::new(scene);
    for iteration in render::iterations(scene, settings, seed, iterations) {
        let iteration = iteration?;
        sum.add(&iteration);
        watch(&iteration);
    }
    Ok(sum)
}

/// Processor time that this process has used, all threads together \[seconds\].
pub(super) fn processor_seconds() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// A mean with its standard error.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub(super) mean: f64,
    pub(super) standard_error: f64,
}

/// Mean of independent observations, of which there are at least two.
pub(super) fn estimate(values: &[f64]) -> Estimate {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Estimate {
        mean,
        standard_error: (squares / (n - 1.0) / n).sqrt(),
    }
}
