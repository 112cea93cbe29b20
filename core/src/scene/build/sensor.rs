//! Sensor, film, reconstruction filter and sampler.

use super::uniform_scale;
use crate::film::{FilmSettings, Filter};
use crate::geometry::Geometry;
use crate::math::{AnimatedTransform, DVec3, Transform, Vec2, Vec3, atan2, tan};
use crate::motion::Motion;
use crate::scene::Limits;
use crate::scene::description::{Description, Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, shortened, within};
use crate::scene::reader::{ANY, NOT_NEGATIVE, POSITIVE, Reader};
use crate::sensor::{Lens, Projection, Sensor, window};

const SENSORS: [&str; 8] = [
    "perspective",
    "perspective_rdist",
    "thinlens",
    "orthographic",
    "telecentric",
    "spherical",
    "radiancemeter",
    "irradiancemeter",
];
/// Sensors of Mitsuba that do not exist here.
const OTHER_SENSORS: [&str; 5] = ["distant", "hdistant", "mdistant", "batch", "fluencemeter"];
/// The field of view of a radiance meter, which has one ray in Mitsuba [radians].
const METER_FOV: f32 = 1e-5;
/// A camera with its film.
pub(super) struct View {
    pub(super) sensor: Sensor,
    pub(super) film: FilmSettings,
    /// Samples per pixel, where the scene says them.
    pub(super) sample_count: Option<u32>,
}

impl View {
    /// Whether up in the picture is down in a world whose up is y, as in Mitsuba, or z, as in Blender. A camera that looks along
    /// -y may be one that looks straight down where y is up.
    pub(super) fn is_upside_down(&self) -> bool {
        let is_meter = match self.sensor.projection {
            Projection::Irradiance { .. } => true,
            Projection::Perspective { fov_x, .. } => fov_x <= METER_FOV,
            Projection::Orthographic | Projection::Spherical => false,
        };
        if is_meter {
            return false;
        }
        let [up, forward] = [Vec3::Y, Vec3::Z].map(|axis| self.sensor.to_world.vector(axis).normalize_or_zero());
        up.y < -0.7 || (up.z < -0.7 && forward.y > -0.7)
    }
}

/// The sensor with the id `name`, or else with that number from 1.
pub(super) fn named(description: &Description, sensors: &[ObjectId], name: &str) -> Result<ObjectId, SceneError> {
    let by_id = description.ids.get(name).filter(|object| sensors.contains(object));
    let by_number = || sensors.get(name.parse::<usize>().ok()?.checked_sub(1)?);
    by_id.or_else(by_number).copied().ok_or_else(|| SceneError::Unknown {
        place: Place::whole(&description.objects[0].place.file),
        context: "<scene>".into(),
        what: "sensor",
        name: shortened(name),
        allowed: names(description, sensors),
    })
}

/// Numbers and ids of sensors, for messages.
pub(super) fn names(description: &Description, sensors: &[ObjectId]) -> String {
    let name = |(index, sensor): (usize, &ObjectId)| {
        let ids: Vec<String> = description
            .ids
            .iter()
            .filter(|(_, object)| *object == sensor)
            .map(|(id, _)| format!("`{id}`"))
            .collect();
        let number = index + 1;
        if ids.is_empty() {
            number.to_string()
        } else {
            format!("{number} or {}", ids.join(" or "))
        }
    };
    let names: Vec<String> = sensors.iter().enumerate().take(MOST_NAMES).map(name).collect();
    match (names.is_empty(), sensors.len() > MOST_NAMES) {
        (true, _) => "none: the scene has no sensor".into(),
        (false, true) => format!("{}, ...", names.join(", ")),
        (false, false) => names.join(", "),
    }
}

/// The most sensors that a message lists.
const MOST_NAMES: usize = 20;

/// The view of a scene without a sensor, which Mitsuba refuses: all of it, from outside along +z, with a field of view of 45 degrees.
pub(super) fn default_view(geometry: &Geometry) -> View {
    let (lower, upper) = geometry.bounds();
    let (center, extent) = (0.5 * (lower + upper), (upper - lower).max_element());
    let fov_x = 45.0_f32.to_radians();
    let distance = extent / (2.0 * tan(0.5 * fov_x));
    let eye = glam::DVec3::new(
        center.x.into(),
        center.y.into(),
        f64::from(lower.z) - f64::from(distance),
    );
    let film = FilmSettings {
        resolution: DEFAULT_RESOLUTION,
        filter: DEFAULT_FILTER,
    };
    let sensor = Sensor {
        to_world: Transform::from_matrix(glam::DMat4::from_translation(eye)).unwrap_or_default(),
        projection: Projection::Perspective {
            fov_x,
            principal_point: Vec2::ZERO,
            lens: None,
        },
        resolution: film.resolution,
        clip: [distance / 100.0, extent * 5.0 + distance],
    };
    View {
        sensor,
        film,
        sample_count: None,
    }
}

/// The sensors of a scene: its own, then those that measure what arrives at its shapes, each with its shape.
pub(super) fn all(description: &Description, scene: &Reader) -> Vec<(ObjectId, Option<ObjectId>)> {
    let own = scene
        .children(Kind::Sensor)
        .into_iter()
        .map(|child| (child.target, None));
    let shapes = description.objects[0].children.iter().map(|child| child.target);
    let on_shapes = shapes
        .filter(|shape| description.objects[*shape].kind == Kind::Shape)
        .flat_map(|shape| {
            let children = description.objects[shape].children.iter().map(|child| child.target);
            let sensors = children.filter(|child| description.objects[*child].kind == Kind::Sensor);
            sensors.map(move |sensor| (sensor, Some(shape)))
        });
    own.chain(on_shapes).collect()
}

/// Builds a sensor, and begins the motion by its own and the time that its shutter is open. `shape` is what it lies on, if it does.
pub(super) fn build(
    description: &Description,
    object: ObjectId,
    shape: Option<ObjectId>,
    limits: &Limits,
) -> Result<(View, Motion), SceneError> {
    let reader = Reader::new(description, object);
    let plugin = reader.object.plugin.as_str();
    if OTHER_SENSORS.contains(&plugin) {
        return Err(reader.unsupported(format!("type `{plugin}`"), format!("there are: {}", SENSORS.join(", "))));
    }
    if !SENSORS.contains(&plugin) {
        return Err(reader.unknown_type(&SENSORS));
    }
    let film = match reader.only_child(Kind::Film)? {
        Some(film) => {
            let settings = film_settings(&Reader::new(description, film.target), description, limits);
            description.attempt(film.target, settings)?
        }
        None => None,
    };
    let is_meter = plugin.ends_with("meter");
    let film = film.unwrap_or_else(|| Frame::whole(if is_meter { [1, 1] } else { DEFAULT_RESOLUTION }));
    let sample_count = match reader.only_child(Kind::Sampler)? {
        Some(sampler) => {
            let count = sample_count(&Reader::new(description, sampler.target));
            description.attempt(sampler.target, count)?.flatten()
        }
        None => None,
    };
    let (sensor, mut motion) = match (plugin, shape) {
        ("irradiancemeter", Some(shape)) => irradiance_meter(&reader, &Reader::new(description, shape), &film)?,
        ("irradiancemeter", None) => {
            let reason =
                "an irradiance meter measures what arrives at a shape: put it inside a <shape type=\"rectangle\">";
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        (_, Some(_)) => {
            let reason = "of all sensors an `irradiancemeter` alone lies on a shape";
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        ("radiancemeter", None) => radiance_meter(&reader, &film)?,
        _ => camera(&reader, film.whole)?,
    };
    reader.finish();
    let sensor = if film.is_whole() {
        sensor
    } else {
        crop(&reader, &film, sensor, &mut motion)?
    };
    let view = View {
        sensor,
        film: FilmSettings {
            resolution: film.size,
            // A meter's pixels are places of their own.
            filter: if is_meter {
                Filter::Box { radius: 0.5 }
            } else {
                film.filter
            },
        },
        sample_count,
    };
    Ok((view, motion))
}

/// A film: the window of an image that is rendered.
struct Frame {
    /// Size of the image [pixels].
    whole: [u32; 2],
    /// Where the window begins.
    offset: [u32; 2],
    /// Size of the window.
    size: [u32; 2],
    filter: Filter,
}

impl Frame {
    fn whole(size: [u32; 2]) -> Self {
        Self {
            whole: size,
            offset: [0, 0],
            size,
            filter: DEFAULT_FILTER,
        }
    }

    fn is_whole(&self) -> bool {
        self.size == self.whole
    }
}

/// The sensor that sees the window of a film.
fn crop(reader: &Reader, film: &Frame, sensor: Sensor, motion: &mut Motion) -> Result<Sensor, SceneError> {
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

/// One ray, which starts at the meter.
fn radiance_meter(reader: &Reader, film: &Frame) -> Result<(Sensor, Motion), SceneError> {
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
    let to_world = to_world.map(super::light::rotation);
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

/// What arrives at a rectangle, each pixel of the film being its part of it.
fn irradiance_meter(reader: &Reader, shape: &Reader, film: &Frame) -> Result<(Sensor, Motion), SceneError> {
    if shape.object.plugin != "rectangle" {
        let what = format!("on a shape of type `{}`", shape.object.plugin);
        return Err(reader.unsupported(what, "it can lie on a `rectangle`"));
    }
    let to_world = shape.animation("to_world")?.unwrap_or_default();
    let flipped = shape.boolean("flip_normals", false)?;
    let mut motion = Motion {
        shutter: shutter(reader)?,
        ..Motion::default()
    };
    let sensor = Sensor {
        to_world: to_world.at(motion.at_rest()),
        projection: Projection::Irradiance { flipped },
        resolution: film.whole,
        clip: [0.0, f32::MAX],
    };
    motion.sensor = to_world.moves_within(motion.shutter).then_some(to_world);
    Ok((sensor, motion))
}

/// Films, which are all the same here.
const FILMS: [&str; 5] = ["hdrfilm", "ldrfilm", "tiledhdrfilm", "mfilm", "specfilm"];

/// What Mitsuba's films of all ages say of files, of their looks on a screen and of borders.
const FILM_WITHOUT_EFFECT: [&str; 23] = [
    "attach_log",
    "banner",
    "burn",
    "channel_names",
    "compensate",
    "component_format",
    "contrast",
    "digits",
    "exposure",
    "file_format",
    "gamma",
    "has_alpha",
    "high_quality_edges",
    "key",
    "label",
    "pixel_format",
    "render_time_annotation",
    "sample_border",
    "tonemap_method",
    "variable",
    "view",
    "white_point",
    "write_xyz",
];

const DEFAULT_RESOLUTION: [u32; 2] = [768, 576];
const DEFAULT_FILTER: Filter = Filter::Gaussian { stddev: 0.5 };

fn camera(reader: &Reader, resolution: [u32; 2]) -> Result<(Sensor, Motion), SceneError> {
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
    let plugin = reader.object.plugin.as_str();
    match plugin {
        "perspective_rdist" => {
            reader.warn(
                reader.place(),
                "the lens does not distort: straight lines stay straight",
            );
            reader.ignore(&["kc"]);
        }
        "telecentric" => {
            reader.warn(
                reader.place(),
                "it is rendered as `orthographic`: everything is in focus",
            );
            reader.ignore(&["aperture_radius"]);
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

/// The part of the plane before the camera that the image shows, in units of half of what `fov` sees, or of an orthographic camera's axes.
/// It runs from left to right and from bottom to top, as in pbrt.
#[derive(Clone, Copy)]
struct ScreenWindow {
    middle: Vec2,
    half_width: f32,
}

impl ScreenWindow {
    /// The horizontal field of view [radians] and the principal point [share of the image] of a camera whose interval [-1, 1] is seen
    /// under `fov`.
    fn of_perspective(self, fov: f32, [width, height]: [u32; 2]) -> (f32, Vec2) {
        let half_width = tan(0.5 * fov) * self.half_width;
        let half_height = self.half_width * height as f32 / width as f32;
        let middle = 0.5 * self.middle / Vec2::new(self.half_width, -half_height);
        (2.0 * atan2(half_width, 1.0), middle)
    }

    /// Maps the image of an orthographic camera to the part of it.
    fn of_plane(self) -> Transform {
        let middle = Vec2::new(-self.middle.x, self.middle.y);
        window(middle, self.half_width)
    }
}

/// `screen_window`: four numbers, x from and to, y from and to.
fn screen_window(reader: &Reader, resolution: [u32; 2]) -> Result<Option<ScreenWindow>, SceneError> {
    let Some(text) = reader.string("screen_window")? else {
        return Ok(None);
    };
    let words = text.split([' ', ',']).filter(|word| !word.is_empty());
    let numbers: Option<Vec<f32>> = words.map(|word| word.parse().ok()).collect();
    let window = match numbers.as_deref() {
        Some(&[left, right, bottom, top]) if left < right && bottom < top => Some([left, right, bottom, top]),
        _ => None,
    };
    let window = window.filter(|window| window.iter().all(|number| number.abs() <= 1e6));
    let Some([left, right, bottom, top]) = window else {
        let reason = format!(
            "`{}` is not four numbers up to 1e6: x from and to, y from and to",
            shortened(text)
        );
        return Err(reader.wrong("screen_window", reason));
    };
    let (width, height) = (right - left, top - bottom);
    let pixel_aspect = width / height * resolution[1] as f32 / resolution[0] as f32;
    if (pixel_aspect - 1.0).abs() > 1e-3 {
        reader.warn_of(
            "screen_window",
            "pixels are square: the window is as high as its width and the film's shape make it",
        );
    }
    Ok(Some(ScreenWindow {
        middle: Vec2::new(0.5 * (left + right), 0.5 * (bottom + top)),
        half_width: 0.5 * width,
    }))
}

fn check_position(reader: &Reader, position: Vec3) -> Result<(), SceneError> {
    let limit = crate::scene::mesh::LARGEST_COORDINATE;
    if position.abs().max_element() <= limit {
        return Ok(());
    }
    Err(reader.wrong("to_world", format!("the camera at {position} lies beyond {limit:e}")))
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

/// When the shutter opens and closes; without motion that says nothing.
fn shutter(reader: &Reader) -> Result<[f64; 2], SceneError> {
    let open = reader.float_or("shutter_open", ANY, 0.0)?;
    let close = reader.float_or("shutter_close", ANY, open)?;
    if close < open {
        let reason = format!("{close} lies before `shutter_open`, {open}");
        reader.fault(reader.wrong("shutter_close", reason))?;
    }
    Ok([open, close])
}

/// The horizontal field of view [radians] of `fov` and `fov_axis`, or of `focal_length` on 35 mm film.
pub(super) fn horizontal_field_of_view(reader: &Reader, aspect: f64) -> Result<f64, SceneError> {
    #[derive(Clone, Copy)]
    enum Axis {
        X,
        Y,
        Diagonal,
    }
    let (smaller, larger) = if aspect > 1.0 {
        (Axis::Y, Axis::X)
    } else {
        (Axis::X, Axis::Y)
    };
    let axes = [
        ("x", Axis::X),
        ("y", Axis::Y),
        ("diagonal", Axis::Diagonal),
        ("smaller", smaller),
        ("larger", larger),
    ];
    let axis = reader.choice("fov_axis", &axes, Axis::X)?;
    let fov = reader.float("fov", 1e-3..=179.999)?;
    let length = focal_length(reader)?;
    let (fov, axis) = match (fov, length) {
        (Some(_), Some(_)) => return Err(reader.wrong("fov", "give either `fov` or `focal_length`, not both")),
        (Some(fov), None) => (fov.to_radians(), axis),
        // The diagonal of a 36 mm by 24 mm image.
        (None, length) => (
            2.0 * libm::atan(1872.0_f64.sqrt() / (2.0 * length.unwrap_or(50.0))),
            Axis::Diagonal,
        ),
    };
    let half = libm::tan(0.5 * fov);
    let fov_x = 2.0
        * libm::atan(match axis {
            Axis::X => half,
            Axis::Y => half * aspect,
            Axis::Diagonal => half / (1.0 + 1.0 / (aspect * aspect)).sqrt(),
        });
    let degrees = fov_x.to_degrees();
    if !(1e-3..=179.999).contains(&degrees) {
        let reason = format!("the horizontal field of view is {degrees} degrees; allowed: 0.001 to 179.999");
        return Err(reader.wrong("fov", reason));
    }
    Ok(fov_x)
}

/// `focal_length` [mm]: a number, or a string such as `50mm`.
fn focal_length(reader: &Reader) -> Result<Option<f64>, SceneError> {
    let Some(Value::String(text)) = reader.property("focal_length").map(|property| &property.value) else {
        return reader.float("focal_length", 0.1..=1e6);
    };
    let number = text
        .trim()
        .strip_suffix("mm")
        .unwrap_or(text)
        .trim()
        .parse::<f64>()
        .ok();
    let number = number.filter(|length| (0.1..=1e6).contains(length));
    number.map(Some).ok_or_else(|| {
        reader.wrong(
            "focal_length",
            format!("`{text:.40}` is not a length from 0.1mm to 1000000mm"),
        )
    })
}

fn film_settings(reader: &Reader, description: &Description, limits: &Limits) -> Result<Frame, SceneError> {
    match reader.object.plugin.as_str() {
        "hdrfilm" | "ldrfilm" | "tiledhdrfilm" | "mfilm" => {}
        other @ "specfilm" => reader.warn(
            reader.place(),
            format_args!("type `{other}`: the picture has red, green and blue, and not the film's spectral channels"),
        ),
        _ => return Err(reader.unknown_type(&FILMS)),
    }
    let size = |name, default: u32| {
        Ok::<_, SceneError>(reader.integer(name, 1..=1 << 16)?.unwrap_or(i64::from(default)) as u32)
    };
    let resolution = [
        size("width", DEFAULT_RESOLUTION[0])?,
        size("height", DEFAULT_RESOLUTION[1])?,
    ];
    let (x, width) = crop_interval(reader, ["crop_offset_x", "crop_width"], resolution[0])?;
    let (y, height) = crop_interval(reader, ["crop_offset_y", "crop_height"], resolution[1])?;
    let pixels = u64::from(width) * u64::from(height);
    within(reader.place(), "number of pixels of the film", pixels, limits.pixels)?;
    // Samples belong to one pixel each, so that edges need no border; and files are written in the formats of this program.
    reader.ignore(&FILM_WITHOUT_EFFECT);
    let filter = match reader.only_child(Kind::Filter)? {
        Some(filter) => {
            let built = reconstruction_filter(&Reader::new(description, filter.target));
            description.attempt(filter.target, built)?.unwrap_or(DEFAULT_FILTER)
        }
        None => DEFAULT_FILTER,
    };
    reader.finish();
    Ok(Frame {
        whole: resolution,
        offset: [x, y],
        size: [width, height],
        filter,
    })
}

/// Where the window of a film of `whole` pixels begins along an axis, and how long it is: the properties `names`, and without them all.
fn crop_interval(reader: &Reader, names: [&str; 2], whole: u32) -> Result<(u32, u32), SceneError> {
    let last = i64::from(whole) - 1;
    let offset = reader.integer(names[0], 0..=last)?.unwrap_or(0) as u32;
    let left = whole - offset;
    let size = reader.integer(names[1], 1..=i64::from(left))?.unwrap_or(left.into());
    Ok((offset, size as u32))
}

fn reconstruction_filter(reader: &Reader) -> Result<Filter, SceneError> {
    let width = |name, default: f64| Ok::<_, SceneError>(reader.float_or(name, 0.01..=16.0, default)? as f32);
    let filter = match reader.object.plugin.as_str() {
        "box" => Filter::Box {
            radius: width("radius", 0.5)?,
        },
        "tent" => Filter::Tent {
            radius: width("radius", 1.0)?,
        },
        "gaussian" => Filter::Gaussian {
            stddev: width("stddev", 0.5)?,
        },
        other @ ("mitchell" | "catmullrom" | "lanczos") => {
            let without = "its negative lobes cannot be sampled";
            reader.warn(
                reader.place(),
                format_args!(
                    "type `{other}`: {without}; the default filter stands in for it, and the picture is a little softer"
                ),
            );
            reader.accept_rest();
            DEFAULT_FILTER
        }
        _ => return Err(reader.unknown_type(&["box", "tent", "gaussian"])),
    };
    reader.finish();
    Ok(filter)
}

/// The renderer has its own random numbers; of a sampler, whatever its type, only the count matters.
fn sample_count(reader: &Reader) -> Result<Option<u32>, SceneError> {
    let count = reader.integer("sample_count", 1..=i64::from(u32::MAX))?;
    reader.accept_rest();
    Ok(count.map(|count| count as u32))
}
