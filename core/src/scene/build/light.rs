//! Emitters that are not on a shape.

use super::texture::light_colour;
use super::{Builder, uniform_scale};
use crate::light::Light;
use crate::math::{Transform, Vec3};
use crate::scene::description::ObjectId;
use crate::scene::error::SceneError;
use crate::scene::mesh::LARGEST_COORDINATE;
use crate::scene::reader::{NOT_NEGATIVE, POSITIVE, Reader};
use crate::scene::spectrum::BRIGHTEST;
use crate::texture::{TextureFilter, WrapMode};
use glam::DMat4;

const SUPPORTED: [&str; 6] = ["area", "point", "spot", "directional", "constant", "envmap"];
/// Emitters of Mitsuba that do not exist here.
const ELSEWHERE: [&str; 8] = [
    "projector",
    "directionalarea",
    "sky",
    "sun",
    "sunsky",
    "timed_sunsky",
    "collimated",
    "volumelight",
];

impl Builder<'_, '_> {
    pub(super) fn emitter(&mut self, object: ObjectId) -> Result<(), SceneError> {
        let reader = self.reader(object);
        let light = match reader.object.plugin.as_str() {
            "area" => return self.detached_area_light(object, &reader),
            "point" => Light::Point {
                position: position(&reader)?,
                intensity: light_colour(&reader, "intensity", 1.0)?,
            },
            "spot" => spot(&reader)?,
            "directional" => Light::Directional {
                direction: direction(&reader)?,
                irradiance: light_colour(&reader, "irradiance", 1.0)?,
            },
            "constant" => {
                self.only_environment(&reader)?;
                Light::Constant {
                    radiance: light_colour(&reader, "radiance", 1.0)?,
                }
            }
            "envmap" => {
                self.only_environment(&reader)?;
                self.environment_map(&reader)?
            }
            other if ELSEWHERE.contains(&other) => {
                let instead = format!("there are: {}", SUPPORTED.join(", "));
                return Err(reader.unsupported(format!("type `{other}`"), instead));
            }
            _ => return Err(reader.unknown_type(&SUPPORTED)),
        };
        check_sampling_weight(&reader)?;
        reader.finish()?;
        self.add_light(light, reader.place());
        Ok(())
    }

    /// An area light outside a shape is there to be referenced.
    fn detached_area_light(&self, object: ObjectId, reader: &Reader) -> Result<(), SceneError> {
        // Where something is wrong elsewhere, it may be what uses the light.
        if self.used_area_lights.contains(&object) || self.description.faults.any() {
            return Ok(());
        }
        let reason = "no shape uses this area light: put it inside a <shape> or reference it there";
        Err(SceneError::value(reader.place(), reader.context(), reason))
    }

    fn only_environment(&mut self, reader: &Reader) -> Result<(), SceneError> {
        match self.environment.replace(reader.place().clone()) {
            Some(first) => {
                let reason = format!("the scene has an environment already, at {first}");
                reader.fault(SceneError::value(reader.place(), reader.context(), reason))
            }
            None => Ok(()),
        }
    }

    fn environment_map(&mut self, reader: &Reader) -> Result<Light, SceneError> {
        let scale = reader.float_or("scale", POSITIVE, 1.0)? as f32;
        // Importance sampling is never compensated; the estimate has the same mean either way.
        reader.boolean("mis_compensation", false)?;
        let to_world = reader.transform("to_world")?.unwrap_or_default();
        let to_world = rotation(&to_world)
            .ok_or_else(|| reader.wrong("to_world", "an environment can be rotated and mirrored only"))?;
        let image = self.bitmap_file(reader, false, WrapMode::Repeat, TextureFilter::Bilinear)?;
        reader.finish()?;
        if image.width < 2 || image.height < 2 {
            let reason = format!(
                "an environment has 2 x 2 texels or more, found {} x {}",
                image.width, image.height
            );
            return Err(reader.wrong("filename", reason));
        }
        let brightest = image
            .texels
            .iter()
            .map(|texel| texel.max_component())
            .fold(0.0, f32::max);
        if f64::from(brightest) * f64::from(scale) > BRIGHTEST {
            let reason = format!("the brightest texel, {brightest}, times {scale} is above {BRIGHTEST:e}");
            return Err(reader.wrong("scale", reason));
        }
        Ok(Light::Environment { image, scale, to_world })
    }
}

/// Accepts `sampling_weight`: lights are chosen by power, and the weight does not change what is estimated.
pub(super) fn check_sampling_weight(reader: &Reader) -> Result<(), SceneError> {
    reader.float("sampling_weight", POSITIVE).map(|_| ())
}

fn position(reader: &Reader) -> Result<Vec3, SceneError> {
    let position = match (reader.vector("position")?, reader.transform("to_world")?) {
        (Some(_), Some(_)) => return Err(reader.wrong("position", "give either `position` or `to_world`, not both")),
        (Some(position), None) => position.as_vec3(),
        (None, to_world) => to_world.unwrap_or_default().point(Vec3::ZERO),
    };
    if position.abs().max_element() > LARGEST_COORDINATE {
        return Err(reader.wrong("position", format!("{position} lies beyond {LARGEST_COORDINATE:e}")));
    }
    Ok(position)
}

fn direction(reader: &Reader) -> Result<Vec3, SceneError> {
    let direction = match (reader.vector("direction")?, reader.transform("to_world")?) {
        (Some(_), Some(_)) => return Err(reader.wrong("direction", "give either `direction` or `to_world`, not both")),
        (Some(direction), None) => direction,
        (None, to_world) => to_world.unwrap_or_default().matrix().z_axis.truncate(),
    };
    let unit = direction.try_normalize().map(|direction| direction.as_vec3());
    unit.ok_or_else(|| reader.wrong("direction", "it has no length"))
}

fn spot(reader: &Reader) -> Result<Light, SceneError> {
    let to_world = reader.transform("to_world")?.unwrap_or_default();
    let to_world = rotation(&to_world)
        .ok_or_else(|| reader.wrong("to_world", "a spot light can be moved, rotated and mirrored only"))?;
    let cutoff = reader.float_or("cutoff_angle", 0.01..=180.0, 20.0)?;
    let beam = reader.float_or("beam_width", NOT_NEGATIVE, cutoff * 0.75)?;
    let intensity = light_colour(reader, "intensity", 1.0)?;
    if beam > cutoff {
        return Err(reader.wrong("beam_width", format!("{beam} is above `cutoff_angle`, {cutoff}")));
    }
    Ok(Light::Spot {
        to_world,
        intensity,
        cutoff_angle: cutoff.to_radians() as f32,
        beam_width: beam.to_radians() as f32,
    })
}

/// The map without its uniform scale; `None` where it has another.
fn rotation(transform: &Transform) -> Option<Transform> {
    let scale = uniform_scale(transform)?;
    let m = transform.matrix();
    let axes = [m.x_axis / scale, m.y_axis / scale, m.z_axis / scale];
    Transform::from_matrix(DMat4::from_cols(axes[0], axes[1], axes[2], m.w_axis))
}
