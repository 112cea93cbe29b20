//! Integrators: ours with their settings, Mitsuba's others for their `max_depth`.

use crate::integrator::{INTEGRATORS, Ignored, Integrator};
use crate::scene::description::{Description, Kind, ObjectId, Value};
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;
use crate::settings::shared::MAX_DEPTH;
use crate::settings::{IntegratorSettings, Setting, SettingError};
use serde_json::{Map, Value as Json};

/// Integrators of Mitsuba of which only `max_depth` is read.
const OTHERS: [&str; 16] = [
    "direct",
    "ptracer",
    "volpath",
    "volpathmis",
    "volpath_simple",
    "ppm",
    "photonmapper",
    "pssmlt",
    "mlt",
    "erpt",
    "vpl",
    "irrcache",
    "aov",
    "moment",
    "stokes",
    "prb",
];

/// What a scene says of how it is rendered.
pub(super) struct Wanted {
    /// The integrator where it is one of ours.
    pub(super) settings: Option<IntegratorSettings>,
    /// The longest light path.
    pub(super) max_depth: Option<u32>,
    /// Whether the camera does not see lights.
    pub(super) hide_emitters: bool,
}

/// What an integrator says.
pub(super) fn build(description: &Description, object: ObjectId) -> Result<Wanted, SceneError> {
    let rendering = innermost(description, object);
    if rendering != object {
        Reader::new(description, object).remark("the integrator within it makes the picture");
    }
    let reader = Reader::new(description, rendering);
    let hide_emitters = reader.boolean("hide_emitters", false)?;
    let max_depth = max_depth(&reader)?;
    let plugin = reader.object.plugin.as_str();
    let settings = match Integrator::find(plugin) {
        Some(integrator) => Some(settings(&reader, integrator, max_depth)?),
        None => {
            if !OTHERS.contains(&plugin) {
                let ours = INTEGRATORS.map(|integrator| integrator.name).join(", ");
                reader.warn(
                    reader.place(),
                    format_args!("there is no integrator of this type; who renders chooses one: {ours}"),
                );
            } else {
                reader.remark("of this integrator only `max_depth` is read");
            }
            reader.accept_rest();
            None
        }
    };
    reader.ignore(&["strict_normals"]);
    reader.finish();
    Ok(Wanted {
        settings,
        max_depth,
        hide_emitters,
    })
}

/// The integrator that makes the picture: some write further layers or statistics, and have a nested one render.
fn innermost(description: &Description, object: ObjectId) -> ObjectId {
    /// More than anybody nests; references may form a circle.
    const MOST: usize = 8;
    (0..MOST).fold(object, |outer, _| {
        let nested = Reader::new(description, outer).children(Kind::Integrator);
        nested.first().map_or(outer, |child| child.target)
    })
}

/// `max_depth`; -1 stands for no limit.
fn max_depth(reader: &Reader) -> Result<Option<u32>, SceneError> {
    match reader.integer("max_depth", -1..=i64::from(u32::MAX))? {
        Some(0) => {
            let reason = "0 is out of range; allowed: -1 for no limit, or 1 and above";
            reader.fault(reader.wrong("max_depth", reason)).map(|()| None)
        }
        Some(depth) => Ok(u32::try_from(depth).ok()),
        None => Ok(None),
    }
}

/// Settings of one of our integrators: its properties under the rules of the job's JSON.
fn settings(
    reader: &Reader,
    integrator: &Integrator,
    max_depth: Option<u32>,
) -> Result<IntegratorSettings, SceneError> {
    let mut given = Map::from_iter([(MAX_DEPTH.name.to_owned(), max_depth.into())]);
    for setting in integrator
        .settings
        .iter()
        .filter(|setting| setting.name != MAX_DEPTH.name)
    {
        let Some(property) = reader.property(setting.name) else {
            continue;
        };
        match value(setting, &property.value) {
            Ok(value) => _ = given.insert(setting.name.to_owned(), value),
            Err(error) => reader.fault(reader.wrong(setting.name, error.to_string()))?,
        }
    }
    match integrator.ignored {
        Ignored::All => reader.accept_rest(),
        Ignored::Integers(names) => {
            for name in names {
                reader.integer(name, 1..=i64::from(u32::MAX))?;
            }
        }
    }
    integrator
        .read(given)
        .map_err(|error| reader.wrong(error.name, error.to_string()))
}

/// The JSON value of a setting; a string is what would be typed on the command line.
fn value(setting: &Setting, written: &Value) -> Result<Json, SettingError> {
    let value = match written {
        Value::Integer(value) => Json::from(*value),
        Value::Float(value) => Json::from(*value),
        Value::Boolean(value) => Json::from(*value),
        Value::String(text) => return setting.parse(text),
        other => return Err(setting.refuse(&format!("a {}", other.type_name()))),
    };
    setting.check(&value).map(|()| value)
}
