//! Cameras: perspective, orthographic and spherical.

use super::field_of_view::horizontal_field_of_view;
use super::film::Frame;
use super::window::{ScreenWindow, screen_window};
use super::{check_position, shutter};
use crate::math::{AnimatedTransform, Transform, Vec2, Vec3};
use crate::motion::Motion;
use crate::scene::build::uniform_scale;
use crate::scene::error::SceneError;
use crate::scene::reader::{NOT_NEGATIVE, POSITIVE, Reader};
use crate::sensor::{Lens, Projection, Sensor};

pub(super) fn camera(reader: &Reader, plugin: &str, resolution: [u32; 2]) -> Result<(Sensor, Motion), SceneError> {
    let to_world = reader.animation("to_world")?.unwrap_or_default();
    for keyframe in to_world.keyframes() {
        check_position(reader, keyframe.point(Vec3::ZERO))?;
    }
    let near = reader.float_or("near_clip", POSITIVE, 1e-2)?;
    let far = reader.float_or("far_clip", POSITIVE, 1e4)?;
    if near >= far {
        reader.fault(reader.wrong("near_clip", format!("{near} is not below `far_clip`, {far}")))?;
    }
    let focus_distance = reader.float_or("focus_distance", POSITIVE, far)? as f32;
    let window = screen_window(reader, resolution)?;
    match plugin {
        "perspective_rdist" => {
            reader.warn(
                reader.place(),
                "the lens does not distort: straight lines stay straight",
            );
            reader.accept(&["kc"]);
        }
        "telecentric" => {
            reader.warn(
                reader.place(),
                "it is rendered as `orthographic`: everything is in focus",
            );
            reader.accept(&["aperture_radius"]);
        }
        _ => {}
    }
    let mut motion = Motion {
        shutter: shutter(reader)?,
        ..Motion::default()
    };
    let (projection, to_world) = match plugin {
        "orthographic" | "telecentric" => {
            let windowed = window.and_then(|window| to_world.map(|keyframe| Some(keyframe.after(&window.of_plane()))));
            (Projection::Orthographic, windowed.unwrap_or(to_world))
        }
        "spherical" => {
            check_unscaled(reader, &to_world)?;
            (Projection::Spherical, to_world)
        }
        _ => (
            perspective(reader, &to_world, resolution, focus_distance, window)?,
            to_world,
        ),
    };
    let placed = |to_world: Transform| Sensor {
        to_world,
        projection,
        resolution,
        clip: [near as f32, far as f32],
    };
    if matches!(projection, Projection::Orthographic) {
        for keyframe in to_world.keyframes() {
            check_extent(reader, &placed(*keyframe))?;
        }
    }
    let sensor = placed(to_world.at(motion.at_rest()));
    motion.sensor = to_world.moves_within(motion.shutter).then_some(to_world);
    Ok((sensor, motion))
}

fn perspective(
    reader: &Reader,
    to_world: &AnimatedTransform,
    resolution: [u32; 2],
    focus_distance: f32,
    window: Option<ScreenWindow>,
) -> Result<Projection, SceneError> {
    check_unscaled(reader, to_world)?;
    let offset = |name| reader.float_or(name, -10.0..=10.0, 0.0);
    let principal_point = Vec2::new(
        offset("principal_point_offset_x")? as f32,
        offset("principal_point_offset_y")? as f32,
    );
    let lens = if reader.object.plugin == "thinlens" {
        let radius = reader.float("aperture_radius", NOT_NEGATIVE)?;
        let radius = radius.ok_or_else(|| reader.missing("property `aperture_radius`"))? as f32;
        (radius > 0.0).then_some(Lens { radius, focus_distance })
    } else {
        None
    };
    // With a window the angle is that of the interval [-1, 1] of either axis.
    let aspect = match window {
        Some(_) => 1.0,
        None => f64::from(resolution[0]) / f64::from(resolution[1]),
    };
    let fov_x = horizontal_field_of_view(reader, aspect)? as f32;
    let (fov_x, centre) = window.map_or((fov_x, Vec2::ZERO), |window| window.of_perspective(fov_x, resolution));
    Ok(Projection::Perspective {
        fov_x,
        principal_point: principal_point + centre,
        lens,
    })
}

fn check_unscaled(reader: &Reader, to_world: &AnimatedTransform) -> Result<(), SceneError> {
    let scaled = |keyframe| uniform_scale(keyframe).is_none_or(|scale| (scale - 1.0).abs() > 1e-3);
    if to_world.keyframes().any(scaled) {
        let reason = "this camera can be moved, rotated and mirrored, but not scaled or sheared";
        reader.fault(reader.wrong("to_world", reason))?;
    }
    Ok(())
}

/// An orthographic image must have a size, and its corners must lie within the largest coordinate.
fn check_extent(reader: &Reader, sensor: &Sensor) -> Result<(), SceneError> {
    let [width, height] = sensor.resolution.map(|n| n as f32);
    for corner in [
        Vec2::ZERO,
        Vec2::new(width, 0.0),
        Vec2::new(0.0, height),
        Vec2::new(width, height),
    ] {
        let ray = sensor.ray(corner, Vec2::ZERO);
        check_position(reader, ray.origin)?;
        if !(ray.direction.is_finite() && ray.direction.is_normalized()) {
            return Err(reader.wrong("to_world", "it scales the viewing direction to nothing"));
        }
    }
    let footprint = sensor.pixel_footprint(1.0);
    if footprint.is_finite() && footprint >= f32::MIN_POSITIVE {
        return Ok(());
    }
    Err(reader.wrong("to_world", format!("a pixel's side in the world is {footprint}")))
}

/// The sensor that sees the window of a film.
pub(super) fn crop(reader: &Reader, film: &Frame, sensor: &Sensor, motion: &mut Motion) -> Result<Sensor, SceneError> {
    if matches!(sensor.projection, Projection::Spherical | Projection::Irradiance { .. }) {
        let plugin = &reader.object.plugin;
        return Err(reader.unsupported(format!("a crop of the film of `{plugin}`"), "leave it out"));
    }
    if let (Projection::Orthographic, Some(moving)) = (sensor.projection, &motion.sensor) {
        let cropped = |to_world: &Transform| {
            let placed = Sensor {
                to_world: *to_world,
                ..sensor.clone()
            };
            Some(placed.cropped(film.offset, film.size).to_world)
        };
        motion.sensor = moving.map(cropped);
    }
    Ok(sensor.cropped(film.offset, film.size))
}
