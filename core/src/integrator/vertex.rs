use crate::geometry::{Ray, SurfacePoint};
use crate::light::LightSample;
use crate::map::Record;
use crate::material::{Bsdf, BsdfSample, TransportMode};
use crate::math::{DVec2, Vec3};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// A surface vertex of a path, with the interface of its BSDF in world space.
#[derive(Clone, Copy)]
pub(super) struct Vertex {
    pub(super) point: SurfacePoint,
    /// The material at the point, its textures looked up.
    bsdf: Bsdf,
    /// Unit direction back along the path.
    pub(super) wo: Vec3,
    wo_local: Vec3,
    mode: TransportMode,
}

/// A direction sampled from the material.
pub(super) struct Scattered {
    /// Unit direction in the world.
    pub(super) wi: Vec3,
    /// Cosine of `wi` with the shading normal, without sign.
    pub(super) cos_shading: f32,
    pub(super) bsdf: BsdfSample,
}

impl Scattered {
    /// `f |cos| / pdf`.
    pub(super) fn weight(&self) -> Spectrum {
        self.bsdf.f * (self.cos_shading / self.bsdf.pdf)
    }
}

impl Vertex {
    pub(super) fn new(scene: &Scene, point: SurfacePoint, wo: Vec3, mode: TransportMode) -> Self {
        let wo_local = point.frame.to_local(wo);
        Self {
            point,
            bsdf: scene.material(&point).resolve(point.uv, wo_local),
            wo,
            wo_local,
            mode,
        }
    }

    /// f(wo, wi) [1/sr], delta lobes left out.
    pub(super) fn eval(&self, wi: Vec3) -> Spectrum {
        self.bsdf.f(self.wo_local, self.point.frame.to_local(wi), self.mode)
    }

    /// Solid-angle density [1/sr] of [`Self::sample`], delta lobes left out.
    pub(super) fn pdf(&self, wi: Vec3) -> f32 {
        self.bsdf.pdf(self.wo_local, self.point.frame.to_local(wi))
    }

    /// Solid-angle density [1/sr] of sampling the direction back along the path, for a path that comes along `wi`.
    pub(super) fn pdf_rev(&self, wi: Vec3) -> f32 {
        self.bsdf.pdf(self.point.frame.to_local(wi), self.wo_local)
    }

    /// The density with which the way back of a direction sampled here would have been sampled [1/sr]; where a delta function chose
    /// it, in units of the density of the way ([`Bsdf::pdf_rev`]).
    pub(super) fn pdf_rev_of(&self, scattered: &Scattered) -> f32 {
        self.bsdf.pdf_rev(self.wo_local, &scattered.bsdf)
    }

    /// Samples a direction; three dimensions.
    pub(super) fn sample(&self, random: &mut PathRandom) -> Option<Scattered> {
        let lobe = random.next_1d();
        let bsdf = self.bsdf.sample(self.wo_local, lobe, random.next_2d(), self.mode)?;
        Some(Scattered {
            wi: self.point.frame.to_world(bsdf.wi),
            cos_shading: bsdf.wi.z.abs(),
            bsdf,
        })
    }

    /// Whether every lobe is a delta function of direction.
    pub(super) fn is_delta(&self) -> bool {
        !self.bsdf.has_smooth()
    }

    /// Whether some lobe is a delta function of direction.
    pub(super) fn has_delta(&self) -> bool {
        self.bsdf.has_delta()
    }

    /// Whether the lobes that are no delta functions are too glossy for a density estimate, or there are none.
    pub(super) fn is_glossier_than(&self, roughness: f32) -> bool {
        self.bsdf.is_glossier_than(roughness)
    }

    /// Cosine of `direction` with the shading normal, without sign.
    pub(super) fn cos_shading(&self, direction: Vec3) -> f32 {
        direction.dot(self.point.frame.n).abs()
    }

    /// Cosine of `direction` with the geometric normal, without sign.
    pub(super) fn cos_geometric(&self, direction: Vec3) -> f32 {
        direction.dot(self.point.geometric_normal).abs()
    }

    /// Whether `direction` points to the side of the true surface that `wo` points to.
    pub(super) fn on_side_of_wo(&self, direction: Vec3) -> bool {
        let height = |w: Vec3| w.dot(self.point.geometric_normal);
        height(direction) * height(self.wo) > 0.0
    }

    /// What turns flux that arrives along `-wo` through the true surface into flux through the surface that the
    /// shading normal pretends: `|wo . ns| / |wo . ng|` (Veach 1997, section 5.3).
    pub(super) fn arrival_correction(&self) -> f32 {
        let geometric = self.cos_geometric(self.wo);
        if geometric == 0.0 {
            0.0
        } else {
            self.wo_local.z.abs() / geometric
        }
    }

    /// Factor of the flux that goes on along a sampled direction: `f |wi . ng| / pdf`.
    pub(super) fn continuation_weight(&self, scattered: &Scattered) -> Spectrum {
        if scattered.cos_shading == 0.0 {
            return Spectrum::ZERO;
        }
        scattered.weight() * (self.cos_geometric(scattered.wi) / scattered.cos_shading)
    }

    /// A record at this vertex.
    pub(super) fn record(&self, direction: Vec3, weight: Spectrum, edges: u32) -> Record {
        Record::new(
            self.point.position,
            self.point.geometric_normal,
            direction,
            weight,
            edges,
        )
    }
}

/// Rays into the scene, counted.
pub(super) struct Tracer<'a> {
    pub(super) scene: &'a Scene,
    pub(super) rays: u64,
}

impl<'a> Tracer<'a> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        Self { scene, rays: 0 }
    }

    pub(super) fn intersect(&mut self, ray: &Ray) -> Option<SurfacePoint> {
        self.rays += 1;
        self.scene.geometry.intersect(ray)
    }

    pub(super) fn occluded(&mut self, ray: &Ray) -> bool {
        self.rays += 1;
        self.scene.geometry.occluded(ray)
    }

    /// Connects a vertex with the light and the point on it that `choice` and `u` select, and f towards it [1/sr]; `None` where no light
    /// comes along that way.
    #[inline]
    pub(super) fn connect_with_light(
        &mut self,
        vertex: &Vertex,
        choice: f64,
        u: DVec2,
    ) -> Option<(LightSample, Spectrum)> {
        let Scene { lights, geometry, .. } = self.scene;
        let light = lights.sample_direct(geometry, vertex.point.position, choice, u)?;
        let f = vertex.eval(light.wi);
        let hidden = f.is_black() || self.occluded(&vertex.point.shadow_ray(light.wi, light.distance));
        (!hidden).then_some((light, f))
    }
}
