//! What the list of integrators says of each, and what the rest of the renderer does by it.

use super::{Bandwidth, INTEGRATORS, IntegratorSettings, Iteration, Job, Observer, RenderError};
use crate::film::{Window, WindowError};
use crate::random::Sampling;
use crate::scene::Scene;
use crate::settings::{Setting, SettingError, fields_of};
use serde_json::{Map, Value, json};

/// An integrator in the list of all ([`INTEGRATORS`]).
#[derive(Debug, PartialEq)]
pub struct Integrator {
    /// Its name: `type` in a job's JSON and in scene files, and `--integrator` on the command line.
    pub name: &'static str,
    /// What it is, in a line without a full stop.
    pub summary: &'static str,
    /// Its settings. Every integrator has `max_depth`.
    pub settings: &'static [Setting],
    /// What else a scene's `<integrator>` may have.
    pub ignored: Ignored,
    /// Values of each pixel that an iteration hands on to the next ([`Iteration::statistics`]). 0: iterations need
    /// nothing of each other. Otherwise the integrator is *sequential*: its iterations are rendered one after the other.
    pub statistics_per_pixel: usize,
}

/// Properties of Mitsuba's plugin of the same name that are accepted in scene files and change nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ignored {
    /// These, with whole numbers of 1 or more.
    Integers(&'static [&'static str]),
    /// All.
    All,
}

/// What an integrator does, by its settings.
pub(super) trait Estimator {
    /// Its line in the list.
    fn integrator(&self) -> &'static Integrator;

    /// How the random numbers of paths relate to each other.
    fn sampling(&self) -> Sampling;

    /// Most edges of a light path, camera to light; `None`: no limit.
    fn max_depth(&self) -> Option<u32>;

    /// Kernel sizes of iteration `iteration` (1, 2, ...); `None` for an integrator without kernels.
    fn bandwidth(&self, _scene: &Scene, _iteration: u32) -> Option<Bandwidth> {
        None
    }

    /// Why the settings themselves may leave a lit scene black, in a sentence without a full stop.
    fn why_black(&self) -> Option<&'static str> {
        None
    }

    /// Whether what a pixel is depends on the camera paths of others, so that a window of a picture is rendered as all of it.
    fn needs_all_pixels(&self) -> bool {
        false
    }

    /// Renders an iteration. `before`: what the iteration before left, empty for the first one and where the integrator is
    /// not sequential.
    fn render(&self, job: &Job, before: &[f32], observer: &dyn Observer) -> Result<Iteration, RenderError>;
}

impl Integrator {
    /// The integrator of that name.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        INTEGRATORS.into_iter().find(|integrator| integrator.name == name)
    }

    /// The setting of that name.
    #[must_use]
    pub fn setting(&self, name: &str) -> Option<&'static Setting> {
        self.settings.iter().find(|setting| setting.name == name)
    }

    /// Whether its kernels have a width in angle as well as one in space: the setting `theta1` says how wide they begin.
    #[must_use]
    pub fn has_angle(&self) -> bool {
        self.setting("theta1").is_some()
    }

    /// Its default settings.
    #[must_use]
    pub fn defaults(&self) -> IntegratorSettings {
        self.read(Map::new()).expect("defaults are settings")
    }

    /// Its settings: those that JSON gives, and defaults for the others.
    ///
    /// # Errors
    /// A setting that it does not have, or that is out of range.
    pub fn read(&self, mut given: Map<String, Value>) -> Result<IntegratorSettings, SettingError> {
        for setting in self.settings {
            if let Some(value) = given.get(setting.name) {
                setting.check(value)?;
            }
        }
        given.insert("type".to_owned(), self.name.into());
        serde_json::from_value(Value::Object(given)).map_err(|error| SettingError {
            name: "integrator",
            value: error.to_string(),
            expected: format!("settings of {}", self.name),
        })
    }

    /// The JSON schema of its settings.
    fn schema(&self) -> Value {
        let defaults = fields_of(&self.defaults());
        let mut properties = Map::from_iter([("type".to_owned(), json!({"type": "string", "enum": [self.name]}))]);
        for setting in self.settings {
            let mut schema = setting.schema();
            // The OpenAPI document cannot say that the default is null.
            if let Some(default) = defaults.get(setting.name).filter(|default| !default.is_null()) {
                schema["default"] = default.clone();
            }
            properties.insert(setting.name.to_owned(), schema);
        }
        json!({"type": "object", "title": self.name, "description": format!("{}.", self.summary),
            "required": ["type"], "properties": properties, "additionalProperties": false})
    }
}

/// The JSON schema of an integrator with its settings.
#[must_use]
pub fn schema() -> Value {
    let each: Vec<Value> = INTEGRATORS.into_iter().map(Integrator::schema).collect();
    json!({"oneOf": each})
}

impl IntegratorSettings {
    /// The integrator's line in the list of all.
    #[must_use]
    pub fn integrator(&self) -> &'static Integrator {
        self.estimator().integrator()
    }

    /// The integrator's name in a job.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.integrator().name
    }

    /// How the random numbers of paths relate to each other.
    #[must_use]
    pub fn sampling(&self) -> Sampling {
        self.estimator().sampling()
    }

    /// Why the settings themselves may leave a lit scene black, in a sentence without a full stop.
    #[must_use]
    pub fn why_black(&self) -> Option<&'static str> {
        self.estimator().why_black()
    }

    /// Most edges of a light path, camera to light; `None`: no limit.
    #[must_use]
    pub fn max_depth(&self) -> Option<u32> {
        self.estimator().max_depth()
    }

    /// Values of each pixel that an iteration hands on to the next ([`Integrator::statistics_per_pixel`]).
    #[must_use]
    pub fn statistics_per_pixel(&self) -> usize {
        self.integrator().statistics_per_pixel
    }

    /// Whether an iteration goes on from what the one before it left.
    #[must_use]
    pub fn is_sequential(&self) -> bool {
        self.statistics_per_pixel() > 0
    }

    /// Camera paths of each pixel in an iteration.
    #[must_use]
    pub fn samples(&self) -> u64 {
        let fields = fields_of(self);
        fields.get("samples").and_then(Value::as_u64).unwrap_or_default()
    }

    /// Checks that a window of a picture can be rendered, where one is asked for.
    ///
    /// # Errors
    /// A window and a sequential integrator.
    pub fn check_window(&self, window: Option<Window>) -> Result<(), WindowError> {
        match window.is_some() && self.is_sequential() {
            true => Err(WindowError::Sequential(self.name())),
            false => Ok(()),
        }
    }
}
