use super::{DVec3, Vec3};
use glam::{DMat3, DMat4};

/// An affine map in double precision, with its inverse. Scenes are built with it; rendering works on its results.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    matrix: DMat4,
    inverse: DMat4,
}

impl Default for Transform {
    fn default() -> Self {
        Self {
            matrix: DMat4::IDENTITY,
            inverse: DMat4::IDENTITY,
        }
    }
}

impl Transform {
    /// The map of a 4 x 4 matrix, or `None` where it has no finite inverse or is not affine.
    #[must_use]
    pub fn from_matrix(matrix: DMat4) -> Option<Self> {
        let affine = matrix.row(3) == glam::DVec4::W;
        let inverse = matrix.inverse();
        (affine && matrix.is_finite() && matrix.determinant() != 0.0 && inverse.is_finite())
            .then_some(Self { matrix, inverse })
    }

    /// The linear map `linear`, which has an inverse, followed by a translation.
    pub(super) fn from_parts(linear: DMat3, translation: DVec3) -> Self {
        let affine = |linear: DMat3, translation: DVec3| {
            let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis].map(|axis| axis.extend(0.0));
            DMat4::from_cols(x, y, z, translation.extend(1.0))
        };
        let inverse = linear.inverse();
        Self {
            matrix: affine(linear, translation),
            inverse: affine(inverse, -(inverse * translation)),
        }
    }

    /// The map that applies `first`, then `self`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        Self {
            matrix: self.matrix * first.matrix,
            inverse: first.inverse * self.inverse,
        }
    }

    /// The inverse map.
    #[must_use]
    pub fn inverted(&self) -> Self {
        Self {
            matrix: self.inverse,
            inverse: self.matrix,
        }
    }

    /// The matrix.
    #[must_use]
    pub fn matrix(&self) -> DMat4 {
        self.matrix
    }

    /// Maps a point.
    #[must_use]
    pub fn point(&self, p: Vec3) -> Vec3 {
        self.matrix.transform_point3(p.as_dvec3()).as_vec3()
    }

    /// Maps a vector; its length changes with the scale.
    #[must_use]
    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.matrix.transform_vector3(v.as_dvec3()).as_vec3()
    }

    /// Maps a surface normal by the inverse transpose and normalises it; zero stays zero.
    #[must_use]
    pub fn normal(&self, n: Vec3) -> Vec3 {
        let linear = DMat3::from_mat4(self.inverse).transpose();
        (linear * n.as_dvec3()).normalize_or(DVec3::ZERO).as_vec3()
    }

    /// Whether the map mirrors: it turns clockwise triangles into counter-clockwise ones.
    #[must_use]
    pub fn flips_handedness(&self) -> bool {
        self.matrix.determinant() < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_stay_perpendicular_under_uneven_scale() {
        let transform = Transform::from_matrix(DMat4::from_scale(DVec3::new(1.0, 4.0, 1.0))).unwrap();
        let tangent = transform.vector(Vec3::new(1.0, 1.0, 0.0));
        let normal = transform.normal(Vec3::new(1.0, -1.0, 0.0));
        assert!(tangent.dot(normal).abs() < 1e-6);
        assert!((normal.length() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_singular_or_projective_matrix_is_refused() {
        assert!(Transform::from_matrix(DMat4::ZERO).is_none());
        assert!(Transform::from_matrix(DMat4::perspective_rh(1.0, 1.0, 0.1, 10.0)).is_none());
    }
}
