use super::Vec3;

/// An orthonormal basis: local `z` is `n`. Local directions are what materials see.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Local x axis in world space.
    pub s: Vec3,
    /// Local y axis in world space.
    pub t: Vec3,
    /// Local z axis in world space.
    pub n: Vec3,
}

impl Frame {
    /// A right-handed basis around the unit vector `n` (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").
    #[must_use]
    pub fn from_normal(n: Vec3) -> Self {
        let sign = 1.0_f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        let s = Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
        let t = Vec3::new(b, sign + n.y * n.y * a, -n.y);
        Self { s, t, n }
    }

    /// World to local.
    #[must_use]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.s), v.dot(self.t), v.dot(self.n))
    }

    /// Local to world.
    #[must_use]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.s * v.x + self.t * v.y + self.n * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_is_orthonormal_and_right_handed() {
        for n in [
            Vec3::Z,
            -Vec3::Z,
            Vec3::X,
            Vec3::new(0.6, -0.64, 0.48),
            Vec3::new(0.1, 0.2, -0.974_679_4),
        ] {
            let frame = Frame::from_normal(n);
            assert!(frame.s.dot(frame.t).abs() < 1e-6);
            assert!(frame.s.dot(n).abs() < 1e-6);
            assert!((frame.s.cross(frame.t) - n).length() < 1e-6);
            let v = Vec3::new(0.3, -0.5, 0.7);
            assert!((frame.to_world(frame.to_local(v)) - v).length() < 1e-6);
        }
    }
}
