//! Lights.
//!
//! How bright they are is told in [`super::colour`]; the film's imaging ratio, which multiplies the picture in pbrt, multiplies them
//! here.

use super::Reading;
use super::parameter::Parameters;
use super::shape::Made;
use super::state::facing;
use super::texture::Tint;
use crate::light::Portal;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError};
use crate::scene::mesh::LARGEST_COORDINATE;
use crate::scene::spectrum::Use;
use crate::spectrum::Spectrum;
use glam::{DMat4, DVec3, DVec4};
use std::f64::consts::{PI, TAU};

const LIGHTS: [&str; 6] = ["point", "spot", "distant", "infinite", "goniometric", "projection"];

impl Reading<'_, '_> {
    pub(super) fn light(&mut self, kind: &str, parameters: &Parameters) -> Result<(), SceneError> {
        match kind {
            "point" => self.point(parameters)?,
            "spot" => self.spot(parameters)?,
            "distant" => self.distant(parameters)?,
            "infinite" | "exinfinite" => self.infinite(parameters)?,
            "goniometric" => self.goniometric(parameters)?,
            "projection" => self.projection(parameters)?,
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                self.faults
                    .note(SceneError::unknown(place, context, "type", kind, LIGHTS))?;
                parameters.ignore_all();
            }
        }
        parameters.ignore(&["nsamples", "samples"]);
        parameters.finish();
        Ok(())
    }

    /// What every light's colour is multiplied by: `scale`, a number or in pbrt-v3 a colour, and the film's imaging ratio.
    fn light_scale(&mut self, parameters: &Parameters) -> Result<[f64; 3], SceneError> {
        let given = self.colour(parameters, "scale", Use::Emission)?;
        Ok(given.unwrap_or([1.0; 3]).map(|scale| scale * self.views.imaging_ratio))
    }

    /// The colour `name` of a light, white by default, times its scale.
    fn light_colour(&mut self, parameters: &Parameters, name: &str) -> Result<[f64; 3], SceneError> {
        let colour = self.colour(parameters, name, Use::Emission)?.unwrap_or([1.0; 3]);
        let scale = self.light_scale(parameters)?;
        Ok(std::array::from_fn(|i| colour[i] * scale[i]))
    }

    /// The luminance of the colour `name` of a light, without its scale.
    fn light_luminance(&mut self, parameters: &Parameters, name: &str) -> Result<f64, SceneError> {
        let [r, g, b] = self.colour(parameters, name, Use::Emission)?.unwrap_or([1.0; 3]);
        let colour = Spectrum::from_rgb([r as f32, g as f32, b as f32]);
        Ok(colour.luminance().into())
    }

    fn point(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let intensity = self.light_colour(parameters, "I")?;
        let power = power(parameters, 4.0 * PI)?;
        let from = parameters.vector("from")?.unwrap_or(DVec3::ZERO);
        let light = self.add_light("point", parameters);
        self.draft
            .set(light, "intensity", Value::Rgb(intensity.map(|channel| channel * power)));
        self.set_to_world(light, self.state.placed(DMat4::from_translation(from)))
    }

    fn spot(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let intensity = self.light_colour(parameters, "I")?;
        let cone = parameters.float_or("coneangle", 30.0)?;
        let start = cone - parameters.float_or("conedeltaangle", 5.0)?;
        let [cos_start, cos_end] = [start, cone].map(|angle| libm::cos(angle.to_radians()));
        // The integral of the falloff over all directions (`SpotLight::Create`).
        let power = power(parameters, TAU * ((1.0 - cos_start) + 0.5 * (cos_start - cos_end)))?;
        let from = parameters.vector("from")?.unwrap_or(DVec3::ZERO);
        let to = parameters.vector("to")?.unwrap_or(DVec3::Z);
        let Some(turned) = facing(to - from) else {
            return parameters
                .fault::<()>("to", "it is the same point as `from`")
                .map(|_| ());
        };
        let light = self.add_light("spot", parameters);
        self.draft
            .set(light, "intensity", Value::Rgb(intensity.map(|channel| channel * power)));
        self.draft.set(light, "cutoff_angle", Value::Float(cone));
        self.draft.set(light, "beam_width", Value::Float(start.max(0.0)));
        let falloff = if self.old { "fourth_power" } else { "smoothstep" };
        self.draft.set(light, "falloff", Value::String(falloff.into()));
        let placed = self.state.placed(DMat4::from_translation(from) * turned);
        self.set_rotation(light, placed)
    }

    fn distant(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let colour = self.light_colour(parameters, "L")?;
        let illuminance = parameters
            .float("illuminance")?
            .filter(|value| *value > 0.0)
            .unwrap_or(1.0);
        let from = parameters.vector("from")?.unwrap_or(DVec3::ZERO);
        let to = parameters.vector("to")?.unwrap_or(DVec3::Z);
        let direction = self.state.to_world[0].transform_vector3(to - from);
        if direction.length_squared() == 0.0 {
            return parameters
                .fault::<()>("to", "it is the same point as `from`")
                .map(|_| ());
        }
        let light = self.add_light("directional", parameters);
        self.draft.set(
            light,
            "irradiance",
            Value::Rgb(colour.map(|channel| channel * illuminance)),
        );
        self.draft.set(light, "direction", Value::Vector(direction));
        Ok(())
    }

    /// Light from all sides: the same from everywhere, or an image; it may come through a portal alone.
    fn infinite(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let portal = portal(parameters)?;
        let light = self.surroundings(parameters, portal.is_some())?;
        if let Some(portal) = portal {
            self.draft.set(light, "portal", Value::Portal(portal));
        }
        Ok(())
    }

    fn surroundings(&mut self, parameters: &Parameters, has_portal: bool) -> Result<ObjectId, SceneError> {
        let illuminance = parameters.float("illuminance")?.filter(|value| *value > 0.0);
        let Some(file) = self.image_file(parameters)? else {
            let colour = self.light_colour(parameters, "L")?;
            let factor = match illuminance {
                None => 1.0,
                // Of a sky of radiance 1 on one side of a surface (`Light::Create`).
                Some(illuminance) if !has_portal => illuminance / PI,
                // Behind a portal it is an image of one texel there, and counted as images are.
                Some(illuminance) => {
                    let luminance = self.light_luminance(parameters, "L")?;
                    if luminance > 0.0 {
                        illuminance / (TAU * luminance)
                    } else {
                        1.0
                    }
                }
            };
            let light = self.add_light("constant", parameters);
            self.draft
                .set(light, "radiance", Value::Rgb(colour.map(|channel| channel * factor)));
            return Ok(light);
        };
        let scale = self.light_colour(parameters, "L")?;
        let light = self.add_light("envmap", parameters);
        self.draft.set(light, "filename", Value::String(file));
        self.draft.set(light, "scale", Value::Rgb(scale));
        self.draft.set(light, "mapping", Value::String("pbrt".into()));
        if let Some(illuminance) = illuminance {
            self.draft.set(light, "illuminance", Value::Float(illuminance));
        }
        self.set_rotation(light, self.state.placed(DMat4::IDENTITY))?;
        Ok(light)
    }

    /// The name of a light's image, which is called otherwise in pbrt-v3.
    fn image_file(&mut self, parameters: &Parameters) -> Result<Option<String>, SceneError> {
        let name = if parameters.has("mapname") {
            "mapname"
        } else {
            "filename"
        };
        self.old |= name == "mapname";
        Ok(parameters.text(name)?.map(str::to_owned))
    }

    fn goniometric(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let Some(file) = self.image_file(parameters)? else {
            parameters.warn("it has no image: it is a point light");
            return self.point(parameters);
        };
        let intensity = self.light_colour(parameters, "I")?;
        let light = self.add_light("goniometric", parameters);
        self.draft.set(light, "filename", Value::String(file));
        self.draft.set(light, "intensity", Value::Rgb(intensity));
        self.draft.set(light, "mapping", Value::String("pbrt".into()));
        self.set_power(light, parameters)?;
        // The image's axis is y (`GoniometricLight::Create`).
        let swap = DMat4::from_cols(
            DVec3::X.extend(0.0),
            DVec3::Z.extend(0.0),
            DVec3::Y.extend(0.0),
            DVec3::ZERO.extend(1.0),
        );
        self.set_rotation(light, self.state.placed(swap))
    }

    fn projection(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let Some(file) = self.image_file(parameters)? else {
            return parameters.fault::<()>("filename", "it is missing").map(|_| ());
        };
        let scale = self.light_colour(parameters, "I")?;
        let bitmap = self.add(Kind::Texture, "bitmap", parameters);
        self.draft.set(bitmap, "filename", Value::String(file));
        self.draft.set(bitmap, "filter_type", Value::String("nearest".into()));
        let light = self.add_light("projector", parameters);
        if scale[0] == scale[1] && scale[1] == scale[2] {
            self.draft.set(light, "scale", Value::Float(scale[0]));
            self.draft.link(light, Some("irradiance"), bitmap);
        } else if let Tint::Texture(image) = self.product(Tint::Texture(bitmap), Tint::Rgb(scale), parameters) {
            self.draft.link(light, Some("irradiance"), image);
        }
        self.draft.set(light, "even", Value::String("directions".into()));
        self.set_power(light, parameters)?;
        let fov = parameters.float_or("fov", if self.old { 45.0 } else { 90.0 })?;
        self.draft.set(light, "fov", Value::Float(fov));
        self.draft.set(light, "fov_axis", Value::String("smaller".into()));
        let mirrored = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        self.set_rotation(light, self.state.placed(mirrored))
    }

    /// Passes on the power that a light's image is scaled to.
    fn set_power(&mut self, light: ObjectId, parameters: &Parameters) -> Result<(), SceneError> {
        if let Some(power) = parameters.float("power")?.filter(|power| *power > 0.0) {
            self.draft.set(light, "power", Value::Float(power));
        }
        Ok(())
    }

    /// The area light that shapes have from here on; nothing where it is of a type that does not exist.
    pub(super) fn area_light(&self, kind: &str, parameters: Parameters) -> Result<Option<Parameters>, SceneError> {
        if matches!(kind, "diffuse" | "area") {
            return Ok(Some(parameters));
        }
        let (place, context) = (&parameters.place, parameters.context.clone());
        let fault = SceneError::unknown(place, context, "type", kind, ["diffuse"]);
        self.faults.note(fault).map(|()| None)
    }

    /// Makes a shape shine.
    pub(super) fn shine(&mut self, made: Made, parameters: &Parameters, place: &Place) -> Result<(), SceneError> {
        let emitter = self.draft.add(Kind::Emitter, "area", Some(&parameters.context), place);
        let power = parameters.float("power")?.filter(|power| *power > 0.0);
        let mut power = power.map(|power| power * made.lights as f64);
        if let Some(file) = parameters.text("filename")?.map(str::to_owned) {
            let scale = self.light_scale(parameters)?[1];
            let image = self.add(Kind::Texture, "bitmap", parameters);
            self.draft.set(image, "filename", Value::String(file));
            self.flip_v(image);
            // An image of a given power counts by its form alone.
            let factor = match &mut power {
                Some(power) => {
                    *power *= scale;
                    1.0
                }
                None => scale,
            };
            if let Tint::Texture(scaled) = self.product(Tint::Texture(image), Tint::Number(factor), parameters) {
                self.draft.link(emitter, Some("radiance"), scaled);
            }
        } else {
            let radiance = self.light_colour(parameters, "L")?;
            self.draft.set(emitter, "radiance", Value::Rgb(radiance));
        }
        if let Some(power) = power {
            self.draft.set(emitter, "power", Value::Float(power));
        }
        if parameters.boolean("twosided", false)? {
            self.draft.set(emitter, "two_sided", Value::Boolean(true));
        }
        parameters.ignore(&["nsamples", "samples"]);
        parameters.finish();
        self.draft.link(made.object, None, emitter);
        Ok(())
    }

    fn add_light(&mut self, plugin: &str, parameters: &Parameters) -> ObjectId {
        let light = self.add(Kind::Emitter, plugin, parameters);
        self.draft.link(0, None, light);
        light
    }

    /// Sets `to_world` of something that has a direction and no size: without scale, and without what projects, which changes no
    /// direction in pbrt.
    fn set_rotation(&mut self, object: ObjectId, placed: [DMat4; 2]) -> Result<(), SceneError> {
        let unscaled = placed.map(|matrix| {
            let axis = |axis: DVec4| axis.truncate().normalize_or_zero().extend(0.0);
            let place = matrix.w_axis.truncate().extend(1.0);
            DMat4::from_cols(axis(matrix.x_axis), axis(matrix.y_axis), axis(matrix.z_axis), place)
        });
        self.set_to_world(object, unscaled)
    }
}

/// What a light shines through. Its corners are in world space whatever the transform is, as in pbrt-v4.
fn portal(parameters: &Parameters) -> Result<Option<Portal>, SceneError> {
    if !parameters.has("portal") {
        return Ok(None);
    }
    let Some(numbers) = parameters.floats::<12>("portal")? else {
        return Ok(None);
    };
    let corners = [0, 3, 6, 9].map(|first| DVec3::from_slice(&numbers[first..]).as_vec3());
    let farthest = corners.map(|corner| corner.abs().max_element());
    if farthest.iter().any(|farthest| *farthest > LARGEST_COORDINATE) {
        return parameters.fault("portal", format!("it reaches beyond {LARGEST_COORDINATE:e}"));
    }
    match Portal::new(corners) {
        Some(portal) => Ok(Some(portal)),
        None => parameters.fault(
            "portal",
            "its points are not the corners of a flat rectangle, one after the other",
        ),
    }
}

/// The factor by which `power` multiplies a light that emits `emitted` for each unit of its intensity, where that is given.
fn power(parameters: &Parameters, emitted: f64) -> Result<f64, SceneError> {
    let given = parameters.float("power")?.filter(|power| *power > 0.0);
    Ok(given.map_or(1.0, |power| power / emitted))
}
