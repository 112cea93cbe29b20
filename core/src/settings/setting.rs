//! What a setting is. Its description is written once: ranges are checked by it, texts are read by it, and errors, help,
//! documentation and the JSON schema say what it says.

use crate::scene::shortened;
use serde_json::{Value, json};
use std::ops::{Bound, RangeBounds};
use thiserror::Error;

/// A setting of an integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Its name in a job's JSON, on the command line, in scene files and in the image's metadata.
    pub name: &'static str,
    /// Which values it has.
    pub kind: Kind,
    /// What may stand in the place of such a value.
    pub instead: Option<Instead>,
    /// Unit of the value; empty where it has none.
    pub unit: &'static str,
    /// What it means, in a phrase without a full stop.
    pub help: &'static str,
}

/// Numbers between two ends. Where there is no upper end, every finite number of single precision is meant.
pub type Range = (Bound<f32>, Bound<f32>);

/// Values that a setting can have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Whole numbers; both ends are included. [`u32::MAX`] as the upper end stands for no limit.
    Integer {
        /// The least.
        least: u32,
        /// The largest.
        most: u32,
    },
    /// Numbers of single precision.
    Number(Range),
    /// True or false.
    Truth,
    /// One of some words.
    Choice(&'static [&'static str]),
    /// A list of one or more of some words, each once.
    Choices {
        /// The words.
        words: &'static [&'static str],
        /// Words of which the list must have one; none where this is empty.
        needed: &'static [&'static str],
    },
    /// A list of numbers, which may be empty.
    Numbers {
        /// What each may be.
        range: Range,
        /// The largest length of the list.
        most: usize,
    },
}

/// What stands in the place of a setting's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Instead {
    /// `null` in JSON; each of these words, of which there is one at least, elsewhere.
    Null(&'static [&'static str]),
    /// This word, in JSON as well.
    Word(&'static str),
}

/// A setting that no image can be made with.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("setting `{name}` is {value}: expected {expected}")]
pub struct SettingError {
    /// The setting, by its name in a job.
    pub name: &'static str,
    /// What was asked for; the beginning of what is long.
    pub value: String,
    /// What is allowed.
    pub expected: String,
}

impl Setting {
    /// Checks a value as JSON has it.
    ///
    /// # Errors
    /// A value of another kind, or one that is out of range.
    pub fn check(&self, value: &Value) -> Result<(), SettingError> {
        let valid = match (self.instead, value) {
            (Some(Instead::Null(_)), Value::Null) => true,
            (Some(Instead::Word(word)), Value::String(text)) if text == word => true,
            _ => self.kind.allows(value),
        };
        match valid {
            true => Ok(()),
            false => Err(self.refuse(&value.to_string())),
        }
    }

    /// The JSON value that a text means, on the command line or in a scene file. Lists are separated by commas or spaces.
    ///
    /// # Errors
    /// A text that is no value of the setting.
    pub fn parse(&self, text: &str) -> Result<Value, SettingError> {
        let value = match self.instead {
            Some(Instead::Null(words)) if words.contains(&text) => Value::Null,
            _ => self.kind.parse(text),
        };
        self.check(&value).map_err(|_| self.refuse(text))?;
        Ok(value)
    }

    /// A value as a text that [`Setting::parse`] reads; an empty list is an empty text.
    pub(super) fn text(&self, value: &Value) -> String {
        match (self.instead, value) {
            (Some(Instead::Null(words)), Value::Null) => words[0].to_owned(),
            (_, Value::Array(items)) => items.iter().map(|item| self.text(item)).collect::<Vec<_>>().join(","),
            (_, Value::String(text)) => text.clone(),
            (_, Value::Number(number)) if number.is_f64() => number.as_f64().unwrap_or(f64::NAN).to_string(),
            (_, value) => value.to_string(),
        }
    }

    /// The error for a value that is none of the setting.
    pub(crate) fn refuse(&self, value: &str) -> SettingError {
        SettingError {
            name: self.name,
            value: shortened(value),
            expected: self.expected(),
        }
    }

    /// The values in words: ``a number above 0 [scene units], or `auto` (null in JSON)``.
    #[must_use]
    pub fn expected(&self) -> String {
        let mut text = self.kind.expected();
        if !self.unit.is_empty() {
            text += &format!(" [{}]", self.unit);
        }
        match self.instead {
            Some(Instead::Null(words)) => text + &format!(", or `{}` (null in JSON)", words[0]),
            Some(Instead::Word(word)) => text + &format!(", or `{word}`"),
            None => text,
        }
    }

    /// The JSON schema of the setting.
    pub(crate) fn schema(&self) -> Value {
        let mut schema = self.kind.schema();
        match self.instead {
            Some(Instead::Null(_)) => schema["type"] = json!([schema["type"], "null"]),
            Some(Instead::Word(word)) => schema = json!({"oneOf": [schema, {"type": "string", "enum": [word]}]}),
            None => {}
        }
        schema["description"] = match self.unit {
            "" => format!("{}.", self.help).into(),
            unit => format!("{} [{unit}].", self.help).into(),
        };
        schema
    }
}

impl Kind {
    fn allows(&self, value: &Value) -> bool {
        match (self, value) {
            (Self::Integer { least, most }, value) => value
                .as_u64()
                .is_some_and(|number| (u64::from(*least)..=u64::from(*most)).contains(&number)),
            (Self::Number(range), value) => is_within(range, value),
            (Self::Truth, value) => value.is_boolean(),
            (Self::Choice(words), value) => is_one_of(words, value),
            (Self::Choices { words, needed }, Value::Array(items)) => {
                let distinct = items.iter().enumerate().all(|(i, item)| !items[..i].contains(item));
                let enough = needed.is_empty() || items.iter().any(|item| is_one_of(needed, item));
                !items.is_empty() && distinct && enough && items.iter().all(|item| is_one_of(words, item))
            }
            (Self::Numbers { range, most }, Value::Array(items)) => {
                items.len() <= *most && items.iter().all(|item| is_within(range, item))
            }
            (Self::Choices { .. } | Self::Numbers { .. }, _) => false,
        }
    }

    /// What a text says; it stays a text where it does not say such a value.
    fn parse(&self, text: &str) -> Value {
        let number = |text: &str| text.parse::<f64>().map_or_else(|_| Value::from(text), Value::from);
        let items = || {
            text.split(|c: char| c == ',' || c.is_whitespace())
                .filter(|item| !item.is_empty())
        };
        match self {
            Self::Integer { .. } => text.parse::<u64>().map_or_else(|_| Value::from(text), Value::from),
            Self::Number(_) => number(text),
            Self::Truth => text.parse::<bool>().map_or_else(|_| Value::from(text), Value::from),
            Self::Choice(_) => Value::from(text),
            Self::Choices { .. } => items().map(Value::from).collect(),
            Self::Numbers { .. } => items().map(number).collect(),
        }
    }

    fn expected(&self) -> String {
        match self {
            Self::Integer { least, most: u32::MAX } => format!("a whole number from {least} on"),
            Self::Integer { least, most } => format!("a whole number from {least} to {most}"),
            Self::Number(range) => format!("a number {}", between(range)),
            Self::Truth => "true or false".to_owned(),
            Self::Choice(words) => words.join(" or "),
            Self::Choices { words, needed } => {
                let among = match needed {
                    [] => String::new(),
                    _ => format!(", with {} among them", needed.join(" or ")),
                };
                format!("a list of one or more of {}, each once{among}", words.join(", "))
            }
            Self::Numbers { range, most } => format!("a list of up to {most} numbers {}", between(range)),
        }
    }

    fn schema(&self) -> Value {
        match self {
            Self::Integer { least, most: u32::MAX } => json!({"type": "integer", "minimum": least}),
            Self::Integer { least, most } => json!({"type": "integer", "minimum": least, "maximum": most}),
            Self::Number(range) => number_schema(range),
            Self::Truth => json!({"type": "boolean"}),
            Self::Choice(words) => json!({"type": "string", "enum": words}),
            Self::Choices { words, .. } => json!({"type": "array", "items": {"type": "string", "enum": words},
                "minItems": 1, "uniqueItems": true}),
            Self::Numbers { range, most } => json!({"type": "array", "items": number_schema(range), "maxItems": most}),
        }
    }
}

/// Whether a number lies within the range at single precision, as which it is kept.
fn is_within(range: &Range, value: &Value) -> bool {
    let number = value.as_f64().map(|number| number as f32);
    number.is_some_and(|number| number.is_finite() && range.contains(&number))
}

fn is_one_of(words: &[&str], value: &Value) -> bool {
    value.as_str().is_some_and(|text| words.contains(&text))
}

fn between(range: &Range) -> String {
    let least = match range.0 {
        Bound::Included(least) => format!("from {least}"),
        Bound::Excluded(least) => format!("above {least}"),
        Bound::Unbounded => String::new(),
    };
    match (range, least.as_str()) {
        ((Bound::Excluded(least), Bound::Excluded(most)), _) => {
            format!("between {least} and {most}, both excluded")
        }
        ((Bound::Included(_), Bound::Included(most)), from) => format!("{from} to {most}"),
        ((_, Bound::Included(most)), from) => format!("{from}, up to {most}"),
        ((_, Bound::Excluded(most)), from) => format!("{from}, below {most}"),
        ((_, Bound::Unbounded), from) => from.to_owned(),
    }
}

fn number_schema(range: &Range) -> Value {
    let mut schema = json!({"type": "number"});
    // Whole ends are written as such, which is what the OpenAPI document makes of them.
    let number = |end: f32| match end.fract() == 0.0 {
        true => json!(end as i64),
        false => super::short_number(end),
    };
    let mut end = |included: &str, excluded: &str, end: Bound<f32>| match end {
        Bound::Included(end) => schema[included] = number(end),
        Bound::Excluded(end) => schema[excluded] = number(end),
        Bound::Unbounded => {}
    };
    end("minimum", "exclusiveMinimum", range.0);
    end("maximum", "exclusiveMaximum", range.1);
    schema
}
