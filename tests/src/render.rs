//! Iterations that tests and measurements render, and how bright they are.

use photonfarm_core::integrator::{Iteration, RenderError, Unobserved, render_iteration, render_next};
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_core::spectrum::Spectrum;

/// The iterations `1..=count` of a job; each goes on from the one before where the integrator is sequential.
pub fn iterations(
    scene: &Scene,
    settings: &IntegratorSettings,
    seed: u64,
    count: u32,
) -> impl Iterator<Item = Result<Iteration, RenderError>> {
    let mut before = Vec::new();
    (1..=count).map(move |iteration| {
        let rendered = render_next(scene, settings, seed, iteration, &before, &Unobserved)?;
        before.clone_from(&rendered.statistics);
        Ok(rendered)
    })
}

/// Mean luminance of an image.
#[must_use]
pub fn mean_luminance(pixels: &[Spectrum]) -> f64 {
    pixels.iter().map(|pixel| f64::from(pixel.luminance())).sum::<f64>() / pixels.len() as f64
}

/// Mean luminance that an iteration shows of the paths of 1, 2, ..., `longest` edges; `settings` makes settings of a `max_depth`.
///
/// The image with `max_depth` n less the image with n - 1, of the same seed, holds the paths of n edges and nothing else,
/// since random numbers do not depend on `max_depth`.
///
/// # Errors
/// Those of [`render_iteration`].
pub fn luminance_by_length(
    scene: &Scene,
    seed: u64,
    iteration: u32,
    longest: u32,
    settings: impl Fn(u32) -> IntegratorSettings,
) -> Result<Vec<f64>, RenderError> {
    let mut shorter = 0.0;
    let lengths = (1..=longest).map(|depth| {
        let image = render_iteration(scene, &settings(depth), seed, iteration, &Unobserved)?;
        let upto = mean_luminance(&image.pixels);
        Ok(upto - std::mem::replace(&mut shorter, upto))
    });
    lengths.collect()
}
