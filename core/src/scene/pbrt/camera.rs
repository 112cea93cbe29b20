//! Camera, film, filter, sampler and integrator.

use super::Reading;
use super::parameter::Parameters;
use super::state::inverse;
use crate::scene::description::{Kind, ObjectId, Value};
use crate::scene::error::SceneError;
use glam::{DMat4, DVec3};

/// What says how the scene is seen, as it is read; the objects are made when all of it is there.
pub(super) struct Views {
    camera: Option<Camera>,
    film: Option<(String, Parameters)>,
    filter: Option<(String, Parameters)>,
    sampler: Option<Parameters>,
    integrator: Option<(String, Parameters)>,
    /// The length of the film's diagonal \[mm\].
    diagonal: f64,
    /// What the film multiplies light by.
    pub(super) imaging_ratio: f64,
}

struct Camera {
    kind: String,
    parameters: Parameters,
    /// The map from the world to the camera, when the shutter opens and when it closes.
    from_world: [DMat4; 2],
    /// The medium that it is in.
    medium: Option<ObjectId>,
}

impl Default for Views {
    fn default() -> Self {
        Self {
            camera: None,
            film: None,
            filter: None,
            sampler: None,
            integrator: None,
            diagonal: DIAGONAL,
            imaging_ratio: 1.0,
        }
    }
}

/// The length of a film's diagonal by default \[mm\].
const DIAGONAL: f64 = 35.0;
/// The near clip distance, as small as rays can start; pbrt has none.
const NEAR: f64 = 1e-4;
/// The far clip distance; pbrt has none.
const FAR: f64 = 1e9;

impl Reading<'_, '_> {
    pub(super) fn view_directive(
        &mut self,
        word: &str,
        kind: String,
        parameters: Parameters,
    ) -> Result<(), SceneError> {
        match word {
            "Camera" => {
                let to_world = self.state.to_world.map(inverse);
                self.systems.insert("camera".to_owned(), to_world);
                let from_world = self.state.to_world;
                self.views.camera = Some(Camera {
                    kind,
                    parameters,
                    from_world,
                    medium: self.state.interface.outside,
                });
            }
            "Film" => {
                self.old |= kind == "image";
                self.views.film = Some((kind, parameters));
            }
            "PixelFilter" => self.views.filter = Some((kind, parameters)),
            "Sampler" => self.views.sampler = Some(parameters),
            _ => self.views.integrator = Some((kind, parameters)),
        }
        self.find_imaging_ratio()
    }

    /// The imaging ratio of pbrt's sensors: the time of exposure times `iso` / 100 (`PixelSensor::Create`); pbrt-v3 has a `scale`.
    fn find_imaging_ratio(&mut self) -> Result<(), SceneError> {
        let mut ratio = 1.0;
        if let Some((kind, film)) = &self.views.film {
            let iso = film.positive_or("iso", 100.0)?;
            ratio = if kind == "image" {
                film.positive_or("scale", 1.0)?
            } else {
                iso / 100.0
            };
        }
        if let (Some(camera), false) = (&self.views.camera, self.old) {
            let open = camera.parameters.float_or("shutteropen", 0.0)?;
            let close = camera.parameters.float_or("shutterclose", 1.0)?;
            if close > open {
                ratio *= close - open;
            } else {
                let reason = format!("{close} is not after `shutteropen`, {open}: the picture would be black");
                camera.parameters.fault::<()>("shutterclose", reason)?;
            }
        }
        self.views.imaging_ratio = ratio;
        Ok(())
    }

    /// Makes the objects of what was read.
    pub(super) fn view(&mut self) -> Result<(), SceneError> {
        self.integrator()?;
        let Some(camera) = self.views.camera.take() else {
            return Ok(());
        };
        let film = self.film(&camera)?;
        let parameters = &camera.parameters;
        let resolution = self.resolution(film);
        let plugin = match camera.kind.as_str() {
            "perspective" if parameters.float_or("lensradius", 0.0)? > 0.0 => "thinlens",
            "orthographic" => "orthographic",
            "spherical" | "environment" => "spherical",
            _ => "perspective",
        };
        let sensor = self.add(Kind::Sensor, plugin, parameters);
        self.draft.link(0, None, sensor);
        self.draft.link(sensor, None, film);
        if let Some(medium) = camera.medium {
            self.draft.link(sensor, None, medium);
        }
        self.sampler(sensor)?;
        let open = parameters.float_or("shutteropen", 0.0)?;
        let close = parameters.float_or("shutterclose", 1.0)?;
        self.draft.set(sensor, "shutter_open", Value::Float(open));
        self.draft.set(sensor, "shutter_close", Value::Float(close));
        self.draft.set(sensor, "near_clip", Value::Float(NEAR));
        self.draft.set(sensor, "far_clip", Value::Float(FAR));
        let screen = self.screen(&camera, resolution)?;
        match plugin {
            "spherical" => self.spherical(sensor, &camera)?,
            "orthographic" => self.orthographic(sensor, &camera, screen)?,
            _ => self.perspective(sensor, &camera, screen)?,
        }
        parameters.ignore(&["lensradius", "focaldistance"]);
        parameters.finish();
        Ok(())
    }

    /// The window [x0, x1, y0, y1] of the plane at distance 1, or for parallel rays of the camera's space, that the film shows: its shorter
    /// side is 2 by default.
    fn screen(&mut self, camera: &Camera, [width, height]: [f64; 2]) -> Result<[f64; 4], SceneError> {
        let parameters = &camera.parameters;
        let aspect = parameters.positive_or("frameaspectratio", width / height)?;
        let (x, y) = if aspect > 1.0 {
            (aspect, 1.0)
        } else {
            (1.0, 1.0 / aspect)
        };
        let screen = parameters.floats::<4>("screenwindow")?.unwrap_or([-x, x, -y, y]);
        let [x0, x1, y0, y1] = screen;
        if x1 <= x0 || y1 <= y0 {
            parameters.fault::<()>("screenwindow", "it is x0 x1 y0 y1, and has no area")?;
            return Ok([-x, x, -y, y]);
        }
        let written = ((x1 - x0) / (y1 - y0)) / (width / height);
        if (written - 1.0).abs() > 1e-3 {
            parameters.warn("the window is not of the film's form: its width counts, and the picture is not stretched");
        }
        Ok(screen)
    }

    fn perspective(&mut self, sensor: ObjectId, camera: &Camera, [x0, x1, y0, y1]: [f64; 4]) -> Result<(), SceneError> {
        let parameters = &camera.parameters;
        let half = match camera.kind.as_str() {
            "perspective" => {
                let half_fov = parameters.float("halffov")?;
                let fov = parameters.float_or("fov", 90.0)?;
                libm::tan(half_fov.map_or(0.5 * fov, |half| half).to_radians())
            }
            _ => {
                let length = parameters.text("lensfile")?.and_then(focal_length);
                let (fov, of) = match (length, parameters.float("fov")?) {
                    (None, Some(fov)) => (Some(fov), "its field of view"),
                    (Some(_), _) => (None, "the focal length in its lens file's name"),
                    (None, None) => (None, "50 mm"),
                };
                let named = "perspective, orthographic, spherical and realistic";
                parameters.warn(&match camera.kind.as_str() {
                    "realistic" => format!("it is rendered as `perspective` of {of}"),
                    _ => format!("there are {named}: it is rendered as `perspective` of {of}"),
                });
                parameters.ignore_all();
                let diagonal = libm::hypot(x1 - x0, y1 - y0) / 2.0;
                match fov {
                    Some(fov) => libm::tan((0.5 * fov).to_radians()),
                    None => 0.5 * self.views.diagonal / length.unwrap_or(50.0) / diagonal,
                }
            }
        };
        // Scale along the axes of the camera's space: in the picture that of the image plane, as the map has it.
        let mut scales = [1.0; 3];
        let to_world = camera.from_world.map(|from_world| {
            let matrix = inverse(from_world) * DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
            scales = [matrix.x_axis.length(), matrix.y_axis.length(), matrix.z_axis.length()];
            let [x, y, z] = [
                matrix.x_axis / scales[0],
                matrix.y_axis / scales[1],
                matrix.z_axis / scales[2],
            ];
            DMat4::from_cols(x, y, z, matrix.w_axis)
        });
        let half = half * scales[0] / scales[2];
        let (width, height) = (x1 - x0, y1 - y0);
        let fov_x = 2.0 * libm::atan(half * width / 2.0).to_degrees();
        self.draft.set(sensor, "fov", Value::Float(fov_x));
        // The axis passes through the origin of the window; offsets are shares of the image, to the right and downwards.
        let offset = [(x0 + x1) / (2.0 * width), -(y0 + y1) / (2.0 * height)];
        for (name, offset) in ["principal_point_offset_x", "principal_point_offset_y"]
            .into_iter()
            .zip(offset)
        {
            if offset != 0.0 {
                self.draft.set(sensor, name, Value::Float(offset));
            }
        }
        if self.draft.objects[sensor].plugin == "thinlens" {
            let radius = parameters.float_or("lensradius", 0.0)? * scales[0];
            let distance = parameters.positive_or("focaldistance", 1e6)? * scales[2];
            self.draft.set(sensor, "aperture_radius", Value::Float(radius));
            self.draft.set(sensor, "focus_distance", Value::Float(distance));
        }
        self.set_to_world(sensor, to_world)
    }

    /// All directions. Its pole is +y, and its left edge +x, from where it goes to +z (`SphericalCamera::GenerateRay`); ours goes from -z
    /// to +x.
    fn spherical(&mut self, sensor: ObjectId, camera: &Camera) -> Result<(), SceneError> {
        if camera.kind == "spherical" && camera.parameters.text("mapping")? != Some("equirectangular") {
            camera
                .parameters
                .warn("the picture is of longitude and latitude, and not of equal areas");
        }
        let turned = DMat4::from_cols(
            DVec3::Z.extend(0.0),
            DVec3::Y.extend(0.0),
            DVec3::NEG_X.extend(0.0),
            DVec3::ZERO.extend(1.0),
        );
        self.set_to_world(sensor, camera.from_world.map(|from_world| inverse(from_world) * turned))
    }

    fn orthographic(
        &mut self,
        sensor: ObjectId,
        camera: &Camera,
        [x0, x1, y0, y1]: [f64; 4],
    ) -> Result<(), SceneError> {
        if camera.parameters.float_or("lensradius", 0.0)? > 0.0 {
            camera
                .parameters
                .warn_of("lensradius", "this camera has no lens here: all is in focus");
        }
        let half = 0.5 * (x1 - x0);
        let middle = DVec3::new(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0);
        let window = DMat4::from_translation(middle) * DMat4::from_scale(DVec3::new(-half, half, 1.0));
        self.set_to_world(sensor, camera.from_world.map(|from_world| inverse(from_world) * window))
    }

    /// The film, with the filter.
    fn film(&mut self, camera: &Camera) -> Result<ObjectId, SceneError> {
        let Some((kind, parameters)) = self.views.film.take() else {
            let place = camera.parameters.place.clone();
            let film = self.draft.add(Kind::Film, "hdrfilm", Some("Film"), &place);
            self.size(film, [1280, 720]);
            self.filter(film)?;
            return Ok(film);
        };
        if !matches!(kind.as_str(), "rgb" | "gbuffer" | "spectral" | "image") {
            parameters.warn("there is no film of this type: its size counts, and it has red, green and blue");
        }
        if kind == "spectral" {
            parameters.warn("the picture has red, green and blue, and not the film's spectral channels");
        }
        let film = self.add(Kind::Film, "hdrfilm", &parameters);
        let default = if self.old { [640, 480] } else { [1280, 720] };
        let mut resolution = default;
        for (side, name) in resolution.iter_mut().zip(["xresolution", "yresolution"]) {
            if let Some(value) = parameters.integer(name)? {
                *side = value;
            }
        }
        self.size(film, resolution);
        self.crop(film, &parameters, resolution)?;
        if let Some(sensor) = parameters.text("sensor")?.filter(|sensor| *sensor != "cie1931") {
            let message = format!("the colours are those of the CIE observer, and not of the sensor `{sensor:.40}`");
            parameters.warn_of("sensor", &message);
        }
        if parameters.float_or("whitebalance", 0.0)? != 0.0 {
            parameters.warn_of("whitebalance", "colours are not balanced: white is that of D65");
        }
        for name in ["maxcomponentvalue", "maxsampleluminance"] {
            if parameters.float(name)?.is_some_and(f64::is_finite) {
                parameters.warn_of(name, "bright samples are not clamped");
            }
        }
        self.views.diagonal = parameters.positive_or("diagonal", DIAGONAL)?;
        // What the imaging ratio was made of, what names and forms of files say, and what other films have.
        parameters.ignore(&[
            "iso",
            "scale",
            "filename",
            "savefp16",
            "coordinatesystem",
            "nbuckets",
            "lambdamin",
            "lambdamax",
            "gbufferchannels",
        ]);
        parameters.finish();
        self.filter(film)?;
        Ok(film)
    }

    fn size(&mut self, film: ObjectId, [width, height]: [i32; 2]) {
        self.draft.set(film, "width", Value::Integer(width.into()));
        self.draft.set(film, "height", Value::Integer(height.into()));
    }

    fn resolution(&self, film: ObjectId) -> [f64; 2] {
        ["width", "height"].map(
            |name| match self.draft.objects[film].properties.get(name).map(|side| &side.value) {
                Some(Value::Integer(side)) if *side > 0 => *side as f64,
                _ => 1.0,
            },
        )
    }

    /// The part of the film that is rendered, in shares of the sides or in pixels: x0, x1, y0, y1.
    fn crop(&mut self, film: ObjectId, parameters: &Parameters, resolution: [i32; 2]) -> Result<(), SceneError> {
        let [width, height] = resolution.map(f64::from);
        let mut bounds = None;
        if let Some(pixels) = parameters.floats::<4>("pixelbounds")? {
            bounds = Some(pixels);
        }
        if let Some([x0, x1, y0, y1]) = parameters.floats::<4>("cropwindow")? {
            let edge = |share: f64, side: f64| (side * share.clamp(0.0, 1.0)).ceil();
            bounds = Some([edge(x0, width), edge(x1, width), edge(y0, height), edge(y1, height)]);
        }
        let Some([x0, x1, y0, y1]) = bounds else { return Ok(()) };
        let [x0, x1] = [x0, x1].map(|x| x.clamp(0.0, width));
        let [y0, y1] = [y0, y1].map(|y| y.clamp(0.0, height));
        if x1 <= x0 || y1 <= y0 {
            return parameters
                .fault::<()>("cropwindow", "nothing is left of the film")
                .map(|_| ());
        }
        if [x0, x1, y0, y1] != [0.0, width, 0.0, height] {
            for (name, value) in [
                ("crop_offset_x", x0),
                ("crop_offset_y", y0),
                ("crop_width", x1 - x0),
                ("crop_height", y1 - y0),
            ] {
                self.draft.set(film, name, Value::Integer(value as i64));
            }
        }
        Ok(())
    }

    fn filter(&mut self, film: ObjectId) -> Result<(), SceneError> {
        let Some((kind, parameters)) = self.views.filter.take() else {
            return Ok(());
        };
        let (plugin, name, default) = match kind.as_str() {
            "box" => ("box", "radius", 0.5),
            "triangle" => ("tent", "radius", 2.0),
            "gaussian" => ("gaussian", "stddev", 1.5),
            "mitchell" => ("mitchell", "radius", 2.0),
            "sinc" => ("lanczos", "radius", 4.0),
            _ => {
                let (place, context) = (&parameters.place, parameters.context.clone());
                let allowed = ["box", "gaussian", "mitchell", "sinc", "triangle"];
                return self
                    .faults
                    .note(SceneError::unknown(place, context, "type", &kind, allowed));
            }
        };
        let filter = self.add(Kind::Filter, plugin, &parameters);
        // pbrt-v2 calls them widths.
        let [x_name, y_name] = match parameters.has("xwidth") || parameters.has("ywidth") {
            true => ["xwidth", "ywidth"],
            false => ["xradius", "yradius"],
        };
        let x = parameters.positive_or(x_name, if self.old && kind == "gaussian" { 2.0 } else { default })?;
        let y = parameters.positive_or(y_name, x)?;
        if x != y {
            parameters.warn_of(y_name, "the filter is as wide along both axes, by their mean");
        }
        let width = match kind.as_str() {
            // In pbrt-v3 the exponent `alpha` is 1 / (2 sigma^2).
            "gaussian" if parameters.has("alpha") => (0.5 / parameters.positive_or("alpha", 2.0)?).sqrt(),
            "gaussian" => parameters.positive_or("sigma", 0.5)?,
            _ => 0.5 * (x + y),
        };
        parameters.ignore(&["B", "C", "tau"]);
        parameters.finish();
        if matches!(plugin, "box" | "tent" | "gaussian") {
            self.draft.set(filter, name, Value::Float(width));
        }
        self.draft.link(film, None, filter);
        Ok(())
    }

    fn sampler(&mut self, sensor: ObjectId) -> Result<(), SceneError> {
        let Some(parameters) = self.views.sampler.take() else {
            return Ok(());
        };
        let sampler = self.add(Kind::Sampler, "independent", &parameters);
        let count = match parameters.integer("pixelsamples")? {
            Some(count) => count,
            None => match (parameters.integer("xsamples")?, parameters.integer("ysamples")?) {
                (None, None) => 16,
                (x, y) => x.unwrap_or(4).saturating_mul(y.unwrap_or(4)),
            },
        };
        self.draft.set(sampler, "sample_count", Value::Integer(count.into()));
        self.draft.link(sensor, None, sampler);
        Ok(())
    }

    /// The integrator. The depth of pbrt counts what scatters light, ours the edges of the whole path: one more.
    fn integrator(&mut self) -> Result<(), SceneError> {
        let Some((kind, parameters)) = self.views.integrator.take() else {
            return Ok(());
        };
        let plugin = match kind.as_str() {
            "path" | "simplepath" | "randomwalk" | "whitted" => "path",
            "bdpt" => "bdpt",
            "sppm" => "sppm",
            "volpath" | "simplevolpath" => "volpath",
            "lightpath" => "ptracer",
            "mlt" => "mlt",
            "directlighting" => "direct",
            other => {
                parameters.warn(&format!(
                    "there is no integrator `{other:.40}` here; who renders chooses one"
                ));
                return Ok(());
            }
        };
        if matches!(kind.as_str(), "randomwalk" | "whitted") {
            parameters.warn("it is rendered as by `path`");
        }
        let integrator = self.add(Kind::Integrator, plugin, &parameters);
        let depth = parameters.integer("maxdepth")?.unwrap_or(5);
        self.draft
            .set(integrator, "max_depth", Value::Integer(i64::from(depth.max(0)) + 1));
        if plugin == "sppm" {
            if let Some(radius) = parameters.float("radius")? {
                self.draft.set(integrator, "sigma1", Value::Float(radius));
            }
            if let Some(photons) = parameters
                .integer("photonsperiteration")?
                .filter(|photons| *photons > 0)
            {
                self.draft.set(integrator, "photons", Value::Integer(photons.into()));
            }
        }
        self.draft.link(0, None, integrator);
        Ok(())
    }
}

/// The focal length \[mm\] in the name of a lens file, as in `dgauss.50mm.dat` and `dgauss.22deg.3.0mm.json`.
fn focal_length(file: &str) -> Option<f64> {
    let before = &file[..file.rfind("mm")?];
    let start = |text: &str| text.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let whole = start(before);
    let decimal = before[..whole].strip_suffix('.').map(|head| (start(head), head.len()));
    let first = match decimal {
        Some((first, end)) if first < end => first,
        _ => whole,
    };
    let length = before.get(first..)?.parse().ok();
    length.filter(|length: &f64| (0.1..=1e4).contains(length))
}
