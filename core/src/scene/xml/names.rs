//! Names of elements, attributes and properties in the format's dialects.

use super::super::description::{Kind, Object, Property, Value};
use super::super::error::{Place, SceneError, shortened};

/// Property names of the 0.x dialect in the form of today: `toWorld` is `to_world`, `intIOR` is `int_ior`.
pub(super) fn snake_case(name: &str) -> String {
    let mut snake = String::with_capacity(name.len() + 4);
    let (mut after_lower, mut lowering) = (false, false);
    for c in name.chars() {
        if c.is_ascii_uppercase() && (after_lower || lowering) {
            if after_lower {
                snake.push('_');
            }
            snake.push(c.to_ascii_lowercase());
            (after_lower, lowering) = (false, true);
        } else {
            snake.push(c);
            (after_lower, lowering) = (c.is_ascii_lowercase(), false);
        }
    }
    snake
}

/// Transform operations of the 0.x dialect in the form of today.
pub(super) fn operation(element: &str) -> &str {
    if element == "lookAt" { "lookat" } else { element }
}

/// Says of an object in a file for Mitsuba 0.x that it is one, where its type means something else in Mitsuba 3: up is +y for a `sunsky`
/// then, and its sun is another.
pub(super) fn mark_old_dialect(object: &mut Object) {
    if object.kind == Kind::Emitter && object.plugin == "sunsky" {
        let place = object.place.clone();
        let value = Value::Boolean(true);
        let property = Property { value, place };
        object.properties.insert("old_dialect".to_owned(), property);
    }
}

/// Checks a file's `version` attribute: 0.4 to 3.x.
pub(super) fn check_version(place: &Place, version: &str) -> Result<(), SceneError> {
    let parts: Option<Vec<u32>> = version.trim().split('.').map(|part| part.parse().ok()).collect();
    let known = match parts.as_deref() {
        Some([0, minor] | [0, minor, _]) => *minor >= 4,
        Some([major, ..]) => (1..=3).contains(major) && version.split('.').count() <= 3,
        _ => false,
    };
    if known {
        return Ok(());
    }
    let reason = format!("`{}` is not a version from 0.4.0 to 3.x", shortened(version));
    Err(SceneError::value(place, "version", reason))
}

/// The error for an element that is no object and no value.
pub(super) fn unknown_element(place: &Place, element: &str) -> SceneError {
    let objects = Kind::ELEMENTS
        .iter()
        .map(|(name, _)| *name)
        .filter(|name| *name != "scene");
    let values = [
        "float",
        "integer",
        "boolean",
        "string",
        "point",
        "vector",
        "rgb",
        "srgb",
        "spectrum",
        "blackbody",
        "transform",
        "animation",
    ];
    let rest = ["default", "include", "path", "ref", "alias"];
    SceneError::unknown(place, "scene", "element", element, objects.chain(values).chain(rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camel_case_becomes_snake_case() {
        for (camel, snake) in [
            ("toWorld", "to_world"),
            ("intIOR", "int_ior"),
            ("alphaU", "alpha_u"),
            ("specularReflectance", "specular_reflectance"),
            ("to_world", "to_world"),
            ("color0", "color0"),
            ("principalPointOffsetX", "principal_point_offset_x"),
            ("K", "K"),
            ("", ""),
        ] {
            assert_eq!(snake_case(camel), snake);
        }
    }

    #[test]
    fn versions_from_0_4_to_3_are_accepted() {
        let place = Place::whole("x");
        for good in ["0.4.0", "0.5.0", "0.6.0", "2.0.0", "2.1.0", "3.0.0", "3.9.1", "0.5"] {
            assert!(check_version(&place, good).is_ok(), "{good}");
        }
        for bad in ["", "0.3.0", "4.0.0", "x", "1.2.3.4", "3.-1"] {
            assert!(check_version(&place, bad).is_err(), "{bad}");
        }
    }
}
