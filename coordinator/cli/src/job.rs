//! From the command line to a job: the scene is read, checked and bundled with every file that it names.

use crate::args::{JobArgs, unique};
use crate::repeat::OldPicture;
use crate::{say, settings};
use anyhow::{Context, Result, anyhow, bail};
use photonfarm_core::scene::{Limits, RecordedFiles, Scene, SceneFolder};
use photonfarm_proto::bundle::{BundleManifest, FileEntry};
use photonfarm_proto::id::BlobHash;
use photonfarm_proto::job::JobSpec;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// A job, ready to be sent.
pub(crate) struct PreparedJob {
    /// What is asked for.
    pub(crate) spec: JobSpec,
    /// The files of the scene.
    pub(crate) manifest: BundleManifest,
    /// Their contents.
    pub(crate) contents: BTreeMap<BlobHash, Vec<u8>>,
    /// Repeating the submission under this key does not create a second job.
    pub(crate) key: String,
}

impl PreparedJob {
    /// Loads the scene, so that what is wrong with it shows here and now, and keeps the files that it read.
    pub(crate) fn new(args: &JobArgs) -> Result<(Self, Scene)> {
        let old = args.from.as_deref().map(OldPicture::read).transpose()?;
        let defines = match &old {
            Some(old) => old.metadata.defines.clone(),
            None => unique("-D", &args.define)?,
        };
        let set = unique("--set", &args.set)?;
        let (folder, main) = split(&args.scene)?;
        let context = || format!("cannot load the scene {}", args.scene.display());
        let files = SceneFolder::new(folder).with_context(context)?;
        let recorded = RecordedFiles::new(&files);
        let sensor = match &old {
            Some(old) => old.metadata.sensor.clone(),
            None => args.sensor.clone(),
        };
        let limits = Limits::default();
        let scene = Scene::load_sensor(&recorded, main, &defines, sensor.as_deref(), &limits).with_context(context)?;
        if let (true, [first, ..]) = (args.strict, &scene.warnings[..]) {
            let count = scene.warnings.len();
            let more = if count == 1 {
                String::new()
            } else {
                format!(" (the first of {count})")
            };
            bail!("--strict: {first}{more}");
        }
        let integrator = match &old {
            Some(old) => old.metadata.integrator.clone(),
            None => settings::integrator(args.integrator, &scene.wishes, &set)?,
        };
        for warning in scene.warnings.iter().chain(&scene.hints(&integrator)) {
            say::tell(format_args!("warning: {warning}"));
        }
        let iterations = match (&old, args.iterations) {
            (Some(old), _) => old.iterations()?,
            (None, Some(iterations)) => iterations.get(),
            (None, None) => settings::default_iterations(&integrator, &scene.wishes),
        };
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
        };
        let now = SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos();
        let key = format!("{now:x}-{:x}", std::process::id());
        Ok((
            Self {
                spec,
                manifest,
                contents,
                key,
            },
            scene,
        ))
    }
}

/// The folder of the scene file and its name there.
fn split(scene: &Path) -> Result<(&Path, &str)> {
    if scene.is_dir() {
        return Err(anyhow!("{} is a folder: name the scene file in it", scene.display()));
    }
    let name = scene.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| anyhow!("{} is no name of a scene file", scene.display()))?;
    let folder = scene
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    Ok((folder, name))
}
