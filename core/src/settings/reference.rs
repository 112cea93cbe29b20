//! All settings of all integrators, for help and documentation.

use super::{Setting, fields_of};
use crate::integrator::INTEGRATORS;
use serde_json::Value;

/// A setting, and which integrators have it.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The setting.
    pub setting: Setting,
    /// Names of the integrators that have it, with the text of its default there.
    pub defaults: Vec<(&'static str, String)>,
}

impl Entry {
    /// Names of the integrators, separated by commas.
    #[must_use]
    pub fn integrators(&self) -> String {
        let names: Vec<&str> = self.defaults.iter().map(|(name, _)| *name).collect();
        names.join(", ")
    }

    /// The default, or each one with the integrators whose default it is: `4 (path, pcf), 1 (pppm, sppm)`.
    #[must_use]
    pub fn default(&self) -> String {
        let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
        for (integrator, text) in &self.defaults {
            match groups.iter_mut().find(|(other, _)| other == text) {
                Some((_, integrators)) => integrators.push(integrator),
                None => groups.push((text, vec![integrator])),
            }
        }
        match groups.as_slice() {
            [(text, _)] => (*text).to_owned(),
            groups => {
                let texts = groups
                    .iter()
                    .map(|(text, names)| format!("{text} ({})", names.join(", ")));
                texts.collect::<Vec<_>>().join(", ")
            }
        }
    }
}

/// Every setting once, in the order in which integrators name them.
#[must_use]
pub fn reference() -> Vec<Entry> {
    let mut entries: Vec<Entry> = Vec::new();
    for integrator in INTEGRATORS {
        let defaults = fields_of(&integrator.defaults());
        for setting in integrator.settings {
            let text = setting.text(defaults.get(setting.name).unwrap_or(&Value::Null));
            let default = match text.as_str() {
                "" => "empty".to_owned(),
                _ => text,
            };
            match entries.iter_mut().find(|entry| entry.setting == *setting) {
                Some(entry) => entry.defaults.push((integrator.name, default)),
                None => entries.push(Entry {
                    setting: *setting,
                    defaults: vec![(integrator.name, default)],
                }),
            }
        }
    }
    entries
}
