//! Motion: what of a scene moves while the shutter is open, and the scene as one iteration renders it.
//!
//! All paths of an iteration see the same moment, so that photons, cones and camera paths meet the same surfaces, and one hierarchy
//! serves them all. The average over iterations is the image blurred by motion.

use crate::geometry::{Shape, ShapeId, ShapeSampler};
use crate::light::LightId;
use crate::math::AnimatedTransform;
use crate::random::{Sampling, Stream};
use crate::scene::Scene;
use crate::sensor::Sensor;
use std::sync::Arc;

/// What moves while the shutter is open, and when that is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Motion {
    /// When the shutter opens and closes.
    pub(crate) shutter: [f64; 2],
    pub(crate) shapes: Vec<MovingShape>,
    /// Lights that move by a transform of their own or with their shape.
    pub(crate) lights: Vec<(LightId, AnimatedTransform)>,
    /// The camera's place.
    pub(crate) sensor: Option<AnimatedTransform>,
}

/// A shape that moves.
#[derive(Clone, Debug)]
pub(crate) struct MovingShape {
    pub(crate) id: ShapeId,
    /// The shape in a space of its own.
    pub(crate) shape: Shape,
    /// From that space to the world; it does not mirror.
    pub(crate) to_world: AnimatedTransform,
}

impl Motion {
    /// The time of a scene at rest: the middle of the interval.
    pub(crate) fn at_rest(&self) -> f64 {
        0.5 * (self.shutter[0] + self.shutter[1])
    }

    /// Whether nothing moves.
    pub(crate) fn is_empty(&self) -> bool {
        self.shapes.is_empty() && self.lights.is_empty() && self.sensor.is_none()
    }

    /// The time of iteration `iteration` (1, 2, ...): a point of a scrambled van der Corput sequence, which any power of two
    /// first iterations spread evenly over the interval. It does so whatever the job's sampling.
    fn time(&self, seed: u64, iteration: u32) -> f64 {
        let sequence = Sampling::Sobol.sequence(seed, iteration, Stream::Time, 0, 1);
        let [open, close] = self.shutter;
        open + (close - open) * f64::from(sequence.path(0).next_1d())
    }
}

impl Scene {
    /// The scene as iteration `iteration` (1, 2, ...) of a job with the seed `seed` renders it; `None` where nothing moves, and all
    /// iterations render the scene itself. It depends on scene, seed and iteration alone.
    #[must_use]
    pub fn frame(&self, seed: u64, iteration: u32) -> Option<Self> {
        let motion = self.motion.as_ref()?;
        Some(self.moved(motion, motion.time(seed, iteration)))
    }

    /// The scene at the time `time`; `None` where nothing moves.
    #[must_use]
    pub fn at(&self, time: f64) -> Option<Self> {
        self.motion.as_ref().map(|motion| self.moved(motion, time))
    }

    /// What stands still is shared, the hierarchy is fitted to what moves, and the choice of lights is made anew.
    fn moved(&self, motion: &Motion, time: f64) -> Self {
        let shapes = motion.shapes.iter();
        let geometry = self
            .geometry
            .moved(shapes.map(|moving| (moving.id, moving.shape.moved(&moving.to_world.at(time)))));
        let moved_lights = motion
            .lights
            .iter()
            .map(|(light, to_world)| (*light, to_world.at(time)));
        let meter = self.meter.as_ref();
        Self {
            meter: meter.map(|meter| ShapeSampler::new(&geometry, meter.shape())),
            lights: self.lights.moved(&geometry, moved_lights),
            geometry: Arc::new(geometry),
            sensor: Sensor {
                to_world: motion
                    .sensor
                    .as_ref()
                    .map_or(self.sensor.to_world, |to_world| to_world.at(time)),
                ..self.sensor.clone()
            },
            motion: None,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any aligned block of a power of two iterations, among them all first ones, has one time in each of as many equal parts of the interval.
    #[test]
    fn times_are_stratified_however_often_a_job_is_extended() {
        let motion = Motion {
            shutter: [2.0, 6.0],
            ..Motion::default()
        };
        for seed in 0..50 {
            for (first, count) in [(0, 1), (0, 8), (8, 8), (0, 256), (512, 64)] {
                let mut parts = vec![false; count];
                for iteration in first..first + count {
                    let time = motion.time(seed, iteration as u32 + 1);
                    let part = ((time - 2.0) / 4.0 * count as f64) as usize;
                    assert!(
                        !std::mem::replace(&mut parts[part], true),
                        "seed {seed}, iteration {iteration}"
                    );
                }
            }
        }
        assert_ne!(motion.time(1, 1), motion.time(2, 1));
    }
}
