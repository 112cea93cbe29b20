//! What the lights of a scene are beside its size: for warnings.

use super::{Place, Scene, SceneWarning};
use crate::geometry::{Geometry, ShapeSampler};
use crate::light::{Even, Light};
use crate::math::warp::one_minus_cos;
use crate::math::{PI, TAU};
use crate::settings::IntegratorSettings;
use crate::spectrum::Spectrum;

/// The most irradiance that a lamp plausibly gives by itself \[lx\]: ten times that of the Sun, about 1.3e5 lx.
const BRIGHTEST_PLAUSIBLE: f32 = 1.3e6;
/// The solid angle below which a lamp is small \[sr\]: a random direction finds it once in a thousand times.
const SMALL: f32 = 4.0 * PI / 1000.0;

/// What a lamp looks like from one radius of the scene away.
struct Appearance {
    /// Solid angle \[sr\]; 0 for lights without a size.
    solid_angle: f32,
    /// Irradiance of a surface that faces it, in the units of the scene's lights.
    irradiance: f32,
}

impl Appearance {
    fn of(light: &Light, geometry: &Geometry) -> Self {
        let (lower, upper) = geometry.bounds();
        let distance2 = (0.25 * (upper - lower).length_squared()).max(f32::MIN_POSITIVE);
        let seen = |solid_angle: f32, radiance: f32| Self {
            solid_angle,
            irradiance: solid_angle.min(PI) * radiance,
        };
        let point = |irradiance: f32| Self {
            solid_angle: 0.0,
            irradiance,
        };
        match light {
            Light::Area { shape, radiance, .. } => {
                let area = ShapeSampler::new(geometry, *shape).area();
                seen(area / distance2, radiance.mean().luminance())
            }
            Light::DirectionalArea { exitance, .. } => point(exitance.mean().luminance()),
            Light::Point { intensity, .. } | Light::Spot { intensity, .. } => point(intensity.luminance() / distance2),
            Light::Projector { image, scale, even, .. } => {
                let intensity = match even {
                    Even::Plane => PI * scale,
                    Even::Directions => *scale,
                };
                point(intensity * image.mean().luminance() / distance2)
            }
            Light::Directional { irradiance, .. } => point(irradiance.luminance()),
            Light::Constant { radiance } => seen(4.0 * PI, radiance.luminance()),
            Light::Environment { image, scale, .. } => {
                seen(4.0 * PI, Spectrum::average(image.texels.iter()).luminance() * scale)
            }
            Light::Goniometric { image, scale, .. } => {
                point(Spectrum::average(image.texels.iter()).luminance() * scale / distance2)
            }
            Light::Portal { portal, beyond } => {
                let solid_angle = portal.area() / distance2;
                let open = Self::of(beyond, geometry);
                Self {
                    solid_angle,
                    irradiance: open.irradiance * (solid_angle / PI).min(1.0),
                }
            }
            Light::Sun {
                half_angle, irradiance, ..
            } => Self {
                solid_angle: TAU * one_minus_cos(*half_angle),
                irradiance: irradiance.luminance(),
            },
        }
    }
}

/// Warnings about the lights, and the place of the first small one.
pub(super) fn examine(lights: &[(Light, Place)], geometry: &Geometry) -> (Vec<SceneWarning>, Option<Place>) {
    let (mut warnings, mut small) = (Vec::new(), None);
    for (light, place) in lights {
        let Appearance {
            solid_angle,
            irradiance,
        } = Appearance::of(light, geometry);
        if solid_angle < SMALL && small.is_none() {
            small = Some(place.clone());
        }
        if irradiance > BRIGHTEST_PLAUSIBLE {
            let message = format!(
                "this light alone gives surfaces of the scene an irradiance of about {irradiance:.0e}, and the Sun gives \
                 1.3e5 even counted in lux: is it, or the scene, in other units, or a power of ten too much?"
            );
            warnings.push(SceneWarning {
                place: place.clone(),
                message,
            });
        }
    }
    (warnings, small)
}

impl Scene {
    /// What these settings are not made for in this scene.
    #[must_use]
    pub fn hints(&self, settings: &IntegratorSettings) -> Vec<SceneWarning> {
        let used = |index: u32| self.materials[index as usize].is_specular();
        match &self.small_lamp {
            Some(lamp)
                if matches!(settings, IntegratorSettings::Path(_))
                    && self.bindings.iter().any(|b| used(b.material)) =>
            {
                vec![SceneWarning {
                    place: lamp.clone(),
                    message: "`path` finds the light of so small a lamp through glass and from mirrors by rare chance or never: \
                              caustics are specks, or are missing; the photons of pppm, sppm and pcf find them"
                        .into(),
                }]
            }
            _ => Vec::new(),
        }
    }
}
