//! What a job asks for: which integrator, with which settings. The same names are used in the job's JSON, on the
//! command line (`--set name=value`), in scene files and in the image's metadata.

mod reference;
mod setting;
pub(crate) mod shared;
#[cfg(test)]
mod tests;

pub use crate::integrator::IntegratorSettings;
pub use crate::integrator::types::*;
pub use reference::{Entry, reference};
pub use setting::{Instead, Kind, Range, Setting, SettingError};

use crate::integrator::{INTEGRATORS, Integrator};
use crate::scene::{Wishes, shortened};
use serde::de::{Deserialize, Deserializer, Error as _, MapAccess, Visitor};
use serde::ser::{Serialize, Serializer};
use serde_json::{Map, Number, Value};
use std::collections::BTreeSet;
use std::fmt;

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
        self.settings.validate()?;
        let own = wishes
            .integrator
            .as_ref()
            .filter(|own| own.name() == self.settings.name());
        let mut fields = fields_of(own.unwrap_or(&self.settings));
        if own.is_none() && self.open.contains(shared::MAX_DEPTH.name) {
            fields.insert(shared::MAX_DEPTH.name.to_owned(), wishes.max_depth.into());
        }
        for (name, value) in fields_of(&self.settings) {
            if !self.open.contains(&name) {
                fields.insert(name, value);
            }
        }
        self.settings.integrator().read(fields)
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

/// The settings by name, the integrator's name under `type`.
pub(crate) fn fields_of(settings: &IntegratorSettings) -> Map<String, Value> {
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
        Value::Number(number) if number.is_f64() => {
            if let Some(wide) = number.as_f64() {
                *value = short_number(wide as f32);
            }
        }
        _ => {}
    }
}

/// A number of single precision; null if it is not finite.
fn short_number(number: f32) -> Value {
    let short = number.to_string().parse().ok().and_then(Number::from_f64);
    short.map_or(Value::Null, Value::Number)
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

/// The integrator that a name stands for.
struct Named(&'static Integrator);

impl<'de> Deserialize<'de> for Named {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Integrator::find(&name).map(Self).ok_or_else(|| {
            let names = INTEGRATORS.map(|integrator| integrator.name).join(", ");
            D::Error::custom(format!(
                "there is no integrator `{}`: expected one of {names}",
                shortened(&name)
            ))
        })
    }
}

impl<'de> Visitor<'de> for RequestVisitor {
    type Value = IntegratorRequest;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an integrator's type with its settings")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<IntegratorRequest, A::Error> {
        let mut given = Map::new();
        let mut integrator = None;
        while let Some(name) = map.next_key::<String>()? {
            let value = match name.as_str() {
                "type" => {
                    let Named(named) = map.next_value()?;
                    integrator = Some(named);
                    named.name.into()
                }
                _ => map.next_value()?,
            };
            if given.insert(name.clone(), value).is_some() {
                return Err(A::Error::custom(format!("duplicate field `{name}`")));
            }
        }
        let integrator = integrator.ok_or_else(|| A::Error::missing_field("type"))?;
        // What is only out of range is left to `validate`, so that whoever asks can name the field.
        let settings = IntegratorSettings::deserialize(Value::Object(given.clone())).map_err(|error| {
            let refused = integrator
                .read(given.clone())
                .err()
                .filter(|error| integrator.setting(error.name).is_some());
            A::Error::custom(refused.map_or_else(|| error.to_string(), |refused| refused.to_string()))
        })?;
        let names = integrator.settings.iter().map(|setting| setting.name.to_owned());
        let open = names.filter(|name| !given.contains_key(name)).collect();
        Ok(IntegratorRequest { settings, open })
    }
}

/// Values of each pixel that iterations of a sequential integrator hand on.
pub const STATISTICS_PER_PIXEL: usize = 2;

impl IntegratorSettings {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), SettingError> {
        let fields = fields_of(self);
        let settings = self.integrator().settings;
        for setting in settings {
            setting.check(fields.get(setting.name).unwrap_or(&Value::Null))?;
        }
        // JSON has null for a number that is not finite, which reads as if nothing were given.
        let again = serde_json::to_value(self).and_then(serde_json::from_value::<Self>);
        let is_lost = |setting: &&Setting| matches!(setting.kind, Kind::Number(_)) && fields[setting.name].is_null();
        match settings.iter().find(is_lost) {
            Some(setting) if again.is_ok_and(|again| again != *self) => Err(setting.refuse("not finite")),
            _ => Ok(()),
        }
    }
}
