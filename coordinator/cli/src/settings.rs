//! The integrator's settings: the scene's wishes, overridden by the command line.

use anyhow::{Context, Result, anyhow};
use photonfarm_core::integrator::Integrator;
use photonfarm_core::scene::Wishes;
use photonfarm_core::settings::{IntegratorRequest, IntegratorSettings};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Iterations where neither the command line nor the scene says more.
const DEFAULT_ITERATIONS: u32 = 64;

/// The integrator where neither the command line nor the scene names one.
const DEFAULT_INTEGRATOR: &str = "pcf";

/// The integrator to render with: the one named, else the scene's own, else [`DEFAULT_INTEGRATOR`]; then `--set` on top. What is
/// not set is up to the scene ([`IntegratorRequest::resolve`]).
pub(crate) fn integrator(
    named: Option<&'static Integrator>,
    wishes: &Wishes,
    set: &BTreeMap<String, String>,
) -> Result<IntegratorSettings> {
    let own = wishes.integrator.as_ref().map(IntegratorSettings::integrator);
    let integrator = named.or(own).or_else(|| Integrator::find(DEFAULT_INTEGRATOR));
    let integrator = integrator.context("there is no default integrator")?;
    Ok(request(integrator, set)?.resolve(wishes)?)
}

/// Iterations to average: for `path` those that take the scene's samples per pixel.
pub(crate) fn default_iterations(settings: &IntegratorSettings, wishes: &Wishes) -> u32 {
    match (settings, wishes.sample_count) {
        (IntegratorSettings::Path(path), Some(samples)) => samples.div_ceil(path.samples.max(1)).max(1),
        _ => DEFAULT_ITERATIONS,
    }
}

/// What is asked for of the integrator, as its JSON would.
fn request(integrator: &Integrator, set: &BTreeMap<String, String>) -> Result<IntegratorRequest> {
    let mut given = Map::from_iter([("type".to_owned(), Value::from(integrator.name))]);
    for (name, text) in set {
        let setting = integrator.setting(name).ok_or_else(|| {
            let valid: Vec<&str> = integrator.settings.iter().map(|setting| setting.name).collect();
            anyhow!(
                "--set {name}: the integrator {} has no such setting; it has {}",
                integrator.name,
                valid.join(", ")
            )
        })?;
        let value = setting.parse(text).with_context(|| format!("--set {name}={text}"))?;
        given.insert(name.clone(), value);
    }
    Ok(serde_json::from_value(Value::Object(given))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use photonfarm_core::random::Sampling;
    use photonfarm_core::settings::{
        ConesInMedia, DirectionSampler, KernelShape, LookupVertex, PathSettings, PcfSettings, PppmSettings,
    };

    fn set(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        pairs.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect()
    }

    fn chosen(name: Option<&str>, wishes: &Wishes, pairs: &[(&str, &str)]) -> IntegratorSettings {
        integrator(name.and_then(Integrator::find), wishes, &set(pairs)).unwrap()
    }

    fn refused(name: &str, pair: (&str, &str)) -> String {
        format!(
            "{:#}",
            integrator(Integrator::find(name), &Wishes::default(), &set(&[pair])).unwrap_err()
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
        assert_eq!(chosen(Some("pppm"), &wishes, &[]), own);
        let path = IntegratorSettings::Path(PathSettings {
            max_depth: Some(9),
            ..Default::default()
        });
        assert_eq!(chosen(Some("path"), &wishes, &[]), path);
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
            ("media", "cones"),
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
            media: ConesInMedia::Cones,
            max_depth: Some(7),
        };
        assert_eq!(
            chosen(Some("pcf"), &Wishes::default(), &pairs),
            IntegratorSettings::Pcf(expected)
        );
        let wishes = Wishes {
            max_depth: Some(4),
            ..Wishes::default()
        };
        let open = chosen(Some("path"), &wishes, &[("max_depth", "-1")]);
        assert_eq!(open, IntegratorSettings::Path(PathSettings::default()));
    }

    #[test]
    fn errors_name_the_setting_and_what_is_valid() {
        let message = refused("path", ("alpha", "0.5"));
        assert!(
            message.contains("--set alpha") && message.contains("samples, sampling, max_depth"),
            "{message}"
        );
        let message = refused("pcf", ("type", "path"));
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
            ("alpha", "1.5"),
            ("photons", "0"),
            ("theta1", "-4"),
            ("alpha", "NaN"),
            ("lookup_vertex", "0"),
            ("mis_beta", "0.5"),
            ("sigma_by_length", "0.5,2"),
            ("theta_glossy", "0"),
        ] {
            let message = refused("pcf", pair);
            let (name, text) = pair;
            let said = format!("--set {name}={text}: setting `{name}` is {text}: expected");
            assert!(message.contains(&said), "{message}");
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
        assert_eq!(iterations("path", "16"), 5);
        assert_eq!(iterations("pcf", "16"), 64);
        assert_eq!(
            default_iterations(&IntegratorSettings::Path(PathSettings::default()), &Wishes::default()),
            64
        );
    }
}
