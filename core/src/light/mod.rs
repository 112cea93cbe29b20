//! Lights: evaluation, connections to them, and the start of light paths.
//!
//! Area lights emit on the side of [`SurfacePoint::geometric_normal`], and that normal gives the cosine of what they
//! emit. All lights at infinity that fill directions (constant, environment, sun) are treated as one background: a
//! connection to any of them carries their sum, with the density of their mixture. Those behind a [`Portal`] are each sampled
//! alone.

mod area;
mod background;
mod beyond;
pub mod daylight;
mod direction_map;
mod environment;
mod equal_area;
mod goniometric;
mod kinds;
mod portal;
mod projector;
mod sample;
mod source;
mod spot;
mod sun;
#[cfg(test)]
mod tests;
mod world;

use crate::geometry::{Geometry, Ray, ShapeId, SurfacePoint};
use crate::math::warp::{square_to_cosine_hemisphere, square_to_sphere};
use crate::math::{DVec2, Discrete, FRAC_1_PI, Frame, PI, Transform, Vec3, to_unit_vec2};
use crate::spectrum::Spectrum;
use background::Background;
pub use kinds::{Even, Falloff, Light, Mapping};
use portal::Opening;
pub use portal::Portal;
pub use sample::{EmissionSample, LightSample, Origin};
use source::Source;
use std::sync::Arc;
use world::World;

/// Index of a light in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightId(pub u32);

/// Share of the choices among lights that all lights have equal parts of, however weak (a defensive mixture: Hesterberg 1995); the
/// others are in proportion to power. A sun that shines at the outside of a house would leave its lamps almost no path otherwise. It
/// takes at most a tenth of the paths from where power would send them.
const DEFENSIVE: f64 = 0.1;

/// The scene's lights, and the probability with which each is chosen: mostly in proportion to its power ([`DEFENSIVE`]).
#[derive(Clone, Debug)]
pub struct Lights {
    sources: Arc<[Source]>,
    choice: Discrete,
    /// Probability of each source.
    probabilities: Vec<f32>,
    /// Those of the sources that rays which hit nothing meet: the lights that fill directions at infinity.
    backgrounds: Vec<u32>,
    /// Those that such rays meet where they pass a portal.
    portals: Vec<u32>,
    /// Whether each source emits nothing, though it is chosen as if it did ([`Lights::only`]); empty where all emit.
    dark: Vec<bool>,
    world: World,
}

impl Lights {
    /// Builds the distributions. `geometry` gives area lights their shapes and distant lights the scene's bounds.
    #[must_use]
    pub fn build(lights: Vec<Light>, geometry: &Geometry) -> Self {
        let sources = lights.into_iter().map(|light| Source::new(light, geometry)).collect();
        Self::of_sources(sources, geometry)
    }

    /// The lights after a motion that has made `geometry` of the geometry before; each light of `moved` is where its transform puts
    /// it, or its shape is now.
    #[must_use]
    pub fn moved(&self, geometry: &Geometry, moved: impl IntoIterator<Item = (LightId, Transform)>) -> Self {
        let mut sources = self.sources.to_vec();
        for (LightId(id), to_world) in moved {
            let source = &mut sources[id as usize];
            *source = source.moved(&to_world, geometry);
        }
        Self::of_sources(sources, geometry)
    }

    fn of_sources(sources: Vec<Source>, geometry: &Geometry) -> Self {
        let world = World::new(geometry);
        let powers: Vec<f64> = sources
            .iter()
            .map(|source| f64::from(source.power(&world).max(0.0)))
            .collect();
        let choice = Discrete::new(shares(&powers).into_iter());
        let indices = |is: fn(&Source) -> bool| -> Vec<u32> {
            let found = (0..).zip(&sources).filter(|(_, source)| is(source));
            found.map(|(index, _)| index).collect()
        };
        Self {
            probabilities: (0..sources.len())
                .map(|index| choice.probability(index) as f32)
                .collect(),
            backgrounds: indices(|source| matches!(source, Source::Background(_))),
            portals: indices(|source| matches!(source, Source::Portal(_))),
            sources: sources.into(),
            choice,
            dark: Vec::new(),
            world,
        }
    }

    /// The same lights, of which those alone emit that `shines` picks. They are chosen, and their densities are, as if all emitted: paths
    /// are those of all the lights, and images of parts of the lights add up to the image of all.
    #[must_use]
    pub(crate) fn only(&self, shines: impl Fn(LightId) -> bool) -> Self {
        Self {
            dark: (0..self.sources.len() as u32).map(|id| !shines(LightId(id))).collect(),
            ..self.clone()
        }
    }

    /// Whether the source emits nothing.
    #[inline]
    fn is_dark(&self, index: usize) -> bool {
        self.dark.get(index).copied().unwrap_or(false)
    }

    /// Whether nothing comes from the source when it is chosen. What a background's directions bring is the sum of all backgrounds.
    fn gives_nothing(&self, index: usize) -> bool {
        self.is_dark(index) && !matches!(self.sources[index], Source::Background(_))
    }

    /// Whether there is a light that no ray finds, such as a point light ([`LightSample::delta`]).
    pub(crate) fn any_delta(&self) -> bool {
        let found = |source: &Source| matches!(source, Source::Area(_) | Source::Background(_) | Source::Portal(_));
        !self.sources.iter().all(found)
    }

    /// Whether there is no light.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// Connects `from` with a light. `choice` selects the light, `u` the point on it. `None` where nothing can arrive.
    #[must_use]
    pub fn sample_direct(&self, geometry: &Geometry, from: Vec3, choice: f64, u: DVec2) -> Option<LightSample> {
        let (index, _) = self.choice.sample(choice)?;
        if self.gives_nothing(index) {
            return None;
        }
        let probability = self.probabilities[index];
        let towards = |position: Vec3| {
            let offset = position - from;
            let distance = offset.length();
            (distance > 0.0).then(|| (offset / distance, distance))
        };
        let delta = |wi, distance, radiance, arrival| LightSample {
            wi,
            distance,
            radiance,
            pdf: probability,
            delta: true,
            arrival,
        };
        let per_cross_section = 1.0 / self.world.cross_section();
        let sample = match &self.sources[index] {
            Source::Area(area) => {
                let towards = area.sampler.sample_towards(geometry, from, u)?;
                if !area.emits_along(&towards.point, -towards.direction) {
                    return None;
                }
                let radiance = area.radiance.eval(&(&towards.point).into());
                let pdf = towards.pdf * probability;
                LightSample {
                    wi: towards.direction,
                    distance: towards.distance,
                    radiance,
                    pdf,
                    delta: false,
                    arrival: FRAC_1_PI * probability / (area.emitting() * pdf),
                }
            }
            Source::Normals(_) => return None,
            Source::Point { position, intensity } => {
                let (wi, distance) = towards(*position)?;
                let spread = 1.0 / (distance * distance);
                delta(wi, distance, *intensity * spread, 0.25 * FRAC_1_PI * spread)
            }
            Source::Spot(spot) => {
                let (wi, distance) = towards(spot.position())?;
                let spread = 1.0 / (distance * distance);
                delta(wi, distance, spot.intensity(-wi) * spread, spot.pdf() * spread)
            }
            Source::Projector(projector) => {
                let (wi, distance) = towards(projector.position())?;
                let spread = 1.0 / (distance * distance);
                delta(
                    wi,
                    distance,
                    projector.intensity(-wi) * spread,
                    projector.pdf(-wi) * spread,
                )
            }
            Source::Goniometric(lamp) => {
                let (wi, distance) = towards(lamp.position())?;
                let spread = 1.0 / (distance * distance);
                delta(wi, distance, lamp.intensity(-wi) * spread, lamp.pdf(-wi) * spread)
            }
            Source::Directional { direction, irradiance } => {
                delta(-*direction, f32::INFINITY, *irradiance, per_cross_section)
            }
            Source::Background(background) => {
                let wi = background.sample(u)?;
                let (radiance, pdf) = (self.background(wi), self.pdf_background(wi));
                LightSample {
                    wi,
                    distance: f32::INFINITY,
                    radiance,
                    pdf,
                    delta: false,
                    arrival: per_cross_section,
                }
            }
            Source::Portal(opening) => opening.connect(probability, from, u)?,
        };
        (sample.pdf > 0.0 && !sample.radiance.is_black()).then_some(sample)
    }

    /// Density [1/sr, choice of light included] with which [`Self::sample_direct`] at `from` returns the direction to `hit`, a point on the area light `light`.
    #[must_use]
    pub fn pdf_area(&self, _geometry: &Geometry, light: LightId, from: Vec3, hit: &SurfacePoint) -> f32 {
        match &self.sources[light.0 as usize] {
            Source::Area(area) if area.emits_along(hit, from - hit.position) => {
                area.sampler.pdf_towards(from, hit) * self.probabilities[light.0 as usize]
            }
            _ => 0.0,
        }
    }

    /// Radiance that the area light `light` emits at `hit` along the unit vector `wo`.
    #[must_use]
    pub fn emitted(&self, light: LightId, hit: &SurfacePoint, wo: Vec3) -> Spectrum {
        let index = light.0 as usize;
        match &self.sources[index] {
            Source::Area(area) if area.emits_along(hit, wo) && !self.is_dark(index) => area.radiance.eval(&hit.into()),
            _ => Spectrum::ZERO,
        }
    }

    /// Radiant intensity of a light at a point along the unit vector `direction` \[W/sr\].
    pub(crate) fn intensity(&self, light: LightId, direction: Vec3) -> Spectrum {
        let index = light.0 as usize;
        if self.is_dark(index) {
            return Spectrum::ZERO;
        }
        match &self.sources[index] {
            Source::Point { intensity, .. } => *intensity,
            Source::Spot(spot) => spot.intensity(direction),
            Source::Projector(projector) => projector.intensity(direction),
            Source::Goniometric(lamp) => lamp.intensity(direction),
            _ => Spectrum::ZERO,
        }
    }

    /// Radiance that arrives from outside the scene from the unit vector `direction`; the sum over distant lights without a portal.
    #[must_use]
    pub(crate) fn background(&self, direction: Vec3) -> Spectrum {
        self.backgrounds()
            .filter(|(index, _)| !self.is_dark(*index))
            .map(|(_, background)| background.radiance(direction))
            .sum()
    }

    /// Density [1/sr, choice of light included] with which [`Self::sample_direct`] returns `direction` from the background lights.
    #[must_use]
    pub(crate) fn pdf_background(&self, direction: Vec3) -> f32 {
        self.backgrounds()
            .map(|(index, background)| self.probabilities[index] * background.pdf(direction))
            .sum()
    }

    /// Starts a light path. `None` where the path would carry nothing.
    #[must_use]
    pub fn sample_emission(
        &self,
        geometry: &Geometry,
        choice: f64,
        u_position: DVec2,
        u_direction: DVec2,
    ) -> Option<EmissionSample> {
        let (index, _) = self.choice.sample(choice)?;
        if self.gives_nothing(index) {
            return None;
        }
        let probability = self.probabilities[index];
        let (position, direction) = (to_unit_vec2(u_position), to_unit_vec2(u_direction));
        let cross_section = self.world.cross_section();
        let at_point = |ray, flux, pdf_direction| EmissionSample {
            ray,
            flux: flux / probability,
            origin: Origin::Point(LightId(index as u32)),
            pdf_position: probability,
            pdf_direction,
        };
        let sample = match &self.sources[index] {
            Source::Area(area) => {
                let point = area.sample(geometry, u_position)?;
                let local = square_to_cosine_hemisphere(direction);
                let direction = Frame::from_normal(point.geometric_normal).to_world(local).normalize();
                EmissionSample {
                    ray: point.ray_towards(direction),
                    flux: area.radiance.eval(&(&point).into()) * (PI * area.emitting()) / probability,
                    origin: Origin::Area(LightId(index as u32), point),
                    pdf_position: probability / area.emitting(),
                    pdf_direction: FRAC_1_PI * point.geometric_normal.dot(direction).max(0.0),
                }
            }
            Source::Normals(area) => {
                let point = area.sample(geometry, u_position)?;
                EmissionSample {
                    ray: point.ray_towards(point.geometric_normal),
                    flux: area.radiance.eval(&(&point).into()) * (area.emitting() / probability),
                    origin: Origin::Normals(LightId(index as u32)),
                    pdf_position: probability / area.emitting(),
                    pdf_direction: 1.0,
                }
            }
            Source::Point { position, intensity } => {
                let ray = Ray {
                    origin: *position,
                    direction: square_to_sphere(direction),
                    max_distance: f32::INFINITY,
                };
                at_point(ray, *intensity * (4.0 * PI), 0.25 * FRAC_1_PI)
            }
            Source::Spot(spot) => {
                let (ray, flux) = spot.emit(direction);
                at_point(ray, flux, spot.pdf())
            }
            Source::Projector(projector) => {
                let (ray, flux, pdf) = projector.emit(direction);
                at_point(ray, flux, pdf)
            }
            Source::Goniometric(lamp) => {
                let (ray, flux, pdf) = lamp.emit(u_direction)?;
                at_point(ray, flux, pdf)
            }
            Source::Directional { direction, irradiance } => EmissionSample {
                ray: self.world.ray(*direction, position),
                flux: *irradiance * cross_section / probability,
                origin: Origin::Directional,
                pdf_position: 1.0 / cross_section,
                pdf_direction: probability,
            },
            Source::Background(background) => {
                let towards = background.sample(u_direction)?;
                let pdf = self.pdf_background(towards);
                if pdf <= 0.0 {
                    return None;
                }
                EmissionSample {
                    ray: self.world.ray(-towards, position),
                    flux: self.background(towards) * (cross_section / pdf),
                    origin: Origin::Background,
                    pdf_position: 1.0 / cross_section,
                    pdf_direction: pdf,
                }
            }
            Source::Portal(opening) => {
                let chosen = (LightId(index as u32), probability);
                opening.emit(chosen, u_position, u_direction)?
            }
        };
        (!sample.flux.is_black()).then_some(sample)
    }

    /// The way that the light of a path through a portal has come before its ray, as a ray back to infinity: the path carries what comes
    /// along it.
    #[must_use]
    pub fn way_before(&self, start: &EmissionSample) -> Option<Ray> {
        match start.origin {
            Origin::Portal(light) => match &self.sources[light.0 as usize] {
                Source::Portal(opening) => Some(opening.way_before(&start.ray)),
                _ => None,
            },
            _ => None,
        }
    }

    /// Density with which [`Self::sample_direct`] at `from` returns the start of a light path, over that with which the path starts
    /// there.
    #[must_use]
    pub fn connection_over_emission(&self, geometry: &Geometry, start: &EmissionSample, from: Vec3) -> f32 {
        match &start.origin {
            Origin::Area(light, point) => {
                let offset = from - point.position;
                let distance2 = offset.length_squared();
                let facing = point.geometric_normal.dot(offset).max(0.0) / distance2.sqrt();
                self.pdf_area(geometry, *light, from, point) * facing / (distance2 * start.pdf_position)
            }
            Origin::Normals(_) => 0.0,
            Origin::Portal(light) => match &self.sources[light.0 as usize] {
                Source::Portal(opening) => opening.connection_over_emission(from, -start.ray.direction),
                _ => 0.0,
            },
            Origin::Point(_) | Origin::Directional | Origin::Background => 1.0,
        }
    }

    /// Density with which [`Self::sample_emission`] starts at a point of the area light `light`, on a side of it [1/unit^2], the choice
    /// of light included.
    #[must_use]
    pub fn pdf_emission_position(&self, light: LightId) -> f32 {
        match &self.sources[light.0 as usize] {
            Source::Area(area) => self.probabilities[light.0 as usize] / area.emitting(),
            _ => 0.0,
        }
    }

    /// Density of the rays of light paths from infinity over the disc that faces them [1/unit^2].
    #[must_use]
    pub(crate) fn pdf_through_scene(&self) -> f32 {
        1.0 / self.world.cross_section()
    }

    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.sources.len()
    }

    /// The shape of an area light, its area [unit^2], and whether both of its sides emit.
    pub(crate) fn area(&self, light: LightId) -> Option<(ShapeId, f32, bool)> {
        match &self.sources[light.0 as usize] {
            Source::Area(area) => Some((area.sampler.shape(), area.sampler.area(), area.two_sided)),
            _ => None,
        }
    }

    /// The unit axis and the cosine of the half angle of the cone into which a light at a point shines.
    pub(crate) fn cone(&self, light: LightId) -> Option<(Vec3, f32)> {
        match &self.sources[light.0 as usize] {
            Source::Spot(spot) => Some(spot.cone()),
            _ => None,
        }
    }

    /// A place at which light leaves the light of this index; `None` of one at infinity.
    pub(crate) fn a_place(&self, geometry: &Geometry, index: usize) -> Option<Vec3> {
        match &self.sources[index] {
            Source::Area(area) | Source::Normals(area) => {
                let point = area.sample(geometry, DVec2::splat(0.25))?;
                Some(point.ray_towards(point.geometric_normal).origin)
            }
            Source::Point { position, .. } => Some(*position),
            Source::Spot(spot) => Some(spot.position()),
            Source::Projector(projector) => Some(projector.position()),
            Source::Goniometric(lamp) => Some(lamp.position()),
            Source::Directional { .. } | Source::Background(_) | Source::Portal(_) => None,
        }
    }

    /// The lights that fill directions at infinity, each with its index.
    fn backgrounds(&self) -> impl Iterator<Item = (usize, &Background)> {
        let indices = self.backgrounds.iter().map(|index| *index as usize);
        indices.filter_map(|index| match &self.sources[index] {
            Source::Background(background) => Some((index, background)),
            _ => None,
        })
    }

    /// The lights behind portals that emit, each with its probability.
    fn portals(&self) -> impl Iterator<Item = (f32, &Opening)> {
        self.portals
            .iter()
            .filter(|index| !self.is_dark(**index as usize))
            .filter_map(|index| match &self.sources[*index as usize] {
                Source::Portal(opening) => Some((self.probabilities[*index as usize], &**opening)),
                _ => None,
            })
    }
}

/// The share of choices of each light of the given powers; none for a light without power.
fn shares(powers: &[f64]) -> Vec<f64> {
    let total: f64 = powers.iter().sum();
    let shining = powers.iter().filter(|power| **power > 0.0).count();
    let share = |power: &f64| {
        if *power > 0.0 {
            (1.0 - DEFENSIVE) * power / total + DEFENSIVE / shining as f64
        } else {
            0.0
        }
    };
    powers.iter().map(share).collect()
}
