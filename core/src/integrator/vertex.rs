use crate::geometry::{Ray, SurfacePoint};
use crate::map::Record;
use crate::material::{BsdfSample, Material, TransportMode};
use crate::math::Vec3;
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// A surface vertex of a path, with the material's interface in world space.
pub(super) struct Vertex<'a> {
    pub(super) point: SurfacePoint,
    pub(super) material: &'a Material,
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

impl<'a> Vertex<'a> {
    pub(super) fn new(scene: &'a Scene, point: SurfacePoint, wo: Vec3, mode: TransportMode) -> Self {
        let wo_local = point.frame.to_local(wo);
        Self {
            point,
            material: scene.material(&point),
            wo,
            wo_local,
            mode,
        }
    }

    /// f(wo, wi) [1/sr].
    pub(super) fn eval(&self, wi: Vec3) -> Spectrum {
        self.material
            .eval(self.point.uv, self.wo_local, self.point.frame.to_local(wi), self.mode)
    }

    /// Solid-angle density [1/sr] of [`Self::sample`].
    pub(super) fn pdf(&self, wi: Vec3) -> f32 {
        self.material
            .pdf(self.point.uv, self.wo_local, self.point.frame.to_local(wi))
    }

    /// Samples a direction; three dimensions.
    pub(super) fn sample(&self, random: &mut PathRandom) -> Option<Scattered> {
        let lobe = random.next_1d();
        let bsdf = self
            .material
            .sample(self.point.uv, self.wo_local, lobe, random.next_2d(), self.mode)?;
        Some(Scattered {
            wi: self.point.frame.to_world(bsdf.wi),
            cos_shading: bsdf.wi.z.abs(),
            bsdf,
        })
    }

    /// Whether the material is a delta function seen from `wo`.
    pub(super) fn is_delta(&self) -> bool {
        self.material.is_delta(self.wo_local)
    }

    /// Whether the material seen from `wo` is too glossy for a density estimate.
    pub(super) fn is_glossier_than(&self, roughness: f32) -> bool {
        self.material.is_glossier_than(self.wo_local, roughness)
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
}
