//! Emitters that are not on a shape.

use super::sensor::horizontal_field_of_view;
use super::texture::{Role, light_colour};
use super::{Builder, uniform_scale};
use crate::light::{Even, Falloff, Light};
use crate::math::{AnimatedTransform, Transform, Vec3};
use crate::scene::description::{Kind, ObjectId};
use crate::scene::error::SceneError;
use crate::scene::mesh::LARGEST_COORDINATE;
use crate::scene::reader::{NOT_NEGATIVE, POSITIVE, Reader};
use crate::scene::spectrum::BRIGHTEST;
use crate::texture::{Bitmap, Texture};
use glam::DMat4;
use std::f64::consts::PI;

const SUPPORTED: [&str; 13] = [
    "area",
    "point",
    "spot",
    "projector",
    "goniometric",
    "directional",
    "collimated",
    "constant",
    "envmap",
    "sky",
    "sun",
    "sunsky",
    "timed_sunsky",
];
/// Emitters of Mitsuba that do not exist here.
const ELSEWHERE: [&str; 2] = ["directionalarea", "volumelight"];
/// Half the angle that a collimated beam opens by here \[degrees\].
const BEAM_HALF_ANGLE: f64 = 0.05;
/// The widest `cutoff_angle` of a spot with a texture, which lies on a plane before it \[degrees\].
const WIDEST_SLIDE: f64 = 89.0;

impl Builder<'_, '_> {
    pub(super) fn emitter(&mut self, object: ObjectId) -> Result<(), SceneError> {
        let reader = self.reader(object);
        let at_rest = self.motion.at_rest();
        let mut to_world = None;
        let portal = reader.portal("portal");
        let light = match reader.object.plugin.as_str() {
            "area" => return self.detached_area_light(object, &reader),
            "sky" | "sun" | "sunsky" | "timed_sunsky" => return self.daylight(&reader),
            "point" => Light::Point {
                position: to_world.insert(place(&reader)?).at(at_rest).point(Vec3::ZERO),
                intensity: light_colour(&reader, "intensity", 1.0)?,
            },
            "spot" => {
                let reason = "a spot light can be moved, rotated and mirrored only";
                let placed = to_world.insert(rotations(&reader, reason)?).at(at_rest);
                self.spot(&reader, placed)?
            }
            "goniometric" => {
                let reason = "a goniometric light can be moved, rotated and mirrored only";
                let placed = to_world.insert(rotations(&reader, reason)?).at(at_rest);
                self.goniometric(&reader, placed)?
            }
            "collimated" => {
                let reason = "a beam can be moved, rotated and mirrored only";
                collimated(&reader, to_world.insert(rotations(&reader, reason)?).at(at_rest))?
            }
            "projector" => {
                let reason = "a projector can be moved, rotated and mirrored only";
                let placed = to_world.insert(rotations(&reader, reason)?).at(at_rest);
                self.projector(&reader, placed)?
            }
            "directional" => Light::Directional {
                direction: direction(&reader, &mut to_world, at_rest)?,
                irradiance: light_colour(&reader, "irradiance", 1.0)?,
            },
            "constant" => Light::Constant {
                radiance: light_colour(&reader, "radiance", 1.0)?,
            },
            "envmap" => {
                let reason = "an environment can be rotated and mirrored only";
                let placed = to_world.insert(rotations(&reader, reason)?).at(at_rest);
                self.environment_map(&reader, placed)?
            }
            other if ELSEWHERE.contains(&other) => {
                let instead = format!("there are: {}", SUPPORTED.join(", "));
                return Err(reader.unsupported(format!("type `{other}`"), instead));
            }
            _ => return reader.other_type(&SUPPORTED, "the light is left out of the picture"),
        };
        check_sampling_weight(&reader)?;
        reader.finish();
        let light = match portal {
            Some(portal) => Light::Portal {
                portal,
                beyond: Box::new(light),
            },
            None => light,
        };
        let moving = to_world.filter(|to_world| to_world.moves_within(self.motion.shutter));
        self.add_light(light, moving, &[object], reader.place());
        Ok(())
    }

    /// An area light outside a shape is there to be referenced.
    fn detached_area_light(&self, object: ObjectId, reader: &Reader) -> Result<(), SceneError> {
        // Where something is wrong elsewhere, it may be what uses the light.
        if self.used_area_lights.contains(&object) || self.description.faults.any() {
            return Ok(());
        }
        let without = "no shape uses this area light, which is left out: put it inside a <shape> or reference it there";
        reader.warn(reader.place(), without);
        reader.accept_rest();
        Ok(())
    }

    fn projector(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let scale = reader.float_or("scale", POSITIVE, 1.0)? as f32;
        let image = self.colour_or_texture(reader, "irradiance", Role::EMISSION, 1.0)?;
        let aspect = match &image {
            Texture::Bitmap(bitmap, _) => bitmap.width as f32 / bitmap.height as f32,
            Texture::Constant(_) | Texture::Pattern(_) | Texture::Attribute(_) => 1.0,
        };
        let fov_x = horizontal_field_of_view(reader, aspect.into())? as f32;
        let even = reader.choice("even", &EVEN, Even::Plane)?;
        let scale = match (reader.float("power", POSITIVE)?, &image) {
            (Some(power), Texture::Bitmap(image, _)) => {
                let factor = power as f32 / projected_power(image, fov_x);
                scale * if factor.is_finite() { factor } else { 1.0 }
            }
            _ => scale,
        };
        Ok(Light::Projector {
            to_world,
            fov_x,
            aspect,
            image,
            scale,
            even,
        })
    }

    fn spot(&mut self, reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
        let cutoff = reader.float_or("cutoff_angle", 0.01..=180.0, 20.0)?;
        let beam = reader.float_or("beam_width", NOT_NEGATIVE, cutoff * 0.75)?.min(cutoff);
        let intensity = light_colour(reader, "intensity", 1.0)?;
        let falloff = reader.choice("falloff", &FALLOFFS, Falloff::Linear)?;
        let texture = if reader.has("texture") {
            if cutoff > WIDEST_SLIDE {
                let reason = format!("{cutoff} is out of range beside a `texture`; allowed: up to {WIDEST_SLIDE}");
                return Err(reader.wrong("cutoff_angle", reason));
            }
            Some(self.colour_or_texture(reader, "texture", Role::EMISSION, 1.0)?)
        } else {
            None
        };
        Ok(Light::Spot {
            to_world,
            intensity,
            cutoff_angle: cutoff.to_radians() as f32,
            beam_width: beam.to_radians() as f32,
            falloff,
            texture,
        })
    }
}

/// How the light of a spot falls off: as Mitsuba's, pbrt-v4's or pbrt-v3's.
const FALLOFFS: [(&str, Falloff); 3] = [
    ("linear", Falloff::Linear),
    ("smoothstep", Falloff::SmoothStep),
    ("fourth_power", Falloff::FourthPower),
];

/// What shows a projector's image as it is: Mitsuba's and pbrt's.
const EVEN: [(&str, Even); 2] = [("plane", Even::Plane), ("directions", Even::Directions)];

/// The power of a projector whose image is even by directions, as `power` has it (`ProjectionLight::Create` of pbrt-v4): the mean of
/// the image's luminance times what it takes of the sphere, the cube of the cosine times the area on the plane at distance 1.
fn projected_power(image: &Bitmap, fov_x: f32) -> f32 {
    let half_width = libm::tan(0.5 * f64::from(fov_x));
    let half_height = half_width * image.height as f64 / image.width as f64;
    let at = |index: usize, side: usize| (index as f64 + 0.5) / side as f64 * 2.0 - 1.0;
    let texels = image.texels.iter().enumerate().map(|(index, value)| {
        let x = half_width * at(index % image.width, image.width);
        let y = half_height * at(index / image.width, image.height);
        let squared = 1.0 + x * x + y * y;
        f64::from(value.luminance()) / (squared * squared.sqrt())
    });
    let area = 4.0 * half_width * half_height;
    (texels.sum::<f64>() * area / (image.width * image.height) as f64) as f32
}

/// Accepts `sampling_weight`: lights are chosen by power, and the weight does not change what is estimated.
pub(super) fn check_sampling_weight(reader: &Reader) -> Result<(), SceneError> {
    // The medium that a light is in follows from the shapes about it.
    reader.children(Kind::Medium);
    reader.float("sampling_weight", POSITIVE).map(|_| ())
}

/// The place of a light without a direction.
fn place(reader: &Reader) -> Result<AnimatedTransform, SceneError> {
    let place = match (reader.vector("position")?, reader.animation("to_world")?) {
        (Some(_), Some(_)) => return Err(reader.wrong("position", "give either `position` or `to_world`, not both")),
        (Some(position), None) => {
            let translation = Transform::from_matrix(DMat4::from_translation(position));
            AnimatedTransform::still(translation.unwrap_or_default())
        }
        (None, to_world) => to_world.unwrap_or_default(),
    };
    for keyframe in place.keyframes() {
        let position = keyframe.point(Vec3::ZERO);
        if position.abs().max_element() > LARGEST_COORDINATE {
            return Err(reader.wrong("position", format!("{position} lies beyond {LARGEST_COORDINATE:e}")));
        }
    }
    Ok(place)
}

/// The direction in which a light from infinity travels, at rest; where a transform gives it, that goes to `to_world`.
fn direction(reader: &Reader, to_world: &mut Option<AnimatedTransform>, at_rest: f64) -> Result<Vec3, SceneError> {
    let direction = match (reader.vector("direction")?, reader.animation("to_world")?) {
        (Some(_), Some(_)) => return Err(reader.wrong("direction", "give either `direction` or `to_world`, not both")),
        (Some(direction), None) => direction,
        (None, given) => {
            let map = to_world.insert(given.unwrap_or_default()).at(at_rest);
            map.matrix().z_axis.truncate()
        }
    };
    let unit = direction.try_normalize().map(|direction| direction.as_vec3());
    unit.ok_or_else(|| reader.wrong("direction", "it has no length"))
}

/// `to_world` without its uniform scale; `reason` says what it may be.
pub(super) fn rotations(reader: &Reader, reason: &str) -> Result<AnimatedTransform, SceneError> {
    let to_world = reader.animation("to_world")?.unwrap_or_default();
    to_world.map(rotation).ok_or_else(|| reader.wrong("to_world", reason))
}

/// A beam of parallel light, as a spot that is as narrow as single precision bears.
fn collimated(reader: &Reader, to_world: Transform) -> Result<Light, SceneError> {
    let power = light_colour(reader, "power", 1.0)?;
    let half_angle = BEAM_HALF_ANGLE.to_radians();
    let solid_angle = 4.0 * PI * libm::pow(libm::sin(0.5 * half_angle), 2.0);
    let intensity = power / solid_angle as f32;
    if f64::from(intensity.max_component()) > BRIGHTEST {
        return Err(reader.wrong("power", "a beam of so much power is too bright"));
    }
    reader.warn(
        reader.place(),
        format_args!(
            "the beam is not parallel: it opens by {} degrees",
            2.0 * BEAM_HALF_ANGLE
        ),
    );
    Ok(Light::Spot {
        to_world,
        intensity,
        cutoff_angle: half_angle as f32,
        beam_width: half_angle as f32,
        falloff: Falloff::Linear,
        texture: None,
    })
}

/// Turns an image of latitude and longitude, whose upper edge is +y, so that the edge is +z.
pub(super) fn upright_image() -> Transform {
    let turn = DMat4::from_cols_array_2d(&[
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]);
    Transform::from_matrix(turn).unwrap_or_default()
}

/// The map without its uniform scale; `None` where it has another.
pub(super) fn rotation(transform: &Transform) -> Option<Transform> {
    let scale = uniform_scale(transform)?;
    let m = transform.matrix();
    let axes = [m.x_axis / scale, m.y_axis / scale, m.z_axis / scale];
    Transform::from_matrix(DMat4::from_cols(axes[0], axes[1], axes[2], m.w_axis))
}
