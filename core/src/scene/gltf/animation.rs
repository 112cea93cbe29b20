//! Keyframes of nodes (section 3.11 of the specification) and their values at a time.

use super::accessor::Accessors;
use super::document::{AnimationSampler, Document};
use super::warnings::Told;
use crate::scene::error::{SceneError, shortened, within};
use crate::scene::limits::Limits;
use glam::DQuat;
use std::collections::BTreeMap;

/// What of a node an animation changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Property {
    Translation,
    Rotation,
    Scale,
    Weights,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Interpolation {
    Step,
    Linear,
    /// Hermite splines with tangents before and after each value.
    Cubic,
}

/// Values of one property over time.
#[derive(Debug)]
pub(super) struct Track {
    /// Seconds; at least one, and they rise strictly.
    times: Vec<f32>,
    /// `width` numbers for each time, for splines three times as many.
    values: Vec<f32>,
    width: usize,
    interpolation: Interpolation,
    rotates: bool,
}

/// The tracks of all animations, by node.
#[derive(Debug, Default)]
pub(super) struct Animations {
    tracks: BTreeMap<(usize, Property), Track>,
}

impl Animations {
    /// Reads all animations. Where several move one property of a node, the first counts.
    pub(super) fn read(
        document: &Document,
        accessors: &Accessors,
        limits: &Limits,
        told: &Told,
    ) -> Result<Self, SceneError> {
        let mut tracks = BTreeMap::new();
        let mut total = 0;
        for (index, animation) in document.animations.iter().enumerate() {
            let name = format!("animations[{index}] \"{}\"", shortened(&animation.name));
            for (number, channel) in animation.channels.iter().enumerate() {
                let field = format!("animations[{index}].channels[{number}]");
                let property = match channel.target.path.as_str() {
                    "translation" => Property::Translation,
                    "rotation" => Property::Rotation,
                    "scale" => Property::Scale,
                    "weights" => Property::Weights,
                    other => {
                        told.warn(format!(
                            "{name}: `{}` stands still: only nodes and weights move",
                            shortened(other)
                        ));
                        continue;
                    }
                };
                let Some(node) = channel.target.node else { continue };
                let sampler = animation.samplers.get(channel.sampler).ok_or_else(|| {
                    accessors.wrong(&field, format!("the animation has no sampler {}", channel.sampler))
                })?;
                if tracks.contains_key(&(node, property)) {
                    told.warn(format!(
                        "{name}: it moves what an animation before it moves, and is left out there"
                    ));
                    continue;
                }
                total += accessors.count(sampler.output, &field)?;
                within(told.place(), "number of animated values", total, limits.vertices)?;
                tracks.insert((node, property), track(sampler, property, accessors, &field)?);
            }
        }
        Ok(Self { tracks })
    }

    pub(super) fn is_empty(&self) -> bool {
        self.tracks.is_empty()
    }

    /// The value of a node's property at `time` \[s\], where it is animated.
    pub(super) fn at(&self, node: usize, property: Property, time: f64) -> Option<Vec<f64>> {
        self.tracks.get(&(node, property)).map(|track| track.at(time))
    }
}

fn track(
    sampler: &AnimationSampler,
    property: Property,
    accessors: &Accessors,
    field: &str,
) -> Result<Track, SceneError> {
    let interpolation = match sampler.interpolation.as_deref() {
        None | Some("LINEAR") => Interpolation::Linear,
        Some("STEP") => Interpolation::Step,
        Some("CUBICSPLINE") => Interpolation::Cubic,
        Some(other) => {
            let reason = format!("there is no interpolation `{}`", shortened(other));
            return Err(accessors.wrong(field, reason));
        }
    };
    let times = accessors.numbers(sampler.input, &[1], field)?;
    let values = match property {
        Property::Translation | Property::Scale => accessors.numbers(sampler.output, &[3], field)?,
        Property::Rotation => accessors.numbers(sampler.output, &[4], field)?,
        Property::Weights => accessors.numbers(sampler.output, &[1], field)?,
    };
    if times.is_empty() || times.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(accessors.wrong(field, "its times must rise strictly, and there must be one"));
    }
    let values_of_key = if interpolation == Interpolation::Cubic { 3 } else { 1 };
    let width = match property {
        Property::Translation | Property::Scale => 3,
        Property::Rotation => 4,
        Property::Weights => values.len() / (times.len() * values_of_key),
    };
    if values.len() != times.len() * values_of_key * width {
        let reason = format!("{} numbers do not fit {} times", values.len(), times.len());
        return Err(accessors.wrong(field, reason));
    }
    Ok(Track {
        times,
        values,
        width,
        interpolation,
        rotates: property == Property::Rotation,
    })
}

impl Track {
    /// The value at `time`; before the first key and after the last it is theirs.
    fn at(&self, time: f64) -> Vec<f64> {
        let next = self.times.partition_point(|key| f64::from(*key) <= time);
        let last = self.times.len() - 1;
        let before = next.saturating_sub(1);
        if next == 0 || before == last || self.interpolation == Interpolation::Step {
            return self.unit(self.value(before));
        }
        let (begin, end) = (f64::from(self.times[before]), f64::from(self.times[next]));
        let (length, part) = (end - begin, (time - begin) / (end - begin));
        let (a, b) = (self.value(before), self.value(next));
        if self.interpolation == Interpolation::Cubic {
            return self.unit(self.spline(before, part, length));
        }
        if self.rotates {
            return slerp(quaternion(&a), quaternion(&b), part).to_array().to_vec();
        }
        a.iter().zip(&b).map(|(a, b)| a + (b - a) * part).collect()
    }

    /// Part 0, 1 or 2 of a key: for splines the tangent before it, the value, and the tangent after it.
    fn part(&self, key: usize, part: usize) -> Vec<f64> {
        let of_key = if self.interpolation == Interpolation::Cubic {
            3
        } else {
            1
        };
        let begin = (key * of_key + part) * self.width;
        let numbers = &self.values[begin..begin + self.width];
        numbers.iter().map(|number| f64::from(*number)).collect()
    }

    fn value(&self, key: usize) -> Vec<f64> {
        self.part(key, usize::from(self.interpolation == Interpolation::Cubic))
    }

    /// The Hermite spline between a key and the next, `length` seconds apart (appendix C.5 of the specification).
    fn spline(&self, key: usize, t: f64, length: f64) -> Vec<f64> {
        let (t2, t3) = (t * t, t * t * t);
        let weights = [
            2.0 * t3 - 3.0 * t2 + 1.0,
            length * (t3 - 2.0 * t2 + t),
            -2.0 * t3 + 3.0 * t2,
            length * (t3 - t2),
        ];
        let parts = [
            self.part(key, 1),
            self.part(key, 2),
            self.part(key + 1, 1),
            self.part(key + 1, 0),
        ];
        (0..self.width)
            .map(|i| weights.iter().zip(&parts).map(|(weight, part)| weight * part[i]).sum())
            .collect()
    }

    /// A rotation as a unit quaternion; other values as they are.
    fn unit(&self, value: Vec<f64>) -> Vec<f64> {
        match self.rotates {
            true => quaternion(&value).to_array().to_vec(),
            false => value,
        }
    }
}

/// The unit quaternion of four numbers; no rotation where they have no length.
pub(super) fn quaternion(xyzw: &[f64]) -> DQuat {
    let q = DQuat::from_xyzw(xyzw[0], xyzw[1], xyzw[2], xyzw[3]);
    let length = q.length();
    if length.is_finite() && length > 1e-12 {
        q * (1.0 / length)
    } else {
        DQuat::IDENTITY
    }
}

/// Between two unit quaternions by the shorter arc (appendix C.4 of the specification; Shoemake 1985).
fn slerp(a: DQuat, b: DQuat, part: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    let angle = 2.0 * libm::atan2((b - a).length(), (b + a).length());
    let sine = libm::sin(angle);
    let blended = if sine < 1e-9 {
        a * (1.0 - part) + b * part
    } else {
        (a * libm::sin((1.0 - part) * angle) + b * libm::sin(part * angle)) * (1.0 / sine)
    };
    quaternion(&blended.to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(interpolation: Interpolation, rotates: bool, width: usize, values: &[f32]) -> Track {
        Track {
            times: vec![1.0, 3.0],
            values: values.to_vec(),
            width,
            interpolation,
            rotates,
        }
    }

    #[test]
    fn keys_are_held_at_the_ends_and_interpolated_between() {
        let linear = track(Interpolation::Linear, false, 1, &[2.0, 6.0]);
        let step = track(Interpolation::Step, false, 1, &[2.0, 6.0]);
        for (time, at_linear, at_step) in [(0.0, 2.0, 2.0), (1.5, 3.0, 2.0), (3.0, 6.0, 6.0), (9.0, 6.0, 6.0)] {
            assert_eq!(linear.at(time), [at_linear], "{time}");
            assert_eq!(step.at(time), [at_step], "{time}");
        }
    }

    /// With the tangents of `x^3` a Hermite spline is that polynomial.
    #[test]
    fn splines_are_cubic() {
        let key = |x: f32| [3.0 * x * x, x * x * x, 3.0 * x * x];
        let values: Vec<f32> = key(1.0).into_iter().chain(key(3.0)).collect();
        let cubic = track(Interpolation::Cubic, false, 1, &values);
        for time in [1.0, 1.5, 2.0, 2.75, 3.0] {
            assert!((cubic.at(time)[0] - time * time * time).abs() < 1e-12);
        }
    }

    #[test]
    fn rotations_take_the_shorter_arc_at_constant_speed() {
        let half = libm::sqrtf(0.5);
        // A quarter turn about z, given by the quaternion of the other sign.
        let turn = track(
            Interpolation::Linear,
            true,
            4,
            &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -half, -half],
        );
        let angle = std::f64::consts::FRAC_PI_2 * 0.25 / 2.0;
        let at = turn.at(1.5);
        assert!((at[2] - libm::sin(angle)).abs() < 1e-7 && (at[3] - libm::cos(angle)).abs() < 1e-7);
    }
}
