use super::direction_map::DirectionMap;
use super::sun::Sun;
use crate::math::warp::square_to_sphere;
use crate::math::{DVec2, FRAC_1_PI, Transform, Vec3, to_unit_vec2};
use crate::spectrum::Spectrum;

/// A light at infinity that fills directions. Directions are unit vectors towards it.
#[derive(Clone, Debug)]
pub(super) enum Background {
    /// The same radiance from everywhere.
    Constant(Spectrum),
    /// An image.
    Environment(Box<DirectionMap>),
    /// A disc.
    Sun(Sun),
}

impl Background {
    /// The same where `to_world` puts it.
    pub(super) fn moved(&self, to_world: &Transform) -> Self {
        match self {
            Self::Environment(map) => Self::Environment(Box::new(map.turned(to_world))),
            Self::Constant(_) | Self::Sun(_) => self.clone(),
        }
    }

    /// Radiance that arrives from `direction` [W/(m^2 sr)].
    pub(super) fn radiance(&self, direction: Vec3) -> Spectrum {
        match self {
            Self::Constant(radiance) => *radiance,
            Self::Environment(map) => map.value(direction),
            Self::Sun(sun) => sun.radiance(direction),
        }
    }

    /// A direction with density [`Self::pdf`].
    pub(super) fn sample(&self, u: DVec2) -> Option<Vec3> {
        match self {
            Self::Constant(_) => Some(square_to_sphere(to_unit_vec2(u))),
            Self::Environment(map) => map.sample(u),
            Self::Sun(sun) => Some(sun.sample(to_unit_vec2(u))),
        }
    }

    /// Solid-angle density [1/sr].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        match self {
            Self::Constant(_) => 0.25 * FRAC_1_PI,
            Self::Environment(map) => map.pdf(direction),
            Self::Sun(sun) => sun.pdf(direction),
        }
    }

    /// Luminance averaged over the sphere.
    pub(super) fn mean_luminance(&self) -> f32 {
        match self {
            Self::Constant(radiance) => radiance.luminance(),
            Self::Environment(map) => map.mean_luminance(),
            Self::Sun(sun) => sun.mean_luminance(),
        }
    }
}
