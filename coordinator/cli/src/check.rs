//! `photonfarm check`: loads a scene and says what it holds and what would become of it.

use crate::args::CheckArgs;
use crate::job::{PreparedJob, refuse_warnings};
use crate::say;
use anyhow::Result;
use photonfarm_core::scene::{Scene, SceneFaults};
use photonfarm_proto::check::CheckReport;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// What is said of a scene: also how a job of it would be, and what a farm would be sent.
#[derive(Debug, Serialize)]
struct Report {
    #[serde(flatten)]
    scene: CheckReport,
    iterations: u32,
    /// Bytes by name.
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
        let files = job.manifest.files.iter();
        Self {
            scene: CheckReport::of(&job.spec.main, scene, job.spec.integrator.with_defaults()),
            iterations: job.spec.iterations,
            files: files.map(|(name, entry)| (name.clone(), entry.bytes)).collect(),
        }
    }

    /// The report for people; `verbose` lists the notes as well.
    fn text(&self, verbose: bool) -> String {
        let scene = &self.scene;
        let [width, height] = scene.resolution;
        let mut text = format!("{}: {}, {width} x {height} pixels\n", scene.scene, scene.format);
        let mut say = |what: &str, said: String| {
            let _ = writeln!(text, "{what:<10} {said}");
        };
        let mesh = format!("{} triangles, {} vertices", scene.triangles, scene.vertices);
        say("shapes", format!("{}; {mesh}", by_type(&scene.shapes)));
        say("lights", by_type(&scene.lights));
        say("lamps", some(&scene.lamps));
        say("materials", by_type(&scene.materials));
        say(
            "textures",
            format!("{}; {} texels", by_type(&scene.textures), scene.texels),
        );
        if let Some(bounds) = scene.bounds {
            let [lower, upper] = bounds.map(|corner| corner.map(|x| x.to_string()).join(", "));
            say("bounds", format!("({lower}) to ({upper})"));
        }
        let settings = serde_json::to_string(&scene.integrator).unwrap_or_default();
        say("rendering", format!("{} iterations of {settings}", self.iterations));
        let total: u64 = self.files.values().sum();
        say("files", format!("{}, {total} bytes", self.files.len()));
        for (name, bytes) in self.files.iter().take(FILES_SHOWN) {
            say("", format!("{name}, {bytes} bytes"));
        }
        if let more @ 1.. = self.files.len().saturating_sub(FILES_SHOWN) {
            say("", format!("and {more} more, which --json names"));
        }
        say("warnings", scene.warnings.len().to_string());
        for warning in &scene.warnings {
            say("", warning.clone());
        }
        match (verbose, scene.notes.len()) {
            (_, 0) => {}
            (true, count) => {
                say("notes", count.to_string());
                scene.notes.iter().for_each(|note| say("", note.clone()));
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
