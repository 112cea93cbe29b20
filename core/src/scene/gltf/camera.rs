//! Cameras and punctual lights.

use super::document::{Camera, Document, Light};
use super::tree::{Timing, Tree, looking, node_name};
use super::warnings::Told;
use crate::scene::description::{Draft, Kind, Value};
use crate::scene::error::{SceneError, shortened};
use glam::{DMat4, DVec3};

/// Pixels along the longer side of a picture whose size nobody says; glTF has the ratio only.
const LONGER_SIDE: f64 = 768.0;

/// Luminous efficacy of the light that Blender exports [lm/W]: the photometric units of glTF over it are the watts that Blender renders.
pub(super) const LUMENS_PER_WATT: f64 = 683.0;

/// Adds the camera at a node as a sensor with the id of its name. `width` is that of the picture in pixels, where the user says it.
pub(super) fn camera(
    draft: &mut Draft,
    document: &Document,
    tree: &Tree,
    node: usize,
    (timing, width): (&Timing, Option<i64>),
    told: &Told,
) -> Result<(), SceneError> {
    let index = document.nodes[node].camera.unwrap_or(0);
    let field = format!("cameras[{index}]");
    let camera: &Camera = document.cameras.get(index).ok_or_else(|| {
        let reason = format!("there is no camera {index}; the file has {}", document.cameras.len());
        SceneError::value(told.place(), format!("nodes[{node}].camera"), reason)
    })?;
    let wrong = |reason: String| SceneError::value(told.place(), field.clone(), reason);
    let written = format!("{field} \"{}\"", shortened(&camera.name));
    let place = told.place();
    let (plugin, aspect, stretch) = match (&camera.perspective, &camera.orthographic) {
        (Some(perspective), _) => ("perspective", perspective.aspect_ratio, 1.0),
        (None, Some(flat)) if flat.xmag.abs() > 0.0 && flat.ymag.abs() > 0.0 => {
            ("orthographic", Some((flat.xmag / flat.ymag).abs()), flat.xmag.abs())
        }
        (None, Some(_)) => return Err(wrong("`xmag` and `ymag` must not be 0".into())),
        (None, None) => return Err(wrong("it has neither `perspective` nor `orthographic`".into())),
    };
    let scaled = |world: DMat4| Some(looking(world)? * DMat4::from_scale(DVec3::new(stretch, stretch, 1.0)));
    let Some(to_world) = tree.placement(node, scaled) else {
        told.warn(format!(
            "{}: its camera has no direction and is left out",
            node_name(document, node)
        ));
        return Ok(());
    };
    let sensor = draft.add(Kind::Sensor, plugin, Some(&written), place);
    draft.set(sensor, "to_world", to_world);
    let mut clip = None;
    if let Some(perspective) = &camera.perspective {
        draft.set(sensor, "fov", Value::Float(perspective.yfov.to_degrees()));
        draft.set(sensor, "fov_axis", Value::String("y".into()));
        clip = Some((perspective.znear, perspective.zfar));
    } else if let Some(flat) = &camera.orthographic {
        clip = Some((flat.znear, Some(flat.zfar)));
    }
    if let Some((near, far)) = clip {
        // An orthographic camera may see from its own plane on.
        let near = near.max(1e-6);
        draft.set(sensor, "near_clip", Value::Float(near));
        draft.set(sensor, "far_clip", Value::Float(far.unwrap_or(1e7 * near.max(1e-2))));
    }
    if timing.shutter > 0.0 {
        let [open, close] = timing.interval();
        draft.set(sensor, "shutter_open", Value::Float(open));
        draft.set(sensor, "shutter_close", Value::Float(close));
    }
    let film = draft.add(Kind::Film, "hdrfilm", Some(&written), place);
    if let Some(aspect) = aspect.or(width.map(|_| 4.0 / 3.0)) {
        if !(1e-4..=1e4).contains(&aspect) {
            return Err(wrong(format!(
                "the ratio of sides is {aspect}; allowed: 0.0001 to 10000"
            )));
        }
        let width = width.map_or_else(|| (LONGER_SIDE * aspect.min(1.0)).round(), |width| width as f64);
        draft.set(film, "width", Value::Integer(width.max(1.0) as i64));
        draft.set(film, "height", Value::Integer((width / aspect).round().max(1.0) as i64));
    }
    draft.link(sensor, None, film);
    draft.link(0, None, sensor);
    for name in [&document.nodes[node].name, &camera.name] {
        if !name.is_empty() {
            draft.ids.entry(name.clone()).or_insert(sensor);
        }
    }
    Ok(())
}

/// Adds the light of `KHR_lights_punctual` at a node.
pub(super) fn light(
    draft: &mut Draft,
    document: &Document,
    tree: &Tree,
    (node, index): (usize, usize),
    told: &Told,
) -> Result<(), SceneError> {
    let lights = &document.extensions.lights.lights;
    let light: &Light = lights.get(index).ok_or_else(|| {
        let reason = format!("there is no light {index}; the file has {}", lights.len());
        SceneError::value(
            told.place(),
            format!("nodes[{node}].extensions.KHR_lights_punctual"),
            reason,
        )
    })?;
    let written = format!("KHR_lights_punctual.lights[{index}] \"{}\"", shortened(&light.name));
    if !(light.intensity > 0.0 && light.color.iter().any(|c| *c > 0.0)) {
        told.warn(format!("{written}: it is dark and left out"));
        return Ok(());
    }
    if light.range.is_some() {
        told.warn(format!(
            "{written}: `range` is left out: light fades by the square of the distance alone"
        ));
    }
    let (plugin, quantity) = match light.kind.as_str() {
        "point" => ("point", "intensity"),
        "spot" => ("spot", "intensity"),
        "directional" => ("directional", "irradiance"),
        other => {
            let reason = format!(
                "there is no type `{}`; allowed: point, spot, directional",
                shortened(other)
            );
            return Err(SceneError::value(told.place(), written, reason));
        }
    };
    let Some(to_world) = tree.placement(node, looking) else {
        told.warn(format!("{written}: it has no direction and is left out"));
        return Ok(());
    };
    let emitter = draft.add(Kind::Emitter, plugin, Some(&written), told.place());
    draft.set(emitter, "to_world", to_world);
    let colour = light.color.map(|c| c * light.intensity / LUMENS_PER_WATT);
    draft.set(emitter, quantity, Value::Rgb(colour));
    if plugin == "spot" {
        let (inner, outer) = (light.spot.inner_cone_angle, light.spot.outer_cone_angle);
        draft.set(emitter, "cutoff_angle", Value::Float(outer.to_degrees()));
        draft.set(emitter, "beam_width", Value::Float(inner.min(outer).to_degrees()));
    }
    for name in [&document.nodes[node].name, &light.name] {
        if !name.is_empty() {
            draft.ids.entry(name.clone()).or_insert(emitter);
        }
    }
    draft.link(0, None, emitter);
    Ok(())
}
