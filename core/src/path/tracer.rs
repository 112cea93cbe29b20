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

    /// Share of the light along a ray that reaches its end: all or nothing, since every surface hides what is behind it.
    pub(crate) fn transmittance(&mut self, ray: &Ray) -> Spectrum {
        self.rays += 1;
        match self.scene.geometry.occluded(ray) {
            true => Spectrum::ZERO,
            false => Spectrum::ONE,
        }
    }

    /// Connects a vertex with the light and the point on it that `choice` and `u` select, and f towards it [1/sr] times the
    /// transmittance; `None` where no light comes along that way.
    #[inline]
    pub(crate) fn connect_with_light(
        &mut self,
        vertex: &Vertex,
        choice: f64,
        u: DVec2,
    ) -> Option<(LightSample, Spectrum)> {
        let Scene { lights, geometry, .. } = self.scene;
        let light = lights.sample_direct(geometry, vertex.point.position, choice, u)?;
        let f = vertex.eval(light.wi);
        if f.is_black() {
            return None;
        }
        let f = f * self.transmittance(&vertex.point.shadow_ray(light.wi, light.distance));
        (!f.is_black()).then_some((light, f))
    }
}
