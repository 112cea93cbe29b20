//! What can be wrong with a scene, and where.

use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// A place in a scene's files, for messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Name of the file within the scene.
    pub file: Arc<str>,
    /// Line, counted from 1; 0 where the whole file is meant.
    pub line: u32,
}

impl Place {
    /// The file as a whole.
    #[must_use]
    pub fn whole(file: &str) -> Self {
        Self {
            file: file.into(),
            line: 0,
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}", self.file),
            line => write!(f, "{}:{line}", self.file),
        }
    }
}

/// Why a scene cannot be loaded. Every message starts with the place, `file:line`.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SceneError {
    /// A file name that is none: empty, a URL, on a drive, or of characters that names have not.
    #[error("{place}: file name `{name}`: {reason}")]
    FileName {
        /// Where.
        place: Place,
        /// The name.
        name: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// A file that is not there.
    #[error("{place}: file `{name}` was not found; it was looked for as {tried}")]
    NotFound {
        /// Where.
        place: Place,
        /// The name.
        name: String,
        /// The names that were tried.
        tried: String,
    },
    /// A file that could not be read.
    #[error("{place}: file `{name}` could not be read: {reason}")]
    Read {
        /// Where.
        place: Place,
        /// The name.
        name: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// More than the limits allow.
    #[error("{place}: {what}: {value} is over the limit of {limit}")]
    Limit {
        /// Where.
        place: Place,
        /// What it is.
        what: String,
        /// How much there is.
        value: u64,
        /// How much is allowed.
        limit: u64,
    },
    /// Not well-formed XML.
    #[error("{place}: not well-formed XML: {reason}")]
    Xml {
        /// Where.
        place: Place,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// An element, attribute, property, plugin or parameter that does not exist.
    #[error(
        "{place}: {context}: unknown {what} `{name}`;{} allowed: {allowed}",
        did_you_mean(name, allowed)
    )]
    Unknown {
        /// Where.
        place: Place,
        /// The element that it belongs to.
        context: String,
        /// What it is.
        what: &'static str,
        /// The name.
        name: String,
        /// What exists.
        allowed: String,
    },
    /// Something that must be there is not.
    #[error("{place}: {context}: {what} is missing")]
    Missing {
        /// Where.
        place: Place,
        /// The element that it belongs to.
        context: String,
        /// What it is.
        what: String,
    },
    /// A value of the wrong form, type or range.
    #[error("{place}: {field}: {reason}")]
    Value {
        /// Where.
        place: Place,
        /// The element and its attribute or property.
        field: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// An id that is used twice, is used and nowhere defined, or refers to itself.
    #[error("{place}: id `{id}`: {reason}")]
    Reference {
        /// Where.
        place: Place,
        /// The id.
        id: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// A file that includes itself.
    #[error("{place}: <include>: the files include each other in a cycle: {chain}")]
    IncludeCycle {
        /// Where.
        place: Place,
        /// The files, outermost first.
        chain: String,
    },
    /// A broken mesh, image or spectrum file.
    #[error("{place}: {reason}")]
    Data {
        /// Where.
        place: Place,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// Something that Mitsuba has and this renderer has not.
    #[error("{place}: {context}: {what} is not supported; {instead}")]
    Unsupported {
        /// Where.
        place: Place,
        /// The element that it belongs to.
        context: String,
        /// What it is.
        what: String,
        /// What there is instead.
        instead: String,
    },
}

impl SceneError {
    /// Where it is wrong.
    #[must_use]
    pub fn place(&self) -> &Place {
        match self {
            Self::FileName { place, .. }
            | Self::NotFound { place, .. }
            | Self::Read { place, .. }
            | Self::Limit { place, .. }
            | Self::Xml { place, .. }
            | Self::Unknown { place, .. }
            | Self::Missing { place, .. }
            | Self::Value { place, .. }
            | Self::Reference { place, .. }
            | Self::IncludeCycle { place, .. }
            | Self::Data { place, .. }
            | Self::Unsupported { place, .. } => place,
        }
    }

    /// The file in which it is wrong.
    #[must_use]
    pub fn file(&self) -> &str {
        &self.place().file
    }

    /// The line, counted from 1, where the file has lines.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        Some(self.place().line).filter(|line| *line > 0)
    }

    pub(crate) fn unknown<'a>(
        place: &Place,
        context: impl Into<String>,
        what: &'static str,
        name: &str,
        allowed: impl IntoIterator<Item = &'a str>,
    ) -> Self {
        Self::Unknown {
            place: place.clone(),
            context: context.into(),
            what,
            name: shortened(name),
            allowed: list(allowed),
        }
    }

    pub(crate) fn value(place: &Place, field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Value {
            place: place.clone(),
            field: field.into(),
            reason: reason.into(),
        }
    }

    pub(crate) fn data(place: &Place, reason: impl Into<String>) -> Self {
        Self::Data {
            place: place.clone(),
            reason: reason.into(),
        }
    }

    /// The same error reported at `place`, for errors of a reader that knows only the file's name.
    pub(crate) fn at(mut self, place: &Place) -> Self {
        match &mut self {
            Self::FileName { place: old, .. }
            | Self::NotFound { place: old, .. }
            | Self::Read { place: old, .. }
            | Self::Limit { place: old, .. } => *old = place.clone(),
            _ => {}
        }
        self
    }
}

/// Text for a message: the first 40 characters.
pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

/// Names as a list for messages.
pub(crate) fn list<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.into_iter().collect();
    match names.is_empty() {
        true => "none".into(),
        false => names.join(", "),
    }
}

/// A question for messages where `name` looks like one of the list `allowed`, or nothing.
pub(crate) fn did_you_mean(name: &str, allowed: &str) -> String {
    nearest(name, allowed.split(", ")).map_or(String::new(), |name| format!(" did you mean `{name}`?"))
}

/// The longest name that is compared with others \[characters\].
const LONGEST_COMPARED: usize = 64;

/// The one of `allowed` that `name` may be a misspelling of: at most a third of its characters differ, in any case.
pub(crate) fn nearest<'a>(name: &str, allowed: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = |text: &str| text.to_lowercase().replace('_', "");
    let (length, name) = (name.chars().count(), plain(name));
    if length > LONGEST_COMPARED {
        return None;
    }
    let short = allowed
        .into_iter()
        .filter(|other| other.chars().count() <= LONGEST_COMPARED);
    let distances = short.map(|other| (strsim::damerau_levenshtein(&name, &plain(other)), other));
    let (distance, other) = distances.min_by_key(|(distance, _)| *distance)?;
    (distance <= (length / 3).max(1) && distance < length).then_some(other)
}

/// `value` if it is at most `limit`, and otherwise the error that names both.
pub(crate) fn within(place: &Place, what: &str, value: u64, limit: u64) -> Result<u64, SceneError> {
    if value > limit {
        return Err(SceneError::Limit {
            place: place.clone(),
            what: what.into(),
            value,
            limit,
        });
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misspelt_names_have_a_nearest_one() {
        let allowed = ["radius", "center", "to_world", "k", "eta"];
        for (name, expected) in [
            ("radios", Some("radius")),
            ("centre", Some("center")),
            ("toWorld", Some("to_world")),
            ("ToWrold", Some("to_world")),
            ("colour", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest(name, allowed), expected, "{name}");
        }
        assert_eq!(nearest(&"radius".repeat(20), allowed), None);
    }
}
