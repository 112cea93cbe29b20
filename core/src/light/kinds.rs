//! What the lights of a scene are, as validated data in world space.

use super::Portal;
use crate::geometry::ShapeId;
use crate::math::{Transform, Vec3};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, Texture};
use std::sync::Arc;

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
    /// A spot: full intensity within `beam_width`, falling to zero at `cutoff_angle` \[radians\].
    Spot {
        /// Maps the origin to the light's place and +z to its axis.
        to_world: Transform,
        /// Radiant intensity on the axis [W/sr].
        intensity: Spectrum,
        /// Angle from the axis beyond which there is no light \[radians\].
        cutoff_angle: f32,
        /// Angle from the axis up to which intensity is full \[radians\].
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
        /// Angle that the width of the image is seen under \[radians\].
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
        /// Half the angle that it is seen under \[radians\], above 0 and below a right angle.
        half_angle: f32,
        /// Irradiance on a surface that faces it [W/m^2], for a small disc: radiance times solid angle.
        irradiance: Spectrum,
    },
    /// A light at infinity that fills directions, where it shines through a portal alone.
    Portal {
        /// What it shines through, in world space; it stays where it is when the light is moved.
        portal: Portal,
        /// The light. Of one that is not at infinity or has no size, the portal changes nothing.
        beyond: Box<Light>,
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
