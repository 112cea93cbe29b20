//! Sensors: which there are, and which of them is chosen.

mod camera;
mod field_of_view;
mod film;
mod meter;
mod window;

pub(super) use field_of_view::horizontal_field_of_view;
pub(super) use meter::about;

use crate::film::{FilmSettings, Filter};
use crate::geometry::Geometry;
use crate::math::{Transform, Vec2, Vec3, tan};
use crate::motion::Motion;
use crate::scene::Limits;
use crate::scene::description::{Description, Kind, ObjectId};
use crate::scene::error::{Place, SceneError, shortened};
use crate::scene::reader::{ANY, Reader};
use crate::sensor::{Projection, Sensor};
use camera::{camera, crop};
use film::{DEFAULT_FILTER, DEFAULT_RESOLUTION, Frame, film_settings, sample_count};
use meter::{METER_FOV, irradiance_meter, radiance_meter};

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
const OTHER_SENSORS: [&str; 4] = ["distant", "hdistant", "mdistant", "fluencemeter"];

/// A camera with its film.
pub(super) struct View {
    pub(super) sensor: Sensor,
    pub(super) film: FilmSettings,
    /// The camera of the whole film, where the picture is a window of it.
    pub(super) whole: Option<Box<Sensor>>,
    /// The shape that the sensor measures the irradiance of, where that is no grid on a rectangle.
    pub(super) meter: Option<ObjectId>,
    /// The medium that the camera is in, where the scene says it.
    pub(super) medium: Option<ObjectId>,
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
        (up.y < -0.7 && up.z < 0.3) || (up.z < -0.7 && up.y < 0.3 && forward.y > -0.7)
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
        window: None,
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
        whole: None,
        meter: None,
        medium: None,
        sample_count: None,
    }
}

/// The sensors of a scene: its own, then those that measure what arrives at its shapes, each with its shape.
pub(super) fn all(description: &Description, scene: &Reader) -> Vec<(ObjectId, Option<ObjectId>)> {
    // The sensors of a `batch`, which makes one picture of several, are chosen one by one.
    let own = scene.children(Kind::Sensor).into_iter().flat_map(|child| {
        let batch = Reader::new(description, child.target);
        match batch.object.plugin.as_str() {
            "batch" => batch
                .children(Kind::Sensor)
                .iter()
                .map(|child| (child.target, None))
                .collect(),
            _ => vec![(child.target, None)],
        }
    });
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
    let mut plugin = reader.object.plugin.as_str();
    if OTHER_SENSORS.contains(&plugin) {
        return Err(reader.unsupported(format!("type `{plugin}`"), format!("there are: {}", SENSORS.join(", "))));
    }
    if !SENSORS.contains(&plugin) {
        plugin = other_camera(&reader)?;
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
            let reason = "an irradiance meter measures what arrives at a shape: put it inside a <shape>";
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        (_, Some(_)) => {
            let reason = "of all sensors an `irradiancemeter` alone lies on a shape";
            return Err(SceneError::value(reader.place(), reader.context(), reason));
        }
        ("radiancemeter", None) => radiance_meter(&reader, &film)?,
        _ => camera(&reader, plugin, film.whole)?,
    };
    let medium = reader.only_child(Kind::Medium)?.map(|child| child.target);
    reader.finish();
    let (sensor, whole) = match film.is_whole() {
        true => (sensor, None),
        false => (crop(&reader, &film, &sensor, &mut motion)?, Some(Box::new(sensor))),
    };
    let is_grid = |shape: &ObjectId| description.objects[*shape].plugin == "rectangle";
    let view = View {
        sensor,
        whole,
        meter: shape.filter(|shape| !is_grid(shape)),
        medium,
        film: FilmSettings {
            resolution: film.size,
            // A meter's pixels are places of their own.
            filter: if is_meter {
                Filter::Box { radius: 0.5 }
            } else {
                film.filter
            },
            window: None,
        },
        sample_count,
    };
    Ok((view, motion))
}

/// What stands in for a camera of another build of Mitsuba.
fn other_camera(reader: &Reader) -> Result<&'static str, SceneError> {
    let name = reader.object.plugin.to_ascii_lowercase();
    let stand_in = match name.contains("ortho") {
        true => "orthographic",
        false => "perspective",
    };
    // Only a letter may be wrong: a longer name is that of another camera.
    let of_length: Vec<&str> = SENSORS
        .into_iter()
        .filter(|known| known.len().abs_diff(name.len()) <= 1)
        .collect();
    reader.other_type(&of_length, &format!("it is rendered as `{stand_in}`"))?;
    Ok(stand_in)
}

fn check_position(reader: &Reader, position: Vec3) -> Result<(), SceneError> {
    let limit = crate::scene::mesh::LARGEST_COORDINATE;
    if position.abs().max_element() <= limit {
        return Ok(());
    }
    Err(reader.wrong("to_world", format!("the camera at {position} lies beyond {limit:e}")))
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
