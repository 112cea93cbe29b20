use super::{DVec3, Transform};
use glam::{DMat3, DQuat};

/// An affine map that changes with time, given by keyframes.
///
/// Between two keyframes the parts of the map are interpolated: the translation and the symmetric stretch (scale and shear)
/// linearly, the rotation along the shortest arc (slerp, Shoemake 1985). The parts are those of the polar decomposition (Shoemake
/// and Duff 1992, "Matrix Animation and Polar Decomposition"). Before the first keyframe and after the last the map stands still.
#[derive(Clone, Debug, PartialEq)]
pub struct AnimatedTransform {
    /// At least one; times rise strictly.
    keyframes: Vec<Keyframe>,
}

#[derive(Clone, Debug, PartialEq)]
struct Keyframe {
    time: f64,
    transform: Transform,
    parts: Parts,
}

/// `x -> translation + rotation * stretch * x`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Parts {
    translation: DVec3,
    rotation: DQuat,
    /// Symmetric; its eigenvalues are all positive, or all negative where the map mirrors.
    stretch: DMat3,
}

impl Default for AnimatedTransform {
    fn default() -> Self {
        Self::still(Transform::default())
    }
}

impl AnimatedTransform {
    /// The map that is `transform` at all times.
    #[must_use]
    pub fn still(transform: Transform) -> Self {
        Self {
            keyframes: vec![Keyframe::new(0.0, transform)],
        }
    }

    /// The map that is each transform at its time. `None` where there is no keyframe, where times do not rise strictly, and where
    /// some keyframes mirror and others do not: between them the map would have no inverse.
    #[must_use]
    pub fn new(keyframes: Vec<(f64, Transform)>) -> Option<Self> {
        let mirrors = keyframes.first()?.1.flips_handedness();
        let rise = keyframes.windows(2).all(|pair| pair[0].0 < pair[1].0);
        let alike = keyframes.iter().all(|(_, map)| map.flips_handedness() == mirrors);
        let keyframes = keyframes
            .into_iter()
            .map(|(time, transform)| Keyframe::new(time, transform));
        (rise && alike).then(|| Self {
            keyframes: keyframes.collect(),
        })
    }

    /// The map at a time: at a keyframe, and between two that are equal, to the last bit what the keyframe says.
    #[must_use]
    pub fn at(&self, time: f64) -> Transform {
        let next = self.keyframes.partition_point(|key| key.time <= time);
        let Some(before) = next.checked_sub(1).map(|last| &self.keyframes[last]) else {
            return self.keyframes[0].transform;
        };
        let Some(after) = self.keyframes.get(next) else {
            return before.transform;
        };
        if before.time == time || before.transform == after.transform {
            return before.transform;
        }
        let part = (time - before.time) / (after.time - before.time);
        before.parts.interpolate(&after.parts, part).compose()
    }

    /// The maps of the keyframes.
    pub fn keyframes(&self) -> impl Iterator<Item = &Transform> {
        self.keyframes.iter().map(|key| &key.transform)
    }

    /// Whether the map is not the same at all times from `open` to `close`.
    #[must_use]
    pub fn moves_within(&self, [open, close]: [f64; 2]) -> bool {
        let moves =
            |pair: &[Keyframe]| pair[0].transform != pair[1].transform && pair[0].time < close && open < pair[1].time;
        open < close && self.keyframes.windows(2).any(moves)
    }

    /// The same times with the maps that `change` makes of the keyframes'; `None` where it makes none of one, or as [`Self::new`].
    #[must_use]
    pub fn map(&self, change: impl Fn(&Transform) -> Option<Transform>) -> Option<Self> {
        let keyframes = self.keyframes.iter();
        Self::new(
            keyframes
                .map(|key| Some((key.time, change(&key.transform)?)))
                .collect::<Option<_>>()?,
        )
    }

    /// A bound of the distance from the origin, at any time, of what the map makes of points up to `radius` from it.
    ///
    /// The Frobenius norm of a stretch bounds its largest eigenvalue, and both parts are interpolated linearly.
    #[must_use]
    pub fn reach(&self, radius: f64) -> f64 {
        let largest = |of: fn(&Parts) -> f64| self.keyframes.iter().map(|key| of(&key.parts)).fold(0.0, f64::max);
        let stretch = largest(|parts| {
            let m = parts.stretch;
            (m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()).sqrt()
        });
        stretch * radius + largest(|parts| parts.translation.length())
    }
}

impl Keyframe {
    fn new(time: f64, transform: Transform) -> Self {
        let matrix = transform.matrix();
        let (rotation, stretch) = polar(DMat3::from_mat4(matrix));
        let parts = Parts {
            translation: matrix.w_axis.truncate(),
            rotation: DQuat::from_mat3(&rotation).normalize(),
            stretch,
        };
        Self { time, transform, parts }
    }
}

impl Parts {
    fn interpolate(&self, other: &Self, part: f64) -> Self {
        Self {
            translation: self.translation.lerp(other.translation, part),
            rotation: slerp(self.rotation, other.rotation, part),
            stretch: self.stretch * (1.0 - part) + other.stretch * part,
        }
    }

    fn compose(&self) -> Transform {
        Transform::from_parts(DMat3::from_quat(self.rotation) * self.stretch, self.translation)
    }
}

/// Steps after which [`polar`] ends: each halves what is too large, and single precision goes to `2^128`; the rest converges
/// quadratically.
const POLAR_STEPS: usize = 150;

/// The rotation `q` and the symmetric `s` with `q s = m`: Newton's iteration for the orthogonal factor, with the sign that makes it a
/// rotation (Higham 1986; Shoemake and Duff 1992).
fn polar(m: DMat3) -> (DMat3, DMat3) {
    let mut q = m;
    for _ in 0..POLAR_STEPS {
        let next = (q + q.inverse().transpose()) * 0.5;
        let settled = next.abs_diff_eq(q, 1e-15);
        q = next;
        if settled {
            break;
        }
    }
    if q.determinant() < 0.0 {
        q = -q;
    }
    let stretch = q.transpose() * m;
    (q, (stretch + stretch.transpose()) * 0.5)
}

/// The unit quaternion a `part` of the way along the shortest arc from `a` to `b` (Shoemake 1985).
fn slerp(a: DQuat, b: DQuat, part: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    let angle = 2.0 * libm::atan2((b - a).length(), (b + a).length());
    let sine = libm::sin(angle);
    if sine < 1e-9 {
        return (a * (1.0 - part) + b * part).normalize();
    }
    ((a * libm::sin((1.0 - part) * angle) + b * libm::sin(part * angle)) * (1.0 / sine)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Vec3;
    use glam::DMat4;

    fn transform(matrix: DMat4) -> Transform {
        Transform::from_matrix(matrix).unwrap()
    }

    fn turn(axis: DVec3, degrees: f64) -> DMat4 {
        DMat4::from_axis_angle(axis.normalize(), degrees.to_radians())
    }

    fn between(first: DMat4, last: DMat4) -> AnimatedTransform {
        AnimatedTransform::new(vec![(1.0, transform(first)), (3.0, transform(last))]).unwrap()
    }

    fn assert_near(found: &Transform, expected: DMat4) {
        assert!(found.matrix().abs_diff_eq(expected, 1e-12), "{found:?} for {expected}");
        let identity = found.matrix() * found.inverted().matrix();
        assert!(identity.abs_diff_eq(DMat4::IDENTITY, 1e-12), "{found:?}");
    }

    #[test]
    fn half_a_turn_by_ninety_degrees_is_one_by_forty_five() {
        let axis = DVec3::new(1.0, -2.0, 0.5);
        for start in [0.0, 70.0, 200.0] {
            let motion = between(turn(axis, start), turn(axis, start + 90.0));
            assert_near(&motion.at(2.0), turn(axis, start + 45.0));
            assert_near(&motion.at(1.5), turn(axis, start + 22.5));
        }
        let short_way = between(turn(axis, 0.0), turn(axis, 270.0));
        assert_near(&short_way.at(2.0), turn(axis, -45.0));
        let hardly = between(turn(axis, 0.0), turn(axis, 1e-8));
        assert_near(&hardly.at(2.0), turn(axis, 0.5e-8));
    }

    #[test]
    fn translation_and_stretch_are_linear() {
        let (from, to) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(5.0, 2.0, -1.0));
        let motion = between(DMat4::from_translation(from), DMat4::from_translation(to));
        assert_near(&motion.at(1.5), DMat4::from_translation(DVec3::new(2.0, 2.0, 2.0)));
        // The symmetric stretches [2 1; 1 2] and diag(4, 2, 1), turned alike.
        let shear = DMat4::from_mat3(DMat3::from_cols(
            DVec3::new(2.0, 1.0, 0.0),
            DVec3::new(1.0, 2.0, 0.0),
            DVec3::Z,
        ));
        let scale = DMat4::from_scale(DVec3::new(4.0, 2.0, 1.0));
        let rotation = turn(DVec3::new(0.2, 1.0, 0.7), 130.0);
        let motion = between(rotation * shear, rotation * scale);
        assert_near(&motion.at(2.0), rotation * (shear * 0.5 + scale * 0.5));
    }

    #[test]
    fn a_mirrored_map_stays_mirrored() {
        let mirror = DMat4::from_scale(DVec3::new(-1.0, 1.0, 2.0));
        let motion = between(mirror, turn(DVec3::Y, 90.0) * mirror);
        for time in [1.0, 1.3, 2.0, 2.9, 3.0] {
            assert!(motion.at(time).flips_handedness());
        }
        assert_near(&motion.at(2.0), turn(DVec3::Y, 45.0) * mirror);
    }

    #[test]
    fn keyframes_are_met_exactly_and_hold_beyond_the_ends() {
        let maps = [turn(DVec3::X, 10.0), turn(DVec3::Y, 50.0), turn(DVec3::Z, 90.0)].map(transform);
        let motion = AnimatedTransform::new([0.0, 1.0, 4.0].into_iter().zip(maps).collect()).unwrap();
        for (time, expected) in [(-9.0, 0), (0.0, 0), (1.0, 1), (4.0, 2), (7.0, 2)] {
            assert_eq!(motion.at(time), maps[expected], "{time}");
        }
        assert!(motion.moves_within([-1.0, 0.5]) && motion.moves_within([3.9, 9.0]));
        for still in [[-2.0, 0.0], [4.0, 9.0], [0.5, 0.5]] {
            assert!(!motion.moves_within(still), "{still:?}");
        }
        assert!(!AnimatedTransform::still(maps[1]).moves_within([0.0, 1.0]));
    }

    #[test]
    fn keyframes_that_make_no_motion_are_refused() {
        let (map, mirror) = (Transform::default(), transform(DMat4::from_scale(-DVec3::ONE)));
        assert!(AnimatedTransform::new(Vec::new()).is_none());
        assert!(AnimatedTransform::new(vec![(1.0, map), (1.0, map)]).is_none());
        assert!(AnimatedTransform::new(vec![(1.0, map), (0.0, map)]).is_none());
        assert!(AnimatedTransform::new(vec![(0.0, map), (1.0, mirror)]).is_none());
        assert!(AnimatedTransform::new(vec![(0.0, mirror), (1.0, mirror)]).is_some());
    }

    #[test]
    fn what_is_mapped_lies_within_reach() {
        let motion = between(
            DMat4::from_translation(DVec3::new(0.0, 3.0, 0.0)) * DMat4::from_scale(DVec3::new(1.0, 2.0, 0.1)),
            turn(DVec3::X, 170.0) * DMat4::from_scale(DVec3::new(1.0, 0.1, 2.0)),
        );
        let reach = motion.reach(2.0) as f32;
        for step in 0..=50 {
            let map = motion.at(1.0 + f64::from(step) / 25.0);
            for point in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_Y] {
                assert!(map.point(2.0 * point).length() <= reach);
            }
        }
    }
}
