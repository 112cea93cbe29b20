//! What the worker needs of a renderer.

use crate::cache::{BundleFiles, FileError};
use bytes::Bytes;
use photonfarm_core::integrator::layers::{Layers, Memory};
use photonfarm_core::integrator::{self, Iteration, Observer, RenderError};
use photonfarm_core::picture::SceneFacts;
use photonfarm_core::scene::{Limits, Place, Scene, SceneError, SceneFiles, Wishes};
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_proto::check::{CheckAnswer, CheckError, CheckFailure, CheckReport};
use photonfarm_proto::job::{BandwidthRange, JobSpec};
use std::sync::Arc;

/// Makes scenes ready. Tests put something else in the place of the core.
pub trait Renderer: Send + Sync + 'static {
    /// Reads the scene of a job. The error is for people: file, line, and what is wrong.
    fn load(&self, files: &BundleFiles, spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String>;
    /// Reads the scene of a job and says what it holds, or all that is wrong with it.
    fn check(&self, _files: &BundleFiles, _spec: &JobSpec) -> CheckAnswer {
        CheckAnswer::Never("this worker checks no scenes".into())
    }
}

/// A scene ready to be rendered.
pub trait LoadedScene: Send + Sync {
    /// Pixels across and down, of the picture and the planes of layers below it.
    fn resolution(&self) -> [u32; 2];
    /// Settings that the scene carries.
    fn wishes(&self) -> Wishes;
    /// What of the scene is not rendered as it is written, each with its place.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }
    /// What the picture's file says of the scene.
    fn facts(&self) -> SceneFacts {
        SceneFacts::default()
    }
    /// The bandwidth of an iteration that goes on from the statistics `before`, if the integrator has one.
    fn bandwidth(&self, settings: &IntegratorSettings, iteration: u32, before: &[f32]) -> Option<BandwidthRange>;
    /// Renders an iteration on the current rayon pool; see [`integrator::render_with_layers`].
    fn render(
        &self,
        settings: &IntegratorSettings,
        seed: u64,
        iteration: u32,
        before: &[f32],
        observer: &dyn Observer,
    ) -> Result<Iteration, RenderError>;
}

/// The renderer of Photonfarm.
#[derive(Clone, Copy, Debug, Default)]
pub struct CoreRenderer;

impl Renderer for CoreRenderer {
    fn load(&self, files: &BundleFiles, spec: &JobSpec) -> Result<Arc<dyn LoadedScene>, String> {
        let limits = Limits::default();
        let scene = Scene::load_sensor(files, &spec.main, &spec.defines, spec.sensor.as_deref(), &limits);
        let scene = scene.map_err(|error| error.to_string())?;
        let scene = scene.cropped(spec.crop).map_err(|error| format!("crop: {error}"))?;
        let layers = spec.layers().map_err(|error| error.to_string())?;
        layers.check_scene(&scene).map_err(|error| error.to_string())?;
        Ok(Arc::new(CoreScene::new(scene, layers)))
    }

    fn check(&self, files: &BundleFiles, spec: &JobSpec) -> CheckAnswer {
        match report(files, spec) {
            Ok(report) => CheckAnswer::Report(Box::new(report)),
            Err(failure) => CheckAnswer::Failure(failure),
        }
    }
}

fn report(files: &BundleFiles, spec: &JobSpec) -> Result<CheckReport, CheckFailure> {
    let limits = Limits::default();
    let scene = Scene::load_sensor(files, &spec.main, &spec.defines, spec.sensor.as_deref(), &limits);
    let scene = scene.map_err(|faults| CheckFailure::from(&faults))?;
    let integrator = spec.integrator.resolve(&scene.wishes);
    let integrator = integrator.map_err(|error| CheckFailure::one(error.into()))?;
    let layers = spec.layers().and_then(|layers| layers.check_scene(&scene));
    layers.map_err(|error| CheckFailure::one(CheckError::of_request(Some("layers"), error.to_string())))?;
    Ok(CheckReport::of(&spec.main, &scene, &integrator))
}

impl SceneFiles for BundleFiles {
    fn read(&self, name: &str) -> Result<Bytes, SceneError> {
        let (place, name) = (Place::whole(name), name.to_owned());
        self.bytes(&name).map(Bytes::from).map_err(|error| match error {
            FileError::Missing => SceneError::NotFound {
                tried: name.clone(),
                place,
                name,
            },
            FileError::Damaged => SceneError::Read {
                place,
                name,
                reason: error.to_string(),
            },
        })
    }
}

/// A scene of the core.
#[derive(Debug)]
pub struct CoreScene {
    /// The scene.
    pub scene: Scene,
    /// What is rendered beside the picture.
    layers: Layers,
    memory: Memory,
}

impl CoreScene {
    /// A scene with what is rendered beside its picture.
    #[must_use]
    pub fn new(scene: Scene, layers: Layers) -> Self {
        Self {
            scene,
            layers,
            memory: Memory::default(),
        }
    }
}

impl LoadedScene for CoreScene {
    fn resolution(&self) -> [u32; 2] {
        self.layers.stacked(self.scene.film.size())
    }

    fn wishes(&self) -> Wishes {
        self.scene.wishes.clone()
    }

    fn warnings(&self) -> Vec<String> {
        self.scene.warnings.iter().map(ToString::to_string).collect()
    }

    fn facts(&self) -> SceneFacts {
        SceneFacts::of(&self.scene, &self.layers)
    }

    fn bandwidth(&self, settings: &IntegratorSettings, iteration: u32, before: &[f32]) -> Option<BandwidthRange> {
        if let Some(sigma) = integrator::radius_range(before) {
            return Some(BandwidthRange { sigma, theta: None });
        }
        let bandwidth = integrator::bandwidth(&self.scene, settings, iteration)?;
        let has_angle = settings.integrator().has_angle();
        Some(BandwidthRange::one(
            bandwidth.sigma,
            has_angle.then_some(bandwidth.theta),
        ))
    }

    fn render(
        &self,
        settings: &IntegratorSettings,
        seed: u64,
        iteration: u32,
        before: &[f32],
        observer: &dyn Observer,
    ) -> Result<Iteration, RenderError> {
        let layers = (&self.layers, &self.memory);
        integrator::render_with_layers(&self.scene, layers, settings, seed, iteration, before, observer)
    }
}
