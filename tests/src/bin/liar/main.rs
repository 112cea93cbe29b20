//! A worker that sends wrong bits, for tests: it renders as it should, then changes one pixel, and what a chain goes on from.
//!
//!     liar COORDINATOR NAME CACHE

use photonfarm_core::integrator::{Iteration, Observer, RenderError};
use photonfarm_core::scene::Wishes;
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_core::spectrum::Spectrum;
use photonfarm_proto::job::{BandwidthRange, JobSpec};
use photonfarm_worker::{BundleFiles, CancellationToken, CoreRenderer, LoadedScene, Renderer, Worker, WorkerConfig};
use std::sync::Arc;

struct Lying;

impl Renderer for Lying {
    fn load(&self, files: &BundleFiles, spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String> {
        Ok(Arc::new(LyingScene(CoreRenderer.load(files, spec)?)))
    }
}

struct LyingScene(Arc<dyn LoadedScene>);

impl LoadedScene for LyingScene {
    fn resolution(&self) -> [u32; 2] {
        self.0.resolution()
    }

    fn wishes(&self) -> Wishes {
        self.0.wishes()
    }

    fn bandwidth(&self, settings: &IntegratorSettings, iteration: u32, before: &[f32]) -> Option<BandwidthRange> {
        self.0.bandwidth(settings, iteration, before)
    }

    fn render(
        &self,
        settings: &IntegratorSettings,
        seed: u64,
        iteration: u32,
        before: &[f32],
        observer: &dyn Observer,
    ) -> Result<Iteration, RenderError> {
        let mut rendered = self.0.render(settings, seed, iteration, before, observer)?;
        rendered.pixels[0] = Spectrum::splat(0.5);
        rendered.statistics.iter_mut().for_each(|value| *value *= 0.5);
        Ok(rendered)
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [coordinator, name, cache] = arguments.as_slice() else {
        anyhow::bail!("usage: liar COORDINATOR NAME CACHE");
    };
    let config = WorkerConfig {
        name: name.clone(),
        threads: 1,
        renderer: Arc::new(Lying),
        ..WorkerConfig::new(coordinator, cache)
    };
    Ok(Worker::new(config)?.run(CancellationToken::new()).await?)
}
