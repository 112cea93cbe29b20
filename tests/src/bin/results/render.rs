//! Renders iterations, many at a time, and keeps what is asked of each.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressStyle};
use photonfarm_core::integrator::{Iteration, Unobserved, render_iteration};
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::IntegratorSettings;
use rayon::prelude::*;

/// A bar that counts to `length` under the heading `name`.
pub(crate) fn progress(name: &str, length: u64) -> ProgressBar {
    let style = "{msg:24} {wide_bar} {pos}/{len} {elapsed}";
    ProgressBar::new(length)
        .with_message(name.to_owned())
        .with_style(ProgressStyle::with_template(style).expect("a valid template"))
}

/// Renders each `(seed, iteration)` of `jobs` on the current rayon pool and returns `keep` of each, in order.
pub(crate) fn each<T: Send>(
    scene: &Scene,
    settings: &IntegratorSettings,
    jobs: &[(u64, u32)],
    bar: &ProgressBar,
    keep: impl Fn(Iteration) -> T + Sync,
) -> Result<Vec<T>> {
    jobs.par_iter()
        .map(|&(seed, iteration)| {
            let image = render_iteration(scene, settings, seed, iteration, &Unobserved)?;
            bar.inc(1);
            Ok(keep(image))
        })
        .collect()
}
