//! Elements that are values: `<float>`, `<rgb>`, `<transform>` and so on.

use super::super::description::Value;
use super::super::error::{Place, SceneError};
use super::document::Document;
use super::{Context, XmlReader, names, take, transform, values};
use roxmltree::Node;

impl XmlReader<'_, '_> {
    /// The name and the value of a property's element.
    pub(super) fn property(&mut self, context: Context, node: Node) -> Result<(String, Value), SceneError> {
        let (document, place, element) = (context.document, context.document.place(node), node.tag_name().name());
        if element == "point" || element == "vector" {
            return self.vector(document, node);
        }
        if element == "spectrum" {
            return self.spectrum(context, node);
        }
        let scalar = ["float", "integer", "boolean", "string", "rgb"];
        if !scalar.contains(&element) {
            return Err(names::unknown_element(&place, element));
        }
        let mut attributes = self.attributes(document, node, &["name", "value"])?;
        let name = take(&mut attributes, &place, element, "name")?;
        let text = take(&mut attributes, &place, element, "value")?;
        let value = match element {
            "float" => values::float(&text).map(Value::Float),
            "integer" => values::integer(&text).map(Value::Integer),
            "boolean" => values::boolean(&text).map(Value::Boolean),
            "rgb" => values::rgb(&text).map(Value::Rgb),
            _ => Ok(Value::String(text)),
        };
        named(&place, element, name, value)
    }

    fn vector(&mut self, document: &Document, node: Node) -> Result<(String, Value), SceneError> {
        let (place, element) = (document.place(node), node.tag_name().name());
        let mut attributes = self.attributes(document, node, &["name", "value", "x", "y", "z"])?;
        let name = take(&mut attributes, &place, element, "name")?;
        let text = if attributes.contains_key("value") {
            let text = take(&mut attributes, &place, element, "value")?;
            if let Some(extra) = attributes.keys().next() {
                let field = format!("<{element} name=\"{name}\"> {extra}");
                return Err(SceneError::value(&place, field, "it cannot be combined with `value`"));
            }
            text
        } else {
            let axes = ["x", "y", "z"].map(|axis| take(&mut attributes, &place, element, axis));
            axes.into_iter().collect::<Result<Vec<_>, _>>()?.join(" ")
        };
        named(&place, element, name, values::vector(&text).map(Value::Vector))
    }

    fn spectrum(&mut self, context: Context, node: Node) -> Result<(String, Value), SceneError> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["name", "value", "filename"])?;
        let name = take(&mut attributes, &place, "spectrum", "name")?;
        match (attributes.get("value"), attributes.get("filename")) {
            (Some(text), None) => named(&place, "spectrum", name, values::spectrum(text).map(Value::Spectrum)),
            (None, Some(filename)) => {
                let search = self.objects[context.parent].search.clone();
                let file = self.loader.open(&place, &search, filename)?;
                let spectrum = values::spectrum_file(&file.bytes);
                spectrum
                    .map(|spectrum| (name, Value::Spectrum(spectrum)))
                    .map_err(|(line, reason)| {
                        SceneError::data(
                            &Place {
                                file: file.name.as_str().into(),
                                line,
                            },
                            reason,
                        )
                    })
            }
            _ => {
                let field = format!("<spectrum name=\"{name}\">");
                Err(SceneError::value(
                    &place,
                    field,
                    "it needs either `value` or `filename`",
                ))
            }
        }
    }

    pub(super) fn transform(&mut self, context: Context, node: Node) -> Result<(), SceneError> {
        let place = context.document.place(node);
        let mut attributes = self.attributes(context.document, node, &["name"])?;
        let name = take(&mut attributes, &place, "transform", "name")?;
        let mut total = transform::identity();
        for child in node.children() {
            if !child.is_element() {
                context.document.no_text(child, "transform")?;
                continue;
            }
            let (place, element) = (context.document.place(child), names::operation(child.tag_name().name()));
            let Some((_, allowed)) = transform::OPERATIONS.iter().find(|(name, _)| *name == element) else {
                let allowed = transform::OPERATIONS.iter().map(|(name, _)| *name);
                return Err(SceneError::unknown(&place, "<transform>", "element", element, allowed));
            };
            let attributes = self.attributes(context.document, child, allowed)?;
            self.no_children(context.document, child)?;
            let wrong = |(attribute, reason): (&str, String)| {
                SceneError::value(&place, format!("<{element}> {attribute}"), reason)
            };
            let operation = transform::operation(element, &attributes).map_err(wrong)?;
            let reason = "the transforms up to here have no finite inverse".to_owned();
            total = transform::checked(&operation.after(&total)).ok_or_else(|| wrong(("", reason)))?;
        }
        self.set(context.parent, &place, &name, Value::Transform(Box::new(total)))
    }
}

/// A value with its name, or the error about it.
fn named(
    place: &Place,
    element: &str,
    name: String,
    value: Result<Value, String>,
) -> Result<(String, Value), SceneError> {
    match value {
        Ok(value) => Ok((name, value)),
        Err(reason) => {
            let field = format!("<{element} name=\"{name}\"> value");
            Err(SceneError::value(place, field, reason))
        }
    }
}
