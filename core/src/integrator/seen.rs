//! Tests of what sensors see, by several integrators.

use super::{IntegratorSettings, Unobserved, render_iteration};
use crate::random::Sampling;
use crate::scene::{Limits, Scene};
use crate::settings::{BdptSettings, LightSettings, PathSettings, PppmSettings, VcmSettings};
use crate::spectrum::Spectrum;
use std::collections::BTreeMap;

fn scene(body: &str) -> Scene {
    let text = format!("<scene version='3.0.0'>{body}</scene>");
    let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap()
}

/// First radius of photons' discs: small, so that what they blur does not count [scene units].
const RADIUS: f32 = 0.02;

fn integrators(samples: u32, photons: u32) -> Vec<IntegratorSettings> {
    let sampling = Sampling::Sobol;
    vec![
        IntegratorSettings::Path(PathSettings {
            samples,
            sampling,
            max_depth: Some(4),
        }),
        IntegratorSettings::Light(LightSettings {
            samples,
            photons,
            max_depth: Some(4),
            ..LightSettings::default()
        }),
        IntegratorSettings::Bdpt(BdptSettings {
            samples,
            photons,
            max_depth: Some(4),
            ..BdptSettings::default()
        }),
        IntegratorSettings::Vcm(VcmSettings {
            samples,
            photons,
            max_depth: Some(4),
            sigma1: Some(RADIUS),
            ..VcmSettings::default()
        }),
        IntegratorSettings::Pppm(PppmSettings {
            samples,
            photons,
            max_depth: Some(4),
            sigma1: Some(RADIUS),
            ..PppmSettings::default()
        }),
    ]
}

fn render(scene: &Scene, settings: &IntegratorSettings) -> Vec<Spectrum> {
    render_iteration(scene, settings, 3, 1, &Unobserved).unwrap().pixels
}

/// A ball of radiance 5 and radius 0.5 at the height 2 over a black square [-1, 1]^2. A point of the square at the distance d from the
/// middle of the ball has the irradiance pi L (r / d)^2 cos, with the cosine of the way to the middle: the whole ball is above it.
#[test]
fn an_irradiance_meter_measures_the_closed_form() {
    let scene = scene(
        "<shape type='sphere'><point name='center' x='0.5' y='0' z='2'/><float name='radius' value='0.5'/>\
         <emitter type='area'><rgb name='radiance' value='5'/></emitter></shape>\
         <shape type='rectangle'><bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf>\
         <sensor type='irradiancemeter'><film type='hdrfilm'><integer name='width' value='3'/><integer name='height' value='1'/></film>\
         </sensor></shape>",
    );
    let expected: Vec<f64> = (0..3)
        .map(|column| {
            let mut sum = 0.0;
            for i in 0..40 {
                for j in 0..120 {
                    let x = -1.0 + 2.0 / 3.0 * (f64::from(column) + (f64::from(i) + 0.5) / 40.0);
                    let y = -1.0 + 2.0 * (f64::from(j) + 0.5) / 120.0;
                    let d2 = (x - 0.5).powi(2) + y * y + 4.0;
                    sum += std::f64::consts::PI * 5.0 * 0.25 / d2 * 2.0 / d2.sqrt();
                }
            }
            sum / 4_800.0
        })
        .collect();
    for settings in integrators(1 << 16, 1 << 18) {
        let pixels = render(&scene, &settings);
        for (pixel, expected) in pixels.iter().zip(&expected) {
            let error = f64::from(pixel[1]) / expected - 1.0;
            assert!(error.abs() < 0.02, "{settings:?}: {pixel:?}, {expected}");
        }
    }
}

/// The mean irradiance of a shape is the light that it catches over its area. Of a point light of intensity 3 it is 3 times the solid angle
/// under which its outer side is seen.
#[test]
fn a_meter_on_any_shape_measures_the_mean() {
    use std::f64::consts::PI;
    let lamp = "<emitter type='point'><rgb name='intensity' value='3'/></emitter>";
    let at = |inner: &str| format!("<transform name='to_world'>{inner}</transform>");
    let within = |distance: f64, radius: f64| 1.0 - distance / distance.hypot(radius);
    for (label, shape, placed, expected) in [
        // A ball of radius 0.5 at the distance 2 fills a cone of that sine.
        (
            "sphere",
            "<float name='radius' value='0.5'/>",
            at("<translate x='2'/>"),
            2.0 * PI * (1.0 - (1.0_f64 - 0.0625).sqrt()) / PI,
        ),
        (
            "disk",
            "",
            at("<rotate x='1' angle='180'/><translate z='2'/>"),
            2.0 * PI * within(2.0, 1.0) / PI,
        ),
        // All of the sphere about the lamp but for the two open ends of the cylinder.
        (
            "cylinder",
            "<boolean name='flip_normals' value='true'/><point name='p0' value='0 0 -1'/><point name='p1' value='0 0 1'/>",
            String::new(),
            4.0 * PI * (1.0 - within(1.0, 1.0)) / (4.0 * PI),
        ),
        // One face of a cube of side 2, which is seen from the distance 2 before its middle; the others look away or along.
        (
            "cube",
            "",
            at("<translate z='3'/>"),
            4.0 * (1.0 / (2.0 * 6.0_f64.sqrt())).atan() / 24.0,
        ),
    ] {
        let scene = scene(&format!(
            "{lamp}<shape type='{label}'>{shape}{placed}<bsdf type='diffuse'><rgb name='reflectance' value='0'/></bsdf>\
             <sensor type='irradiancemeter'/></shape>"
        ));
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        for settings in integrators(1 << 16, 1 << 18) {
            let error = f64::from(render(&scene, &settings)[0][1]) / (3.0 * expected) - 1.0;
            assert!(error.abs() < 0.02, "{label}: {settings:?}: off by {error}");
        }
    }
}

/// A lamp before the camera, a mirror and a grey wall in a bright environment, without the lights being seen: every integrator shows the
/// wall behind the lamp, the lamp in the mirror, and black in place of the environment.
#[test]
fn hidden_lights_are_seen_through_by_every_integrator() {
    let body = |hide: bool| {
        format!(
            "<integrator type='path'><boolean name='hide_emitters' value='{hide}'/></integrator>\
             <sensor type='perspective'><float name='fov' value='60'/><film type='hdrfilm'><integer name='width' value='4'/>\
             <integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
             <emitter type='constant'><rgb name='radiance' value='0.5'/></emitter>\
             <shape type='rectangle'><transform name='to_world'><rotate y='1' angle='180'/><translate x='1' z='6'/></transform>\
             <bsdf type='diffuse'/></shape>\
             <shape type='sphere'><point name='center' x='0.5' y='0' z='3'/><float name='radius' value='0.4'/>\
             <emitter type='area'><rgb name='radiance' value='4'/></emitter></shape>"
        )
    };
    let [hidden, shown] = [scene(&body(true)), scene(&body(false))];
    let mean = |pixels: &[Spectrum]| pixels.iter().map(|pixel| f64::from(pixel[1])).sum::<f64>() / pixels.len() as f64;
    let reference = render(&hidden, &integrators(1 << 14, 1)[0]);
    let seen = render(&shown, &integrators(1 << 10, 1)[0]);
    assert!(
        reference[0].is_black() && seen[0][1] > 0.4,
        "the environment: {reference:?}"
    );
    assert!(mean(&reference) < 0.5 * mean(&seen) && mean(&reference) > 0.01);
    for settings in integrators(1 << 10, 1 << 17) {
        let pixels = render(&hidden, &settings);
        for (pixel, expected) in pixels.iter().zip(&reference) {
            let (found, expected) = (pixel[1], expected[1]);
            assert!(
                (found - expected).abs() < 0.03 * expected.max(0.1),
                "{settings:?}: {found}, {expected}"
            );
        }
    }
}

/// A square of the area 1 that sends 3 W straight down onto a grey floor, of which the camera sees a part below it: the radiance there is
/// that of the irradiance 3.
/// `path` finds nothing of it.
#[test]
fn a_light_along_its_normals_is_found_by_light_paths() {
    let scene = scene(
        "<sensor type='perspective'><float name='fov' value='4'/>\
         <transform name='to_world'><lookat origin='0, 1, 3' target='0, 0, 0' up='0, 1, 0'/></transform>\
         <film type='hdrfilm'><integer name='width' value='4'/><integer name='height' value='4'/><rfilter type='box'/></film></sensor>\
         <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='90'/><scale value='0.5'/><translate y='2'/></transform>\
         <emitter type='directionalarea'><rgb name='radiance' value='3'/></emitter></shape>\
         <shape type='rectangle'><transform name='to_world'><rotate x='1' angle='-90'/><scale value='4'/></transform>\
         <bsdf type='diffuse'><rgb name='reflectance' value='0.4'/></bsdf></shape>",
    );
    let expected = 3.0 * 0.4 / std::f64::consts::PI;
    for settings in integrators(16, 1 << 18) {
        let pixels = render(&scene, &settings);
        let mean = pixels.iter().map(|pixel| f64::from(pixel[1])).sum::<f64>() / 16.0;
        if matches!(settings, IntegratorSettings::Path(_)) {
            assert_eq!(mean, 0.0);
            continue;
        }
        assert!((mean / expected - 1.0).abs() < 0.02, "{settings:?}: {mean}, {expected}");
    }
}
