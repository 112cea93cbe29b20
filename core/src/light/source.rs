//! Lights with what sampling them takes.

use super::Light;
use super::area::Area;
use super::background::Background;
use super::direction_map::DirectionMap;
use super::goniometric::Goniometric;
use super::portal::Opening;
use super::projector::Projector;
use super::spot::Spot;
use super::sun::Sun;
use super::world::World;
use crate::geometry::{Geometry, ShapeSampler};
use crate::math::{PI, Transform, Vec3};
use crate::spectrum::Spectrum;

/// A light with what sampling it takes.
#[derive(Clone, Debug)]
pub(super) enum Source {
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
    Portal(Box<Opening>),
}

impl Source {
    pub(super) fn new(light: Light, geometry: &Geometry) -> Self {
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
            Light::Portal { portal, beyond } => match Self::new(*beyond, geometry) {
                Self::Background(beyond) => Self::Portal(Box::new(Opening::new(portal, beyond))),
                other => other,
            },
        }
    }

    /// The light where `to_world` puts it; that of a shape where the shape is in `geometry`.
    pub(super) fn moved(&self, to_world: &Transform, geometry: &Geometry) -> Self {
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
            Self::Background(background) => Self::Background(background.moved(to_world)),
            Self::Portal(opening) => Self::Portal(Box::new(opening.moved(to_world))),
        }
    }

    /// Luminous part of the power that enters the scene.
    pub(super) fn power(&self, world: &World) -> f32 {
        match self {
            Self::Area(area) => area.radiance.mean().luminance() * PI * area.emitting(),
            Self::Normals(area) => area.radiance.mean().luminance() * area.emitting(),
            Self::Point { intensity, .. } => intensity.luminance() * 4.0 * PI,
            Self::Spot(spot) => spot.power(),
            Self::Projector(projector) => projector.power(),
            Self::Goniometric(lamp) => lamp.power(),
            Self::Directional { irradiance, .. } => irradiance.luminance() * world.cross_section(),
            Self::Background(background) => background.mean_luminance() * 4.0 * PI * world.cross_section(),
            Self::Portal(opening) => opening.power(),
        }
    }
}
