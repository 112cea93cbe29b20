//! Meters: of the radiance along a ray, and of the irradiance of a shape.

use super::film::Frame;
use super::{check_position, shutter};
use crate::geometry::{Geometry, ShapeId};
use crate::math::{AnimatedTransform, DVec3, Transform, Vec2, Vec3};
use crate::motion::Motion;
use crate::scene::build::light;
use crate::scene::error::SceneError;
use crate::scene::reader::Reader;
use crate::sensor::{Projection, Sensor};
use glam::DMat4;

/// The field of view of a radiance meter, which has one ray in Mitsuba \[radians\].
pub(super) const METER_FOV: f32 = 1e-5;

/// One ray, which starts at the meter.
pub(super) fn radiance_meter(reader: &Reader, film: &Frame) -> Result<(Sensor, Motion), SceneError> {
    let given = [reader.vector("origin")?, reader.vector("direction")?];
    let to_world = match (given, reader.animation("to_world")?) {
        ([None, None], to_world) => to_world.unwrap_or_default(),
        (_, Some(_)) => return Err(reader.wrong("to_world", "give either `origin` and `direction` or `to_world`")),
        ([origin, direction], None) => {
            let direction = direction.unwrap_or(DVec3::Z).try_normalize();
            let direction = direction.ok_or_else(|| reader.wrong("direction", "it has no length"))?;
            let axes = direction.any_orthonormal_pair();
            let origin = origin.unwrap_or(DVec3::ZERO).extend(1.0);
            let [s, t, n] = [axes.0, axes.1, direction].map(|axis| axis.extend(0.0));
            let matrix = glam::DMat4::from_cols(s, t, n, origin);
            AnimatedTransform::still(Transform::from_matrix(matrix).unwrap_or_default())
        }
    };
    for keyframe in to_world.keyframes() {
        check_position(reader, keyframe.point(Vec3::ZERO))?;
    }
    let to_world = to_world.map(light::rotation);
    let to_world =
        to_world.ok_or_else(|| reader.wrong("to_world", "a meter can be moved, rotated and mirrored only"))?;
    let mut motion = Motion {
        shutter: shutter(reader)?,
        ..Motion::default()
    };
    let sensor = Sensor {
        to_world: to_world.at(motion.at_rest()),
        projection: Projection::Perspective {
            fov_x: METER_FOV,
            principal_point: Vec2::ZERO,
            lens: None,
        },
        resolution: film.whole,
        clip: [f32::MIN_POSITIVE, f32::MAX],
    };
    motion.sensor = to_world.moves_within(motion.shutter).then_some(to_world);
    Ok((sensor, motion))
}

/// What arrives at a shape. On a rectangle each pixel of the film is its part of it; on another shape the one pixel is the mean over its
/// outer side, and the sensor is placed when the shape is.
pub(super) fn irradiance_meter(reader: &Reader, shape: &Reader, film: &Frame) -> Result<(Sensor, Motion), SceneError> {
    let plugin = shape.object.plugin.as_str();
    if GROUPS.contains(&plugin) {
        let what = format!("on a shape of type `{plugin}`");
        return Err(reader.unsupported(what, "it lies on a shape that is none of several"));
    }
    let is_grid = plugin == "rectangle";
    if !is_grid && film.whole != [1, 1] {
        let reason = format!("on a `{plugin}` a meter measures one value: its film has 1 x 1 pixels");
        return Err(SceneError::value(reader.place(), reader.context(), reason));
    }
    let mut motion = Motion {
        shutter: shutter(reader)?,
        ..Motion::default()
    };
    let to_world = match is_grid {
        true => shape.animation("to_world")?.unwrap_or_default(),
        false => AnimatedTransform::default(),
    };
    let flipped = is_grid && shape.boolean("flip_normals", false)?;
    let sensor = Sensor {
        to_world: to_world.at(motion.at_rest()),
        projection: Projection::Irradiance { flipped },
        resolution: film.whole,
        clip: [0.0, f32::MAX],
    };
    motion.sensor = to_world.moves_within(motion.shutter).then_some(to_world);
    Ok((sensor, motion))
}

/// Shapes that stand for several or for none.
const GROUPS: [&str; 6] = [
    "shapegroup",
    "instance",
    "merge",
    "sdfgrid",
    "ellipsoids",
    "ellipsoidsmesh",
];

/// Where a meter on the shape `id` stands: its square and its reach, which say where the meter is to be found, hold the shape.
pub(in crate::scene::build) fn about(geometry: &Geometry, id: ShapeId) -> Transform {
    let (lower, upper) = geometry.shape(id).bounds();
    let (middle, radius) = (
        0.5 * (lower + upper).as_dvec3(),
        0.5 * (upper - lower).as_dvec3().length(),
    );
    let placed = DMat4::from_translation(middle) * DMat4::from_scale(DVec3::splat(radius));
    Transform::from_matrix(placed).unwrap_or_default()
}
