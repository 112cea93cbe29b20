//! The integrator's settings: the scene's wishes, overridden by the command line.

use crate::args::IntegratorName;
use anyhow::{Context, Result, bail};
use photonfarm_core::scene::Wishes;
use photonfarm_core::settings::{IntegratorRequest, IntegratorSettings};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Iterations where neither the command line nor the scene says more.
const DEFAULT_ITERATIONS: u32 = 64;

/// The integrator to render with: the one named, else the scene's own, else `pcf`; then `--set` on top. What is not set is
/// up to the scene ([`IntegratorRequest::resolve`]).
pub(crate) fn integrator(
    name: Option<IntegratorName>,
    wishes: &Wishes,
    set: &BTreeMap<String, String>,
) -> Result<IntegratorSettings> {
    let own = wishes.integrator.as_ref().map(IntegratorSettings::name);
    let name = name.map(name_of).or(own).unwrap_or("pcf");
    Ok(request(name, set)?.resolve(wishes)?)
}

/// Iterations to average: for `path` those that take the scene's samples per pixel.
pub(crate) fn default_iterations(settings: &IntegratorSettings, wishes: &Wishes) -> u32 {
    match (settings, wishes.sample_count) {
        (IntegratorSettings::Path(path), Some(samples)) => samples.div_ceil(path.samples.max(1)).max(1),
        _ => DEFAULT_ITERATIONS,
    }
}

fn name_of(name: IntegratorName) -> &'static str {
    match name {
        IntegratorName::Path => "path",
        IntegratorName::Pppm => "pppm",
        IntegratorName::Sppm => "sppm",
        IntegratorName::Pcf => "pcf",
    }
}

/// What is asked for of the integrator `name`, as its JSON would.
fn request(name: &str, set: &BTreeMap<String, String>) -> Result<IntegratorRequest> {
    let mut given = Map::from_iter([("type".to_owned(), Value::from(name))]);
    let defaults: IntegratorSettings = serde_json::from_value(Value::Object(given.clone()))?;
    let known = serde_json::to_value(&defaults)?;
    let Value::Object(known) = &known else {
        bail!("settings of an integrator are a JSON object")
    };
    for (setting, text) in set {
        if setting == "type" || !known.contains_key(setting) {
            let valid: Vec<&str> = known.keys().map(String::as_str).filter(|key| *key != "type").collect();
            bail!(
                "--set {setting}: the integrator {name} has no such setting; it has {}",
                valid.join(", ")
            );
        }
        given.insert(setting.clone(), value(setting, text));
        serde_json::from_value::<IntegratorRequest>(Value::Object(given.clone()))
            .with_context(|| format!("--set {setting}={text}"))?;
    }
    Ok(serde_json::from_value(Value::Object(given))?)
}

/// The JSON value of a setting: a list for a list, nothing for the absence of a limit or an automatic bandwidth.
fn value(name: &str, text: &str) -> Value {
    match (name, text) {
        ("samplers" | "sigma_by_length", _) => {
            let items = text.split(',').map(str::trim).filter(|item| !item.is_empty());
            items.map(scalar).collect()
        }
        ("max_depth", "-1" | "none") | ("sigma1", "auto") => Value::Null,
        _ => scalar(text),
    }
}

/// A number or a truth value where the text reads as one.
fn scalar(text: &str) -> Value {
    if let Ok(integer) = text.parse::<u64>() {
        return Value::from(integer);
    }
    if let Ok(truth) = text.parse::<bool>() {
        return Value::from(truth);
    }
    let number = text.parse::<f64>().ok().and_then(serde_json::Number::from_f64);
    number.map_or_else(|| Value::from(text), Value::Number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::random::Sampling;
    use photonfarm_core::settings::{
        DirectionSampler, KernelShape, LookupVertex, PathSettings, PcfSettings, PppmSettings,
    };

    fn set(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        pairs.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect()
    }

    fn chosen(name: Option<IntegratorName>, wishes: &Wishes, pairs: &[(&str, &str)]) -> IntegratorSettings {
        integrator(name, wishes, &set(pairs)).unwrap()
    }

    fn refused(name: IntegratorName, pair: (&str, &str)) -> String {
        format!(
            "{:#}",
            integrator(Some(name), &Wishes::default(), &set(&[pair])).unwrap_err()
        )
    }

    #[test]
    fn the_command_line_wins_then_the_scene_then_pcf() {
        let own = IntegratorSettings::Pppm(PppmSettings {
            photons: 5,
            max_depth: Some(9),
            ..Default::default()
        });
        let wishes = Wishes {
            integrator: Some(own.clone()),
            max_depth: Some(9),
            sample_count: None,
        };
        assert_eq!(chosen(None, &wishes, &[]), own);
        assert_eq!(chosen(Some(IntegratorName::Pppm), &wishes, &[]), own);
        let path = IntegratorSettings::Path(PathSettings {
            max_depth: Some(9),
            ..Default::default()
        });
        assert_eq!(chosen(Some(IntegratorName::Path), &wishes, &[]), path);
        let foreign = Wishes {
            integrator: None,
            max_depth: Some(3),
            sample_count: None,
        };
        let pcf = IntegratorSettings::Pcf(PcfSettings {
            max_depth: Some(3),
            ..Default::default()
        });
        assert_eq!(chosen(None, &foreign, &[]), pcf);
    }

    #[test]
    fn every_setting_can_be_set() {
        let pairs = [
            ("photons", "1000"),
            ("samples", "2"),
            ("sampling", "independent"),
            ("alpha", "0.3"),
            ("p", "2"),
            ("sigma1", "0.25"),
            ("theta1", "10.5"),
            ("lookup_vertex", "2"),
            ("samplers", "bsdf, camera, importon"),
            ("mis_beta", "1.5"),
            ("nested", "true"),
            ("kernel", "epanechnikov"),
            ("sigma_by_length", "0.5,1"),
            ("theta_glossy", "0.25"),
            ("surface_test", "true"),
            ("max_depth", "7"),
        ];
        let expected = PcfSettings {
            photons: 1000,
            samples: 2,
            sampling: Sampling::Independent,
            alpha: 0.3,
            p: 2.0,
            sigma1: Some(0.25),
            theta1: 10.5,
            lookup_vertex: LookupVertex::Fixed(2),
            samplers: vec![
                DirectionSampler::Bsdf,
                DirectionSampler::Camera,
                DirectionSampler::Importon,
            ],
            mis_beta: 1.5,
            nested: true,
            kernel: KernelShape::Epanechnikov,
            sigma_by_length: vec![0.5, 1.0],
            theta_glossy: 0.25,
            surface_test: true,
            max_depth: Some(7),
        };
        assert_eq!(
            chosen(Some(IntegratorName::Pcf), &Wishes::default(), &pairs),
            IntegratorSettings::Pcf(expected)
        );
        let wishes = Wishes {
            max_depth: Some(4),
            ..Wishes::default()
        };
        let open = chosen(Some(IntegratorName::Path), &wishes, &[("max_depth", "-1")]);
        assert_eq!(open, IntegratorSettings::Path(PathSettings::default()));
    }

    #[test]
    fn errors_name_the_setting_and_what_is_valid() {
        let message = refused(IntegratorName::Path, ("alpha", "0.5"));
        assert!(
            message.contains("--set alpha") && message.contains("max_depth, samples"),
            "{message}"
        );
        let message = refused(IntegratorName::Pcf, ("type", "path"));
        assert!(message.contains("lookup_vertex"), "{message}");
        for pair in [
            ("samples", "many"),
            ("samples", "-3"),
            ("samples", "1.5"),
            ("samplers", "bsdf,moon"),
            ("kernel", "sinc"),
            ("sampling", "halton"),
            ("nested", "1"),
            ("sigma_by_length", "1,wide"),
        ] {
            let message = refused(IntegratorName::Pcf, pair);
            assert!(message.contains(&format!("--set {}={}", pair.0, pair.1)), "{message}");
        }
        for pair in [
            ("alpha", "1.5"),
            ("photons", "0"),
            ("theta1", "-4"),
            ("alpha", "NaN"),
            ("lookup_vertex", "0"),
            ("mis_beta", "0.5"),
            ("sigma_by_length", "0.5,2"),
            ("theta_glossy", "0"),
        ] {
            let message = refused(IntegratorName::Pcf, pair);
            assert!(message.contains(pair.0), "{message}");
        }
    }

    #[test]
    fn path_takes_the_scenes_samples() {
        let wishes = Wishes {
            sample_count: Some(65),
            ..Wishes::default()
        };
        let iterations =
            |name, samples| default_iterations(&chosen(Some(name), &wishes, &[("samples", samples)]), &wishes);
        assert_eq!(iterations(IntegratorName::Path, "16"), 5);
        assert_eq!(iterations(IntegratorName::Pcf, "16"), 64);
        assert_eq!(
            default_iterations(&IntegratorSettings::Path(PathSettings::default()), &Wishes::default()),
            64
        );
    }
}
