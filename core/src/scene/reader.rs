//! Typed access to a described object that notices what was never asked for.

use super::description::{Child, Description, Kind, Object, ObjectId, Property, SpectrumValue, Value};
use super::error::{Place, SceneError};
use crate::math::Transform;
use glam::DVec3;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;

/// Reads one object. Every property and child must be asked for before [`Reader::finish`].
pub(crate) struct Reader<'d> {
    description: &'d Description,
    pub(crate) object: &'d Object,
    /// Names asked for, whether or not they were there.
    asked: RefCell<BTreeSet<String>>,
    /// Indices of the children that were taken.
    taken: RefCell<BTreeSet<usize>>,
}

/// Every finite number.
pub(crate) const ANY: RangeInclusive<f64> = f64::MIN..=f64::MAX;
/// Every number above zero.
pub(crate) const POSITIVE: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::MAX;
/// Every number from zero on.
pub(crate) const NOT_NEGATIVE: RangeInclusive<f64> = 0.0..=f64::MAX;

impl<'d> Reader<'d> {
    pub(crate) fn new(description: &'d Description, object: ObjectId) -> Self {
        let object = &description.objects[object];
        Self {
            description,
            object,
            asked: RefCell::default(),
            taken: RefCell::default(),
        }
    }

    pub(crate) fn place(&self) -> &'d Place {
        &self.object.place
    }

    /// The element as in messages: `<bsdf type="diffuse">`.
    pub(crate) fn context(&self) -> String {
        format!("<{} type=\"{}\">", self.object.kind.element(), self.object.plugin)
    }

    pub(crate) fn property(&self, name: &str) -> Option<&'d Property> {
        self.asked.borrow_mut().insert(name.to_owned());
        self.object.properties.get(name)
    }

    /// An error about the property `name`, at its place or else at the object's.
    pub(crate) fn wrong(&self, name: &str, reason: impl Into<String>) -> SceneError {
        let place = self
            .object
            .properties
            .get(name)
            .map_or(self.place(), |property| &property.place);
        SceneError::value(place, format!("{} `{name}`", self.context()), reason)
    }

    pub(crate) fn unsupported(&self, what: impl Into<String>, instead: impl Into<String>) -> SceneError {
        let (place, context) = (self.place().clone(), self.context());
        SceneError::Unsupported {
            place,
            context,
            what: what.into(),
            instead: instead.into(),
        }
    }

    pub(crate) fn missing(&self, what: impl Into<String>) -> SceneError {
        SceneError::Missing {
            place: self.place().clone(),
            context: self.context(),
            what: what.into(),
        }
    }

    /// The error for a plugin type that does not exist.
    pub(crate) fn unknown_type(&self, allowed: &[&str]) -> SceneError {
        SceneError::Unknown {
            place: self.place().clone(),
            context: format!("<{}>", self.object.kind.element()),
            what: "type",
            name: self.object.plugin.clone(),
            allowed: allowed.join(", "),
        }
    }

    fn mismatch(&self, name: &str, property: &Property, expected: &str) -> SceneError {
        self.wrong(
            name,
            format!(
                "expected a value of type {expected}, found {}",
                property.value.type_name()
            ),
        )
    }

    /// A number (a float, or an integer standing for one) within `range`.
    pub(crate) fn float(&self, name: &str, range: RangeInclusive<f64>) -> Result<Option<f64>, SceneError> {
        let Some(property) = self.property(name) else {
            return Ok(None);
        };
        let value = match property.value {
            Value::Float(value) => value,
            Value::Integer(value) => value as f64,
            _ => return Err(self.mismatch(name, property, "float")),
        };
        if !range.contains(&value) {
            return Err(self.wrong(name, format!("{value} is out of range; allowed: {}", describe(&range))));
        }
        Ok(Some(value))
    }

    pub(crate) fn float_or(&self, name: &str, range: RangeInclusive<f64>, default: f64) -> Result<f64, SceneError> {
        Ok(self.float(name, range)?.unwrap_or(default))
    }

    pub(crate) fn integer(&self, name: &str, range: RangeInclusive<i64>) -> Result<Option<i64>, SceneError> {
        let Some(property) = self.property(name) else {
            return Ok(None);
        };
        let Value::Integer(value) = property.value else {
            return Err(self.mismatch(name, property, "integer"));
        };
        if !range.contains(&value) {
            let allowed = format!("{} to {}", range.start(), range.end());
            return Err(self.wrong(name, format!("{value} is out of range; allowed: {allowed}")));
        }
        Ok(Some(value))
    }

    pub(crate) fn boolean(&self, name: &str, default: bool) -> Result<bool, SceneError> {
        match self.property(name) {
            None => Ok(default),
            Some(Property {
                value: Value::Boolean(value),
                ..
            }) => Ok(*value),
            Some(property) => Err(self.mismatch(name, property, "boolean")),
        }
    }

    pub(crate) fn string(&self, name: &str) -> Result<Option<&'d str>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::String(value),
                ..
            }) => Ok(Some(value)),
            Some(property) => Err(self.mismatch(name, property, "string")),
        }
    }

    /// The value that goes with a string, which is one of `choices`.
    pub(crate) fn choice<T: Copy>(&self, name: &str, choices: &[(&str, T)], default: T) -> Result<T, SceneError> {
        let Some(text) = self.string(name)? else {
            return Ok(default);
        };
        let lower = text.to_ascii_lowercase();
        let found = choices.iter().find(|(choice, _)| *choice == lower);
        found.map(|(_, value)| *value).ok_or_else(|| {
            let allowed: Vec<&str> = choices.iter().map(|(choice, _)| *choice).collect();
            self.wrong(name, format!("`{text}` is not one of: {}", allowed.join(", ")))
        })
    }

    pub(crate) fn vector(&self, name: &str) -> Result<Option<DVec3>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::Vector(value),
                ..
            }) => Ok(Some(*value)),
            Some(property) => Err(self.mismatch(name, property, "point or vector")),
        }
    }

    pub(crate) fn transform(&self, name: &str) -> Result<Option<Transform>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::Transform(value),
                ..
            }) => Ok(Some(**value)),
            Some(property) => Err(self.mismatch(name, property, "transform")),
        }
    }

    /// A colour as written: a number, `rgb` or `spectrum`.
    pub(crate) fn colour(&self, name: &str) -> Result<Option<Colour>, SceneError> {
        let Some(property) = self.property(name) else {
            return Ok(None);
        };
        match &property.value {
            Value::Float(value) => Ok(Some(Colour::Number(*value))),
            Value::Integer(value) => Ok(Some(Colour::Number(*value as f64))),
            Value::Rgb(rgb) => Ok(Some(Colour::Rgb(*rgb))),
            Value::Spectrum(spectrum) => Ok(Some(Colour::Spectrum(spectrum.clone()))),
            _ => Err(self.mismatch(name, property, "rgb, spectrum or float, or a texture")),
        }
    }

    /// The child with a name, such as a texture.
    pub(crate) fn named_child(&self, name: &str, kind: Kind) -> Result<Option<&'d Child>, SceneError> {
        self.asked.borrow_mut().insert(name.to_owned());
        let mut found = None;
        for (index, child) in self.object.children.iter().enumerate() {
            if child.name.as_deref() != Some(name) || self.kind_of(child) != kind {
                continue;
            }
            self.taken.borrow_mut().insert(index);
            if found.is_some() || self.object.properties.contains_key(name) {
                return Err(SceneError::value(
                    &child.place,
                    format!("{} `{name}`", self.context()),
                    "it is given twice",
                ));
            }
            found = Some(child);
        }
        Ok(found)
    }

    /// The children of a kind, whatever their names.
    pub(crate) fn children(&self, kind: Kind) -> Vec<&'d Child> {
        let of_kind = self
            .object
            .children
            .iter()
            .enumerate()
            .filter(|(_, child)| self.kind_of(child) == kind);
        of_kind
            .map(|(index, child)| {
                self.taken.borrow_mut().insert(index);
                child
            })
            .collect()
    }

    /// The child of a kind, of which there may be one at most.
    pub(crate) fn only_child(&self, kind: Kind) -> Result<Option<&'d Child>, SceneError> {
        let children = self.children(kind);
        match children.get(1) {
            Some(second) => {
                let reason = format!("only one <{}> is allowed here", kind.element());
                Err(SceneError::value(&second.place, self.context(), reason))
            }
            None => Ok(children.first().copied()),
        }
    }

    fn kind_of(&self, child: &Child) -> Kind {
        self.description.objects[child.target].kind
    }

    /// Accepts everything that is left: for plugins that are known by name only.
    pub(crate) fn accept_rest(&self) {
        self.asked.borrow_mut().extend(self.object.properties.keys().cloned());
        self.taken.borrow_mut().extend(0..self.object.children.len());
    }

    /// Refuses properties and children that were never asked for.
    pub(crate) fn finish(&self) -> Result<(), SceneError> {
        let asked = self.asked.borrow();
        let unknown = self.object.properties.iter().find(|(name, _)| !asked.contains(*name));
        let (place, what, name) = if let Some((name, property)) = unknown {
            (&property.place, "property", name.clone())
        } else {
            let taken = self.taken.borrow();
            let Some((_, child)) = self
                .object
                .children
                .iter()
                .enumerate()
                .find(|(index, _)| !taken.contains(index))
            else {
                return Ok(());
            };
            let element = self.kind_of(child).element();
            let name = child
                .name
                .as_ref()
                .map_or(format!("<{element}>"), |name| format!("<{element} name=\"{name}\">"));
            (&child.place, "nested object", name)
        };
        let allowed: Vec<&str> = asked.iter().map(String::as_str).collect();
        let allowed = if allowed.is_empty() {
            "none".to_owned()
        } else {
            allowed.join(", ")
        };
        Err(SceneError::Unknown {
            place: place.clone(),
            context: self.context(),
            what,
            name,
            allowed,
        })
    }
}

/// A colour as written.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Colour {
    Number(f64),
    Rgb([f64; 3]),
    Spectrum(SpectrumValue),
}

fn describe(range: &RangeInclusive<f64>) -> String {
    match (*range.start(), *range.end()) {
        (f64::MIN_POSITIVE, f64::MAX) => "numbers above 0".into(),
        (0.0, f64::MAX) => "0 and above".into(),
        (low, high) => format!("{low} to {high}"),
    }
}
