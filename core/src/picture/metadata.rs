//! What a picture says about how it was made.

use crate::film::Window;
use crate::settings::IntegratorSettings;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Everything that repeats a render: the same scene, settings, seed and iterations give the same pixels, bit for bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureMetadata {
    /// Version of Photonfarm.
    pub version: String,
    /// Name of the renderer's build, which the bits depend on; empty in pictures of older versions.
    #[serde(default)]
    pub renderer: String,
    /// Hash of the scene bundle: the scene file and every file that it names.
    pub scene_hash: String,
    /// Name of the scene file in the bundle; empty in pictures of older versions.
    #[serde(default)]
    pub main: String,
    /// Values given to the scene's `<default>`s, by name.
    pub defines: BTreeMap<String, String>,
    /// The sensor that was chosen, where one was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// Layers beside the picture.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<String>,
    /// The window of the picture that it is, where it is not all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<Window>,
    /// The integrator and its settings.
    pub integrator: IntegratorSettings,
    /// What of the scene is not rendered as it is written, each with its place.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// Seed of the job.
    pub seed: u64,
    /// Iterations averaged: 1 to this number.
    pub iterations: u64,
    /// Set in a partial picture: the iterations that were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations_asked: Option<u32>,
    /// Spatial bandwidth of the first and the last iteration [scene units]; none for `path`.
    pub sigma: Option<[f32; 2]>,
    /// Angular bandwidth of the first and the last iteration \[radians\]; `pcf` only.
    pub theta: Option<[f32; 2]>,
    /// Mean standard error over mean luminance ([`Image::noise`](crate::film::Image::noise)); none where it is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

/// A metadata value of a picture file.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Entry {
    Text(String),
    Integer(i32),
    Float(f32),
}

/// JSON in ASCII, since the strings of an OpenEXR file have no encoding.
pub(super) fn in_ascii(json: &str) -> String {
    let mut ascii = String::with_capacity(json.len());
    for c in json.chars() {
        if c.is_ascii() {
            ascii.push(c);
        } else {
            for unit in c.encode_utf16(&mut [0; 2]) {
                ascii.push_str(&format!("\\u{unit:04x}"));
            }
        }
    }
    ascii
}

impl PictureMetadata {
    /// The metadata value by value, under the names of the job's JSON. A setting that is left to its automatic value
    /// has no entry.
    pub(super) fn entries(&self) -> Result<Vec<(String, Entry)>, serde_json::Error> {
        let mut entries = vec![
            ("renderer".to_owned(), Entry::Text(self.renderer.clone())),
            ("scene_hash".to_owned(), Entry::Text(self.scene_hash.clone())),
            ("scene_file".to_owned(), Entry::Text(self.main.clone())),
            ("seed".to_owned(), integer(self.seed)),
            ("iterations".to_owned(), integer(self.iterations)),
        ];
        let asked = self.iterations_asked.map(u64::from).map(integer);
        entries.extend(asked.map(|asked| ("iterations_asked".to_owned(), asked)));
        entries.extend(self.noise.map(|noise| ("noise".to_owned(), Entry::Float(noise as f32))));
        entries.extend(self.crop.map(|crop| ("crop".to_owned(), Entry::Text(crop.to_string()))));
        if !self.warnings.is_empty() {
            entries.push(("warnings".to_owned(), Entry::Text(self.warnings.join("\n"))));
        }
        for (name, range) in [("sigma", self.sigma), ("theta", self.theta)] {
            if let Some([first, last]) = range {
                entries.push((format!("{name}_first"), Entry::Float(first)));
                entries.push((format!("{name}_last"), Entry::Float(last)));
            }
        }
        if let Value::Object(settings) = serde_json::to_value(&self.integrator)? {
            for (name, value) in settings {
                let name = if name == "type" { "integrator".to_owned() } else { name };
                entries.extend(setting(&value).map(|entry| (name, entry)));
            }
        }
        Ok(entries)
    }
}

fn integer(value: u64) -> Entry {
    i32::try_from(value).map_or_else(|_| Entry::Text(value.to_string()), Entry::Integer)
}

fn setting(value: &Value) -> Option<Entry> {
    match value {
        Value::Null => None,
        Value::String(text) => Some(Entry::Text(text.clone())),
        Value::Number(number) => Some(match number.as_u64() {
            Some(number) => integer(number),
            None => Entry::Float(number.as_f64().unwrap_or(f64::NAN) as f32),
        }),
        Value::Array(items) => {
            let text = |item: &Value| item.as_str().map_or_else(|| item.to_string(), str::to_owned);
            let items: Vec<String> = items.iter().map(text).collect();
            Some(Entry::Text(items.join(",")))
        }
        other => Some(Entry::Text(other.to_string())),
    }
}
