//! From a point to the coordinates of a texture.

use super::TexturePoint;
use crate::math::{FRAC_1_PI, PI, TAU, Transform, Vec2, Vec3, acos, atan2};

/// Affine map of surface coordinates: linear part by rows, then offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvTransform {
    /// Rows of the linear part.
    pub linear: [Vec2; 2],
    /// Added after the linear part.
    pub offset: Vec2,
}

impl UvTransform {
    /// Leaves coordinates as they are.
    pub const IDENTITY: Self = Self {
        linear: [Vec2::X, Vec2::Y],
        offset: Vec2::ZERO,
    };

    /// Maps surface coordinates to texture coordinates.
    #[must_use]
    pub fn apply(&self, uv: Vec2) -> Vec2 {
        Vec2::new(self.linear[0].dot(uv), self.linear[1].dot(uv)) + self.offset
    }

    /// From derivatives by texture coordinates to derivatives by surface coordinates.
    pub(super) fn gradient(&self, of_texture: Vec2) -> Vec2 {
        self.linear[0] * of_texture.x + self.linear[1] * of_texture.y
    }
}

/// Coordinates from the position in the texture's own space, as in pbrt, in the place of the surface's.
#[derive(Clone, Copy, Debug)]
pub enum Mapping {
    /// Colatitude over pi and longitude over 2 pi, about +z.
    Spherical,
    /// Longitude over 2 pi, from -x on, and height, about +z.
    Cylindrical,
    /// Components along two vectors.
    Planar([Vec3; 2]),
}

impl Mapping {
    /// Coordinates of a point, whose position `to_local` brings into the texture's space.
    pub(super) fn coordinates(&self, to_local: &Transform, at: &TexturePoint) -> Vec2 {
        let p = to_local.point(at.position);
        match self {
            Self::Spherical => {
                let w = p.normalize_or_zero();
                let longitude = atan2(w.y, w.x);
                let longitude = if longitude < 0.0 { longitude + TAU } else { longitude };
                Vec2::new(acos(w.z.clamp(-1.0, 1.0)) * FRAC_1_PI, longitude / TAU)
            }
            Self::Cylindrical => Vec2::new((PI + atan2(p.y, p.x)) / TAU, p.z),
            Self::Planar([s, t]) => Vec2::new(p.dot(*s), p.dot(*t)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, DVec3};

    /// By hand, from the formulas of Pharr, Jakob and Humphreys 2016, section 10.2.
    #[test]
    fn mappings_are_those_of_pbrt() {
        let to_local = Transform::from_matrix(DMat4::from_translation(DVec3::new(-1.0, -2.0, -3.0))).unwrap();
        let at = |x: f32, y: f32, z: f32| TexturePoint {
            position: Vec3::new(1.0 + x, 2.0 + y, 3.0 + z),
            ..TexturePoint::of_uv(Vec2::ZERO)
        };
        let planar = Mapping::Planar([Vec3::new(0.5, 0.0, 0.0), Vec3::new(0.0, 1.0, -1.0)]);
        let cases = [
            (Mapping::Spherical, at(0.0, 0.0, 5.0), [0.0, 0.0]),
            (Mapping::Spherical, at(0.0, 2.0, 0.0), [0.5, 0.25]),
            (Mapping::Spherical, at(0.0, -2.0, -2.0), [0.75, 0.75]),
            (Mapping::Cylindrical, at(3.0, 0.0, 4.0), [0.5, 4.0]),
            (Mapping::Cylindrical, at(0.0, -1.0, -1.0), [0.25, -1.0]),
            (planar, at(4.0, 3.0, 1.0), [2.0, 2.0]),
        ];
        for (mapping, at, expected) in cases {
            let found = mapping.coordinates(&to_local, &at);
            assert!((found - Vec2::from(expected)).length() < 1e-6, "{mapping:?} {found}");
        }
    }
}
