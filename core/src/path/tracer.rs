//! The rays of paths.

use super::{Vertex, Way};
use crate::geometry::{Ray, SurfacePoint};
use crate::light::LightSample;
use crate::math::DVec2;
use crate::medium::{Medium, MediumId, Space};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// What comes through along a way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Passed {
    /// An estimate of the share of light.
    pub(crate) share: Spectrum,
    /// What stands for the share where techniques are weighed: a function of the way alone.
    pub(crate) expected: f32,
}

impl Passed {
    pub(crate) const ALL: Self = Self {
        share: Spectrum::ONE,
        expected: 1.0,
    };
    const NOTHING: Self = Self {
        share: Spectrum::ZERO,
        expected: 0.0,
    };
}

/// What a piece of a way lies in.
#[derive(Clone, Copy)]
pub(crate) struct Piece<'a> {
    pub(crate) id: MediumId,
    pub(crate) medium: &'a Medium,
    pub(crate) space: Space,
}

/// Rays into the scene, counted.
pub(crate) struct Tracer<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) rays: u64,
}

impl<'a> Tracer<'a> {
    pub(crate) fn new(scene: &'a Scene) -> Self {
        Self { scene, rays: 0 }
    }

    /// The nearest surface along a ray.
    pub(crate) fn intersect(&mut self, ray: &Ray) -> Option<SurfacePoint> {
        self.rays += 1;
        self.scene.geometry.intersect(ray)
    }

    /// The nearest surface along a ray of the camera, which sees through the shapes of lights where these are hidden.
    pub(crate) fn intersect_from_camera(&mut self, ray: &Ray) -> Option<SurfacePoint> {
        let scene = self.scene;
        self.intersect_behind(ray, |point| scene.hide_emitters && scene.light_at(point).is_some())
    }

    /// The nearest surface along a ray of the camera that people would call one: what does nothing but bound a medium is none, nor what a
    /// body covers.
    pub(crate) fn first_seen(&mut self, ray: &Ray) -> Option<SurfacePoint> {
        let (scene, mut space, direction) = (self.scene, self.scene.space_of_camera(), ray.direction);
        self.intersect_behind(ray, |point| {
            let passed = scene.is_passed(point, space, direction);
            space = scene
                .sides(point, space, direction)
                .towards(direction, point.geometric_normal);
            passed || scene.hide_emitters && scene.light_at(point).is_some()
        })
    }

    /// The nearest surface behind those that `is_skipped`.
    #[inline]
    fn intersect_behind(
        &mut self,
        ray: &Ray,
        mut is_skipped: impl FnMut(&SurfacePoint) -> bool,
    ) -> Option<SurfacePoint> {
        let mut point = self.intersect(ray)?;
        let mut before = 0.0;
        while is_skipped(&point) {
            before += point.distance;
            let behind = Ray {
                max_distance: ray.max_distance - before,
                ..point.ray_towards(ray.direction)
            };
            point = self.intersect(&behind)?;
        }
        point.distance += before;
        Some(point)
    }

    /// As [`Self::transmittance`], of a way that ends at the camera.
    pub(crate) fn transmittance_to_camera(&mut self, way: &Way, random: &mut PathRandom) -> Passed {
        let hides = self.scene.hide_emitters;
        match (&self.scene.media, hides) {
            (None, false) => self.transmittance(way, random),
            (None, true) => match self.intersect_from_camera(&way.ray) {
                Some(_) => Passed::NOTHING,
                None => Passed::ALL,
            },
            (Some(_), _) => self.pass(way, hides, random).0,
        }
    }

    /// What comes through along a way. Every surface hides what is behind it, but for those that do nothing but bound media.
    #[inline]
    pub(crate) fn transmittance(&mut self, way: &Way, random: &mut PathRandom) -> Passed {
        if self.scene.media.is_some() {
            return self.pass(way, false, random).0;
        }
        self.rays += 1;
        match self.scene.geometry.occluded(&way.ray) {
            true => Passed::NOTHING,
            false => Passed::ALL,
        }
    }

    /// An estimate of the share of light that comes through media along a way, and what its end lies in; `None` where something is in the way.
    pub(crate) fn follow(&mut self, way: &Way, random: &mut PathRandom) -> Option<(Spectrum, Space)> {
        let (passed, space) = self.pass(way, false, random);
        (!passed.share.is_black()).then_some((passed.share, space))
    }

    /// What comes through media along a way, and through their bounds, and what its end lies in; also through the shapes of lights where these
    /// are hidden.
    fn pass(&mut self, way: &Way, hide_emitters: bool, random: &mut PathRandom) -> (Passed, Space) {
        let mut way = *way;
        let mut passed = Passed::ALL;
        loop {
            let hit = self.intersect(&way.ray);
            let end = hit.as_ref().map_or(way.length, |point| point.distance);
            let opaque = hit.as_ref().filter(|point| {
                let hidden = hide_emitters && self.scene.light_at(point).is_some();
                !hidden && !self.scene.is_passed(point, way.space, way.ray.direction)
            });
            if opaque.is_some() {
                return (Passed::NOTHING, way.space);
            }
            if let Some((_, inside)) = self.scene.medium(way.space) {
                passed.share *= inside.transmittance(&way.ray, end, random);
                passed.expected *= inside.expected_transmittance(end);
                if passed.share.is_black() {
                    return (Passed::NOTHING, way.space);
                }
            }
            let Some(point) = hit else {
                return (passed, way.space);
            };
            way = way.behind(self.scene, &point);
        }
    }

    /// Calls `visit` with the pieces of a way that lie in media, one after the other and through their bounds, up to the first surface that hides
    /// what is behind it, or until it says no. A piece is a ray up to its end.
    pub(crate) fn for_each_piece(&mut self, way: Way, mut visit: impl FnMut(Piece<'a>, &Ray) -> bool) {
        let mut way = way;
        loop {
            let hit = self.intersect(&way.ray);
            if let Some((id, medium)) = self.scene.medium(way.space) {
                let max_distance = hit.as_ref().map_or(way.ray.max_distance, |point| point.distance);
                let piece = Ray {
                    max_distance,
                    ..way.ray
                };
                let inside = Piece {
                    id,
                    medium,
                    space: way.space,
                };
                if !visit(inside, &piece) {
                    return;
                }
            }
            let Some(point) = hit.filter(|point| self.scene.is_passed(point, way.space, way.ray.direction)) else {
                return;
            };
            way = way.behind(self.scene, &point);
        }
    }

    /// A point of a light that a vertex can be connected with, chosen by `choice` and `u`; `None` where no light comes along that way. What
    /// lies between is not looked at.
    #[inline]
    pub(crate) fn sample_light(&self, vertex: &Vertex, choice: f64, u: DVec2) -> Option<LightSample> {
        let Scene { lights, geometry, .. } = self.scene;
        lights.sample_direct(geometry, vertex.position(), choice, u)
    }
}
