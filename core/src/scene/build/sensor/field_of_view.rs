//! Fields of view.

use crate::scene::description::Value;
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;

/// The horizontal field of view \[radians\] of `fov` and `fov_axis`, or of `focal_length` on 35 mm film.
pub(in crate::scene::build) fn horizontal_field_of_view(reader: &Reader, aspect: f64) -> Result<f64, SceneError> {
    #[derive(Clone, Copy)]
    enum Axis {
        X,
        Y,
        Diagonal,
    }
    let (smaller, larger) = if aspect > 1.0 {
        (Axis::Y, Axis::X)
    } else {
        (Axis::X, Axis::Y)
    };
    let axes = [
        ("x", Axis::X),
        ("y", Axis::Y),
        ("diagonal", Axis::Diagonal),
        ("smaller", smaller),
        ("larger", larger),
    ];
    let axis = reader.choice("fov_axis", &axes, Axis::X)?;
    let fov = reader.float("fov", 1e-3..=179.999)?;
    let length = focal_length(reader)?;
    let (fov, axis) = match (fov, length) {
        (Some(_), Some(_)) => return Err(reader.wrong("fov", "give either `fov` or `focal_length`, not both")),
        (Some(fov), None) => (fov.to_radians(), axis),
        // The diagonal of a 36 mm by 24 mm image.
        (None, length) => (
            2.0 * libm::atan(1872.0_f64.sqrt() / (2.0 * length.unwrap_or(50.0))),
            Axis::Diagonal,
        ),
    };
    let half = libm::tan(0.5 * fov);
    let fov_x = 2.0
        * libm::atan(match axis {
            Axis::X => half,
            Axis::Y => half * aspect,
            Axis::Diagonal => half / (1.0 + 1.0 / (aspect * aspect)).sqrt(),
        });
    let degrees = fov_x.to_degrees();
    if !(1e-3..=179.999).contains(&degrees) {
        let reason = format!("the horizontal field of view is {degrees} degrees; allowed: 0.001 to 179.999");
        return Err(reader.wrong("fov", reason));
    }
    Ok(fov_x)
}

/// `focal_length` \[mm\]: a number, or a string such as `50mm`.
fn focal_length(reader: &Reader) -> Result<Option<f64>, SceneError> {
    let Some(Value::String(text)) = reader.property("focal_length").map(|property| &property.value) else {
        return reader.float("focal_length", 0.1..=1e6);
    };
    let number = text
        .trim()
        .strip_suffix("mm")
        .unwrap_or(text)
        .trim()
        .parse::<f64>()
        .ok();
    let number = number.filter(|length| (0.1..=1e6).contains(length));
    number.map(Some).ok_or_else(|| {
        reader.wrong(
            "focal_length",
            format!("`{text:.40}` is not a length from 0.1mm to 1000000mm"),
        )
    })
}
