//! Typed access to a described object that notices what was never asked for.

use super::description::{Child, Description, Kind, Object, ObjectId, Property, SharedMesh, SpectrumValue, Value};
use super::error::{Place, SceneError, did_you_mean, list, nearest, shortened};
use super::loader::LoadedFile;
use crate::light::Portal;
use crate::math::{AnimatedTransform, Transform};
use crate::medium::Grid;
use glam::DVec3;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Reads one object. Every property and child must be asked for before [`Reader::finish`].
pub(crate) struct Reader<'d> {
    description: &'d Description,
    pub(crate) id: ObjectId,
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
        Self {
            description,
            id: object,
            object: &description.objects[object],
            asked: RefCell::default(),
            taken: RefCell::default(),
        }
    }

    pub(crate) fn place(&self) -> &'d Place {
        &self.object.place
    }

    /// The element as in messages: `<bsdf type="diffuse">`.
    pub(crate) fn context(&self) -> String {
        match (self.object.kind, &self.object.written) {
            (_, Some(written)) => written.to_string(),
            (Kind::Scene, None) => "<scene>".to_owned(),
            (kind, None) => format!("<{} type=\"{}\">", kind.element(), self.object.plugin),
        }
    }

    /// Whether a property or a child of the name is there.
    pub(crate) fn has(&self, name: &str) -> bool {
        let mut children = self.object.children.iter();
        self.object.properties.contains_key(name) || children.any(|child| child.name.as_deref() == Some(name))
    }

    pub(crate) fn property(&self, name: &str) -> Option<&'d Property> {
        self.asked.borrow_mut().insert(name.to_owned());
        self.object.properties.get(name)
    }

    /// Notes a fault of the object, which counts as not written; reading goes on.
    ///
    /// # Errors
    /// A fault that ends the reading.
    pub(crate) fn fault(&self, fault: SceneError) -> Result<(), SceneError> {
        self.object.faulty.set(true);
        self.description.faults.note(fault)
    }

    /// Warns about something at `place` that is rendered otherwise than its author may think.
    pub(crate) fn warn(&self, place: &Place, message: impl fmt::Display) {
        self.description
            .warnings
            .note(place, format!("{}: {message}", self.context()));
    }

    /// Notes what changes nothing in the picture, for those who ask.
    pub(crate) fn remark(&self, message: impl fmt::Display) {
        let message = format!("{}: {message}", self.context());
        self.description.warnings.remark(self.place(), message);
    }

    /// As [`Reader::warn`], about the property `name`.
    pub(crate) fn warn_of(&self, name: &str, message: &str) {
        let place = self
            .object
            .properties
            .get(name)
            .map_or(self.place(), |property| &property.place);
        self.warn(place, format_args!("`{name}`: {message}"));
    }

    /// Accepts properties and children that change nothing in the picture, with a remark.
    pub(crate) fn ignore(&self, names: &[&str]) {
        let given: Vec<String> = names
            .iter()
            .filter(|name| self.has(name))
            .map(|name| format!("`{name}`"))
            .collect();
        if !given.is_empty() {
            let verb = if given.len() == 1 { "changes" } else { "change" };
            self.remark(format_args!("{} {verb} nothing in the picture", given.join(", ")));
        }
        self.accept(names);
    }

    /// Accepts properties and children, about which all is said.
    pub(crate) fn accept(&self, names: &[&str]) {
        let mut asked = self.asked.borrow_mut();
        asked.extend(names.iter().map(|name| (*name).to_owned()));
        let of_name = |child: &Child| child.name.as_deref().is_some_and(|name| names.contains(&name));
        let children = self.object.children.iter().enumerate();
        let ignored = children.filter(|(_, child)| of_name(child)).map(|(index, _)| index);
        self.taken.borrow_mut().extend(ignored);
    }

    /// As [`Reader::fault`], for the value of a property.
    fn left_out<T>(&self, fault: SceneError) -> Result<Option<T>, SceneError> {
        self.fault(fault).map(|()| None)
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
        let context = match &self.object.written {
            Some(written) => written.to_string(),
            None => format!("<{}>", self.object.kind.element()),
        };
        SceneError::unknown(
            self.place(),
            context,
            "type",
            &self.object.plugin,
            allowed.iter().copied(),
        )
    }

    /// Warns of a plugin type that is not known here, for which `instead` says what is rendered.
    ///
    /// # Errors
    /// Where the type looks like a misspelt one of those `allowed`.
    pub(crate) fn other_type(&self, allowed: &[&str], instead: &str) -> Result<(), SceneError> {
        let plugin = &self.object.plugin;
        if nearest(plugin, allowed.iter().copied()).is_some() {
            return Err(self.unknown_type(allowed));
        }
        let element = match &self.object.written {
            Some(written) => written.to_string(),
            None => format!("<{}>", self.object.kind.element()),
        };
        let message = format!(
            "{element}: the type `{}` is not known here: {instead}",
            shortened(plugin)
        );
        self.description.warnings.note(self.place(), message);
        self.accept_rest();
        Ok(())
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
            _ => return self.left_out(self.mismatch(name, property, "float")),
        };
        if !range.contains(&value) {
            let reason = format!("{value} is out of range; allowed: {}", describe(&range));
            return self.left_out(self.wrong(name, reason));
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
            return self.left_out(self.mismatch(name, property, "integer"));
        };
        if !range.contains(&value) {
            let allowed = format!("{} to {}", range.start(), range.end());
            return self.left_out(self.wrong(name, format!("{value} is out of range; allowed: {allowed}")));
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
            Some(property) => self.fault(self.mismatch(name, property, "boolean")).map(|()| default),
        }
    }

    pub(crate) fn string(&self, name: &str) -> Result<Option<&'d str>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::String(value),
                ..
            }) => Ok(Some(value)),
            Some(property) => self.left_out(self.mismatch(name, property, "string")),
        }
    }

    /// The file that a property holds in place of a name.
    pub(crate) fn embedded_file(&self, name: &str) -> Option<&'d LoadedFile> {
        match &self.property(name)?.value {
            Value::File(file) => Some(file),
            _ => None,
        }
    }

    /// The triangles that the property `name` holds.
    pub(crate) fn mesh(&self, name: &str) -> Result<Option<&'d SharedMesh>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::Mesh(mesh),
                ..
            }) => Ok(Some(mesh)),
            Some(property) => self.left_out(self.mismatch(name, property, "mesh")),
        }
    }

    /// The lattice that the property `name` holds, where it holds one: no format but pbrt's has the property.
    pub(crate) fn grid(&self, name: &str) -> Option<Arc<Grid>> {
        let Value::Grid(grid) = &self.object.properties.get(name)?.value else {
            return None;
        };
        self.accept(&[name]);
        Some(grid.clone())
    }

    /// The portal that the property `name` holds, where it holds one: no format but pbrt's has the property.
    pub(crate) fn portal(&self, name: &str) -> Option<Portal> {
        let Value::Portal(portal) = self.object.properties.get(name)?.value else {
            return None;
        };
        self.accept(&[name]);
        Some(portal)
    }

    /// The value that goes with a string, which is one of `choices`.
    pub(crate) fn choice<T: Copy>(&self, name: &str, choices: &[(&str, T)], default: T) -> Result<T, SceneError> {
        if let Some(Value::Integer(_)) = self.property(name).map(|property| &property.value) {
            self.warn_of(name, "a number names no choice here; the default counts");
            return Ok(default);
        }
        let Some(text) = self.string(name)? else {
            return Ok(default);
        };
        let lower = text.to_ascii_lowercase();
        if let Some((_, value)) = choices.iter().find(|(choice, _)| *choice == lower) {
            return Ok(*value);
        }
        let problem = format!("`{}` is not one of", shortened(text));
        self.fault(self.no_such(name, &problem, text, choices.iter().map(|(choice, _)| *choice)))?;
        Ok(default)
    }

    /// The error for a `text` that is none of `allowed`.
    pub(crate) fn no_such<'a>(
        &self,
        name: &str,
        problem: &str,
        text: &str,
        allowed: impl Iterator<Item = &'a str>,
    ) -> SceneError {
        let allowed: Vec<&str> = allowed.collect();
        let hint =
            nearest(text, allowed.iter().copied()).map_or(String::new(), |name| format!("; did you mean `{name}`?"));
        self.wrong(name, format!("{problem}: {}{hint}", allowed.join(", ")))
    }

    /// A list of numbers, written with commas or blanks between them.
    pub(crate) fn numbers(&self, name: &str) -> Result<Option<Vec<f64>>, SceneError> {
        let Some(text) = self.string(name)? else {
            return Ok(None);
        };
        let words = text.split([' ', ',', ';', '\n', '\t']).filter(|word| !word.is_empty());
        let numbers = words.map(|word| word.parse::<f64>().ok().filter(|number| number.is_finite()));
        match numbers.collect::<Option<Vec<f64>>>() {
            Some(numbers) => Ok(Some(numbers)),
            None => self.left_out(self.wrong(name, "expected numbers with commas or blanks between them")),
        }
    }

    pub(crate) fn vector(&self, name: &str) -> Result<Option<DVec3>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::Vector(value),
                ..
            }) => Ok(Some(*value)),
            Some(property) => self.left_out(self.mismatch(name, property, "point or vector")),
        }
    }

    pub(crate) fn transform(&self, name: &str) -> Result<Option<Transform>, SceneError> {
        match self.property(name) {
            None => Ok(None),
            Some(Property {
                value: Value::Transform(value),
                ..
            }) => Ok(Some(**value)),
            Some(property) => self.left_out(self.mismatch(name, property, "transform")),
        }
    }

    /// A transform that may be animated.
    pub(crate) fn animation(&self, name: &str) -> Result<Option<AnimatedTransform>, SceneError> {
        match self.property(name) {
            Some(Property {
                value: Value::Animation(value),
                ..
            }) => Ok(Some(value.clone())),
            _ => Ok(self.transform(name)?.map(AnimatedTransform::still)),
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
            _ => self.left_out(self.mismatch(name, property, "rgb, spectrum or float, or a texture")),
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
                let field = format!("{} `{name}`", self.context());
                self.fault(SceneError::value(&child.place, field, "it is given twice"))?;
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
        if let Some(second) = children.get(1) {
            let reason = format!("only one <{}> is allowed here", kind.element());
            self.fault(SceneError::value(&second.place, self.context(), reason))?;
        }
        Ok(children.first().copied())
    }

    fn kind_of(&self, child: &Child) -> Kind {
        self.description.objects[child.target].kind
    }

    /// Accepts everything that is left: for plugins that are known by name only.
    pub(crate) fn accept_rest(&self) {
        self.asked.borrow_mut().extend(self.object.properties.keys().cloned());
        self.taken.borrow_mut().extend(0..self.object.children.len());
    }

    /// Warns about properties and children that were never asked for.
    pub(crate) fn finish(&self) {
        let (asked, taken) = (self.asked.borrow(), self.taken.borrow());
        let unknown = |place: &Place, what: &str, name: &str, written: &str| {
            let known = list(asked.iter().map(String::as_str));
            let hint = did_you_mean(name, &known);
            let message = format_args!("{what} `{written}` is not known here and left out;{hint} known: {known}");
            self.warn(place, message);
        };
        for (name, property) in &self.object.properties {
            if !asked.contains(name) {
                unknown(&property.place, "property", name, &shortened(name));
            }
        }
        for (index, child) in self.object.children.iter().enumerate() {
            if taken.contains(&index) {
                continue;
            }
            let (kind, name) = (self.kind_of(child), child.name.as_deref());
            if let Some(without) = kind.left_out() {
                self.warn(
                    &child.place,
                    format_args!("<{}> is left out: {without}", kind.element()),
                );
                continue;
            }
            let written = match name {
                Some(name) => format!("<{} name=\"{}\">", kind.element(), shortened(name)),
                None => format!("<{}>", kind.element()),
            };
            unknown(&child.place, "nested object", name.unwrap_or_default(), &written);
        }
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
