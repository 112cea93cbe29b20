//! What a lease begins with: its scene, all settings, and what it goes on from.

use super::Worker;
use crate::block::panic_message;
use crate::cache::CacheError;
use crate::client::{ClientError, retry};
use crate::render::LoadedScene;
use photonfarm_core::film::Window;
use photonfarm_core::settings::{IntegratorSettings, SettingError};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::job::{FailureKind, JobSpec};
use photonfarm_proto::problem::ErrorCode;
use photonfarm_proto::trace::Context;
use photonfarm_proto::worker::{Acknowledged, Lease, MOST_WARNINGS, SceneReport, StatisticsRequest, cut_text};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// Attempts at a scene whose files are damaged in the cache.
const LOADS: usize = 3;

/// What makes two jobs share a loaded scene.
pub(super) type SceneKey = (
    BlobHash,
    String,
    BTreeMap<String, String>,
    Option<String>,
    (Vec<String>, Option<Window>),
);

/// Why a scene is not ready.
pub(super) enum LoadError {
    /// It never will be.
    Scene(FailureKind, String),
    /// It may be elsewhere, or later.
    Elsewhere(String),
}

impl From<CacheError> for LoadError {
    fn from(error: CacheError) -> Self {
        Self::Elsewhere(error.to_string())
    }
}

impl From<ClientError> for LoadError {
    fn from(error: ClientError) -> Self {
        Self::Elsewhere(error.to_string())
    }
}

impl Worker {
    /// All settings. The coordinator is told how the scene has decided over those that the job leaves to it, what it was warned about, and
    /// what the picture's file says of it, if there is any of that.
    pub(super) async fn resolve(
        &self,
        scene: &dyn LoadedScene,
        spec: &JobSpec,
        lease: &Lease,
        drain: &CancellationToken,
    ) -> Result<IntegratorSettings, LoadError> {
        let of_scene = |error: SettingError| LoadError::Scene(FailureKind::Scene, error.to_string());
        let integrator = match spec.integrator.complete() {
            Some(settings) => settings.clone(),
            None => spec.integrator.resolve(&scene.wishes()).map_err(of_scene)?,
        };
        let warnings: Vec<String> = scene.warnings().into_iter().take(MOST_WARNINGS).map(cut_text).collect();
        let facts = scene.facts();
        if spec.integrator.complete().is_some() && warnings.is_empty() && facts.is_empty() {
            return Ok(integrator);
        }
        let Lease { token, worker, job, .. } = *lease;
        let report = SceneReport {
            token,
            worker,
            job,
            integrator: integrator.clone(),
            warnings,
            facts,
        };
        let said: Result<Acknowledged, _> = self.client.insist("worker/scene", &report, drain).await;
        match said {
            Ok(Acknowledged) => Ok(integrator),
            Err(error) if error.code() == Some(ErrorCode::Invalid) => {
                Err(LoadError::Scene(FailureKind::Render, error.to_string()))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// What a lease goes on from, where the integrator is sequential.
    pub(super) async fn statistics(
        &self,
        scene: &dyn LoadedScene,
        spec: &JobSpec,
        lease: &Lease,
        drain: &CancellationToken,
    ) -> Result<Vec<f32>, LoadError> {
        let settings = spec.integrator.with_defaults();
        if !settings.is_sequential() || lease.node.first() == 0 {
            return Ok(Vec::new());
        }
        let [width, height] = scene.resolution();
        let values = width as usize * height as usize * settings.statistics_per_pixel();
        let Lease { token, worker, job, .. } = *lease;
        let request = StatisticsRequest { token, worker, job };
        Ok(retry(drain, "the request for statistics", || {
            self.client.statistics(&request, values)
        })
        .await?)
    }

    /// The scene of a job, loaded before or now, within the span of a lease.
    pub(super) async fn load(
        &mut self,
        spec: &JobSpec,
        within: Context,
        drain: &CancellationToken,
    ) -> Result<Arc<dyn LoadedScene>, LoadError> {
        let key = scene_key(spec);
        if let Some((_, scene)) = self.loaded.as_ref().filter(|(loaded, _)| *loaded == key) {
            return Ok(scene.clone());
        }
        self.loaded = None;
        let manifest = retry(drain, "the request for a manifest", || self.client.manifest(spec.scene)).await?;
        for _ in 0..LOADS {
            let mut span = self.config.tracer.begin(within, "download");
            span.fact("scene", || spec.scene.to_string());
            span.fact("files", || manifest.files.len() as u64);
            let files = self.cache.fetch(&self.client, manifest.clone(), drain).await;
            span.end(&files);
            let files = files?;
            let mut span = self.config.tracer.begin(within, "load");
            span.fact("scene", || spec.scene.to_string());
            let (renderer, pool) = (self.config.renderer.clone(), self.pool.clone());
            let (read, spec) = (files.clone(), spec.clone());
            let load = move || {
                let load = || pool.install(|| renderer.load(&read, &spec));
                catch_unwind(AssertUnwindSafe(load)).map_err(|panic| panic_message(&*panic).to_owned())
            };
            let loaded = tokio::task::spawn_blocking(load).await;
            match &loaded {
                Ok(Ok(Ok(_))) => {}
                Ok(Ok(Err(why)) | Err(why)) => span.failed(why),
                Err(error) => span.failed(error),
            }
            drop(span);
            match loaded {
                Ok(Ok(Ok(scene))) => {
                    self.loaded = Some((key, scene.clone()));
                    return Ok(scene);
                }
                Ok(Ok(Err(_))) if files.is_damaged() => {}
                Ok(Ok(Err(message))) => return Err(LoadError::Scene(FailureKind::Scene, message)),
                Ok(Err(panic)) => {
                    let message = format!("loading the scene panicked: {panic}");
                    return Err(LoadError::Scene(FailureKind::Panic, message));
                }
                Err(error) => return Err(LoadError::Elsewhere(error.to_string())),
            }
        }
        Err(LoadError::Elsewhere("the cache is damaged again and again".into()))
    }
}

pub(super) fn scene_key(spec: &JobSpec) -> SceneKey {
    let (main, defines, sensor) = (spec.main.clone(), spec.defines.clone(), spec.sensor.clone());
    (spec.scene, main, defines, sensor, (spec.layers.clone(), spec.crop))
}
