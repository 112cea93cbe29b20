//! The rays of paths.

use super::Vertex;
use crate::geometry::{Ray, SurfacePoint};
use crate::light::LightSample;
use crate::math::DVec2;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

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
        let mut point = self.intersect(ray)?;
        if !self.scene.hide_emitters {
            return Some(point);
        }
        let mut before = 0.0;
        while self.scene.light_at(&point).is_some() {
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

    /// As [`Self::transmittance`], of a ray that ends at the camera.
    pub(crate) fn transmittance_to_camera(&mut self, ray: &Ray) -> Spectrum {
        if !self.scene.hide_emitters {
            return self.transmittance(ray);
        }
        match self.intersect_from_camera(ray) {
            Some(_) => Spectrum::ZERO,
            None => Spectrum::ONE,
        }
    }

    /// Share of the light along a ray that reaches its end: all or nothing, since every surface hides what is behind it.
    pub(crate) fn transmittance(&mut self, ray: &Ray) -> Spectrum {
        self.rays += 1;
        match self.scene.geometry.occluded(ray) {
            true => Spectrum::ZERO,
            false => Spectrum::ONE,
        }
    }

    /// A point of a light that a vertex can be connected with, chosen by `choice` and `u`; `None` where no light comes along that way. What
    /// lies between is not looked at.
    #[inline]
    pub(crate) fn sample_light(&self, vertex: &Vertex, choice: f64, u: DVec2) -> Option<LightSample> {
        let Scene { lights, geometry, .. } = self.scene;
        lights.sample_direct(geometry, vertex.point.position, choice, u)
    }
}
