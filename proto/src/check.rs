//! Checks: what a worker says of a scene before a job is made of it.
//!
//! A check is asked for as a job is, but nothing is rendered, nothing is counted and nothing is kept on a disk.

use crate::id::{BlobHash, CheckId, WorkerId};
use crate::job::{IntegratorSchema, JobSpec};
use crate::waiting::Waiting;
use crate::worker::{cut_to, json_text};
use photonfarm_core::scene::{Scene, SceneError, SceneFaults};
use photonfarm_core::settings::{IntegratorRequest, IntegratorSettings, SettingError};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// Most names of lights in a report.
pub const MOST_LAMPS: usize = 256;
/// Most errors, most warnings and most notes of a check that travel; a scene tells fewer.
pub const MOST_REMARKS: usize = 64;
/// The longest of these, and the longest name of a light \[bytes\].
pub const REMARK_BYTES: usize = 1024;
/// Most bytes of the JSON of a worker's answer.
pub const ANSWER_BYTES: usize = 1 << 20;

/// What a check asks for: what a job would name that decides whether its scene can be rendered, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CheckSpec {
    /// The bundle that holds the scene.
    pub scene: BlobHash,
    /// Name of the scene file in the bundle.
    pub main: String,
    /// Values for the scene's `<default>` elements.
    #[serde(default)]
    pub defines: BTreeMap<String, String>,
    /// The sensor to see the scene through, as a job names it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// The integrator with its settings, as a job names them.
    #[schema(value_type = IntegratorSchema)]
    pub integrator: IntegratorRequest,
    /// Layers beside the picture, as a job names them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 16, example = json!(["albedo", "lamp:*"]))]
    pub layers: Vec<String>,
}

impl CheckSpec {
    /// A job of one iteration that names the same.
    #[must_use]
    pub fn job(self) -> JobSpec {
        JobSpec {
            scene: self.scene,
            main: self.main,
            defines: self.defines,
            sensor: self.sensor,
            integrator: self.integrator,
            iterations: 1,
            seed: 0,
            schedule: Default::default(),
            layers: self.layers,
            crop: None,
            name: String::new(),
            labels: Default::default(),
            after: None,
            webhook: None,
        }
    }
}

/// How far a check has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum CheckState {
    /// No worker is at it: `waiting` says why.
    Waiting,
    /// A worker loads the scene.
    Checking,
    /// A worker has answered: there is a `report` if the scene can be rendered, and otherwise a `failure`.
    Done,
    /// No worker could answer, and none is asked any more: `reason` says why. That says nothing about the scene.
    Failed,
}

/// A check as it stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckStatus {
    /// The check.
    pub id: CheckId,
    /// How far it has come.
    pub state: CheckState,
    /// Why no worker is at it, while none is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waiting: Option<String>,
    /// The same for programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waiting_reason: Option<Waiting>,
    /// What the scene holds, and how it would be rendered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub report: Option<CheckReport>,
    /// What is wrong with the scene, or with what is asked of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<CheckFailure>,
    /// Why no worker could answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// What is said of a scene that can be rendered. The command `check` says the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckReport {
    /// Name of the scene file.
    pub scene: String,
    /// The format of the scene file, for people.
    pub format: String,
    /// Shapes by type, as the files say it: also what nothing refers to.
    pub shapes: BTreeMap<String, u64>,
    /// Lights by type.
    pub lights: BTreeMap<String, u64>,
    /// Materials by type.
    pub materials: BTreeMap<String, u64>,
    /// Textures by type.
    pub textures: BTreeMap<String, u64>,
    /// Triangles of all meshes; what is instanced counts once.
    pub triangles: u64,
    /// Vertices of all meshes.
    pub vertices: u64,
    /// Texels of all images.
    pub texels: u64,
    /// Names of the lights, for layers. From a farm there are at most 256.
    pub lamps: BTreeSet<String>,
    /// Pixels across and down.
    pub resolution: [u32; 2],
    /// Lower and upper corner of all shapes (scene units); absent where there is no shape.
    pub bounds: Option<[[f32; 3]; 2]>,
    /// How it would be rendered.
    #[schema(value_type = IntegratorSchema)]
    pub integrator: IntegratorSettings,
    /// What is not rendered as it is written, or is probably not meant, each with its place.
    pub warnings: Vec<String>,
    /// What changes nothing in the picture, each with its place.
    pub notes: Vec<String>,
}

impl CheckReport {
    /// What is said of the scene of the file `main`, to be rendered with these settings.
    #[must_use]
    pub fn of(main: &str, scene: &Scene, integrator: &IntegratorSettings) -> Self {
        let contents = scene.contents.clone();
        let corners: [[f32; 3]; 2] = <[_; 2]>::from(scene.geometry.bounds()).map(|corner| corner.to_array());
        let hints = scene.hints(integrator);
        Self {
            scene: main.to_owned(),
            format: contents.format.to_owned(),
            shapes: contents.shapes,
            lights: contents.lights,
            materials: contents.materials,
            textures: contents.textures,
            triangles: contents.triangles,
            vertices: contents.vertices,
            texels: contents.texels,
            lamps: scene.lamps.iter().cloned().collect(),
            resolution: scene.film.size(),
            bounds: Some(corners).filter(|corners| corners.as_flattened().iter().all(|x| x.is_finite())),
            integrator: integrator.clone(),
            warnings: scene.warnings.iter().chain(&hints).map(ToString::to_string).collect(),
            notes: scene.notes.iter().map(ToString::to_string).collect(),
        }
    }

    /// As much of it as travels from a worker to a farm.
    #[must_use]
    pub fn bounded(mut self) -> Self {
        let lamps = self.lamps.into_iter().filter(|name| name.len() <= REMARK_BYTES);
        self.lamps = lamps.take(MOST_LAMPS).collect();
        self.warnings = bounded(self.warnings);
        self.notes = bounded(self.notes);
        self
    }
}

/// What is wrong, all of it: there is at least one error.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CheckFailure {
    /// What is wrong.
    pub errors: Vec<CheckError>,
    /// What was warned about besides, each with its place: an error may follow from it.
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl CheckFailure {
    /// One thing is wrong.
    #[must_use]
    pub fn one(error: CheckError) -> Self {
        Self {
            errors: vec![error],
            warnings: Vec::new(),
        }
    }

    /// As much of it as travels from a worker to a farm.
    #[must_use]
    pub fn bounded(mut self) -> Self {
        self.errors.truncate(MOST_REMARKS);
        for error in &mut self.errors {
            cut(&mut error.message);
            error.field.iter_mut().chain(&mut error.file).for_each(cut);
        }
        self.warnings = bounded(self.warnings);
        self
    }
}

impl From<&SceneFaults> for CheckFailure {
    fn from(faults: &SceneFaults) -> Self {
        Self {
            errors: faults.all().iter().map(CheckError::from).collect(),
            warnings: faults.warnings().iter().map(ToString::to_string).collect(),
        }
    }
}

/// Something that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CheckError {
    /// In words: where, and what is allowed.
    pub message: String,
    /// The file of the scene in which it is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// The line, counted from 1, where the file has lines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<u32>,
    /// The element of the scene with its attribute or property; or the field of the request, such as `integrator.photons`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
}

impl CheckError {
    /// Something that is wrong with the request, at a field of it where one is to blame.
    pub fn of_request(field: Option<&str>, message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            file: None,
            line: None,
            field: field.map(str::to_owned),
        }
    }
}

impl From<&SceneError> for CheckError {
    fn from(error: &SceneError) -> Self {
        let field = match error {
            SceneError::Value { field, .. } => Some(field),
            SceneError::Unknown { context, .. }
            | SceneError::Missing { context, .. }
            | SceneError::Unsupported { context, .. } => Some(context),
            _ => None,
        };
        Self {
            message: error.to_string(),
            file: Some(error.file().to_owned()),
            line: error.line(),
            field: field.cloned(),
        }
    }
}

impl From<SettingError> for CheckError {
    fn from(error: SettingError) -> Self {
        Self::of_request(Some(&format!("integrator.{}", error.name)), error.to_string())
    }
}

fn cut(text: &mut String) {
    cut_to(text, REMARK_BYTES);
}

fn bounded(mut texts: Vec<String>) -> Vec<String> {
    texts.truncate(MOST_REMARKS);
    texts.iter_mut().for_each(cut);
    texts
}

/// The fencing token of a check: nobody but the worker that was given it knows the nonce.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckToken {
    /// The check.
    pub id: CheckId,
    /// Random bits.
    pub nonce: u64,
}

/// A check, lent to one worker until it is silent for too long. It renders meanwhile whatever else it is lent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckAssignment {
    /// Fencing token.
    pub token: CheckToken,
    /// What to load; JSON within bincode, which cannot carry tagged enums.
    #[serde(with = "json_text")]
    pub spec: CheckSpec,
}

/// What a worker does about checks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Checking {
    /// It takes none now.
    #[default]
    Not,
    /// It would take one.
    Ready,
    /// It is at one.
    At(CheckToken),
}

/// What became of a check.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckResult {
    /// The check.
    pub token: CheckToken,
    /// Who.
    pub worker: WorkerId,
    /// The answer; JSON within bincode, which cannot carry tagged enums. At most [`ANSWER_BYTES`] bytes.
    #[serde(with = "json_text")]
    pub answer: CheckAnswer,
}

/// A worker's answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CheckAnswer {
    /// The scene can be rendered.
    Report(Box<CheckReport>),
    /// It cannot.
    Failure(CheckFailure),
    /// This worker cannot tell, and another one may.
    Elsewhere(String),
    /// This worker cannot tell, and no other one is to try.
    Never(String),
}

impl CheckAnswer {
    /// As much of it as travels.
    #[must_use]
    pub fn bounded(self) -> Self {
        let cut_off = |mut text| {
            cut(&mut text);
            text
        };
        match self {
            Self::Report(report) => Self::Report(Box::new(report.bounded())),
            Self::Failure(failure) => Self::Failure(failure.bounded()),
            Self::Elsewhere(reason) => Self::Elsewhere(cut_off(reason)),
            Self::Never(reason) => Self::Never(cut_off(reason)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec;
    use crate::worker::LeaseReply;
    use photonfarm_core::scene::Limits;
    use serde_json::json;

    const SCENE: &str = "<scene version='3.0.0'>\n<shape type='sphere' id='ball'><emitter type='area'>\
        <rgb name='radiance' value='1'/></emitter></shape></scene>";

    fn load(text: &str) -> Result<Scene, SceneFaults> {
        let files = BTreeMap::from([("a.xml".to_owned(), text.as_bytes().to_vec())]);
        Scene::load(&files, "a.xml", &BTreeMap::new(), &Limits::default())
    }

    fn report() -> CheckReport {
        CheckReport::of(
            "a.xml",
            &load(SCENE).unwrap(),
            &IntegratorSettings::Path(Default::default()),
        )
    }

    fn answered(answer: CheckAnswer) -> Vec<u8> {
        let token = CheckToken {
            id: CheckId(7),
            nonce: 9,
        };
        let worker = WorkerId(2);
        let result = CheckResult { token, worker, answer };
        let bytes = codec::encode(&result).unwrap();
        assert_eq!(codec::decode::<CheckResult>(&bytes).unwrap(), result);
        bytes
    }

    #[test]
    fn a_report_survives_the_way_and_has_what_the_scene_has() {
        let report = report();
        assert_eq!((report.shapes["sphere"], report.lights["area"]), (1, 1));
        assert_eq!(report.lamps, BTreeSet::from(["ball".to_owned()]));
        let corners = report.bounds.unwrap();
        assert!(
            corners.as_flattened().iter().all(|x| (x.abs() - 1.0).abs() < 1e-6),
            "{corners:?}"
        );
        answered(CheckAnswer::Report(Box::new(report)));
    }

    #[test]
    fn errors_name_file_line_and_field() {
        let faults = load(&SCENE.replace("value='1'", "value='bright'")).unwrap_err();
        let failure = CheckFailure::from(&faults);
        let error = &failure.errors[0];
        assert_eq!((error.file.as_deref(), error.line), (Some("a.xml"), Some(2)));
        assert!(error.field.as_ref().unwrap().contains("radiance"), "{error:?}");
        assert!(error.message.starts_with("a.xml:2: "), "{error:?}");
        answered(CheckAnswer::Failure(failure));
    }

    #[test]
    fn what_travels_is_bounded() {
        let long = || vec!["é".repeat(REMARK_BYTES); 2 * MOST_REMARKS];
        let report = CheckReport {
            lamps: (0..2 * MOST_LAMPS).map(|index| index.to_string()).collect(),
            warnings: long(),
            notes: long(),
            ..report()
        };
        let mut error = CheckError::of_request(Some(&long()[0]), long()[0].clone());
        error.file = Some(long()[0].clone());
        let failure = CheckFailure {
            errors: vec![error; 2 * MOST_REMARKS],
            warnings: long(),
        };
        for answer in [
            CheckAnswer::Report(Box::new(report)),
            CheckAnswer::Failure(failure),
            CheckAnswer::Never(long()[0].clone()),
        ] {
            let bounded = answer.bounded();
            assert!(serde_json::to_string(&bounded).unwrap().len() <= ANSWER_BYTES);
            answered(bounded);
        }
    }

    #[test]
    fn an_assignment_survives_with_its_settings() {
        let spec = json!({"scene": BlobHash::of(b""), "main": "a.xml", "integrator": {"type": "pcf", "photons": 5}});
        let check = CheckAssignment {
            token: CheckToken {
                id: CheckId(1),
                nonce: 2,
            },
            spec: serde_json::from_value(spec).unwrap(),
        };
        let reply = LeaseReply {
            assignment: None,
            check: Some(check),
        };
        let bytes = codec::encode(&reply).unwrap();
        assert_eq!(codec::decode::<LeaseReply>(&bytes).unwrap(), reply);
    }
}
