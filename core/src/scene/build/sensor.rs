//! Sensor, film, reconstruction filter and sampler.

use super::uniform_scale;
use crate::film::{FilmSettings, Filter};
use crate::geometry::Geometry;
use crate::math::{AnimatedTransform, Transform, Vec2, Vec3, tan};
use crate::motion::Motion;
use crate::scene::Limits;
use crate::scene::description::{Description, Kind, ObjectId, Value};
use crate::scene::error::{Place, SceneError, shortened, within};
use crate::scene::reader::{ANY, NOT_NEGATIVE, POSITIVE, Reader};
use crate::sensor::{Lens, Projection, Sensor};

const SENSORS: [&str; 3] = ["perspective", "thinlens", "orthographic"];
/// Sensors of Mitsuba that do not exist here.
const OTHER_SENSORS: [&str; 6] = [
    "radiancemeter",
    "irradiancemeter",
    "distant",
    "batch",
    "telecentric",
    "spherical",
];
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

/// Builds a sensor, and begins the motion by its own and the time that its shutter is open.
pub(super) fn build(
    description: &Description,
    object: ObjectId,
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
    let film = film.unwrap_or(FilmSettings {
        resolution: DEFAULT_RESOLUTION,
        filter: DEFAULT_FILTER,
    });
    let sample_count = match reader.only_child(Kind::Sampler)? {
        Some(sampler) => {
            let count = sample_count(&Reader::new(description, sampler.target));
            description.attempt(sampler.target, count)?.flatten()
        }
        None => None,
    };
    let (sensor, motion) = camera(&reader, film.resolution)?;
    reader.finish();
    let view = View {
        sensor,
        film,
        sample_count,
    };
    Ok((view, motion))
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
    let mut motion = Motion {
        shutter: shutter(reader)?,
        ..Motion::default()
    };
    let projection = if reader.object.plugin == "orthographic" {
        Projection::Orthographic
    } else {
        perspective(reader, &to_world, resolution, focus_distance)?
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
) -> Result<Projection, SceneError> {
    let scaled = |keyframe| uniform_scale(keyframe).is_none_or(|scale| (scale - 1.0).abs() > 1e-3);
    if to_world.keyframes().any(scaled) {
        let reason = "this camera can be moved, rotated and mirrored, but not scaled or sheared";
        reader.fault(reader.wrong("to_world", reason))?;
    }
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
    let fov_x = horizontal_field_of_view(reader, f64::from(resolution[0]) / f64::from(resolution[1]))? as f32;
    Ok(Projection::Perspective {
        fov_x,
        principal_point,
        lens,
    })
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

fn film_settings(reader: &Reader, description: &Description, limits: &Limits) -> Result<FilmSettings, SceneError> {
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
    let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
    within(reader.place(), "number of pixels of the film", pixels, limits.pixels)?;
    for (name, whole) in [
        ("crop_offset_x", 0),
        ("crop_offset_y", 0),
        ("crop_width", resolution[0]),
        ("crop_height", resolution[1]),
    ] {
        if reader
            .integer(name, 0..=i64::MAX)?
            .is_some_and(|value| value != i64::from(whole))
        {
            let reason = format!("crops are not supported; leave it out or set it to {whole}");
            reader.fault(reader.wrong(name, reason))?;
        }
    }
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
    Ok(FilmSettings { resolution, filter })
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
