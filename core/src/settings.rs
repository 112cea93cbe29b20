//! What a job asks for: which integrator, with which settings. The same names are used in the job's JSON, on the
//! command line (`--set name=value`) and in the image's metadata.

use crate::random::Sampling;
use crate::scene::Wishes;
use serde::de::{Deserializer, Error as _, MapAccess, Visitor};
use serde::ser::Serializer;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Number, Value};
use std::collections::BTreeSet;
use std::fmt;
use thiserror::Error;

/// An integrator with its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum IntegratorSettings {
    /// Path tracing with next-event estimation.
    Path(PathSettings),
    /// Probabilistic progressive photon mapping (Knaus and Zwicker 2011).
    Pppm(PppmSettings),
    /// Stochastic progressive photon mapping (Hachisuka and Jensen 2009): sequential.
    Sppm(PppmSettings),
    /// Photon cone focusing (Chang 2019).
    Pcf(PcfSettings),
}

/// An integrator as it is asked for: some settings are given, and the others are *open*. The scene decides over those
/// ([`IntegratorRequest::resolve`]). In JSON, what is left out is open.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegratorRequest {
    /// With defaults in the place of what is open.
    settings: IntegratorSettings,
    open: BTreeSet<String>,
}

impl IntegratorRequest {
    /// The settings, with defaults in the place of those that are open.
    #[must_use]
    pub fn with_defaults(&self) -> &IntegratorSettings {
        &self.settings
    }

    /// The settings, if all of them are given.
    #[must_use]
    pub fn complete(&self) -> Option<&IntegratorSettings> {
        self.open.is_empty().then_some(&self.settings)
    }

    /// All settings, as the scene decides over those that are open: they are those of the scene's own `<integrator>` if it is of the
    /// same type, else the defaults with the scene's `max_depth`.
    ///
    /// This is the one place where this is decided, for the command line and for jobs that come over the network.
    ///
    /// # Errors
    /// A setting that no image can be made with.
    pub fn resolve(&self, wishes: &Wishes) -> Result<IntegratorSettings, SettingError> {
        let own = wishes
            .integrator
            .as_ref()
            .filter(|own| own.name() == self.settings.name());
        let mut fields = fields_of(own.unwrap_or(&self.settings));
        if own.is_none() && self.open.contains(MAX_DEPTH) {
            fields.insert(MAX_DEPTH.to_owned(), wishes.max_depth.into());
        }
        for (name, value) in fields_of(&self.settings) {
            if !self.open.contains(&name) {
                fields.insert(name, value);
            }
        }
        let settings: IntegratorSettings =
            serde_json::from_value(Value::Object(fields)).map_err(|error| SettingError {
                name: "integrator",
                value: error.to_string(),
                expected: "settings of one integrator",
            })?;
        settings.validate()?;
        Ok(settings)
    }

    /// Whether settings are these, but for what is open.
    #[must_use]
    pub fn allows(&self, settings: &IntegratorSettings) -> bool {
        let given = fields_of(&self.settings);
        let mut given = given.into_iter().filter(|(name, _)| !self.open.contains(name));
        let fields = fields_of(settings);
        given.all(|(name, value)| fields.get(&name) == Some(&value))
    }
}

const MAX_DEPTH: &str = "max_depth";

/// The settings by name, the integrator's name under `type`.
fn fields_of(settings: &IntegratorSettings) -> Map<String, Value> {
    let Ok(Value::Object(mut fields)) = serde_json::to_value(settings) else {
        return Map::new();
    };
    fields.values_mut().for_each(shorten);
    fields
}

/// Numbers of single precision with as few digits as tell them apart: 0.2, not 0.20000000298023224.
fn shorten(value: &mut Value) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(shorten),
        Value::Number(number) => {
            let wide = number.as_f64().filter(|_| number.is_f64());
            let short = wide.and_then(|wide| (wide as f32).to_string().parse().ok());
            if let Some(short) = short.and_then(Number::from_f64) {
                *number = short;
            }
        }
        _ => {}
    }
}

impl From<IntegratorSettings> for IntegratorRequest {
    fn from(settings: IntegratorSettings) -> Self {
        let open = BTreeSet::new();
        Self { settings, open }
    }
}

impl Serialize for IntegratorRequest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = fields_of(&self.settings);
        fields.retain(|name, _| !self.open.contains(name));
        fields.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for IntegratorRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RequestVisitor)
    }
}

/// Notes which settings are given. The type is read on its own, so that an error says that it is the type that is wrong.
struct RequestVisitor;

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum IntegratorType {
    Path,
    Pppm,
    Sppm,
    Pcf,
}

impl<'de> Visitor<'de> for RequestVisitor {
    type Value = IntegratorRequest;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an integrator's type with its settings")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<IntegratorRequest, A::Error> {
        let mut given = Map::new();
        while let Some(name) = map.next_key::<String>()? {
            let value = match name.as_str() {
                "type" => serde_json::to_value(map.next_value::<IntegratorType>()?).map_err(A::Error::custom)?,
                _ => map.next_value()?,
            };
            if given.insert(name.clone(), value).is_some() {
                return Err(A::Error::custom(format!("duplicate field `{name}`")));
            }
        }
        let given = Value::Object(given);
        let settings = IntegratorSettings::deserialize(&given).map_err(A::Error::custom)?;
        let names = fields_of(&settings).into_iter().map(|(name, _)| name);
        let open = names.filter(|name| given.get(name).is_none()).collect();
        Ok(IntegratorRequest { settings, open })
    }
}

/// A setting that no image can be made with.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("setting `{name}` is {value}: expected {expected}")]
pub struct SettingError {
    /// The setting, by its name in a job.
    pub name: &'static str,
    /// What was asked for.
    pub value: String,
    /// What is allowed.
    pub expected: &'static str,
}

/// Most light paths of an iteration: at half a dozen records each, their map takes about 4 GB.
pub const MAX_PHOTONS: u32 = 10_000_000;

/// Most camera samples per pixel of an iteration.
pub const MAX_SAMPLES: u32 = 65_536;

/// Least first angular bandwidth [degrees]; kernels are never narrower than [`LEAST_ANGLE`], 0.06 degrees.
///
/// [`LEAST_ANGLE`]: crate::map::LEAST_ANGLE
const LEAST_THETA1: f32 = 0.1;

/// Values of each pixel that iterations of a sequential integrator hand on.
pub const STATISTICS_PER_PIXEL: usize = 2;

impl IntegratorSettings {
    /// The integrator's name in a job.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Path(_) => "path",
            Self::Pppm(_) => "pppm",
            Self::Sppm(_) => "sppm",
            Self::Pcf(_) => "pcf",
        }
    }

    /// How the random numbers of paths relate to each other.
    #[must_use]
    pub fn sampling(&self) -> Sampling {
        match self {
            Self::Path(s) => s.sampling,
            Self::Pppm(s) | Self::Sppm(s) => s.sampling,
            Self::Pcf(s) => s.sampling,
        }
    }

    /// Values of each pixel that an iteration hands on to the next ([`Iteration::statistics`]). 0: iterations need
    /// nothing of each other. Otherwise the integrator is *sequential*: its iterations are rendered one after the other.
    ///
    /// [`Iteration::statistics`]: crate::integrator::Iteration::statistics
    #[must_use]
    pub fn statistics_per_pixel(&self) -> usize {
        match self {
            Self::Path(_) | Self::Pppm(_) | Self::Pcf(_) => 0,
            Self::Sppm(_) => STATISTICS_PER_PIXEL,
        }
    }

    /// Whether an iteration goes on from what the one before it left.
    #[must_use]
    pub fn is_sequential(&self) -> bool {
        self.statistics_per_pixel() > 0
    }

    /// Checks every value against its range.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        match self {
            Self::Path(s) => check_common(s.samples, s.max_depth),
            Self::Pppm(s) | Self::Sppm(s) => {
                check_common(s.samples, s.max_depth)?;
                check_photons(s.photons, s.alpha, s.sigma1)
            }
            Self::Pcf(s) => {
                check_common(s.samples, s.max_depth)?;
                check_photons(s.photons, s.alpha, s.sigma1)?;
                check("p", s.p, (1.0..=16.0).contains(&s.p), "a number from 1 to 16")?;
                check(
                    "theta1",
                    s.theta1,
                    (LEAST_THETA1..=180.0).contains(&s.theta1),
                    "degrees from 0.1 to 180",
                )?;
                let distinct = s
                    .samplers
                    .iter()
                    .enumerate()
                    .all(|(i, sampler)| !s.samplers[..i].contains(sampler));
                let names = format!("{:?}", s.samplers);
                check(
                    "samplers",
                    names,
                    !s.samplers.is_empty() && distinct,
                    "one or more of bsdf, camera, importon, each once",
                )?;
                check(
                    "mis_beta",
                    s.mis_beta,
                    (1.0..=16.0).contains(&s.mis_beta),
                    "a number from 1 to 16",
                )?;
                let shares = format!("{:?}", s.sigma_by_length);
                let valid = s.sigma_by_length.len() <= 64 && s.sigma_by_length.iter().all(|&share| is_share(share));
                check("sigma_by_length", shares, valid, "up to 64 numbers above 0, up to 1")?;
                check(
                    "theta_glossy",
                    s.theta_glossy,
                    is_share(s.theta_glossy),
                    "a number above 0, up to 1",
                )
            }
        }
    }
}

fn is_share(value: f32) -> bool {
    value > 0.0 && value <= 1.0
}

fn check_common(samples: u32, max_depth: Option<u32>) -> Result<(), SettingError> {
    check("samples", samples, (1..=MAX_SAMPLES).contains(&samples), "1 to 65536")?;
    check(
        "max_depth",
        format!("{max_depth:?}"),
        max_depth != Some(0),
        "at least one edge, or none for no limit",
    )
}

fn check_photons(photons: u32, alpha: f32, sigma1: Option<f32>) -> Result<(), SettingError> {
    check(
        "photons",
        photons,
        (1..=MAX_PHOTONS).contains(&photons),
        "1 to 10 million",
    )?;
    check(
        "alpha",
        alpha,
        alpha > 0.0 && alpha < 1.0,
        "a number between 0 and 1, both excluded",
    )?;
    let sigma1 = sigma1.unwrap_or(1.0);
    check(
        "sigma1",
        sigma1,
        sigma1 > 0.0 && sigma1.is_finite(),
        "a positive length in scene units",
    )
}

fn check(name: &'static str, value: impl ToString, valid: bool, expected: &'static str) -> Result<(), SettingError> {
    if valid {
        Ok(())
    } else {
        Err(SettingError {
            name,
            value: value.to_string(),
            expected,
        })
    }
}

/// Settings of `path`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PathSettings {
    /// Camera samples per pixel and iteration.
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self {
            samples: 4,
            sampling: Sampling::Sobol,
            max_depth: None,
        }
    }
}

/// Settings of `pppm` and of `sppm`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PppmSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Share of the photons that the shrinking radius keeps, in (0, 1).
    pub alpha: f32,
    /// First radius [scene units], of `sppm` that of every pixel; `None`: from the scene and the pixel footprint.
    pub sigma1: Option<f32>,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PppmSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 1,
            sampling: Sampling::Sobol,
            alpha: 2.0 / 3.0,
            sigma1: None,
            max_depth: None,
        }
    }
}

/// Settings of `pcf`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PcfSettings {
    /// Light paths per iteration (M).
    pub photons: u32,
    /// Camera samples per pixel and iteration (S).
    pub samples: u32,
    /// How the random numbers of paths relate to each other.
    pub sampling: Sampling,
    /// Share of the cones that the shrinking bandwidth keeps, in (0, 1).
    pub alpha: f32,
    /// Order of the angular bandwidth t(sigma) = theta1 (sigma / sigma1)^p, at least 1.
    pub p: f32,
    /// First spatial bandwidth [scene units]; `None`: from the scene and the pixel footprint.
    pub sigma1: Option<f32>,
    /// First angular bandwidth [degrees].
    pub theta1: f32,
    /// Camera vertex at which the cone map is read.
    pub lookup_vertex: LookupVertex,
    /// Techniques that choose a cone's direction, combined by the power heuristic. Cones of delta materials are sampled from
    /// the material whatever this says: nothing else can.
    pub samplers: Vec<DirectionSampler>,
    /// Exponent of the power heuristic (thesis, equation 4.4).
    pub mis_beta: f32,
    /// Whether light that paths carry to a vertex before the lookup vertex is estimated by cones too, in place of next-event
    /// estimation and of emission found by scattering (thesis, section 3.6): no light, sensor or material is singular then.
    pub nested: bool,
    /// How a cone's weight falls with its distance from the query.
    pub kernel: KernelShape,
    /// Share of the spatial bandwidth within which cones of light paths with 1, 2, ... edges count, the last share for all
    /// longer ones (thesis, section 4.4: an initial bandwidth for each path length). Empty: the whole.
    pub sigma_by_length: Vec<f32>,
    /// Share of the angular bandwidth on delta and glossy surfaces (thesis, section 4.4).
    pub theta_glossy: f32,
    /// Whether a cone must lie in the query's tangent plane and on its side of the surface, about, to count, and the kernel is
    /// clipped to that surface.
    pub surface_test: bool,
    /// Most edges of a light path, camera to light; `None`: no limit.
    pub max_depth: Option<u32>,
}

impl Default for PcfSettings {
    fn default() -> Self {
        Self {
            photons: 200_000,
            samples: 4,
            sampling: Sampling::Sobol,
            alpha: 0.2,
            p: 1.0,
            sigma1: None,
            theta1: 18.0,
            lookup_vertex: LookupVertex::Auto,
            samplers: vec![DirectionSampler::Bsdf, DirectionSampler::Camera],
            mis_beta: 2.0,
            nested: false,
            kernel: KernelShape::Box,
            sigma_by_length: Vec::new(),
            theta_glossy: 1.0,
            surface_test: false,
            max_depth: None,
        }
    }
}

/// Camera vertex at which the cone map is read: a number of 1 or more, or `"auto"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "serde_json::Value", into = "serde_json::Value")]
pub enum LookupVertex {
    /// Always the k-th vertex.
    Fixed(u32),
    /// The first vertex whose material is rough enough for a density estimate.
    Auto,
}

/// A technique that chooses a cone's direction (thesis, section 4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DirectionSampler {
    /// Sample the material.
    Bsdf,
    /// Sample a lobe about the direction to the camera.
    Camera,
    /// Sample the directions in which camera paths near by need radiance.
    Importon,
}

/// A kernel's shape, in position and direction alike (thesis, sections 3.1 and 3.7.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KernelShape {
    /// Constant.
    Box,
    /// Falling with the square of the distance to zero at the rim.
    Epanechnikov,
}

impl TryFrom<serde_json::Value> for LookupVertex {
    type Error = String;

    fn try_from(value: serde_json::Value) -> Result<Self, String> {
        let number = value.as_u64().or_else(|| value.as_str()?.parse().ok());
        match (number, value.as_str()) {
            (Some(k @ 1..=64), _) => Ok(Self::Fixed(k as u32)),
            (_, Some("auto")) => Ok(Self::Auto),
            _ => Err(format!(
                "lookup_vertex is {value}: expected a camera vertex from 1 to 64, or \"auto\""
            )),
        }
    }
}

impl From<LookupVertex> for serde_json::Value {
    fn from(vertex: LookupVertex) -> Self {
        match vertex {
            LookupVertex::Fixed(k) => k.into(),
            LookupVertex::Auto => "auto".into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn request(json: Value) -> IntegratorRequest {
        serde_json::from_value(json).unwrap()
    }

    fn wishes(integrator: Option<IntegratorSettings>) -> Wishes {
        Wishes {
            integrator,
            max_depth: Some(5),
            sample_count: None,
        }
    }

    #[test]
    fn what_is_left_out_is_up_to_the_scene() {
        let own = IntegratorSettings::Pppm(PppmSettings {
            alpha: 0.3,
            samples: 7,
            max_depth: Some(5),
            ..PppmSettings::default()
        });
        let asked = request(json!({"type": "pppm", "samples": 2}));
        let IntegratorSettings::Pppm(found) = asked.resolve(&wishes(Some(own.clone()))).unwrap() else {
            panic!("another integrator")
        };
        assert_eq!((found.alpha, found.samples, found.max_depth), (0.3, 2, Some(5)));
        let IntegratorSettings::Pppm(found) = asked.resolve(&wishes(None)).unwrap() else {
            panic!("another integrator")
        };
        let default = PppmSettings::default();
        assert_eq!(
            (found.alpha, found.samples, found.max_depth),
            (default.alpha, 2, Some(5))
        );
        let path = request(json!({"type": "path"})).resolve(&wishes(Some(own))).unwrap();
        assert!(matches!(path, IntegratorSettings::Path(path) if path.max_depth == Some(5)));
    }

    #[test]
    fn what_is_given_stays() {
        let given = request(json!({"type": "path", "samples": 3, "sampling": "independent", "max_depth": null}));
        let settings = given.complete().unwrap();
        assert_eq!(
            given.resolve(&wishes(None)).unwrap(),
            *settings,
            "no limit is a limit that is given"
        );
        assert_eq!(IntegratorRequest::from(settings.clone()), given);
        let text = serde_json::to_string(&request(json!({"type": "pcf", "alpha": 0.2, "theta1": 1e-3}))).unwrap();
        assert_eq!(text, r#"{"alpha":0.2,"theta1":0.001,"type":"pcf"}"#);
        assert!(given.resolve(&Wishes::default()).is_ok());
        let bad = request(json!({"type": "path", "samples": 0}));
        assert_eq!(bad.resolve(&wishes(None)).unwrap_err().name, "samples");
    }

    #[test]
    fn a_request_survives_its_json_and_says_what_it_allows() {
        let text = json!({"type": "pcf", "alpha": 0.25, "samplers": ["camera"]});
        let asked = request(text.clone());
        assert_eq!(serde_json::to_value(&asked).unwrap(), text);
        assert_eq!(asked.complete(), None);
        let resolved = asked.resolve(&wishes(None)).unwrap();
        assert!(asked.allows(&resolved) && !asked.allows(&IntegratorSettings::Pcf(PcfSettings::default())));
        assert!(!asked.allows(&IntegratorSettings::Path(PathSettings::default())));
        for (bad, said) in [
            (r#"{"type": "pcf", "photon": 1}"#, "photon"),
            (r#"{"type": "pcf", "alpha": 0.1, "alpha": 0.2}"#, "duplicate"),
            (r#"{"type": "bdpt"}"#, "bdpt"),
            (r#"{"alpha": 0.1}"#, "type"),
            (r#"["pcf"]"#, "sequence"),
        ] {
            let error = serde_json::from_str::<IntegratorRequest>(bad).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
