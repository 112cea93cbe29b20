//! The parameters of a directive, as they are asked for.

use super::colour::ColourSpace;
use super::token::Tokens;
use super::values::{Parameter, Type, Values, parameter};
use crate::math::Vec3;
use crate::scene::error::{Place, SceneError, did_you_mean, list, shortened};
use crate::scene::faults::Faults;
use crate::scene::warning::Warnings;
use bytemuck::Pod;
use bytemuck::allocation::try_cast_vec;
use glam::DVec3;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;

/// The parameters of one directive, which notes those that are asked for.
pub(super) struct Parameters {
    /// What messages call the directive: `Shape "sphere"`.
    pub(super) context: String,
    pub(super) place: Place,
    own: Vec<Rc<Parameter>>,
    /// What an `Attribute` before has set for directives that do not say it.
    defaults: Rc<Vec<Rc<Parameter>>>,
    pub(super) faults: Rc<Faults>,
    pub(super) warnings: Rc<Warnings>,
    /// The names that were asked for.
    asked: RefCell<BTreeSet<String>>,
}

impl Parameters {
    /// Reads the parameters that follow in `tokens`.
    pub(super) fn read(
        tokens: &mut Tokens,
        context: String,
        space: ColourSpace,
        faults: &Rc<Faults>,
        warnings: &Rc<Warnings>,
    ) -> Result<Self, SceneError> {
        let place = tokens.place();
        let mut own = Vec::new();
        while tokens.peek() == Some(b'"') {
            if let Some(parameter) = parameter(tokens, &context, space, faults)? {
                own.push(Rc::new(parameter));
            }
        }
        Ok(Self {
            context,
            place,
            own,
            defaults: Rc::default(),
            faults: faults.clone(),
            warnings: warnings.clone(),
            asked: RefCell::default(),
        })
    }

    /// The same parameters, and for those that are not among them `defaults`.
    pub(super) fn with_defaults(mut self, defaults: &Rc<Vec<Rc<Parameter>>>) -> Self {
        self.defaults = defaults.clone();
        self
    }

    /// The parameters themselves, as defaults of others.
    pub(super) fn into_own(self) -> Vec<Rc<Parameter>> {
        self.own
    }

    /// Whether a parameter of this name and kind is written, which does not count as asking for it.
    pub(super) fn has(&self, name: &str) -> bool {
        self.own
            .iter()
            .chain(self.defaults.iter())
            .any(|parameter| parameter.name == name)
    }

    /// The last parameter of the name.
    pub(super) fn find(&self, name: &str) -> Option<&Parameter> {
        self.asked.borrow_mut().insert(name.to_owned());
        let mut found = None;
        for parameter in self.defaults.iter().chain(&self.own) {
            if parameter.name == name {
                parameter.used.set(true);
                found = Some(&**parameter);
            }
        }
        found
    }

    /// An error about the parameter `name`.
    pub(super) fn wrong(&self, name: &str, reason: impl Into<String>) -> SceneError {
        let written = self
            .own
            .iter()
            .chain(self.defaults.iter())
            .find(|parameter| parameter.name == name);
        let place = written.map_or(&self.place, |parameter| &parameter.place);
        SceneError::value(place, format!("{} `{name}`", self.context), reason)
    }

    /// Notes a fault; the parameter counts as not written.
    pub(super) fn fault<T>(&self, name: &str, reason: impl Into<String>) -> Result<Option<T>, SceneError> {
        self.faults.note(self.wrong(name, reason)).map(|()| None)
    }

    /// Warns about the directive.
    pub(super) fn warn(&self, message: &str) {
        self.warnings.note(&self.place, format!("{}: {message}", self.context));
    }

    /// Warns about the parameter `name`.
    pub(super) fn warn_of(&self, name: &str, message: &str) {
        let written = self
            .own
            .iter()
            .chain(self.defaults.iter())
            .find(|parameter| parameter.name == name);
        let place = written.map_or(&self.place, |parameter| &parameter.place);
        self.warnings
            .note(place, format!("{} `{name}`: {message}", self.context));
    }

    /// Accepts parameters that change nothing here.
    pub(super) fn ignore(&self, names: &[&str]) {
        for name in names {
            self.find(name);
        }
    }

    /// Accepts all parameters, of what is known by its name only.
    pub(super) fn ignore_all(&self) {
        self.own.iter().for_each(|parameter| parameter.used.set(true));
    }

    /// Warns about parameters that are written and do not exist here.
    pub(super) fn finish(&self) {
        let asked = self.asked.borrow();
        let known = list(asked.iter().map(String::as_str));
        for parameter in self.own.iter().filter(|parameter| !parameter.used.get()) {
            let hint = did_you_mean(&parameter.name, &known);
            let (kind, name) = (shortened(&parameter.written), shortened(&parameter.name));
            let message = format!(
                "{}: parameter \"{kind} {name}\" is not known here and left out;{hint} known: {known}",
                self.context
            );
            self.warnings.note(&parameter.place, message);
        }
    }

    /// The numbers of a parameter of one of `kinds`, of which there must be `count`.
    fn numbers(&self, name: &str, kinds: &[Type], count: usize) -> Result<Option<Vec<f64>>, SceneError> {
        let Some(parameter) = self.find(name) else {
            return Ok(None);
        };
        let numbers = parameter.values.numbers();
        if !kinds.contains(&parameter.kind) || numbers.len() != count {
            let expected = match (kinds.first(), count) {
                (Some(Type::Integer), 1) => "one integer".to_owned(),
                (_, 1) => "one number".to_owned(),
                (_, count) => format!("{count} numbers"),
            };
            let reason = format!(
                "expected {expected}, found {} of type \"{}\"",
                parameter.values.len(),
                shortened(&parameter.written)
            );
            return self.fault(name, reason);
        }
        Ok(Some(numbers))
    }

    pub(super) fn float(&self, name: &str) -> Result<Option<f64>, SceneError> {
        Ok(self
            .numbers(name, &[Type::Float, Type::Integer], 1)?
            .map(|values| values[0]))
    }

    pub(super) fn float_or(&self, name: &str, default: f64) -> Result<f64, SceneError> {
        Ok(self.float(name)?.unwrap_or(default))
    }

    /// A number above zero; others are faults.
    pub(super) fn positive_or(&self, name: &str, default: f64) -> Result<f64, SceneError> {
        match self.float(name)? {
            Some(value) if value <= 0.0 => Ok(self
                .fault(name, format!("{value} is out of range; allowed: numbers above 0"))?
                .unwrap_or(default)),
            value => Ok(value.unwrap_or(default)),
        }
    }

    pub(super) fn integer(&self, name: &str) -> Result<Option<i32>, SceneError> {
        let found = self.numbers(name, &[Type::Integer, Type::Float], 1)?;
        match found.map(|values| values[0]) {
            Some(value) if value.fract() != 0.0 || value.abs() > f64::from(i32::MAX) => {
                self.fault(name, format!("{value} is not an integer"))
            }
            value => Ok(value.map(|value| value as i32)),
        }
    }

    /// A given number of numbers, such as a window's four sides.
    pub(super) fn floats<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, SceneError> {
        let kinds = [Type::Float, Type::Integer, Type::Vector];
        Ok(self.numbers(name, &kinds, N)?.and_then(|values| values.try_into().ok()))
    }

    pub(super) fn vector(&self, name: &str) -> Result<Option<DVec3>, SceneError> {
        let found = self.numbers(name, &[Type::Vector, Type::Float], 3)?;
        Ok(found.map(|values| DVec3::new(values[0], values[1], values[2])))
    }

    pub(super) fn boolean(&self, name: &str, default: bool) -> Result<bool, SceneError> {
        match self.find(name) {
            None => Ok(default),
            Some(Parameter {
                values: Values::Booleans(values),
                ..
            }) if values.len() == 1 => Ok(values[0]),
            Some(_) => Ok(self.fault(name, "expected one of true and false")?.unwrap_or(default)),
        }
    }

    pub(super) fn text(&self, name: &str) -> Result<Option<&str>, SceneError> {
        match self.find(name) {
            None => Ok(None),
            Some(Parameter {
                values: Values::Texts(values),
                ..
            }) if values.len() == 1 => Ok(Some(&values[0])),
            Some(_) => self.fault(name, "expected one text in quotes"),
        }
    }

    /// A list of texts.
    pub(super) fn texts(&self, name: &str) -> Result<Option<&[String]>, SceneError> {
        match self.find(name) {
            None => Ok(None),
            Some(Parameter {
                values: Values::Texts(values),
                ..
            }) => Ok(Some(values)),
            Some(_) => self.fault(name, "expected texts in quotes"),
        }
    }

    /// The name of the texture, where the parameter is one.
    pub(super) fn texture(&self, name: &str) -> Result<Option<&str>, SceneError> {
        if self
            .own
            .iter()
            .chain(self.defaults.iter())
            .any(|p| p.name == name && p.kind == Type::Texture)
        {
            return self.text(name);
        }
        Ok(None)
    }

    /// The values of the last parameter of the name, which has none afterwards: lists of large meshes are there once.
    fn take(&mut self, name: &str) -> Option<Values> {
        self.find(name)?;
        match self.own.iter_mut().rfind(|parameter| parameter.name == name) {
            Some(own) => Some(match Rc::get_mut(own) {
                Some(own) => std::mem::replace(&mut own.values, Values::Texts(Vec::new())),
                None => own.values.clone(),
            }),
            None => self.find(name).map(|parameter| parameter.values.clone()),
        }
    }

    /// A list of indices, which can be taken once. Negative ones are far out of range.
    pub(super) fn take_indices(&mut self, name: &str) -> Result<Option<Vec<u32>>, SceneError> {
        match self.take(name) {
            None => Ok(None),
            Some(Values::Integers(values)) => Ok(Some(bytemuck::cast_vec(values))),
            Some(_) => self.fault(name, "expected values of type \"integer\""),
        }
    }

    /// Numbers in groups of `N`, in single precision, which can be taken once.
    pub(super) fn take_groups<const N: usize>(&mut self, name: &str) -> Result<Option<Vec<[f32; N]>>, SceneError> {
        let values = match self.take(name) {
            None => return Ok(None),
            Some(Values::Coordinates(values)) => values,
            Some(Values::Numbers(values)) => values.iter().map(|value| *value as f32).collect(),
            Some(_) => return self.fault(name, "expected numbers"),
        };
        match groups(values) {
            Ok(groups) => Ok(Some(groups)),
            Err(count) => self.fault(name, format!("{count} numbers are no multiple of {N}")),
        }
    }

    /// Points, vectors or normals, which can be taken once.
    pub(super) fn take_vectors(&mut self, name: &str) -> Result<Vec<Vec3>, SceneError> {
        let groups = self.take_groups::<3>(name)?.unwrap_or_default();
        Ok(groups.into_iter().map(Vec3::from_array).collect())
    }
}

/// The values in groups of `N`, in the same memory where it allows that. The error is the number of values, which is no multiple.
pub(super) fn groups<T: Pod, const N: usize>(values: Vec<T>) -> Result<Vec<[T; N]>, usize> {
    if !values.len().is_multiple_of(N) {
        return Err(values.len());
    }
    let group = |values: &[T]| -> [T; N] { std::array::from_fn(|i| values[i]) };
    Ok(try_cast_vec(values).unwrap_or_else(|(_, values)| values.chunks_exact(N).map(group).collect()))
}
