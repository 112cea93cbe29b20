//! Jobs: what is asked for, and how far it has come.

mod schema;
mod totals;

pub(crate) use schema::IntegratorSchema;
pub use totals::{BandwidthRange, MOST_COUNTED, PhaseSeconds, Totals};

use crate::bundle::BundleManifest;
use crate::id::{BlobHash, JobId, WorkerId};
use crate::limits::{LimitError, Limits, within};
use crate::schedule::{Checkpoint, Schedule, Stop};
use crate::waiting::Waiting;
use photonfarm_core::film::{Window, WindowError};
use photonfarm_core::integrator::layers::{LayerError, Layers};
use photonfarm_core::settings::{IntegratorRequest, IntegratorSettings};
use schema::WindowSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What a job asks for. Together with the renderer's build it determines every bit of every iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobSpec {
    /// The bundle that holds the scene.
    pub scene: BlobHash,
    /// Name of the scene file in the bundle.
    pub main: String,
    /// Values for the scene's `<default>` elements.
    #[serde(default)]
    pub defines: BTreeMap<String, String>,
    /// The sensor to see the scene through: its id, or its number from 1; the first one by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// The integrator with its settings. Settings that are left out are those of the scene's own integrator if it is of the same
    /// type, else the defaults with the scene's `max_depth`.
    #[schema(value_type = IntegratorSchema)]
    pub integrator: IntegratorRequest,
    /// Number of iterations to average.
    #[schema(minimum = 1)]
    pub iterations: u32,
    /// Seed of the random numbers.
    #[serde(default)]
    pub seed: u64,
    /// When and where it is worked on, and when it stops.
    #[serde(default, skip_serializing_if = "Schedule::is_default")]
    pub schedule: Schedule,
    /// Layers beside the picture: `alpha`, `albedo`, `normal`, `depth`, `position`, `halves`, `lamp:NAME` for the light of a lamp of the
    /// scene, `lamp:NAME+NAME` for that of several, `lamp:*` for that of all which no other layer names,
    /// `NAME=EXPRESSION` for the light along some paths, such as `caustic=L S+ D E`; `samples` for the number of camera paths of each
    /// pixel, `cryptomatte:object` and `cryptomatte:material` for what is seen.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 16, example = json!(["albedo", "lamp:*"]))]
    pub layers: Vec<String>,
    /// The window of the picture that is rendered, whose pixels are those of the whole picture; all of it by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<WindowSchema>)]
    pub crop: Option<Window>,
    /// A name for people, which changes nothing in the picture and need not be the only one of its kind.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schema(max_length = 200)]
    pub name: String,
    /// Labels for people and scripts, which change nothing in the picture.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// The job that is to be done before this one begins. Where that fails or is cancelled, this one is cancelled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<JobId>,
    /// A URL that is told when the job ends, where the farm tells anything. Whoever may look at the job sees it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(max_length = 2000)]
    pub webhook: Option<String>,
}

/// The longest name of a job \[bytes\].
pub const NAME_BYTES: usize = 200;
/// Most labels of a job.
pub const LABELS: usize = 32;
/// The longest label, its name and its value each \[bytes\].
pub const LABEL_BYTES: usize = 200;

impl JobSpec {
    /// Checks the job against a farm's limits and the bundle that it names.
    ///
    /// # Errors
    /// The first field that is beyond its limit, or that no job can have.
    pub fn check(&self, limits: &Limits, manifest: &BundleManifest) -> Result<(), LimitError> {
        limits.check_iterations(self.iterations)?;
        if !manifest.files.contains_key(&self.main) {
            let reason = format!("the bundle has no file {:?}", self.main);
            return Err(LimitError::invalid("main", reason));
        }
        let defines = self.defines.len() as u64;
        within("the number of defines", defines, "defines", limits.defines)?;
        let bytes_within = |what, bytes: usize| within(what, bytes as u64, "define_bytes", limits.define_bytes);
        for (name, value) in &self.defines {
            bytes_within("the length of a definition in bytes", name.len() + value.len())?;
        }
        if let Some(sensor) = &self.sensor {
            bytes_within("the length of the sensor's name in bytes", sensor.len())?;
        }
        self.layers()
            .and_then(|layers| layers.check_integrator(self.integrator.with_defaults()))
            .map_err(|error| LimitError::invalid("layers", error.to_string()))?;
        self.check_crop()
            .map_err(|error| LimitError::invalid("crop", error.to_string()))?;
        if self.name.len() > NAME_BYTES || self.name.chars().any(char::is_control) {
            let reason = format!("a name is text of at most {NAME_BYTES} bytes without control characters");
            return Err(LimitError::invalid("name", reason));
        }
        check_labels(&self.labels)?;
        self.schedule.check()
    }

    /// Checks what can be checked of the window without the scene.
    fn check_crop(&self) -> Result<(), WindowError> {
        let crop = self.crop.map(Window::check).transpose()?;
        self.integrator.with_defaults().check_window(crop)
    }

    /// The layers.
    ///
    /// # Errors
    /// Names that no layers have.
    pub fn layers(&self) -> Result<Layers, LayerError> {
        Layers::parse(&self.layers)
    }
}

/// Checks labels: few, of short texts without control characters, with names that a filter can tell from values.
fn check_labels(labels: &BTreeMap<String, String>) -> Result<(), LimitError> {
    if labels.len() > LABELS {
        let reason = format!("{} labels, more than {LABELS}", labels.len());
        return Err(LimitError::invalid("labels", reason));
    }
    let plain = |text: &str| text.len() <= LABEL_BYTES && !text.chars().any(char::is_control);
    let good = |name: &str, value: &str| !name.is_empty() && !name.contains('=') && plain(name) && plain(value);
    match labels.iter().find(|(name, value)| !good(name, value)) {
        Some((name, value)) => {
            let reason = format!(
                "{name:?}: {value:?}: a label is a name without `=` and a value, each of at most {LABEL_BYTES} bytes without \
                 control characters"
            );
            Err(LimitError::invalid("labels", reason))
        }
        None => Ok(()),
    }
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// Nothing of it has been handed out.
    Queued,
    /// Workers are at it, or were.
    Running,
    /// Every iteration is in the image.
    Done,
    /// It ended without all of its iterations.
    Failed,
    /// It was cancelled.
    Cancelled,
}

impl JobState {
    /// Whether the job will not change any more.
    #[must_use]
    pub fn ended(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// Why work could not be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FailureKind {
    /// The scene or a setting is at fault: no iteration can be rendered. Ends the job at once.
    Scene,
    /// An iteration has no valid image.
    Render,
    /// The renderer panicked.
    Panic,
    /// The worker was lost while rendering.
    Lost,
    /// The worker's process was killed while rendering, since memory had run out.
    OutOfMemory,
}

/// An iteration that was given up, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Poisoned {
    /// The iteration, from 1.
    pub iteration: u32,
    /// What happened at each attempt.
    pub attempts: Vec<Attempt>,
}

/// An attempt at an iteration that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Attempt {
    /// The worker that tried.
    pub worker: WorkerId,
    /// How it failed.
    pub kind: FailureKind,
    /// What the worker said.
    pub message: String,
    /// When.
    #[serde(rename = "at", alias = "at_ms", with = "crate::time", default)]
    #[schema(value_type = String, format = DateTime)]
    pub at_ms: u64,
}

/// How far a job has come.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobStatus {
    /// The job.
    pub id: JobId,
    /// Where it stands.
    pub state: JobState,
    /// What is asked for, as it stands: extended, stopped, paused, and so on.
    pub spec: JobSpec,
    /// The integrator with all its settings; absent until a worker has loaded the scene, if that decides over some of them.
    #[serde(default)]
    #[schema(value_type = Option<IntegratorSchema>)]
    pub integrator: Option<IntegratorSettings>,
    /// What of the scene is not rendered as it is written, or probably not meant so, each with its place; none until a worker has loaded it.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// Name of the token that it was submitted with; empty without tokens.
    #[serde(default)]
    pub owner: String,
    /// When it was submitted.
    #[serde(rename = "created", alias = "created_ms", with = "crate::time")]
    #[schema(value_type = String, format = DateTime)]
    pub created_ms: u64,
    /// When it ended.
    #[serde(rename = "ended", alias = "ended_ms", with = "crate::time::option", default)]
    #[schema(value_type = Option<String>, format = DateTime)]
    pub ended_ms: Option<u64>,
    /// Iterations in the image.
    pub iterations_done: u64,
    /// Iterations in the image, and those that workers have rendered but not delivered.
    pub iterations_rendered: u64,
    /// Iterations given up, with the reasons.
    pub poisoned: Vec<Poisoned>,
    /// Why the job failed.
    pub failure: Option<String>,
    /// Pixels across and down, known once an iteration has arrived.
    pub resolution: Option<[u32; 2]>,
    /// What the iterations in the image took.
    pub totals: Totals,
    /// Iterations per second of wall-clock time, lately.
    pub iterations_per_second: Option<f64>,
    /// Workers that hold a lease of the job.
    pub workers: u32,
    /// Iterations in the image that another worker is to repeat before they are believed.
    #[serde(default)]
    pub iterations_in_doubt: u64,
    /// Most memory that a worker's process was measured to hold while it worked on the job (MiB).
    #[serde(default)]
    pub memory_mb: Option<u32>,
    /// Name of the renderer that the job is bound to since its first lease.
    #[serde(default)]
    pub renderer: Option<String>,
    /// The noise at the last checkpoint, if there is a noise target.
    #[serde(default)]
    pub checkpoint: Option<Checkpoint>,
    /// Set when the job ended before its last iteration.
    #[serde(default)]
    pub stop: Option<Stop>,
    /// Why nobody is at work on it, while nobody is.
    #[serde(default)]
    pub waiting: Option<String>,
    /// The same for programs.
    #[serde(default)]
    pub waiting_reason: Option<Waiting>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::FileEntry;
    use photonfarm_core::settings::PathSettings;

    #[test]
    fn jobs_beyond_a_limit_are_refused_by_its_name() {
        let limits = Limits {
            iterations: 8,
            defines: 1,
            define_bytes: 4,
            ..Limits::default()
        };
        let files = [("scene.xml".to_owned(), FileEntry::of(b"scene"))].into();
        let bundle = BundleManifest { files };
        let spec = JobSpec {
            scene: bundle.hash(),
            main: "scene.xml".into(),
            defines: Default::default(),
            sensor: None,
            integrator: IntegratorSettings::Path(PathSettings::default()).into(),
            iterations: 4,
            seed: 0,
            schedule: Default::default(),
            layers: Vec::new(),
            crop: None,
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        };
        assert!(spec.check(&limits, &bundle).is_ok());
        let refused = |change: &dyn Fn(&mut JobSpec)| {
            let mut bad = spec.clone();
            change(&mut bad);
            bad.check(&limits, &bundle).unwrap_err().to_string()
        };
        assert!(refused(&|s| s.iterations = 9).contains("iterations"));
        assert!(refused(&|s| s.iterations = 0).contains("iterations"));
        assert!(refused(&|s| s.main = "other.xml".into()).contains("other.xml"));
        assert!(refused(&|s| _ = s.defines.insert("abc".into(), "de".into())).contains("define_bytes"));
        assert!(refused(&|s| s.name = "a\nb".into()).contains("control"));
        assert!(refused(&|s| s.name = "a".repeat(NAME_BYTES + 1)).contains("200 bytes"));
        let labelled = |name: &str, value: &str| BTreeMap::from([(name.to_owned(), value.to_owned())]);
        assert!(refused(&|s| s.labels = labelled("", "x")).contains("labels"));
        assert!(refused(&|s| s.labels = labelled("a=b", "x")).contains("without `=`"));
        assert!(refused(&|s| s.labels = labelled("a", "x\ny")).contains("control"));
        assert!(refused(&|s| s.labels = labelled("a", &"x".repeat(LABEL_BYTES + 1))).contains("200 bytes"));
        let many = (0..=LABELS).map(|i| (i.to_string(), String::new()));
        assert!(refused(&|s| s.labels = many.clone().collect()).contains("33 labels"));
        let fine = JobSpec {
            labels: labelled("shot", "a = b"),
            ..spec.clone()
        };
        assert!(fine.check(&limits, &bundle).is_ok());
        assert!(refused(&|s| s.sensor = Some("abcde".into())).contains("define_bytes"));
    }
}
