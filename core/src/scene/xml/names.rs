//! Names of elements, attributes and properties in the format's dialects.

use super::super::description::{Kind, Object, Property, Value};
use super::super::error::{Place, SceneError, nearest, shortened};
use crate::math::Transform;
use glam::{DMat4, DVec3};

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

/// The type of an object. Where the names of files have no case, a capital first letter finds the same plugin.
pub(super) fn plugin(written: &str) -> String {
    let mut rest = written.chars();
    match rest.next() {
        Some(first) => first.to_ascii_lowercase().to_string() + rest.as_str(),
        None => String::new(),
    }
}

/// The element of today for one of files before Mitsuba 0.4.
pub(super) fn element(element: &str) -> &str {
    match element {
        "camera" => "sensor",
        "luminaire" => "emitter",
        other => other,
    }
}

/// Brings an object that was written as `element` up to date, as Mitsuba 0.6 does with files from before 0.4: images were mirrored
/// then, `fov` was of the smaller side unless told, and lights of any type had an `intensity`.
pub(super) fn upgrade(element: &str, object: &mut Object) {
    match (element, object.plugin.as_str()) {
        ("camera", plugin) => {
            let of_larger_side = matches!(
                object.properties.remove("map_smaller_side"),
                Some(Property {
                    value: Value::Boolean(false),
                    ..
                })
            );
            let place = object.place.clone();
            if plugin == "perspective" {
                let axis = if of_larger_side { "larger" } else { "smaller" };
                let value = Value::String(axis.to_owned());
                object
                    .properties
                    .entry("fov_axis".to_owned())
                    .or_insert(Property { value, place });
            }
            if let Some(Property {
                value: Value::Transform(to_world),
                ..
            }) = object.properties.get_mut("to_world")
                && let Some(mirror) = Transform::from_matrix(DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)))
            {
                **to_world = to_world.after(&mirror);
            }
        }
        ("texture", "checkerboard" | "gridtexture") => {
            rename(object, "bright_color", "color0");
            rename(object, "dark_color", "color1");
        }
        ("luminaire", "envmap") => rename(object, "intensity_scale", "scale"),
        ("luminaire", "area" | "constant") => rename(object, "intensity", "radiance"),
        ("luminaire", "directional") => rename(object, "intensity", "irradiance"),
        _ => {}
    }
}

fn rename(object: &mut Object, from: &str, to: &str) {
    if let Some(property) = object.properties.remove(from) {
        object.properties.insert(to.to_owned(), property);
    }
    for child in object
        .children
        .iter_mut()
        .filter(|child| child.name.as_deref() == Some(from))
    {
        child.name = Some(to.to_owned());
    }
}

/// Checks a file's `version` attribute: 0.x to 3.x.
pub(super) fn check_version(place: &Place, version: &str) -> Result<(), SceneError> {
    let parts: Option<Vec<u32>> = version.trim().split('.').map(|part| part.parse().ok()).collect();
    let known = match parts.as_deref() {
        Some([major, ..]) => (0..=3).contains(major) && version.split('.').count() <= 3,
        _ => false,
    };
    if known {
        return Ok(());
    }
    let reason = format!("`{}` is not a version from 0.x to 3.x", shortened(version));
    Err(SceneError::value(place, "version", reason))
}

/// Elements that are no objects.
const OTHER_ELEMENTS: [&str; 17] = [
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
    "default",
    "include",
    "path",
    "ref",
    "alias",
];

/// The error for an element that looks like a misspelt one; `None` for one of another program, which can be left out.
pub(super) fn misspelt_element(place: &Place, element: &str) -> Option<SceneError> {
    let objects = Kind::ELEMENTS.iter().map(|(name, _)| *name);
    let known = objects.filter(|name| *name != "scene").chain(OTHER_ELEMENTS);
    nearest(element, known.clone())?;
    Some(SceneError::unknown(place, "scene", "element", element, known))
}

/// Whether an element is a property, or something else that is no object.
pub(super) fn is_other_element(element: &str) -> bool {
    OTHER_ELEMENTS.contains(&element)
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
    fn versions_up_to_3_are_accepted() {
        let place = Place::whole("x");
        for good in [
            "0.2.1", "0.4.0", "0.5.0", "0.6.0", "2.0.0", "2.1.0", "3.0.0", "3.9.1", "0.5",
        ] {
            assert!(check_version(&place, good).is_ok(), "{good}");
        }
        for bad in ["", "4.0.0", "x", "1.2.3.4", "3.-1"] {
            assert!(check_version(&place, bad).is_err(), "{bad}");
        }
    }
}
