//! Lights: evaluation, connections to them, and the start of light paths.
//!
//! Area lights emit on the side of [`SurfacePoint::geometric_normal`], and that normal gives the cosine of what they
//! emit. All lights at infinity that fill directions (constant, environment, sun) are treated as one background: a
//! connection to any of them carries their sum, with the density of their mixture.

mod background;
pub mod daylight;
mod direction_map;
mod environment;
mod equal_area;
mod goniometric;
mod projector;
mod spot;
mod sun;
#[cfg(test)]
mod tests;

use crate::geometry::{Geometry, Ray, ShapeId, ShapeSampler, SurfacePoint};
use crate::math::warp::{square_to_cosine_hemisphere, square_to_disk, square_to_sphere};
use crate::math::{DVec2, Discrete, FRAC_1_PI, Frame, PI, Transform, Vec2, Vec3, to_unit_vec2};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, Texture};
use background::Background;
use direction_map::DirectionMap;
use goniometric::Goniometric;
use projector::Projector;
use spot::Spot;
use std::sync::Arc;
use sun::Sun;

/// Index of a light in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightId(pub u32);

/// A connection from a point to a light (next-event estimation).
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction from the point to the light.
    pub wi: Vec3,
    /// Distance to the light; infinite for distant ones.
    pub distance: f32,
    /// Radiance arriving along `wi` if nothing is in the way; for a delta light divided by nothing: the factor such that
    /// `f * |cos| * radiance / pdf` estimates the reflected radiance.
    pub radiance: Spectrum,
    /// Solid-angle density [1/sr] times the probability of choosing the light; for a delta light that probability alone.
    pub pdf: f32,
    /// Whether no other technique can hit this light (point, spot, directional).
    pub delta: bool,
    /// Density with which a light path from the same point of the light arrives at the place connected [1/unit^2, by area that
    /// faces the light], times that of starting there ([`Lights::sample_emission`]) over that of being connected with.
    pub arrival: f32,
}

/// The start of a light path.
#[derive(Clone, Copy, Debug)]
pub struct EmissionSample {
    /// Ray away from the light, already off its surface.
    pub ray: Ray,
    /// Flux of the path: emitted radiance times cosine over the density of origin, direction and light choice [W].
    pub flux: Spectrum,
    /// Where it starts.
    pub origin: Origin,
    /// Density of the origin, the choice of light included, where it lies at a finite distance: [1/unit^2] on an area light, 1 of a
    /// point. Of the ray through the disc that faces it [1/unit^2] where it does not.
    pub pdf_position: f32,
    /// Solid-angle density of the direction [1/sr], the choice of light included where it lies at infinity; of a directional light
    /// that choice alone, and 1 where the origin says the direction.
    pub pdf_direction: f32,
}

/// Where a light path starts.
#[derive(Clone, Copy, Debug)]
pub enum Origin {
    /// On an area light.
    Area(LightId, SurfacePoint),
    /// On a shape that emits along its normals: nothing but light paths finds it.
    Normals,
    /// At a point: a point light, a spot, a projector or a goniometric light.
    Point,
    /// At infinity, in one direction.
    Directional,
    /// At infinity, in any direction.
    Background,
}

impl Origin {
    /// Whether paths that are scattered can find it.
    #[must_use]
    pub fn is_hit_by_chance(&self) -> bool {
        matches!(self, Self::Area(..) | Self::Background)
    }

    /// Whether it lies at infinity.
    #[must_use]
    pub fn is_infinite(&self) -> bool {
        matches!(self, Self::Directional | Self::Background)
    }
}

/// A light, as validated data in world space.
#[derive(Clone, Debug)]
pub enum Light {
    /// A shape whose outer side emits `radiance` [W/(m^2 sr)] in every direction.
    Area {
        /// The shape that emits.
        shape: ShapeId,
        /// Radiance, by the shape's texture coordinates.
        radiance: Texture,
        /// Whether its inner side emits as well.
        two_sided: bool,
    },
    /// A shape that emits along the normals of its outer side alone, as Mitsuba's `directionalarea`.
    DirectionalArea {
        /// The shape that emits.
        shape: ShapeId,
        /// Radiant exitance [W/m^2], by the shape's texture coordinates.
        exitance: Texture,
    },
    /// `intensity` [W/sr] in every direction from `position`.
    Point {
        /// Place of the light [scene units].
        position: Vec3,
        /// Radiant intensity [W/sr].
        intensity: Spectrum,
    },
    /// A spot: full intensity within `beam_width`, falling to zero at `cutoff_angle` [radians].
    Spot {
        /// Maps the origin to the light's place and +z to its axis.
        to_world: Transform,
        /// Radiant intensity on the axis [W/sr].
        intensity: Spectrum,
        /// Angle from the axis beyond which there is no light [radians].
        cutoff_angle: f32,
        /// Angle from the axis up to which intensity is full [radians].
        beam_width: f32,
        /// How it falls from there.
        falloff: Falloff,
        /// Factor on the intensity, which the square about the cone on the plane before the light shows; of a cone below a right angle.
        texture: Option<Texture>,
    },
    /// A point light whose intensity by direction is an image.
    Goniometric {
        /// Frame of the image to the world; it moves, turns and mirrors only.
        to_world: Transform,
        /// Intensity [W/sr] before scaling; texels are finite and not negative.
        image: Arc<Bitmap>,
        /// Where the image has which direction.
        mapping: Mapping,
        /// Factor on the image.
        scale: f32,
    },
    /// A slide projector: an image thrown from a point.
    Projector {
        /// Maps the origin to the light's place and +z to its axis; it moves, turns and mirrors only.
        to_world: Transform,
        /// Angle that the width of the image is seen under [radians].
        fov_x: f32,
        /// Width of the image over its height.
        aspect: f32,
        /// What is as bright as `even` says, before scaling.
        image: Texture,
        /// Factor on the image.
        scale: f32,
        /// What the image's values are.
        even: Even,
    },
    /// `irradiance` [W/m^2] on a surface facing it, travelling along the unit vector `direction`.
    Directional {
        /// Unit direction in which light travels.
        direction: Vec3,
        /// Irradiance on a surface that faces the light [W/m^2].
        irradiance: Spectrum,
    },
    /// The same `radiance` from everywhere outside.
    Constant {
        /// Radiance [W/(m^2 sr)].
        radiance: Spectrum,
    },
    /// Mitsuba's `envmap`: an image at infinity.
    Environment {
        /// Radiance [W/(m^2 sr)] before scaling; texels are finite and not negative.
        image: Arc<Bitmap>,
        /// Where the image has which direction.
        mapping: Mapping,
        /// Factor on the image.
        scale: f32,
        /// Frame of the image to the world.
        to_world: Transform,
    },
    /// A disc at infinity, evenly bright.
    Sun {
        /// Unit direction to its middle.
        towards: Vec3,
        /// Half the angle that it is seen under [radians], above 0 and below a right angle.
        half_angle: f32,
        /// Irradiance on a surface that faces it [W/m^2], for a small disc: radiance times solid angle.
        irradiance: Spectrum,
    },
}

/// How the intensity of a spot falls between its beam and the edge of its cone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Falloff {
    /// Linearly in the angle, as Mitsuba's.
    Linear,
    /// By the cubic `3 x^2 - 2 x^3` of the share `x` of the cosine's way from the edge to the beam, as pbrt-v4's.
    SmoothStep,
    /// By the fourth power of that share, as pbrt-v3's.
    FourthPower,
}

/// What shows the image of a projector as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Even {
    /// A white diffuse surface on the plane at distance 1, as Mitsuba's: the values are its radiance [W/(m^2 sr)].
    Plane,
    /// The directions, as pbrt's: the values are intensities [W/sr].
    Directions,
}

/// How an image shows all directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mapping {
    /// Longitude across and latitude down; the upper edge is +y, as in Mitsuba's `envmap`.
    LatitudeLongitude,
    /// A square whose texels have equal solid angles; the middle is +z, the right edge's middle +x, the lower edge's +y, as in pbrt-v4
    /// (Clarberg 2008).
    EqualArea,
}

/// Share of the choices among lights that all lights have equal parts of, however weak (a defensive mixture: Hesterberg 1995); the
/// others are in proportion to power. A sun that shines at the outside of a house would leave its lamps almost no path otherwise. It
/// takes at most a tenth of the paths from where power would send them.
const DEFENSIVE: f64 = 0.1;

/// The scene's lights, and the probability with which each is chosen: mostly in proportion to its power ([`DEFENSIVE`]).
#[derive(Debug)]
pub struct Lights {
    sources: Vec<Source>,
    choice: Discrete,
    /// Probability of each source.
    probabilities: Vec<f32>,
    /// Those of the sources that rays which hit nothing meet: the lights that fill directions at infinity.
    backgrounds: Vec<u32>,
    world: World,
}

/// A light with what sampling it takes.
#[derive(Clone, Debug)]
enum Source {
    Area(Area),
    /// Of which `radiance` is the exitance along its normals.
    Normals(Area),
    Point {
        position: Vec3,
        intensity: Spectrum,
    },
    Spot(Spot),
    Projector(Projector),
    Goniometric(Box<Goniometric>),
    Directional {
        direction: Vec3,
        irradiance: Spectrum,
    },
    Background(Background),
}

/// A shape that emits.
#[derive(Clone, Debug)]
struct Area {
    sampler: ShapeSampler,
    radiance: Texture,
    two_sided: bool,
}

impl Area {
    /// Area of the sides that emit [scene units squared].
    fn emitting(&self) -> f32 {
        match self.two_sided {
            true => 2.0 * self.sampler.area(),
            false => self.sampler.area(),
        }
    }

    /// The same on the shape as it is in `geometry`.
    fn moved(&self, geometry: &Geometry) -> Self {
        Self {
            sampler: ShapeSampler::new(geometry, self.sampler.shape()),
            ..self.clone()
        }
    }

    /// Whether the surface emits along `wo`.
    fn emits_along(&self, point: &SurfacePoint, wo: Vec3) -> bool {
        self.two_sided || point.geometric_normal.dot(wo) > 0.0
    }

    /// A point uniform over the sides that emit; its normal is that of its side.
    fn sample(&self, geometry: &Geometry, mut u: DVec2) -> Option<SurfacePoint> {
        let inner = self.two_sided && u.x >= 0.5;
        if self.two_sided {
            u.x = 2.0 * u.x - f64::from(u8::from(inner));
        }
        let mut point = self.sampler.sample(geometry, u)?;
        if inner {
            point.geometric_normal = -point.geometric_normal;
        }
        Some(point)
    }
}

/// A sphere around the scene: what distant lights shine through.
#[derive(Clone, Copy, Debug)]
struct World {
    center: Vec3,
    radius: f32,
}

impl World {
    fn new(geometry: &Geometry) -> Self {
        let (lower, upper) = geometry.bounds();
        let radius = 0.5 * (upper - lower).length() * (1.0 + 1e-4);
        Self {
            center: 0.5 * (lower + upper),
            radius: if radius > 0.0 { radius } else { 1.0 },
        }
    }

    /// Area of the disc that faces any direction.
    fn cross_section(&self) -> f32 {
        PI * self.radius * self.radius
    }

    /// A ray along `direction` from before the sphere, its origin uniform on that disc.
    fn ray(&self, direction: Vec3, u: Vec2) -> Ray {
        let offset = (square_to_disk(u) * self.radius).extend(-self.radius);
        let origin = self.center + Frame::from_normal(direction).to_world(offset);
        Ray {
            origin,
            direction,
            max_distance: f32::INFINITY,
        }
    }
}

impl Source {
    fn new(light: Light, geometry: &Geometry) -> Self {
        match light {
            Light::Area {
                shape,
                radiance,
                two_sided,
            } => Self::Area(Area {
                sampler: ShapeSampler::new(geometry, shape),
                radiance,
                two_sided,
            }),
            Light::DirectionalArea { shape, exitance } => Self::Normals(Area {
                sampler: ShapeSampler::new(geometry, shape),
                radiance: exitance,
                two_sided: false,
            }),
            Light::Point { position, intensity } => Self::Point { position, intensity },
            Light::Spot {
                to_world,
                intensity,
                cutoff_angle,
                beam_width,
                falloff,
                texture,
            } => {
                let angles = [beam_width, cutoff_angle];
                Self::Spot(Spot::new(&to_world, intensity, angles, falloff, texture))
            }
            Light::Goniometric {
                to_world,
                image,
                mapping,
                scale,
            } => {
                let intensity = DirectionMap::new(image, mapping, scale, &to_world);
                Self::Goniometric(Box::new(Goniometric::new(&to_world, intensity)))
            }
            Light::Projector {
                to_world,
                fov_x,
                aspect,
                image,
                scale,
                even,
            } => Self::Projector(Projector::new(&to_world, fov_x, aspect, image, scale, even)),
            Light::Directional { direction, irradiance } => Self::Directional { direction, irradiance },
            Light::Constant { radiance } => Self::Background(Background::Constant(radiance)),
            Light::Environment {
                image,
                mapping,
                scale,
                to_world,
            } => Self::Background(Background::Environment(Box::new(DirectionMap::new(
                image, mapping, scale, &to_world,
            )))),
            Light::Sun {
                towards,
                half_angle,
                irradiance,
            } => Self::Background(Background::Sun(Sun::new(towards, half_angle, irradiance))),
        }
    }

    /// The light where `to_world` puts it; that of a shape where the shape is in `geometry`.
    fn moved(&self, to_world: &Transform, geometry: &Geometry) -> Self {
        match self {
            Self::Area(area) => Self::Area(area.moved(geometry)),
            Self::Normals(area) => Self::Normals(area.moved(geometry)),
            Self::Point { intensity, .. } => Self::Point {
                position: to_world.point(Vec3::ZERO),
                intensity: *intensity,
            },
            Self::Spot(spot) => Self::Spot(spot.moved(to_world)),
            Self::Projector(projector) => Self::Projector(projector.moved(to_world)),
            Self::Goniometric(lamp) => Self::Goniometric(Box::new(lamp.moved(to_world))),
            Self::Directional { irradiance, .. } => Self::Directional {
                direction: to_world.matrix().z_axis.truncate().normalize().as_vec3(),
                irradiance: *irradiance,
            },
            Self::Background(Background::Environment(map)) => {
                Self::Background(Background::Environment(Box::new(map.turned(to_world))))
            }
            Self::Background(Background::Constant(_) | Background::Sun(_)) => self.clone(),
        }
    }

    /// Luminous part of the power that enters the scene.
    fn power(&self, world: &World) -> f32 {
        match self {
            Self::Area(area) => area.radiance.mean().luminance() * PI * area.emitting(),
            Self::Normals(area) => area.radiance.mean().luminance() * area.emitting(),
            Self::Point { intensity, .. } => intensity.luminance() * 4.0 * PI,
            Self::Spot(spot) => spot.power(),
            Self::Projector(projector) => projector.power(),
            Self::Goniometric(lamp) => lamp.power(),
            Self::Directional { irradiance, .. } => irradiance.luminance() * world.cross_section(),
            Self::Background(background) => background.mean_luminance() * 4.0 * PI * world.cross_section(),
        }
    }
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
        let mut sources = self.sources.clone();
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
        Self {
            probabilities: (0..sources.len())
                .map(|index| choice.probability(index) as f32)
                .collect(),
            backgrounds: (0..)
                .zip(&sources)
                .filter(|(_, source)| matches!(source, Source::Background(_)))
                .map(|(index, _)| index)
                .collect(),
            sources,
            choice,
            world,
        }
    }

    /// Whether there is a light that no ray finds, such as a point light ([`LightSample::delta`]).
    pub(crate) fn any_delta(&self) -> bool {
        let found = |source: &Source| matches!(source, Source::Area { .. } | Source::Background(_));
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
        match &self.sources[light.0 as usize] {
            Source::Area(area) if area.emits_along(hit, wo) => area.radiance.eval(&hit.into()),
            _ => Spectrum::ZERO,
        }
    }

    /// Radiance that arrives from outside the scene along a ray of unit `direction` that hits nothing; the sum over distant lights.
    #[must_use]
    pub fn background(&self, direction: Vec3) -> Spectrum {
        self.backgrounds()
            .map(|(_, background)| background.radiance(direction))
            .sum()
    }

    /// Density [1/sr, choice of light included] with which [`Self::sample_direct`] returns `direction` from the background lights.
    #[must_use]
    pub fn pdf_background(&self, direction: Vec3) -> f32 {
        self.backgrounds()
            .map(|(probability, background)| probability * background.pdf(direction))
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
        let probability = self.probabilities[index];
        let (position, direction) = (to_unit_vec2(u_position), to_unit_vec2(u_direction));
        let cross_section = self.world.cross_section();
        let at_point = |ray, flux, pdf_direction| EmissionSample {
            ray,
            flux: flux / probability,
            origin: Origin::Point,
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
                    origin: Origin::Normals,
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
        };
        (!sample.flux.is_black()).then_some(sample)
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
            Origin::Normals => 0.0,
            Origin::Point | Origin::Directional | Origin::Background => 1.0,
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
    pub fn pdf_through_scene(&self) -> f32 {
        1.0 / self.world.cross_section()
    }

    /// The lights that fill directions at infinity, each with its probability.
    fn backgrounds(&self) -> impl Iterator<Item = (f32, &Background)> {
        self.backgrounds
            .iter()
            .filter_map(|index| match &self.sources[*index as usize] {
                Source::Background(background) => Some((self.probabilities[*index as usize], background)),
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
