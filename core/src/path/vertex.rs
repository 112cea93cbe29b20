//! Vertices on surfaces.

use super::expression::{ANY, Event, PathExpression, States};
use crate::density::Cone;
use crate::geometry::SurfacePoint;
use crate::integrator::GLOSSY_ROUGHNESS;
use crate::material::{Bsdf, BsdfSample, Tangents, TransportMode};
use crate::math::Vec3;
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// A vertex of a subpath on a surface, with the interface of its BSDF in world space.
#[derive(Clone)]
pub(crate) struct Vertex {
    pub(crate) point: SurfacePoint,
    /// What arrives: of a camera subpath, the share of the radiance that leaves along `wo` which reaches the camera; of a light
    /// subpath, the flux along `-wo` \[W\], corrected for the shading normal.
    pub(crate) beta: Spectrum,
    /// Edges of the subpath up to here.
    pub(crate) edges: u32,
    /// The material at the point, its textures looked up.
    bsdf: Bsdf,
    /// Unit direction back along the subpath.
    pub(crate) wo: Vec3,
    wo_local: Vec3,
    mode: TransportMode,
    pub(crate) states: VertexStates,
}

/// Where a subpath is among the words of a scene's [`PathExpression`], at a vertex: all sets hold every state where all paths count.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VertexStates {
    /// Before the vertex scatters.
    pub(crate) arrived: States,
    /// After it has scattered by a lobe that is no delta function.
    pub(crate) smooth: States,
    /// After it has scattered by a delta function.
    pub(crate) delta: States,
}

impl VertexStates {
    const ANY: Self = Self {
        arrived: ANY,
        smooth: ANY,
        delta: ANY,
    };
}

/// A direction in which a vertex is connected or merged, delta lobes left out.
pub(crate) struct Towards {
    /// f(wo, wi) [1/sr].
    pub(crate) f: Spectrum,
    /// Solid-angle density of sampling the direction [1/sr].
    pub(crate) pdf: f32,
    /// Solid-angle density of sampling the direction back along the path, for a path that comes along this one [1/sr].
    pub(crate) pdf_rev: f32,
}

/// A direction sampled from the material.
pub(crate) struct Scattered {
    /// Unit direction in the world.
    pub(crate) wi: Vec3,
    /// Cosine of `wi` with the shading normal, without sign.
    pub(crate) cos_shading: f32,
    pub(crate) bsdf: BsdfSample,
}

impl Scattered {
    /// `f |cos| / pdf`.
    pub(crate) fn weight(&self) -> Spectrum {
        self.bsdf.f * (self.cos_shading / self.bsdf.pdf)
    }
}

impl Vertex {
    /// The first vertex of a subpath that comes along `-wo` and carries 1.
    #[inline(always)]
    pub(crate) fn new(scene: &Scene, point: SurfacePoint, wo: Vec3, mode: TransportMode) -> Self {
        let wo_local = point.frame.to_local(wo);
        let tangents = || {
            let [du, dv] = scene
                .geometry
                .tangents(&point)
                .map(|tangent| point.frame.to_local(tangent));
            Tangents { du, dv }
        };
        let bsdf = scene.material(&point).resolve_on(&(&point).into(), wo_local, &tangents);
        Self {
            point,
            beta: Spectrum::ONE,
            edges: 1,
            bsdf,
            wo,
            wo_local,
            mode,
            states: VertexStates::ANY,
        }
    }

    /// Notes where the subpath is among the words of an expression.
    pub(super) fn note(&mut self, paths: &PathExpression, arrived: States) {
        let smooth = match self.is_glossier_than(GLOSSY_ROUGHNESS) {
            true => Event::Glossy,
            false => Event::Diffuse,
        };
        let step = |event| match self.mode {
            TransportMode::Radiance => paths.before(arrived, event),
            TransportMode::Flux => paths.after(arrived, event),
        };
        self.states = VertexStates {
            arrived,
            smooth: step(smooth),
            delta: step(Event::Specular),
        };
    }

    /// f(wo, wi) [1/sr], delta lobes left out.
    pub(crate) fn eval(&self, wi: Vec3) -> Spectrum {
        self.bsdf.f(self.wo_local, self.point.frame.to_local(wi), self.mode)
    }

    /// Solid-angle density [1/sr] of [`Self::sample`], delta lobes left out.
    pub(crate) fn pdf(&self, wi: Vec3) -> f32 {
        self.bsdf.pdf(self.wo_local, self.point.frame.to_local(wi))
    }

    /// f and both densities of a direction at once.
    pub(crate) fn towards(&self, wi: Vec3) -> Towards {
        let wi = self.point.frame.to_local(wi);
        Towards {
            f: self.bsdf.f(self.wo_local, wi, self.mode),
            pdf: self.bsdf.pdf(self.wo_local, wi),
            pdf_rev: self.bsdf.pdf(wi, self.wo_local),
        }
    }

    /// The density with which the way back of a direction sampled here would have been sampled [1/sr]; where a delta function chose
    /// it, in units of the density of the way ([`Bsdf::pdf_rev`]).
    pub(crate) fn pdf_rev_of(&self, scattered: &Scattered) -> f32 {
        self.bsdf.pdf_rev(self.wo_local, &scattered.bsdf)
    }

    /// Samples a direction; three dimensions.
    pub(crate) fn sample(&self, random: &mut PathRandom) -> Option<Scattered> {
        let lobe = random.next_1d();
        let bsdf = self.bsdf.sample(self.wo_local, lobe, random.next_2d(), self.mode)?;
        Some(Scattered {
            wi: self.point.frame.to_world(bsdf.wi),
            cos_shading: bsdf.wi.z.abs(),
            bsdf,
        })
    }

    /// Whether every lobe is a delta function of direction.
    pub(crate) fn is_delta(&self) -> bool {
        !self.bsdf.has_smooth()
    }

    /// Whether some lobe is a delta function of direction.
    pub(crate) fn has_delta(&self) -> bool {
        self.bsdf.has_delta()
    }

    /// Whether the lobes that are no delta functions are too glossy for a density estimate, or there are none.
    pub(crate) fn is_glossier_than(&self, roughness: f32) -> bool {
        self.bsdf.is_glossier_than(roughness)
    }

    /// Cosine of `direction` with the shading normal, without sign.
    pub(crate) fn cos_shading(&self, direction: Vec3) -> f32 {
        direction.dot(self.point.frame.n).abs()
    }

    /// Cosine of `direction` with the geometric normal, without sign.
    pub(crate) fn cos_geometric(&self, direction: Vec3) -> f32 {
        direction.dot(self.point.geometric_normal).abs()
    }

    /// Whether `direction` points to the side of the true surface that `wo` points to.
    pub(crate) fn on_side_of_wo(&self, direction: Vec3) -> bool {
        let height = |w: Vec3| w.dot(self.point.geometric_normal);
        height(direction) * height(self.wo) > 0.0
    }

    /// What turns flux that arrives along `-wo` through the true surface into flux through the surface that the
    /// shading normal pretends: `|wo . ns| / |wo . ng|` (Veach 1997, section 5.3).
    pub(crate) fn arrival_correction(&self) -> f32 {
        let geometric = self.cos_geometric(self.wo);
        if geometric == 0.0 {
            0.0
        } else {
            self.wo_local.z.abs() / geometric
        }
    }

    /// Factor of the flux that goes on along a sampled direction: `f |wi . ng| / pdf`.
    pub(crate) fn continuation_weight(&self, scattered: &Scattered) -> Spectrum {
        if scattered.cos_shading == 0.0 {
            return Spectrum::ZERO;
        }
        scattered.weight() * (self.cos_geometric(scattered.wi) / scattered.cos_shading)
    }

    /// A cone at this vertex.
    pub(crate) fn cone(&self, direction: Vec3, weight: Spectrum, states: States) -> Cone {
        Cone::new(
            self.point.position,
            self.point.geometric_normal,
            direction,
            weight,
            self.edges,
            states,
        )
    }
}
