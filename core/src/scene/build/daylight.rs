//! The sky and the sun: `sky`, `sun`, `sunsky` and `timed_sunsky`.

use super::Builder;
use super::texture::colour;
use crate::light::daylight::{Moment, SUN_APERTURE, Sky, sun_direction, sun_irradiance, sun_spectrum};
use crate::light::{Light, Mapping};
use crate::math::{DVec3, Transform};
use crate::scene::description::SpectrumValue;
use crate::scene::error::SceneError;
use crate::scene::reader::{ANY, Colour, NOT_NEGATIVE, POSITIVE, Reader};
use crate::scene::spectrum::{BRIGHTEST, Use, to_rgb};
use crate::spectrum::Spectrum;
use crate::texture::{Bitmap, TextureFilter, WrapMode};
use glam::DMat4;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

/// Size of the image that the sky becomes. A row of nodes lies on the horizon.
const SKY_SIZE: [usize; 2] = [1024, 513];

/// The properties that say when and where it is.
const WHEN_AND_WHERE: [&str; 9] = [
    "latitude",
    "longitude",
    "timezone",
    "year",
    "month",
    "day",
    "hour",
    "minute",
    "second",
];

/// What Mitsuba's two ages mean differently.
#[derive(Clone, Copy, PartialEq)]
enum Age {
    /// 0.x: up is +y, north -z and east +x; the sun is that of Preetham et al.
    Old,
    /// 3.x: up is +z, south +x and west +y; the sun is that of Hosek and Wilkie.
    New,
}

/// The sky and the sun of an emitter, in a frame whose +z is up.
struct Daylight {
    /// From that frame to the world.
    to_world: Transform,
    /// Unit direction to the sun.
    sun: DVec3,
    turbidity: f64,
    age: Age,
}

impl Builder<'_, '_> {
    /// Adds the lights of a clear day.
    pub(super) fn daylight(&mut self, reader: &Reader) -> Result<(), SceneError> {
        let plugin = reader.object.plugin.as_str();
        let old = matches!(plugin, "sky" | "sun") || reader.object.old_dialect;
        let age = if old { Age::Old } else { Age::New };
        let to_world = match super::light::rotations(reader, "the sky can be rotated and mirrored only")? {
            moving if moving.moves_within(self.motion.shutter) => {
                reader.warn_of(
                    "to_world",
                    "the sky does not move: it stands as in the middle of the interval",
                );
                moving.at(self.motion.at_rest())
            }
            still => still.at(self.motion.at_rest()),
        };
        let upright = Transform::from_matrix(match age {
            Age::Old => DMat4::from_cols_array_2d(&[
                [0.0, 0.0, 1.0, 0.0],
                [-1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ]),
            Age::New => DMat4::IDENTITY,
        });
        let to_world = to_world.after(&upright.unwrap_or_default());
        let day = Daylight {
            sun: sun_of(reader, plugin, &to_world)?,
            to_world,
            turbidity: reader.float_or("turbidity", 1.0..=10.0, 3.0)?,
            age,
        };
        let scale = reader.float_or("scale", NOT_NEGATIVE, 1.0)?;
        let (mut sky_scale, mut sun_scale) = (
            reader.float_or("sky_scale", NOT_NEGATIVE, scale)?,
            reader.float_or("sun_scale", NOT_NEGATIVE, scale)?,
        );
        let sky = self.sky_settings(reader, age)?;
        let aperture = sun_aperture(reader)?;
        reader.ignore(&["resolution", "complex_sun"]);
        super::light::check_sampling_weight(reader)?;
        reader.finish();
        if plugin == "sun" {
            sky_scale = 0.0;
        } else if plugin == "sky" {
            sun_scale = 0.0;
        }
        if day.sun.z < 0.0 {
            reader.warn(
                reader.place(),
                "the sun is below the horizon at this time and place: this light gives nothing",
            );
            (sky_scale, sun_scale) = (0.0, 0.0);
        }
        let before = self.lights.len();
        if sky_scale > 0.0 {
            let light = day.sky(reader, &sky, sky_scale)?;
            self.add_light(light, None, &[reader.id], reader.place());
        }
        if sun_scale > 0.0 {
            let light = day.sun_light(reader, aperture, sky.stretch, sun_scale)?;
            self.add_light(light, None, &[reader.id], reader.place());
        }
        if self.lights.len() == before {
            let radiance = Spectrum::ZERO;
            self.add_light(Light::Constant { radiance }, None, &[reader.id], reader.place());
        }
        Ok(())
    }

    fn sky_settings(&mut self, reader: &Reader, age: Age) -> Result<SkySettings, SceneError> {
        let default = match age {
            Age::Old => 0.2,
            Age::New => 0.3,
        };
        let albedo = colour(reader, "albedo", Use::Reflectance)?.unwrap_or(Spectrum::splat(default));
        Ok(SkySettings {
            albedo: albedo.to_rgb().map(f64::from),
            stretch: reader.float_or("stretch", 1.0..=2.0, 1.0)?,
            extend: reader.boolean("extend", false)?,
        })
    }
}

/// What the sky is like beside the place of the sun.
struct SkySettings {
    /// Albedo of the ground.
    albedo: [f64; 3],
    /// By what angles from the zenith are stretched, in [1, 2], so that the horizon lies lower (Mitsuba 0.x).
    stretch: f64,
    /// Whether the horizon's light goes on below it, fading to the nadir (Mitsuba 0.x).
    extend: bool,
}

/// The sun's direction in the frame of the sky: as given in the world, or by time and place.
fn sun_of(reader: &Reader, plugin: &str, to_world: &Transform) -> Result<DVec3, SceneError> {
    let given = reader.vector("sun_direction")?;
    let moment = if plugin == "timed_sunsky" {
        middle_of_window(reader)?
    } else {
        moment(reader)?
    };
    let Some(given) = given else {
        return Ok(sun_direction(&moment));
    };
    if let Some(name) = WHEN_AND_WHERE.iter().find(|name| reader.has(name)) {
        reader.warn_of(name, "it is left out: `sun_direction` is given as well, and counts");
    }
    let local = to_world.inverted().matrix().transform_vector3(given);
    local
        .try_normalize()
        .ok_or_else(|| reader.wrong("sun_direction", "it has no length"))
}

fn moment(reader: &Reader) -> Result<Moment, SceneError> {
    let date = |name, range, default| Ok::<_, SceneError>(reader.integer(name, range)?.unwrap_or(default));
    Ok(Moment {
        date: [
            date("year", 1..=9999, 2010)?,
            date("month", 1..=12, 7)?,
            date("day", 1..=31, 10)?,
        ],
        time: [
            reader.float_or("hour", ANY, 15.0)?,
            reader.float_or("minute", ANY, 0.0)?,
            reader.float_or("second", ANY, 0.0)?,
        ],
        ..place(reader)?
    })
}

/// Where it is, at noon of a day that does not matter.
fn place(reader: &Reader) -> Result<Moment, SceneError> {
    Ok(Moment {
        latitude: reader.float_or("latitude", -90.0..=90.0, 35.6894)?,
        longitude: reader.float_or("longitude", -360.0..=360.0, 139.6917)?,
        timezone: reader.float_or("timezone", -24.0..=24.0, 9.0)?,
        date: [2010, 7, 10],
        time: [12.0, 0.0, 0.0],
    })
}

/// The middle of the window of time of `timed_sunsky`, on its first day.
fn middle_of_window(reader: &Reader) -> Result<Moment, SceneError> {
    let date = |name, range, default| Ok::<_, SceneError>(reader.integer(name, range)?.unwrap_or(default));
    let (start, end) = (
        reader.float_or("window_start_time", 0.0..=24.0, 7.0)?,
        reader.float_or("window_end_time", 0.0..=24.0, 19.0)?,
    );
    let first_day = [
        date("start_year", 1..=9999, 2025)?,
        date("start_month", 1..=12, 1)?,
        date("start_day", 1..=31, 1)?,
    ];
    reader.accept(&[
        "end_year",
        "end_month",
        "end_day",
        "shutter_open",
        "shutter_close",
        "nb_samples",
    ]);
    reader.warn(
        reader.place(),
        "the sun does not move: it stands as in the middle of the window of time, on the first day",
    );
    Ok(Moment {
        date: first_day,
        time: [0.5 * (start + end), 0.0, 0.0],
        ..place(reader)?
    })
}

/// The angle that the sun is seen under \[degrees\], by `sun_aperture` of Mitsuba 3 or `sun_radius_scale` of 0.x; 0 is a point.
fn sun_aperture(reader: &Reader) -> Result<f64, SceneError> {
    let scale = reader.float_or("sun_radius_scale", 0.0..=100.0, 1.0)?;
    reader.float_or(
        "sun_aperture",
        POSITIVE.start().to_owned()..=179.0,
        SUN_APERTURE * scale,
    )
}

impl Daylight {
    /// The sky as an image at infinity.
    fn sky(&self, reader: &Reader, settings: &SkySettings, scale: f64) -> Result<Light, SceneError> {
        let [width, height] = SKY_SIZE;
        let sky = Sky::new(self.sun, self.turbidity, settings.albedo);
        let horizon = FRAC_PI_2 * settings.stretch;
        let mut texels = Vec::with_capacity(width * height);
        for row in 0..height {
            let theta = PI * row as f64 / (height - 1) as f64;
            let share = share_of_row(theta, horizon, PI / (height - 1) as f64);
            let fading = if settings.extend {
                smooth_step(2.0 * (1.0 - theta / PI))
            } else {
                share
            };
            // Below the horizon counts, where anything does, what is seen at it.
            let (sin_theta, cos_theta) = libm::sincos((theta / settings.stretch).min(FRAC_PI_2));
            for column in 0..width {
                if fading == 0.0 {
                    texels.push(Spectrum::ZERO);
                    continue;
                }
                let (sin_phi, cos_phi) = libm::sincos(TAU * (column as f64 + 0.5) / width as f64);
                let towards = DVec3::new(sin_theta * sin_phi, sin_theta * cos_phi, cos_theta.max(0.0));
                let radiance = sky.radiance(towards).map(|channel| (channel * fading) as f32);
                texels.push(Spectrum::from_rgb(radiance));
            }
        }
        let image = Bitmap {
            width,
            height,
            texels: texels.into(),
            wrap: WrapMode::Repeat,
            filter: TextureFilter::Bilinear,
        };
        if f64::from(image.texels.brightest()) * scale > BRIGHTEST {
            return Err(reader.wrong("sky_scale", format!("the sky is brighter than {BRIGHTEST:e}")));
        }
        Ok(Light::Environment {
            image: Arc::new(image),
            mapping: Mapping::LatitudeLongitude,
            scale: scale as f32,
            to_world: self.to_world.after(&super::light::upright_image()),
        })
    }

    /// The sun as a disc at infinity, or as a point there.
    fn sun_light(&self, reader: &Reader, aperture: f64, stretch: f64, scale: f64) -> Result<Light, SceneError> {
        let elevation = FRAC_PI_2 - libm::acos(self.sun.z.clamp(-1.0, 1.0));
        let irradiance = match self.age {
            Age::New => Spectrum::from_rgb(sun_irradiance(elevation, self.turbidity).map(|channel| channel as f32)),
            Age::Old => {
                let spectrum = SpectrumValue::Sampled(sun_spectrum(elevation, self.turbidity));
                let radiance = to_rgb(&Colour::Spectrum(spectrum), Use::Emission)
                    .map_err(|reason| reader.wrong("turbidity", reason))?;
                let one_minus_cos = 2.0 * libm::pow(libm::sin(0.25 * SUN_APERTURE.to_radians()), 2.0);
                radiance * (TAU * one_minus_cos) as f32
            }
        };
        let irradiance = irradiance * scale as f32;
        let towards = self.to_world.matrix().transform_vector3(stretched(self.sun, stretch));
        let towards = towards.normalize().as_vec3();
        let half_angle = 0.5 * aperture.to_radians();
        let radiance = f64::from(irradiance.max_component()) / (PI * half_angle * half_angle).min(1.0);
        if half_angle > 0.0 && radiance > BRIGHTEST || !irradiance.is_valid() {
            return Err(reader.wrong("sun_scale", format!("the sun is brighter than {BRIGHTEST:e}")));
        }
        Ok(if half_angle > 0.0 {
            Light::Sun {
                towards,
                half_angle: half_angle as f32,
                irradiance,
            }
        } else {
            Light::Directional {
                direction: -towards,
                irradiance,
            }
        })
    }
}

/// How much of the band of half a row about the angle `theta` from the zenith lies above the horizon.
fn share_of_row(theta: f64, horizon: f64, row: f64) -> f64 {
    (0.5 + (horizon - theta) / row).clamp(0.0, 1.0)
}

/// The polynomial of degree 3 that goes from 0 at 0 to 1 at 1 and is level there.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// A direction whose angle from +z is `factor` times that of `direction`.
fn stretched(direction: DVec3, factor: f64) -> DVec3 {
    let sine = direction.truncate().length();
    let theta = factor * libm::atan2(sine, direction.z);
    let (sin_theta, cos_theta) = libm::sincos(theta);
    let across = direction.truncate().normalize_or(glam::DVec2::X) * sin_theta;
    across.extend(cos_theta)
}
