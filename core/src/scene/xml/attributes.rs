//! The attributes of an element, and all that is wrong with it.

use super::super::error::{Place, SceneError};
use super::XmlReader;
use super::document::Document;
use super::parameters::FillError;
use roxmltree::Node;
use std::collections::BTreeMap;

/// Values of attributes by name, parameters filled in.
pub(super) type Values<'a> = BTreeMap<&'a str, String>;

/// What is wrong with one element, in the order in which it was found; there is at least one fault.
#[derive(Debug)]
pub(super) struct ElementFaults(Vec<SceneError>);

impl ElementFaults {
    pub(super) fn into_list(self) -> Vec<SceneError> {
        self.0
    }
}

impl From<SceneError> for ElementFaults {
    fn from(fault: SceneError) -> Self {
        Self(vec![fault])
    }
}

impl From<Vec<SceneError>> for ElementFaults {
    fn from(faults: Vec<SceneError>) -> Self {
        Self(faults)
    }
}

/// The attributes of an element. Faults are collected, so that one run tells them all.
pub(super) struct Attributes<'a> {
    pub(super) place: Place,
    pub(super) element: &'a str,
    /// Those that may be there and can be filled in.
    pub(super) given: Values<'a>,
    pub(super) faults: Vec<SceneError>,
    /// Whether some attribute is not among those given: one that seems to be missing may be that one.
    pub(super) lost: bool,
}

impl Attributes<'_> {
    /// Takes an attribute that must be there.
    pub(super) fn take(&mut self, name: &str) -> Option<String> {
        let value = self.given.remove(name);
        if value.is_none() && !self.lost {
            self.faults.push(SceneError::Missing {
                place: self.place.clone(),
                context: format!("<{}>", self.element),
                what: format!("attribute `{name}`"),
            });
        }
        value
    }

    /// The value of a result; a fault is collected.
    pub(super) fn check<T>(&mut self, result: Result<T, SceneError>) -> Option<T> {
        result.map_err(|fault| self.faults.push(fault)).ok()
    }

    /// What an element without faults has the value of.
    pub(super) fn settle<T>(self, value: Option<T>) -> Result<T, ElementFaults> {
        match value {
            Some(value) if self.faults.is_empty() => Ok(value),
            _ => Err(self.faults.into()),
        }
    }
}

impl XmlReader<'_, '_> {
    /// The attributes of an element; none but `allowed` may be there. The error is a limit.
    pub(super) fn attributes<'a>(
        &mut self,
        document: &Document,
        node: Node<'a, '_>,
        allowed: &[&str],
    ) -> Result<Attributes<'a>, SceneError> {
        let mut attributes = Attributes {
            place: document.place(node),
            element: node.tag_name().name(),
            given: Values::new(),
            faults: Vec::new(),
            lost: false,
        };
        for attribute in node.attributes() {
            let name = attribute.name();
            let value = if allowed.contains(&name) && attribute.namespace().is_none() {
                self.filled(&attributes, name, attribute.value())
            } else {
                let context = format!("<{}>", attributes.element);
                let allowed = allowed.iter().copied();
                Err(SceneError::unknown(
                    &attributes.place,
                    context,
                    "attribute",
                    name,
                    allowed,
                ))
            };
            match value {
                Ok(value) => {
                    attributes.given.insert(name, value);
                }
                Err(limit @ SceneError::Limit { .. }) => return Err(limit),
                Err(fault) => {
                    attributes.faults.push(fault);
                    attributes.lost = true;
                }
            }
        }
        Ok(attributes)
    }

    /// The value of attribute `name` with parameters filled in.
    fn filled(&mut self, of: &Attributes, name: &str, value: &str) -> Result<String, SceneError> {
        let limit = self.limits().attribute_bytes;
        let (place, element) = (&of.place, of.element);
        let filled = self
            .parameters
            .fill(value, limit as usize)
            .map_err(|error| match error {
                FillError::Undefined(parameter) => {
                    let context = format!("<{element}> {name}");
                    SceneError::unknown(place, context, "parameter", &parameter, self.parameters.names())
                }
                FillError::TooLong => SceneError::Limit {
                    place: place.clone(),
                    what: format!("<{element}> {name}: bytes of the filled-in value"),
                    value: limit + 1,
                    limit,
                },
            })?;
        if value.contains('$') {
            self.charge(place, filled.len())?;
        }
        Ok(filled)
    }
}
