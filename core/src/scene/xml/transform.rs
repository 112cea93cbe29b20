//! Transforms: the operations of a `<transform>`, applied one after the other.

use super::attributes::Values;
use super::values;
use crate::math::Transform;
use glam::{DMat3, DMat4, DVec3, DVec4};

/// Operations by element name, with the attributes that each may have.
pub(super) const OPERATIONS: [(&str, &[&str]); 5] = [
    ("translate", &["x", "y", "z", "value"]),
    ("rotate", &["x", "y", "z", "value", "angle"]),
    ("scale", &["x", "y", "z", "value"]),
    ("matrix", &["value"]),
    ("lookat", &["origin", "target", "up"]),
];

/// Attributes that are wrong, and why.
type Faults = Vec<(&'static str, String)>;

/// The attributes of an operation, and what is wrong with them.
struct Reader<'a> {
    attributes: &'a Values<'a>,
    /// Whether some attribute is not among them: one that seems to be missing may be that one.
    lost: bool,
    faults: Faults,
}

/// The map of one operation, or all attributes that are wrong. `lost`: attributes were given that cannot be read.
pub(super) fn operation(name: &str, attributes: &Values, lost: bool) -> Result<Transform, Faults> {
    let mut reader = Reader {
        attributes,
        lost,
        faults: Faults::new(),
    };
    let matrix = match name {
        "translate" => reader.components(0.0).map(DMat4::from_translation),
        "scale" => reader.components(1.0).map(DMat4::from_scale),
        "rotate" => reader.rotation(),
        "matrix" => reader.matrix(),
        _ => reader.look_at(),
    };
    let Some(matrix) = matrix.filter(|_| reader.faults.is_empty()) else {
        return Err(reader.faults);
    };
    let at_fault = if name == "lookat" { "target" } else { "value" };
    let reason = "the transform has no finite inverse, or the last row of its matrix is not 0 0 0 1";
    Transform::from_matrix(matrix).ok_or_else(|| vec![(at_fault, reason.into())])
}

impl Reader<'_> {
    fn wrong<T>(&mut self, name: &'static str, reason: impl Into<String>) -> Option<T> {
        self.faults.push((name, reason.into()));
        None
    }

    /// The value of the attribute `name` by `parse`. It must be there.
    fn required<T>(&mut self, name: &'static str, parse: impl Fn(&str) -> Result<T, String>) -> Option<T> {
        match self.attributes.get(name).map(|text| parse(text)) {
            Some(Ok(value)) => Some(value),
            Some(Err(reason)) => self.wrong(name, reason),
            None if self.lost => None,
            None => self.wrong(name, "it is missing"),
        }
    }

    /// `x`, `y` and `z`, each `default` where left out, or a `value` for all three.
    fn components(&mut self, default: f64) -> Option<DVec3> {
        let given = |axis: &&str| self.attributes.contains_key(axis);
        let axes: Vec<&'static str> = ["x", "y", "z"].into_iter().filter(given).collect();
        if self.attributes.contains_key("value") {
            if !axes.is_empty() {
                self.wrong::<()>("value", "it cannot be combined with `x`, `y` and `z`");
            }
            return self.required("value", values::vector);
        }
        let mut component = |axis| {
            if axes.contains(&axis) {
                self.required(axis, values::float)
            } else {
                Some(default)
            }
        };
        let (x, y, z) = (component("x"), component("y"), component("z"));
        Some(DVec3::new(x?, y?, z?))
    }

    /// Rotation about an axis by an angle in degrees (Rodrigues).
    fn rotation(&mut self) -> Option<DMat4> {
        let (axis, angle) = (self.components(0.0), self.required("angle", values::float));
        let Some(axis) = axis?.try_normalize() else {
            return if self.lost {
                None
            } else {
                self.wrong("value", "the axis of rotation is zero")
            };
        };
        let (sin, cos) = libm::sincos(angle?.to_radians());
        let cross = DMat3::from_cols(
            DVec3::new(0.0, axis.z, -axis.y),
            DVec3::new(-axis.z, 0.0, axis.x),
            DVec3::new(axis.y, -axis.x, 0.0),
        );
        let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        Some(DMat4::from_mat3(
            DMat3::IDENTITY * cos + cross * sin + outer * (1.0 - cos),
        ))
    }

    /// 16 or 9 numbers by rows.
    fn matrix(&mut self) -> Option<DMat4> {
        let numbers = self.required("value", values::floats)?;
        if let Ok(rows) = <[f64; 16]>::try_from(numbers.as_slice()) {
            return Some(affine(DMat4::from_cols_array(&rows).transpose()));
        }
        if let Ok(rows) = <[f64; 9]>::try_from(numbers.as_slice()) {
            return Some(DMat4::from_mat3(DMat3::from_cols_array(&rows).transpose()));
        }
        self.wrong(
            "value",
            format!("a matrix has 16 or 9 numbers, found {}", numbers.len()),
        )
    }

    /// The frame of a camera at `origin` that looks along +z at `target`.
    fn look_at(&mut self) -> Option<DMat4> {
        let three = |text: &str| match values::floats(text)?[..] {
            [x, y, z] => Ok(DVec3::new(x, y, z)),
            ref numbers => Err(format!("expected three numbers, found {}", numbers.len())),
        };
        let (origin, target) = (self.required("origin", three), self.required("target", three));
        let up = self.attributes.contains_key("up").then(|| self.required("up", three));
        let (origin, target) = (origin?, target?);
        let Some(forward) = (target - origin).try_normalize() else {
            return self.wrong("target", "it is the same point as `origin`");
        };
        let up = match up {
            Some(given) => given?,
            None => any_perpendicular(forward),
        };
        let left = up
            .cross(forward)
            .try_normalize()
            .filter(|_| up.cross(forward).length() > 1e-12 * up.length());
        let Some(left) = left else {
            return self.wrong("up", "it is zero or parallel to the direction of view");
        };
        let up = forward.cross(left);
        Some(DMat4::from_cols(
            left.extend(0.0),
            up.extend(0.0),
            forward.extend(0.0),
            origin.extend(1.0),
        ))
    }
}

/// The matrix with 0 0 0 1 as its last row, where that is what it holds but for the rounding of the program that wrote it.
fn affine(matrix: DMat4) -> DMat4 {
    if !matrix.row(3).abs_diff_eq(DVec4::W, 1e-5) {
        return matrix;
    }
    let mut rows = matrix.transpose();
    rows.w_axis = DVec4::W;
    rows.transpose()
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

    fn attributes<'a>(pairs: &[(&'a str, &str)]) -> Values<'a> {
        pairs.iter().map(|(name, value)| (*name, (*value).to_owned())).collect()
    }

    fn near(a: Vec3, b: Vec3) -> bool {
        (a - b).length() < 1e-6
    }

    #[test]
    fn rotation_turns_counter_clockwise_about_its_axis() {
        let turn = operation("rotate", &attributes(&[("z", "2"), ("angle", "90")]), false).unwrap();
        assert!(near(turn.vector(Vec3::X), Vec3::Y));
        let turn = operation("rotate", &attributes(&[("value", "1,1,1"), ("angle", "120")]), false).unwrap();
        assert!(near(turn.vector(Vec3::X), Vec3::Y) && near(turn.vector(Vec3::Y), Vec3::Z));
    }

    #[test]
    fn look_at_maps_z_to_the_direction_and_x_to_the_left() {
        let view = attributes(&[("origin", "1, 2, 3"), ("target", "1 2 2"), ("up", "0 1 0")]);
        let camera = operation("lookat", &view, false).unwrap();
        assert!(near(camera.point(Vec3::ZERO), Vec3::new(1.0, 2.0, 3.0)));
        assert!(near(camera.vector(Vec3::Z), -Vec3::Z));
        assert!(near(camera.vector(Vec3::X), -Vec3::X));
        assert!(near(camera.vector(Vec3::Y), Vec3::Y));
    }

    #[test]
    fn matrices_come_by_rows() {
        let m = operation("matrix", &attributes(&[("value", "0 -1 0  1 0 0  0 0 1")]), false).unwrap();
        assert!(near(m.point(Vec3::X), Vec3::Y));
        let m = operation(
            "matrix",
            &attributes(&[("value", "1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1")]),
            false,
        )
        .unwrap();
        assert!(near(m.point(Vec3::ZERO), Vec3::new(5.0, 6.0, 7.0)));
    }

    #[test]
    fn the_last_row_of_a_matrix_may_be_rounded() {
        let matrix = |row: &str| {
            let value = format!("1 0 0 5 0 1 0 6 0 0 1 7 {row}");
            operation("matrix", &attributes(&[("value", &value)]), false)
        };
        let m = matrix("-0.0 1e-9 0 1.000000238418579").unwrap();
        assert_eq!(m.matrix().row(3), DVec4::W);
        assert_eq!(m.point(Vec3::ZERO), Vec3::new(5.0, 6.0, 7.0));
        assert!(matrix("0 0 0 2").is_err() && matrix("0 0 0.1 1").is_err());
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
            assert!(operation(name, &attributes(pairs), false).is_err(), "{name} {pairs:?}");
        }
    }

    #[test]
    fn every_bad_attribute_is_named() {
        for (name, pairs, lost, expected) in [
            (
                "translate",
                &[("x", "a"), ("y", "1"), ("z", "b")][..],
                false,
                &["x", "z"][..],
            ),
            ("scale", &[("x", "1"), ("value", "a")], false, &["value", "value"]),
            ("rotate", &[("y", "a")], false, &["y", "angle"]),
            ("rotate", &[("y", "a")], true, &["y"]),
            (
                "lookat",
                &[("origin", "a"), ("up", "1 2")],
                false,
                &["origin", "target", "up"],
            ),
        ] {
            let faults = operation(name, &attributes(pairs), lost).unwrap_err();
            let named: Vec<&str> = faults.iter().map(|(attribute, _)| *attribute).collect();
            assert_eq!(named, expected, "{name} {pairs:?}");
        }
    }
}
