//! Transforms: the operations of a `<transform>`, applied one after the other.

use super::values;
use crate::math::Transform;
use glam::{DMat3, DMat4, DVec3, DVec4};

/// The attributes of an operation by name, parameters filled in.
pub(super) type Attributes<'a> = std::collections::BTreeMap<&'a str, String>;

/// Operations by element name, with the attributes that each may have.
pub(super) const OPERATIONS: [(&str, &[&str]); 5] = [
    ("translate", &["x", "y", "z", "value"]),
    ("rotate", &["x", "y", "z", "value", "angle"]),
    ("scale", &["x", "y", "z", "value"]),
    ("matrix", &["value"]),
    ("lookat", &["origin", "target", "up"]),
];

/// The map of one operation, or the attribute that is wrong and why.
pub(super) fn operation(name: &str, attributes: &Attributes) -> Result<Transform, (&'static str, String)> {
    let matrix = match name {
        "translate" => DMat4::from_translation(components(attributes, 0.0)?),
        "scale" => DMat4::from_scale(components(attributes, 1.0)?),
        "rotate" => rotation(components(attributes, 0.0)?, required(attributes, "angle")?)?,
        "matrix" => matrix(required(attributes, "value")?)?,
        _ => look_at(attributes)?,
    };
    let at_fault = if name == "lookat" { "target" } else { "value" };
    Transform::from_matrix(matrix).ok_or_else(|| {
        (
            at_fault,
            "the transform has no finite inverse, or the last row of its matrix is not 0 0 0 1".into(),
        )
    })
}

fn required<'a>(attributes: &'a Attributes, name: &'static str) -> Result<&'a str, (&'static str, String)> {
    attributes
        .get(name)
        .map(String::as_str)
        .ok_or((name, "it is missing".into()))
}

/// `x`, `y` and `z`, each `default` where left out, or a `value` for all three.
fn components(attributes: &Attributes, default: f64) -> Result<DVec3, (&'static str, String)> {
    if let Some(value) = attributes.get("value") {
        if ["x", "y", "z"].iter().any(|axis| attributes.contains_key(axis)) {
            return Err(("value", "it cannot be combined with `x`, `y` and `z`".into()));
        }
        return values::vector(value).map_err(|reason| ("value", reason));
    }
    let mut vector = DVec3::splat(default);
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        if let Some(text) = attributes.get(axis) {
            vector[i] = values::float(text).map_err(|reason| (axis, reason))?;
        }
    }
    Ok(vector)
}

/// Rotation about `axis` by an angle in degrees (Rodrigues).
fn rotation(axis: DVec3, angle: &str) -> Result<DMat4, (&'static str, String)> {
    let angle = values::float(angle).map_err(|reason| ("angle", reason))?;
    let axis = axis
        .try_normalize()
        .ok_or(("value", "the axis of rotation is zero".to_owned()))?;
    let (sin, cos) = libm::sincos(angle.to_radians());
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
    Ok(DMat4::from_mat3(
        DMat3::IDENTITY * cos + cross * sin + outer * (1.0 - cos),
    ))
}

/// 16 or 9 numbers by rows.
fn matrix(text: &str) -> Result<DMat4, (&'static str, String)> {
    let numbers = values::floats(text).map_err(|reason| ("value", reason))?;
    if let Ok(rows) = <[f64; 16]>::try_from(numbers.as_slice()) {
        return Ok(DMat4::from_cols_array(&rows).transpose());
    }
    if let Ok(rows) = <[f64; 9]>::try_from(numbers.as_slice()) {
        return Ok(DMat4::from_mat3(DMat3::from_cols_array(&rows).transpose()));
    }
    Err((
        "value",
        format!("a matrix has 16 or 9 numbers, found {}", numbers.len()),
    ))
}

/// The frame of a camera at `origin` that looks along +z at `target`.
fn look_at(attributes: &Attributes) -> Result<DMat4, (&'static str, String)> {
    let read = |name: &'static str| match values::floats(required(attributes, name)?) {
        Ok(v) if v.len() == 3 => Ok(DVec3::new(v[0], v[1], v[2])),
        Ok(v) => Err((name, format!("expected three numbers, found {}", v.len()))),
        Err(reason) => Err((name, reason)),
    };
    let (origin, target) = (read("origin")?, read("target")?);
    let forward = (target - origin)
        .try_normalize()
        .ok_or(("target", "it is the same point as `origin`".to_owned()))?;
    let up = match attributes.get("up") {
        Some(_) => read("up")?,
        None => any_perpendicular(forward),
    };
    let left = up
        .cross(forward)
        .try_normalize()
        .filter(|_| up.cross(forward).length() > 1e-12 * up.length());
    let left = left.ok_or(("up", "it is zero or parallel to the direction of view".to_owned()))?;
    let up = forward.cross(left);
    Ok(DMat4::from_cols(
        left.extend(0.0),
        up.extend(0.0),
        forward.extend(0.0),
        origin.extend(1.0),
    ))
}

fn any_perpendicular(v: DVec3) -> DVec3 {
    let axis = if v.x.abs() < 0.5 { DVec3::X } else { DVec3::Y };
    axis - v * axis.dot(v)
}

/// The identity, for a `<transform>` without operations.
pub(super) fn identity() -> Transform {
    Transform::default()
}

/// Whether a composed transform is still finite and invertible.
pub(super) fn checked(transform: &Transform) -> Option<Transform> {
    Transform::from_matrix(transform.matrix()).filter(|t| t.matrix().row(3) == DVec4::W)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;

    fn attributes<'a>(pairs: &[(&'a str, &str)]) -> Attributes<'a> {
        pairs.iter().map(|(name, value)| (*name, (*value).to_owned())).collect()
    }

    fn near(a: Vec3, b: Vec3) -> bool {
        (a - b).length() < 1e-6
    }

    #[test]
    fn rotation_turns_counter_clockwise_about_its_axis() {
        let turn = operation("rotate", &attributes(&[("z", "2"), ("angle", "90")])).unwrap();
        assert!(near(turn.vector(Vec3::X), Vec3::Y));
        let turn = operation("rotate", &attributes(&[("value", "1,1,1"), ("angle", "120")])).unwrap();
        assert!(near(turn.vector(Vec3::X), Vec3::Y) && near(turn.vector(Vec3::Y), Vec3::Z));
    }

    #[test]
    fn look_at_maps_z_to_the_direction_and_x_to_the_left() {
        let view = attributes(&[("origin", "1, 2, 3"), ("target", "1 2 2"), ("up", "0 1 0")]);
        let camera = operation("lookat", &view).unwrap();
        assert!(near(camera.point(Vec3::ZERO), Vec3::new(1.0, 2.0, 3.0)));
        assert!(near(camera.vector(Vec3::Z), -Vec3::Z));
        assert!(near(camera.vector(Vec3::X), -Vec3::X));
        assert!(near(camera.vector(Vec3::Y), Vec3::Y));
    }

    #[test]
    fn matrices_come_by_rows() {
        let m = operation("matrix", &attributes(&[("value", "0 -1 0  1 0 0  0 0 1")])).unwrap();
        assert!(near(m.point(Vec3::X), Vec3::Y));
        let m = operation("matrix", &attributes(&[("value", "1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1")])).unwrap();
        assert!(near(m.point(Vec3::ZERO), Vec3::new(5.0, 6.0, 7.0)));
    }

    #[test]
    fn what_cannot_be_inverted_is_refused() {
        for (name, pairs) in [
            ("scale", &[("x", "0")][..]),
            ("matrix", &[("value", "1 2 3")]),
            ("matrix", &[("value", "0 0 0 0 0 0 0 0 0")]),
            ("rotate", &[("angle", "10")]),
            ("lookat", &[("origin", "0 0 0"), ("target", "0 0 0"), ("up", "0 1 0")]),
            ("lookat", &[("origin", "0 0 0"), ("target", "0 1 0"), ("up", "0 1 0")]),
            ("translate", &[("x", "1"), ("value", "2")]),
        ] {
            assert!(operation(name, &attributes(pairs)).is_err(), "{name} {pairs:?}");
        }
    }
}
