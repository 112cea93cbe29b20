//! The state that directives change, and its transforms.

use super::colour::ColourSpace;
use super::medium::Interface;
use super::parameter::Parameters;
use super::values::Parameter;
use crate::scene::description::ObjectId;
use glam::{DMat3, DMat4, DVec3, DVec4};
use std::rc::Rc;

/// What shapes, lights and materials are made with.
#[derive(Clone)]
pub(super) struct State {
    /// The map to the world from the space that the next directives write in, when the shutter opens and when it closes.
    pub(super) to_world: [DMat4; 2],
    /// Which of the two transforms directives change.
    pub(super) active: [bool; 2],
    /// `None` stands for a grey diffuse surface.
    pub(super) material: Option<ObjectId>,
    pub(super) area_light: Option<Rc<Parameters>>,
    pub(super) reverse_orientation: bool,
    /// What lies on the sides of shapes.
    pub(super) interface: Interface,
    pub(super) space: ColourSpace,
    /// What `Attribute` has set, in the order of [`ATTRIBUTES`].
    pub(super) defaults: [Rc<Vec<Rc<Parameter>>>; ATTRIBUTES.len()],
}

/// What an `Attribute` may be for.
pub(super) const ATTRIBUTES: [&str; 5] = ["shape", "light", "material", "medium", "texture"];

impl Default for State {
    fn default() -> Self {
        Self {
            to_world: [DMat4::IDENTITY; 2],
            active: [true; 2],
            material: None,
            area_light: None,
            reverse_orientation: false,
            interface: Interface::default(),
            space: ColourSpace::default(),
            defaults: Default::default(),
        }
    }
}

impl State {
    /// Changes the transforms that are active.
    pub(super) fn change(&mut self, change: impl Fn(DMat4) -> DMat4) {
        for (matrix, active) in self.to_world.iter_mut().zip(self.active) {
            if active {
                *matrix = change(*matrix);
            }
        }
    }

    /// The transforms, each after `first`.
    pub(super) fn placed(&self, first: DMat4) -> [DMat4; 2] {
        self.to_world.map(|matrix| matrix * first)
    }

    /// Whether the transform mirrors.
    pub(super) fn mirrors(&self) -> bool {
        self.to_world[0].determinant() < 0.0
    }

    /// The defaults that `Attribute` has set for what `name` says.
    pub(super) fn defaults(&self, name: &str) -> &Rc<Vec<Rc<Parameter>>> {
        let index = ATTRIBUTES.iter().position(|attribute| *attribute == name);
        &self.defaults[index.unwrap_or_default()]
    }
}

/// What begins and ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Block {
    Attribute,
    Transform,
    Object,
}

impl Block {
    pub(super) fn begin(self) -> &'static str {
        match self {
            Self::Attribute => "AttributeBegin",
            Self::Transform => "TransformBegin",
            Self::Object => "ObjectBegin",
        }
    }
}

/// Rotation about an axis by an angle in degrees (Rodrigues); `None` for an axis without a length.
pub(super) fn rotation(degrees: f64, axis: DVec3) -> Option<DMat4> {
    let axis = axis.try_normalize()?;
    let (sin, cos) = libm::sincos(degrees.to_radians());
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

/// The map from the world to a camera at `eye` that looks at `target`: +z there, with +x to the right and +y up. `None` where these
/// do not give directions.
pub(super) fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> Option<DMat4> {
    let forward = (target - eye).try_normalize()?;
    let right = up.try_normalize()?.cross(forward).try_normalize()?;
    let up = forward.cross(right);
    let to_world = DMat4::from_cols(right.extend(0.0), up.extend(0.0), forward.extend(0.0), eye.extend(1.0));
    Some(inverse(to_world))
}

/// The inverse of a map, affine to the last bit where the map is.
pub(super) fn inverse(matrix: DMat4) -> DMat4 {
    if matrix.row(3) != DVec4::W {
        return matrix.inverse();
    }
    let linear = DMat3::from_mat4(matrix).inverse();
    let translation = -(linear * matrix.w_axis.truncate());
    let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis].map(|axis| axis.extend(0.0));
    DMat4::from_cols(x, y, z, translation.extend(1.0))
}

/// A rotation whose z axis is `direction`.
pub(super) fn facing(direction: DVec3) -> Option<DMat4> {
    let z = direction.try_normalize()?;
    let x = z.any_orthonormal_vector();
    let y = z.cross(x);
    Some(DMat4::from_mat3(DMat3::from_cols(x, y, z)))
}
