//! Vertices on surfaces and in media.

use super::expression::{ANY, Event, PathExpression, States};
use crate::density::Cone;
use crate::geometry::{Ray, SHADOW_GAP, SurfacePoint};
use crate::integrator::GLOSSY_ROUGHNESS;
use crate::material::{Bsdf, BsdfSample, Tangents, TransportMode};
use crate::math::Vec3;
use crate::medium::{Phase, Sides, Space};
use crate::random::PathRandom;
use crate::scene::Scene;
use crate::spectrum::Spectrum;

/// A vertex of a subpath on a surface or in a medium, with the interface of its BSDF, or phase function, in world space.
///
/// In a medium there is no normal: every cosine with it counts as 1.
#[derive(Clone)]
pub(crate) struct Vertex<'s> {
    site: Site<'s>,
    /// What arrives: of a camera subpath, the share of the radiance that leaves along `wo` which reaches the camera; of a light
    /// subpath, the flux along `-wo` \[W\], corrected for the shading normal.
    pub(crate) beta: Spectrum,
    /// Edges of the subpath up to here.
    pub(crate) edges: u32,
    /// Of these, those that limits of the length of paths count ([`super::Walk::counted_edges`]).
    pub(crate) counted_edges: u32,
    /// Unit direction back along the subpath.
    pub(crate) wo: Vec3,
    mode: TransportMode,
    pub(crate) states: VertexStates,
    /// What lies on the two sides of the surface, or the same on both in a medium.
    sides: Sides,
}

/// Where a vertex lies, and what scatters there.
#[derive(Clone)]
#[expect(clippy::large_enum_variant, reason = "a box would be an allocation for every vertex")]
enum Site<'s> {
    Surface {
        point: SurfacePoint,
        /// The material at the point, its textures looked up.
        bsdf: Bsdf,
        wo_local: Vec3,
    },
    Medium {
        position: Vec3,
        phase: &'s Phase,
    },
}

/// A straight way from a vertex, along which light may come.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    /// Ends just before what the way leads to.
    pub(crate) ray: Ray,
    /// To the end \[scene units\].
    pub(crate) length: f32,
    /// What the way begins in.
    pub(crate) space: Space,
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

impl Way {
    /// The way to what lies at `length` along it.
    pub(crate) fn up_to(self, length: f32) -> Self {
        let max_distance = length * (1.0 - SHADOW_GAP);
        Self {
            ray: Ray {
                max_distance,
                ..self.ray
            },
            length,
            ..self
        }
    }

    /// What is left of the way behind a surface that it goes straight through.
    pub(crate) fn behind(self, scene: &Scene, point: &SurfacePoint) -> Self {
        let direction = self.ray.direction;
        Self {
            ray: Ray {
                max_distance: self.ray.max_distance - point.distance,
                ..point.ray_towards(direction)
            },
            length: self.length - point.distance,
            space: scene
                .sides(point, self.space, direction)
                .towards(direction, point.geometric_normal),
        }
    }
}

/// A direction in which a vertex is connected or merged, delta lobes left out.
pub(crate) struct Towards {
    /// f(wo, wi) \[1/sr\].
    pub(crate) f: Spectrum,
    /// Solid-angle density of sampling the direction \[1/sr\].
    pub(crate) pdf: f32,
    /// Solid-angle density of sampling the direction back along the path, for a path that comes along this one \[1/sr\].
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

impl<'s> Vertex<'s> {
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
            site: Site::Surface { point, bsdf, wo_local },
            beta: Spectrum::ONE,
            edges: 1,
            counted_edges: 1,
            wo,
            mode,
            states: VertexStates::ANY,
            sides: Sides::NOTHING,
        }
    }

    /// As [`Self::new`], in a space whose medium scatters by `phase`.
    pub(super) fn in_medium(position: Vec3, space: Space, phase: &'s Phase, wo: Vec3, mode: TransportMode) -> Self {
        Self {
            site: Site::Medium { position, phase },
            beta: Spectrum::ONE,
            edges: 1,
            counted_edges: 1,
            wo,
            mode,
            states: VertexStates::ANY,
            sides: Sides::within(space),
        }
    }

    /// Says what lies on the sides of the vertex's surface, and the index of refraction of what a body's surface stands in.
    pub(super) fn stand(&mut self, sides: Sides, index: f32) {
        self.sides = sides;
        if index != 1.0
            && let Site::Surface { bsdf, .. } = &mut self.site
        {
            bsdf.immerse(index);
        }
    }

    /// The point of the surface that the vertex lies on; `None` in a medium.
    pub(crate) fn surface(&self) -> Option<&SurfacePoint> {
        match &self.site {
            Site::Surface { point, .. } => Some(point),
            Site::Medium { .. } => None,
        }
    }

    /// \[scene units\].
    pub(crate) fn position(&self) -> Vec3 {
        match &self.site {
            Site::Surface { point, .. } => point.position,
            Site::Medium { position, .. } => *position,
        }
    }

    /// Into what `direction` leads.
    pub(crate) fn space_towards(&self, direction: Vec3) -> Space {
        match &self.site {
            Site::Surface { point, .. } => self.sides.towards(direction, point.geometric_normal),
            Site::Medium { .. } => self.sides.towards(direction, direction),
        }
    }

    /// A ray that leaves the vertex.
    pub(super) fn ray_towards(&self, direction: Vec3) -> Ray {
        match &self.site {
            Site::Surface { point, .. } => point.ray_towards(direction),
            Site::Medium { position, .. } => Ray {
                origin: *position,
                direction,
                max_distance: f32::INFINITY,
            },
        }
    }

    /// The way to what lies at `length` along the unit vector `direction`.
    pub(crate) fn way_to(&self, direction: Vec3, length: f32) -> Way {
        let way = |ray| Way {
            ray,
            length,
            space: self.space_towards(direction),
        };
        match &self.site {
            Site::Surface { point, .. } => way(point.shadow_ray(direction, length)),
            Site::Medium { .. } => way(self.ray_towards(direction)).up_to(length),
        }
    }

    /// Notes where the subpath is among the words of an expression.
    pub(super) fn note(&mut self, paths: &PathExpression, arrived: States) {
        let smooth = match self.site {
            Site::Medium { .. } => Event::Volume,
            Site::Surface { .. } if self.is_glossier_than(GLOSSY_ROUGHNESS) => Event::Glossy,
            Site::Surface { .. } => Event::Diffuse,
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

    /// f(wo, wi) \[1/sr\], delta lobes left out.
    pub(crate) fn eval(&self, wi: Vec3) -> Spectrum {
        match &self.site {
            Site::Surface { point, bsdf, wo_local } => bsdf.f(*wo_local, point.frame.to_local(wi), self.mode),
            Site::Medium { phase, .. } => Spectrum::splat(phase.pdf(self.wo, wi)),
        }
    }

    /// Solid-angle density \[1/sr\] of [`Self::sample`], delta lobes left out.
    pub(crate) fn pdf(&self, wi: Vec3) -> f32 {
        match &self.site {
            Site::Surface { point, bsdf, wo_local } => bsdf.pdf(*wo_local, point.frame.to_local(wi)),
            Site::Medium { phase, .. } => phase.pdf(self.wo, wi),
        }
    }

    /// f and both densities of a direction at once.
    pub(crate) fn towards(&self, wi: Vec3) -> Towards {
        match &self.site {
            Site::Surface { point, bsdf, wo_local } => {
                let wi = point.frame.to_local(wi);
                Towards {
                    f: bsdf.f(*wo_local, wi, self.mode),
                    pdf: bsdf.pdf(*wo_local, wi),
                    pdf_rev: bsdf.pdf(wi, *wo_local),
                }
            }
            Site::Medium { phase, .. } => {
                let pdf = phase.pdf(self.wo, wi);
                Towards {
                    f: Spectrum::splat(pdf),
                    pdf,
                    pdf_rev: pdf,
                }
            }
        }
    }

    /// The density with which the way back of a direction sampled here would have been sampled \[1/sr\]; where a delta function chose
    /// it, in units of the density of the way ([`Bsdf::pdf_rev`]).
    pub(crate) fn pdf_rev_of(&self, scattered: &Scattered) -> f32 {
        match &self.site {
            Site::Surface { bsdf, wo_local, .. } => bsdf.pdf_rev(*wo_local, &scattered.bsdf),
            Site::Medium { .. } => scattered.bsdf.pdf,
        }
    }

    /// Samples a direction; three dimensions.
    pub(crate) fn sample(&self, random: &mut PathRandom) -> Option<Scattered> {
        let choice = random.next_1d();
        match &self.site {
            Site::Surface { point, bsdf, wo_local } => {
                let bsdf = bsdf.sample(*wo_local, choice, random.next_2d(), self.mode)?;
                Some(Scattered {
                    wi: point.frame.to_world(bsdf.wi),
                    cos_shading: bsdf.wi.z.abs(),
                    bsdf,
                })
            }
            Site::Medium { phase, .. } => {
                let wi = phase.sample(self.wo, choice, random.next_2d());
                let pdf = phase.pdf(self.wo, wi);
                (pdf > 0.0).then(|| Scattered {
                    wi,
                    cos_shading: 1.0,
                    bsdf: BsdfSample::scattered(wi, Spectrum::splat(pdf), pdf),
                })
            }
        }
    }

    /// Whether every lobe is a delta function of direction.
    pub(crate) fn is_delta(&self) -> bool {
        match &self.site {
            Site::Surface { bsdf, .. } => !bsdf.has_smooth(),
            Site::Medium { .. } => false,
        }
    }

    /// Whether some lobe is a delta function of direction.
    pub(crate) fn has_delta(&self) -> bool {
        match &self.site {
            Site::Surface { bsdf, .. } => bsdf.has_delta(),
            Site::Medium { .. } => false,
        }
    }

    /// Whether a density estimate on surfaces does not serve here: in a medium, and where the lobes that are no delta functions are too
    /// glossy for it, or there are none.
    pub(crate) fn is_glossier_than(&self, roughness: f32) -> bool {
        match &self.site {
            Site::Surface { bsdf, .. } => bsdf.is_glossier_than(roughness),
            Site::Medium { .. } => true,
        }
    }

    /// Whether a sampled direction goes straight on through the surface, as through a pane or where a mask has a hole.
    pub(super) fn goes_straight(&self, scattered: &Scattered) -> bool {
        let BsdfSample { wi, delta, eta, .. } = scattered.bsdf;
        matches!(&self.site, Site::Surface { wo_local, .. } if delta && eta == 1.0 && wi.z * wo_local.z < 0.0)
    }

    /// Cosine of `direction` with the shading normal, without sign.
    pub(crate) fn cos_shading(&self, direction: Vec3) -> f32 {
        self.surface().map_or(1.0, |point| direction.dot(point.frame.n).abs())
    }

    /// Cosine of `direction` with the geometric normal, without sign.
    pub(crate) fn cos_geometric(&self, direction: Vec3) -> f32 {
        self.surface()
            .map_or(1.0, |point| direction.dot(point.geometric_normal).abs())
    }

    /// Whether `direction` points to the side of the true surface that `wo` points to.
    pub(crate) fn on_side_of_wo(&self, direction: Vec3) -> bool {
        self.surface().is_none_or(|point| {
            let height = |w: Vec3| w.dot(point.geometric_normal);
            height(direction) * height(self.wo) > 0.0
        })
    }

    /// What turns flux that arrives along `-wo` through the true surface into flux through the surface that the
    /// shading normal pretends: `|wo . ns| / |wo . ng|` (Veach 1997, section 5.3).
    pub(crate) fn arrival_correction(&self) -> f32 {
        let Site::Surface { wo_local, .. } = &self.site else {
            return 1.0;
        };
        let geometric = self.cos_geometric(self.wo);
        if geometric == 0.0 {
            0.0
        } else {
            wo_local.z.abs() / geometric
        }
    }

    /// Factor of the flux that goes on along a sampled direction: `f |wi . ng| / pdf`.
    pub(crate) fn continuation_weight(&self, scattered: &Scattered) -> Spectrum {
        if scattered.cos_shading == 0.0 {
            return Spectrum::ZERO;
        }
        scattered.weight() * (self.cos_geometric(scattered.wi) / scattered.cos_shading)
    }

    /// A cone at this vertex. `states`: after it has scattered, on a surface; in a medium that is left to the camera's path ([`super::Crossed`]).
    pub(crate) fn cone(&self, direction: Vec3, weight: Spectrum, states: States) -> Cone {
        match &self.site {
            Site::Surface { point, .. } => Cone::new(
                point.position,
                point.geometric_normal,
                direction,
                weight,
                self.edges,
                states,
            ),
            // Nobody asks for a normal there.
            Site::Medium { position, .. } => Cone::new(
                *position,
                direction,
                direction,
                weight,
                self.counted_edges,
                self.states.arrived,
            ),
        }
    }
}
