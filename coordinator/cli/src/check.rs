//! `photonfarm check`: loads a scene and says what it holds and what would become of it.

use crate::args::CheckArgs;
use crate::job::{PreparedJob, refuse_warnings};
use crate::say;
use anyhow::Result;
use photonfarm_core::scene::{Scene, SceneContents, SceneFaults};
use photonfarm_core::settings::IntegratorSettings;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// What is said of a scene.
#[derive(Debug, Serialize)]
struct Report {
    /// Name of the scene file.
    scene: String,
    #[serde(flatten)]
    contents: SceneContents,
    /// Pixels across and down.
    /// Names of the lights, for layers.
    lamps: BTreeSet<String>,
    resolution: [u32; 2],
    /// Lower and upper corner of all shapes [scene units].
    bounds: [[f32; 3]; 2],
    /// How it would be rendered.
    integrator: IntegratorSettings,
    iterations: u32,
    warnings: Vec<String>,
    /// What changes nothing in the picture.
    notes: Vec<String>,
    /// What a farm would be sent: bytes by name.
    files: BTreeMap<String, u64>,
}

/// The most files that are named to people.
const FILES_SHOWN: usize = 12;

/// What is said of a scene that cannot be loaded.
#[derive(Debug, Serialize)]
struct Failure {
    errors: Vec<String>,
    warnings: Vec<String>,
}

/// Runs the command.
pub(crate) fn run(args: CheckArgs) -> Result<()> {
    let (job, scene) = match PreparedJob::load(&args.job) {
        Ok(loaded) => loaded,
        Err(error) => {
            if args.json {
                say::json(&Failure::of(&error))?;
            }
            return Err(error);
        }
    };
    let report = Report::of(&job, &scene);
    match args.json {
        true => say::json(&report)?,
        false => say::line(report.text(args.job.verbose))?,
    }
    refuse_warnings(&args.job, &scene)
}

impl Failure {
    fn of(error: &anyhow::Error) -> Self {
        match error.downcast_ref::<SceneFaults>() {
            Some(faults) => Self {
                errors: faults.all().iter().map(ToString::to_string).collect(),
                warnings: faults.warnings().iter().map(ToString::to_string).collect(),
            },
            None => Self {
                errors: vec![say::causes(error)],
                warnings: vec![],
            },
        }
    }
}

impl Report {
    fn of(job: &PreparedJob, scene: &Scene) -> Self {
        let (lower, upper) = scene.geometry.bounds();
        let files = job.manifest.files.iter();
        Self {
            scene: job.spec.main.clone(),
            contents: scene.contents.clone(),
            lamps: scene.lamps.iter().cloned().collect(),
            resolution: scene.film.size(),
            bounds: [lower.to_array(), upper.to_array()],
            integrator: job.spec.integrator.with_defaults().clone(),
            iterations: job.spec.iterations,
            warnings: job.warnings(scene).iter().map(ToString::to_string).collect(),
            notes: scene.notes.iter().map(ToString::to_string).collect(),
            files: files.map(|(name, entry)| (name.clone(), entry.bytes)).collect(),
        }
    }

    /// The report for people; `verbose` lists the notes as well.
    fn text(&self, verbose: bool) -> String {
        let [width, height] = self.resolution;
        let contents = &self.contents;
        let mut text = format!("{}: {}, {width} x {height} pixels\n", self.scene, contents.format);
        let mut say = |what: &str, said: String| {
            let _ = writeln!(text, "{what:<10} {said}");
        };
        let mesh = format!("{} triangles, {} vertices", contents.triangles, contents.vertices);
        say("shapes", format!("{}; {mesh}", by_type(&contents.shapes)));
        say("lights", by_type(&contents.lights));
        say("lamps", some(&self.lamps));
        say("materials", by_type(&contents.materials));
        say(
            "textures",
            format!("{}; {} texels", by_type(&contents.textures), contents.texels),
        );
        let [lower, upper] = self.bounds.map(|corner| corner.map(|x| x.to_string()).join(", "));
        say("bounds", format!("({lower}) to ({upper})"));
        let settings = serde_json::to_string(&self.integrator).unwrap_or_default();
        say("rendering", format!("{} iterations of {settings}", self.iterations));
        let total: u64 = self.files.values().sum();
        say("files", format!("{}, {total} bytes", self.files.len()));
        for (name, bytes) in self.files.iter().take(FILES_SHOWN) {
            say("", format!("{name}, {bytes} bytes"));
        }
        if let more @ 1.. = self.files.len().saturating_sub(FILES_SHOWN) {
            say("", format!("and {more} more, which --json names"));
        }
        say("warnings", self.warnings.len().to_string());
        for warning in &self.warnings {
            say("", warning.clone());
        }
        match (verbose, self.notes.len()) {
            (_, 0) => {}
            (true, count) => {
                say("notes", count.to_string());
                self.notes.iter().for_each(|note| say("", note.clone()));
            }
            (false, count) => say("notes", format!("{count}, which -v lists")),
        }
        text.truncate(text.trim_end().len());
        text
    }
}

/// The first of some names.
fn some(names: &BTreeSet<String>) -> String {
    let first: Vec<&str> = names.iter().take(FILES_SHOWN).map(String::as_str).collect();
    match names.len().saturating_sub(FILES_SHOWN) {
        0 => first.join(", "),
        more => format!("{} and {more} more, which --json names", first.join(", ")),
    }
}

/// How many there are, and of which types.
fn by_type(types: &BTreeMap<String, u64>) -> String {
    let total: u64 = types.values().sum();
    let each: Vec<String> = types.iter().map(|(name, count)| format!("{name} {count}")).collect();
    match each.is_empty() {
        true => "none".to_owned(),
        false => format!("{total} ({})", each.join(", ")),
    }
}
