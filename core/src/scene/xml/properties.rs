//! Elements that are values: `<float>`, `<rgb>`, `<transform>` and so on.

use super::super::description::{SpectrumValue, Value};
use super::super::error::{Place, SceneError};
use super::super::spectrum::blackbody;
use super::attributes::{Attributes, ElementFaults};
use super::document::Document;
use super::{Context, XmlReader, names, transform, values};
use crate::math::{AnimatedTransform, Transform};
use glam::DVec3;
use roxmltree::Node;

impl XmlReader<'_, '_> {
    /// The name and the value of a property's element.
    pub(super) fn property(&mut self, context: Context, node: Node) -> Result<(String, Value), ElementFaults> {
        let (document, element) = (context.document, node.tag_name().name());
        if element == "point" || element == "vector" {
            return self.vector(document, node);
        }
        if element == "spectrum" {
            return self.spectrum(context, node);
        }
        if element == "blackbody" {
            return self.blackbody(context.document, node);
        }
        let mut attributes = self.attributes(document, node, &["name", "value"])?;
        let (name, text) = (attributes.take("name"), attributes.take("value"));
        let value = text.map(|text| match element {
            "float" => values::float(&text).map(Value::Float),
            "integer" => values::integer(&text).map(Value::Integer),
            "boolean" => values::boolean(&text).map(Value::Boolean),
            "rgb" => values::rgb(&text).map(Value::Rgb),
            "srgb" => values::srgb(&text).map(Value::Rgb),
            _ => Ok(Value::String(text)),
        });
        let value = value.and_then(|value| named(&mut attributes, name.as_deref(), "value", value));
        attributes.settle(name.zip(value))
    }

    fn vector(&mut self, document: &Document, node: Node) -> Result<(String, Value), ElementFaults> {
        const AXES: [&str; 3] = ["x", "y", "z"];
        let mut attributes = self.attributes(document, node, &["name", "value", "x", "y", "z"])?;
        let name = attributes.take("name");
        let vector = if let Some(text) = attributes.given.remove("value") {
            for axis in AXES {
                if attributes.given.contains_key(axis) {
                    let reason = Err("it cannot be combined with `value`".to_owned());
                    named::<()>(&mut attributes, name.as_deref(), axis, reason);
                }
            }
            named(&mut attributes, name.as_deref(), "value", values::vector(&text))
        } else {
            let [x, y, z] = AXES.map(|axis| {
                let text = attributes.take(axis)?;
                named(&mut attributes, name.as_deref(), axis, values::float(&text))
            });
            x.zip(y).zip(z).map(|((x, y), z)| DVec3::new(x, y, z))
        };
        attributes.settle(name.zip(vector.map(Value::Vector)))
    }

    fn spectrum(&mut self, context: Context, node: Node) -> Result<(String, Value), ElementFaults> {
        let mut attributes = self.attributes(context.document, node, &["name", "value", "filename"])?;
        let name = attributes.take("name");
        let (text, filename) = (attributes.given.remove("value"), attributes.given.remove("filename"));
        let value = match (text, filename) {
            // Builds of Mitsuba 0.x that render in RGB take three numbers for that.
            (Some(text), None) if values::is_triple(&text) => {
                let rgb = named(&mut attributes, name.as_deref(), "value", values::rgb(&text));
                return attributes.settle(name.zip(rgb.map(Value::Rgb)));
            }
            (Some(text), None) => named(&mut attributes, name.as_deref(), "value", values::spectrum(&text)),
            (None, Some(filename)) => match self.spectrum_file(context, &attributes.place, &filename) {
                Ok(spectrum) => Some(spectrum),
                Err(faults) => {
                    attributes.faults.extend(faults.into_list());
                    None
                }
            },
            (None, None) if attributes.lost => None,
            _ => {
                let field = field(&attributes, name.as_deref());
                let reason = "it needs either `value` or `filename`";
                attributes
                    .faults
                    .push(SceneError::value(&attributes.place, field, reason));
                None
            }
        };
        attributes.settle(name.zip(value.map(Value::Spectrum)))
    }

    /// The light of a black body, of Mitsuba 0.x.
    fn blackbody(&mut self, document: &Document, node: Node) -> Result<(String, Value), ElementFaults> {
        let mut attributes = self.attributes(document, node, &["name", "temperature", "scale"])?;
        let (name, text) = (attributes.take("name"), attributes.take("temperature"));
        let kelvin = text.and_then(|text| {
            let number = text.trim().trim_end_matches(['K', 'k']);
            let kelvin = values::float(number).and_then(values::temperature);
            named(&mut attributes, name.as_deref(), "temperature", kelvin)
        });
        let scale = match attributes.given.remove("scale") {
            Some(text) => named(&mut attributes, name.as_deref(), "scale", values::float(&text)),
            None => Some(1.0),
        };
        let value = kelvin
            .zip(scale)
            .map(|(kelvin, scale)| Value::Spectrum(SpectrumValue::Sampled(blackbody(kelvin, scale))));
        attributes.settle(name.zip(value))
    }

    fn spectrum_file(
        &mut self,
        context: Context,
        place: &Place,
        filename: &str,
    ) -> Result<SpectrumValue, ElementFaults> {
        let search = self.objects[context.parent].search.clone();
        let file = self.loader.open(place, &search, filename)?;
        Ok(values::spectrum_file(&file)?)
    }

    pub(super) fn transform(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let mut attributes = self.attributes(context.document, node, &["name"])?;
        let name = attributes.take("name");
        let total = self.operations(context, node, &mut attributes);
        let place = attributes.place.clone();
        let name = attributes.settle(name)?;
        Ok(self.set(context.parent, &place, &name, Value::Transform(Box::new(total)))?)
    }

    /// All operations of a transform together; what is wrong with them is collected.
    fn operations(&mut self, context: Context, node: Node, attributes: &mut Attributes) -> Transform {
        let mut total = transform::identity();
        for child in node.children() {
            let operation = if child.is_element() {
                self.operation(context, child, &total)
            } else {
                self.text(context.document, child, "transform");
                Ok(total)
            };
            match operation {
                Ok(map) => total = map,
                Err(faults) => attributes.faults.extend(faults.into_list()),
            }
        }
        total
    }

    /// An `<animation>`: transforms with their times, in any order.
    pub(super) fn animation(&mut self, context: Context, node: Node) -> Result<(), ElementFaults> {
        let mut attributes = self.attributes(context.document, node, &["name"])?;
        let name = attributes.take("name");
        let mut keyframes = Vec::new();
        for child in node.children() {
            if !child.is_element() {
                self.text(context.document, child, "animation");
                continue;
            }
            match self.keyframe(context, child) {
                Ok(keyframe) => keyframes.push(keyframe),
                Err(faults) => attributes.faults.extend(faults.into_list()),
            }
        }
        keyframes.sort_by(|(a, _, _), (b, _, _)| a.total_cmp(b));
        for pair in keyframes.windows(2) {
            let ((time, _, first), (again, _, second)) = (&pair[0], &pair[1]);
            if time == again {
                let reason = format!("{time} is the time of the transform at {first} as well");
                attributes
                    .faults
                    .push(SceneError::value(second, "<transform> time", reason));
            }
        }
        let (place, field) = (attributes.place.clone(), field(&attributes, name.as_deref()));
        let name = attributes.settle(name)?;
        let reason = match keyframes.is_empty() {
            true => "it has no <transform time=\"...\">",
            false => "some of its transforms mirror and others do not, so that a map between them has no inverse",
        };
        let keyframes = keyframes.into_iter().map(|(time, map, _)| (time, map)).collect();
        let animation = AnimatedTransform::new(keyframes).ok_or_else(|| SceneError::value(&place, field, reason))?;
        // Mitsuba's own scenes of motion call it so.
        let name = if name == "animation" { "to_world" } else { &name };
        Ok(self.set(context.parent, &place, name, Value::Animation(animation))?)
    }

    /// A `<transform>` within an `<animation>`: its time, its map and its place.
    fn keyframe(&mut self, context: Context, node: Node) -> Result<(f64, Transform, Place), ElementFaults> {
        let (place, element) = (context.document.place(node), node.tag_name().name());
        if element != "transform" {
            return Err(SceneError::unknown(&place, "<animation>", "element", element, ["transform"]).into());
        }
        let mut attributes = self.attributes(context.document, node, &["time"])?;
        let time = attributes.take("time");
        let time = time.and_then(|text| named(&mut attributes, None, "time", values::float(&text)));
        let map = self.operations(context, node, &mut attributes);
        let time = attributes.settle(time)?;
        Ok((time, map, place))
    }

    /// The transform `before` followed by an operation.
    fn operation(&mut self, context: Context, node: Node, before: &Transform) -> Result<Transform, ElementFaults> {
        let (place, element) = (context.document.place(node), names::operation(node.tag_name().name()));
        let Some((_, allowed)) = transform::OPERATIONS.iter().find(|(name, _)| *name == element) else {
            let allowed = transform::OPERATIONS.iter().map(|(name, _)| *name);
            return Err(SceneError::unknown(&place, "<transform>", "element", element, allowed).into());
        };
        let mut attributes = self.attributes(context.document, node, allowed)?;
        if let Err(faults) = self.no_children(context.document, node) {
            attributes.faults.extend(faults.into_list());
        }
        let wrong =
            |(attribute, reason): (&str, String)| SceneError::value(&place, format!("<{element}> {attribute}"), reason);
        let map = transform::operation(element, &attributes.given, attributes.lost);
        let map = map.map_err(|faults| attributes.faults.extend(faults.into_iter().map(wrong)));
        let map = attributes.settle(map.ok())?;
        let reason = "the transforms up to here have no finite inverse".to_owned();
        Ok(transform::checked(&map.after(before)).ok_or_else(|| wrong(("", reason)))?)
    }
}

/// The value of an attribute; what is wrong with it is collected, by the property's name.
fn named<T>(attributes: &mut Attributes, name: Option<&str>, attribute: &str, value: Result<T, String>) -> Option<T> {
    let field = format!("{} {attribute}", field(attributes, name));
    let value = value.map_err(|reason| SceneError::value(&attributes.place, field, reason));
    attributes.check(value)
}

/// The element as in messages: `<float name="radius">`.
fn field(attributes: &Attributes, name: Option<&str>) -> String {
    let element = attributes.element;
    name.map_or(format!("<{element}>"), |name| format!("<{element} name=\"{name}\">"))
}
