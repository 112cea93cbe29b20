//! From the command line to a job: the scene is read, checked and bundled with every file that it names.

use crate::args::{JobArgs, unique};
use crate::input::Input;
use crate::repeat::OldPicture;
use crate::{say, settings};
use anyhow::{Context, Result, bail};
use bytes::Bytes;
use photonfarm_core::integrator::layers::{LayerError, Layers};
use photonfarm_core::scene::{Limits, RecordedFiles, Scene, SceneWarning};
use photonfarm_core::settings::IntegratorSettings;
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::job::JobSpec;
use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

/// A job, ready to be sent.
pub(crate) struct PreparedJob {
    /// What is asked for.
    pub(crate) spec: JobSpec,
    /// The files of the scene.
    pub(crate) manifest: BundleManifest,
    /// Their contents.
    pub(crate) contents: BTreeMap<BlobHash, Bytes>,
    /// What the job is called where nothing else is said.
    pub(crate) name: String,
    /// Repeating the submission under this key does not create a second job.
    pub(crate) key: String,
}

impl PreparedJob {
    /// Loads the scene, so that what is wrong with it shows here and now, and keeps the files that it read. What it is warned about
    /// is told.
    pub(crate) fn new(args: &JobArgs) -> Result<(Self, Scene)> {
        let (job, scene) = Self::load(args)?;
        for warning in job.warnings(&scene) {
            say::tell(format_args!("warning: {warning}"));
        }
        for note in scene.notes.iter().filter(|_| args.verbose) {
            say::tell(format_args!("note: {note}"));
        }
        refuse_warnings(args, &scene)?;
        Ok((job, scene))
    }

    /// Warnings of the scene, and those about rendering it as the job asks.
    pub(crate) fn warnings(&self, scene: &Scene) -> Vec<SceneWarning> {
        let integrator = self.spec.integrator.with_defaults();
        let hints = scene.hints(integrator);
        scene.warnings.iter().cloned().chain(hints).collect()
    }

    /// As [`PreparedJob::new`], and tells nothing.
    pub(crate) fn load(args: &JobArgs) -> Result<(Self, Scene)> {
        let old = args.from.as_deref().map(OldPicture::read).transpose()?;
        let defines = match &old {
            Some(old) => old.metadata.defines.clone(),
            None => {
                let frame = args.frame.map(|frame| ("frame".to_owned(), frame.to_string()));
                let given: Vec<_> = args.define.iter().cloned().chain(frame).collect();
                unique("-D", &given)?
            }
        };
        let set = unique("--set", &args.set)?;
        let input = Input::open(&args.scene, args.format)?;
        let main = input.main.as_str();
        let context = || format!("cannot load the scene {}", args.scene.display());
        let recorded = RecordedFiles::new(&*input.files);
        let sensor = match &old {
            Some(old) => old.metadata.sensor.clone(),
            None => args.sensor.clone(),
        };
        let limits = Limits::default();
        let scene = Scene::load_sensor(&recorded, main, &defines, sensor.as_deref(), &limits).with_context(context)?;
        let integrator = match &old {
            Some(old) => old.metadata.integrator.clone(),
            None => settings::integrator(args.integrator, &scene.wishes, &set)?,
        };
        let iterations = match (&old, args.iterations) {
            (Some(old), _) => old.iterations()?,
            (None, Some(iterations)) => iterations.get(),
            (None, None) => settings::default_iterations(&integrator, &scene.wishes),
        };
        let layers = match &old {
            Some(old) => old.metadata.layers.clone(),
            None => args.layer.clone(),
        };
        check_layers(&layers, &integrator, &scene).context("--layer")?;
        let mut manifest = BundleManifest::default();
        let mut contents = BTreeMap::new();
        for (name, bytes) in recorded.into_files() {
            let entry = FileEntry::of(&bytes);
            manifest.files.insert(name, entry);
            contents.insert(entry.hash, bytes);
        }
        if let Some(old) = &old {
            old.check_scene(&args.scene, main, manifest.hash())?;
        }
        let spec = JobSpec {
            scene: manifest.hash(),
            main: main.to_owned(),
            defines,
            sensor,
            integrator: integrator.into(),
            iterations,
            seed: old.map_or(args.seed, |old| old.metadata.seed),
            schedule: Default::default(),
            layers,
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        let now = SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos();
        let key = format!("{now:x}-{:x}", std::process::id());
        Ok((
            Self {
                spec,
                manifest,
                contents,
                name: input.name,
                key,
            },
            scene,
        ))
    }
}

/// Checks that the integrator and the scene have the layers that are asked for.
fn check_layers(names: &[String], integrator: &IntegratorSettings, scene: &Scene) -> Result<(), LayerError> {
    let layers = Layers::parse(names)?;
    layers.check_integrator(integrator)?;
    layers.check_scene(scene)
}

/// Refuses a scene with warnings where that is asked for.
pub(crate) fn refuse_warnings(args: &JobArgs, scene: &Scene) -> Result<()> {
    match scene.warnings.len() {
        1.. if args.strict => bail!("--strict: the scene is not rendered as it is written, see its warnings"),
        _ => Ok(()),
    }
}
