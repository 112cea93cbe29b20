//! Integrators: ours with their settings, Mitsuba's others for their `max_depth`.

use crate::scene::description::{Description, ObjectId, Value};
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;
use crate::settings::{IntegratorSettings, PathSettings, PcfSettings, PppmSettings};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value as Json};

/// Integrators of Mitsuba of which only `max_depth` is read.
const OTHERS: [&str; 17] = [
    "direct",
    "ptracer",
    "volpath",
    "volpathmis",
    "volpath_simple",
    "bdpt",
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

/// The integrator where it is one of ours, and the longest light path.
pub(super) fn build(
    description: &Description,
    object: ObjectId,
) -> Result<(Option<IntegratorSettings>, Option<u32>), SceneError> {
    let reader = Reader::new(description, object);
    let max_depth = max_depth(&reader)?;
    let settings = match reader.object.plugin.as_str() {
        "path" => {
            path_options(&reader)?;
            Some(IntegratorSettings::Path(PathSettings {
                max_depth,
                ..PathSettings::default()
            }))
        }
        "pppm" => {
            let names = ["photons", "samples", "sampling", "alpha", "sigma1"];
            let settings: PppmSettings = settings(&reader, &names)?;
            Some(IntegratorSettings::Pppm(PppmSettings { max_depth, ..settings }))
        }
        // A plugin of Mitsuba 0.6 as well: its settings of other names are left out.
        "sppm" => {
            let names = ["photons", "samples", "sampling", "alpha", "sigma1"];
            let settings: PppmSettings = settings(&reader, &names)?;
            reader.accept_rest();
            Some(IntegratorSettings::Sppm(PppmSettings { max_depth, ..settings }))
        }
        "pcf" => {
            let names = [
                "photons",
                "samples",
                "sampling",
                "alpha",
                "p",
                "sigma1",
                "theta1",
                "lookup_vertex",
                "samplers",
                "mis_beta",
                "nested",
                "kernel",
                "sigma_by_length",
                "theta_glossy",
                "surface_test",
            ];
            let settings: PcfSettings = settings(&reader, &names)?;
            Some(IntegratorSettings::Pcf(PcfSettings { max_depth, ..settings }))
        }
        other if OTHERS.contains(&other) => {
            reader.accept_rest();
            None
        }
        _ => {
            let allowed: Vec<&str> = ["path", "pppm", "sppm", "pcf"].into_iter().chain(OTHERS).collect();
            return Err(reader.unknown_type(&allowed));
        }
    };
    if let Some(Err(error)) = settings.as_ref().map(IntegratorSettings::validate) {
        reader.fault(reader.wrong(error.name, error.to_string()))?;
    }
    if settings.is_some() && reader.boolean("hide_emitters", false)? {
        let reason = "hiding emitters is not supported; leave it out or set it to false";
        reader.fault(reader.wrong("hide_emitters", reason))?;
    }
    reader.finish()?;
    Ok((settings, max_depth))
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

/// Russian roulette starts where the renderer finds it best; the estimate has the same mean.
fn path_options(reader: &Reader) -> Result<(), SceneError> {
    reader.integer("rr_depth", 1..=i64::from(u32::MAX)).map(|_| ())
}

/// Settings of one of our integrators: the properties `names` under the rules of the job's JSON.
fn settings<S: DeserializeOwned>(reader: &Reader, names: &[&str]) -> Result<S, SceneError> {
    let mut given = Map::new();
    for name in names {
        let Some(property) = reader.property(name) else {
            continue;
        };
        let json = match (&property.value, *name) {
            (Value::Integer(value), _) => Json::from(*value),
            (Value::Float(value), _) => Json::from(*value),
            (Value::Boolean(value), _) => Json::from(*value),
            (Value::String(text), "samplers") => words(text).map(Json::from).collect(),
            (Value::String(text), "sigma_by_length") => words(text)
                .map(|word| word.parse::<f64>().map_or_else(|_| Json::from(word), Json::from))
                .collect(),
            (Value::String(text), _) => Json::from(text.as_str()),
            (other, _) => {
                reader.fault(reader.wrong(name, format!("a {} is no setting", other.type_name())))?;
                continue;
            }
        };
        let alone = Map::from_iter([((*name).to_owned(), json.clone())]);
        if let Err(error) = serde_json::from_value::<S>(Json::Object(alone)) {
            reader.fault(reader.wrong(name, error.to_string()))?;
            continue;
        }
        given.insert((*name).to_owned(), json);
    }
    serde_json::from_value(Json::Object(given)).map_err(|error| reader.wrong("type", error.to_string()))
}

fn words(list: &str) -> impl Iterator<Item = &str> {
    list.split(|c: char| c == ',' || c.is_whitespace())
        .filter(|word| !word.is_empty())
}
