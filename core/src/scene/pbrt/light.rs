//! Lights.
//!
//! How bright they are is told in [`super::colour`]; the film's imaging ratio, which multiplies the picture in pbrt, multiplies them
//! here.

use super::Reading;
use super::parameter::Parameters;
use super::state::facing;
use super::texture::Tint;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError};
use crate::scene::spectrum::Use;
use crate::scene::{image, linear_image};
use glam::{DMat4, DVec3};
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
        // The integral of the falloff over all directions (`SpotLight::Phi`).
        let power = power(parameters, TAU * ((1.0 - cos_start) + 0.5 * (cos_start - cos_end)))?;
        let from = parameters.vector("from")?.unwrap_or(DVec3::ZERO);
        let to = parameters.vector("to")?.unwrap_or(DVec3::Z);
        let Some(turned) = facing(to - from) else {
            return parameters
                .fault::<()>("to", "it is the same point as `from`")
                .map(|_| ());
        };
        if start < cone {
            parameters.warn("its light falls off evenly with the angle, where pbrt's begins and ends smoothly");
        }
        let light = self.add_light("spot", parameters);
        self.draft
            .set(light, "intensity", Value::Rgb(intensity.map(|channel| channel * power)));
        self.draft.set(light, "cutoff_angle", Value::Float(cone));
        self.draft.set(light, "beam_width", Value::Float(start.max(0.0)));
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

    /// Light from all sides: the same from everywhere, or an image.
    fn infinite(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        if parameters.has("portal") {
            let without = "it is left out: light comes from all sides, and not through the portal alone";
            parameters.warn_of("portal", without);
            parameters.ignore(&["portal"]);
        }
        // Of a sky of radiance 1 on one side of a surface (`Light::Create`).
        let illuminance = parameters.float("illuminance")?.filter(|value| *value > 0.0);
        let old_name = if parameters.has("mapname") {
            "mapname"
        } else {
            "filename"
        };
        self.old |= old_name == "mapname";
        let Some(file) = parameters.text(old_name)?.map(str::to_owned) else {
            let colour = self.light_colour(parameters, "L")?;
            let factor = illuminance.map_or(1.0, |illuminance| illuminance / PI);
            let light = self.add_light("constant", parameters);
            self.draft
                .set(light, "radiance", Value::Rgb(colour.map(|channel| channel * factor)));
            return Ok(());
        };
        if illuminance.is_some() {
            parameters.warn_of(
                "illuminance",
                "of an image it is left out: the light is as bright as the image says",
            );
        }
        let scale = self.light_colour(parameters, "L")?;
        if scale[0] != scale[1] || scale[1] != scale[2] {
            parameters.warn(
                "the colour beside the image is left out: the light has the image's, and the mean brightness of both",
            );
        }
        let opened = match self.loader.open(&parameters.place, &self.search, &file) {
            Ok(opened) => opened,
            Err(fault) => return self.faults.note(fault),
        };
        let texels = self.loader.limits.image_texels;
        let decoded = match image::read(&opened, &linear_image::Reading::COLOURS, texels) {
            Ok(decoded) => decoded,
            Err(found) => {
                let last = self.faults.all_but_last(found);
                return self.faults.note(last);
            }
        };
        let light = self.add_light("envmap", parameters);
        self.draft.set(light, "filename", Value::String(file));
        let mean = scale.iter().sum::<f64>() / 3.0;
        self.draft.set(light, "scale", Value::Float(mean));
        let turned = if decoded.width == decoded.height {
            self.draft.set(light, "mapping", Value::String("equalarea".into()));
            DMat4::IDENTITY
        } else {
            old_environment()
        };
        self.set_rotation(light, self.state.placed(turned))
    }

    fn goniometric(&mut self, parameters: &Parameters) -> Result<(), SceneError> {
        let intensity = self.light_colour(parameters, "I")?;
        let old_name = if parameters.has("mapname") {
            "mapname"
        } else {
            "filename"
        };
        let Some(file) = parameters.text(old_name)?.map(str::to_owned) else {
            parameters.warn("it has no image: it is a point light");
            return self.point(parameters);
        };
        if parameters.float("power")?.is_some() {
            parameters.warn_of(
                "power",
                "of an image it is left out: the light is as bright as image and `scale` say",
            );
        }
        let light = self.add_light("goniometric", parameters);
        self.draft.set(light, "filename", Value::String(file));
        self.draft.set(light, "intensity", Value::Rgb(intensity));
        self.draft.set(light, "mapping", Value::String("equalarea".into()));
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
        let scale = self.light_colour(parameters, "I")?;
        let old_name = if parameters.has("mapname") {
            "mapname"
        } else {
            "filename"
        };
        let Some(file) = parameters.text(old_name)?.map(str::to_owned) else {
            return parameters.fault::<()>("filename", "it is missing").map(|_| ());
        };
        if parameters.float("power")?.is_some() {
            parameters.warn_of(
                "power",
                "of an image it is left out: the light is as bright as image and `scale` say",
            );
        }
        parameters.warn("it lights a plane before it evenly, where pbrt's is as bright in all directions of its image");
        let image = self.add(Kind::Texture, "bitmap", parameters);
        self.draft.set(image, "filename", Value::String(file));
        let light = self.add_light("projector", parameters);
        self.draft.link(light, Some("irradiance"), image);
        // In the middle of the image: ours is the radiance of a white surface at distance 1, which is the intensity over pi.
        let mean = scale.iter().sum::<f64>() / 3.0;
        self.draft.set(light, "scale", Value::Float(mean / PI));
        let fov = parameters.float_or("fov", if self.old { 45.0 } else { 90.0 })?;
        self.draft.set(light, "fov", Value::Float(fov));
        self.draft.set(light, "fov_axis", Value::String("smaller".into()));
        let mirrored = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        self.set_rotation(light, self.state.placed(mirrored))
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

    /// Makes a shape shine. `area` is that of the shape, or of each of the lights that it is of in pbrt; `None` where it is not known.
    pub(super) fn shine(
        &mut self,
        shape: ObjectId,
        parameters: &Parameters,
        area: Option<f64>,
        place: &Place,
    ) -> Result<(), SceneError> {
        let two_sided = parameters.boolean("twosided", false)?;
        let mut factor = 1.0;
        if let Some(power) = parameters.float("power")?.filter(|power| *power > 0.0) {
            match area {
                Some(area) => factor = power / (area * PI * if two_sided { 2.0 } else { 1.0 }),
                None => parameters.warn_of(
                    "power",
                    "of this shape it is left out: the radiance is that of `L` and `scale`",
                ),
            }
        }
        let emitter = self.draft.add(Kind::Emitter, "area", Some(&parameters.context), place);
        if let Some(file) = parameters.text("filename")?.map(str::to_owned) {
            let scale = self.light_scale(parameters)?.map(|scale| scale * factor);
            let image = self.add(Kind::Texture, "bitmap", parameters);
            self.draft.set(image, "filename", Value::String(file));
            self.flip_v(image);
            if let Tint::Texture(scaled) = self.product(Tint::Texture(image), Tint::Number(scale[1]), parameters) {
                self.draft.link(emitter, Some("radiance"), scaled);
            }
            if factor != 1.0 {
                parameters.warn_of("power", "the mean of the image is taken for 1");
            }
        } else {
            let radiance = self.light_colour(parameters, "L")?.map(|channel| channel * factor);
            self.draft.set(emitter, "radiance", Value::Rgb(radiance));
        }
        parameters.ignore(&["nsamples", "samples"]);
        parameters.finish();
        if two_sided {
            parameters.warn_of("twosided", "the shape shines from its outer side alone");
        }
        self.draft.link(shape, None, emitter);
        Ok(())
    }

    fn add_light(&mut self, plugin: &str, parameters: &Parameters) -> ObjectId {
        let light = self.add(Kind::Emitter, plugin, parameters);
        self.draft.link(0, None, light);
        light
    }

    /// Sets `to_world` of something that has a direction and no size: without scale.
    fn set_rotation(&mut self, object: ObjectId, placed: [DMat4; 2]) -> Result<(), SceneError> {
        let unscaled = placed.map(|matrix| {
            let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.normalize_or_zero());
            DMat4::from_cols(axes[0], axes[1], axes[2], matrix.w_axis)
        });
        self.set_to_world(object, unscaled)
    }
}

/// What turns our images of all directions, whose pole is +y and whose middle is +z, into those of pbrt-v3: their pole is +z, and their left
/// edge +x, from where they go to +y.
fn old_environment() -> DMat4 {
    DMat4::from_cols(
        DVec3::Y.extend(0.0),
        DVec3::Z.extend(0.0),
        DVec3::NEG_X.extend(0.0),
        DVec3::ZERO.extend(1.0),
    )
}

/// The factor by which `power` multiplies a light that emits `emitted` for each unit of its intensity, where that is given.
fn power(parameters: &Parameters, emitted: f64) -> Result<f64, SceneError> {
    let given = parameters.float("power")?.filter(|power| *power > 0.0);
    Ok(given.map_or(1.0, |power| power / emitted))
}
