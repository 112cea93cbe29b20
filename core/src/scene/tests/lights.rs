//! Lights of scenes: the sky and the sun, several environments, profiles of lamps.

use super::{BALL, LIGHT, load, warnings};
use crate::chi_square::integrate_sphere;
use crate::light::daylight::{Sky, sun_irradiance};
use crate::math::{DVec2, DVec3, PI, TAU, Vec3};
use crate::scene::{Limits, Scene};
use std::collections::BTreeMap;

const SENSOR: &str = "<sensor type='perspective'/>";

fn scene(light: &str) -> Scene {
    load(&format!("{light}{SENSOR}{BALL}"), None).unwrap_or_else(|faults| panic!("{light}\n{faults}"))
}

/// A scene for Mitsuba 0.6.
fn old(light: &str) -> Scene {
    let text = format!("<scene version='0.6.0'>{light}{SENSOR}{BALL}</scene>");
    let files = BTreeMap::from([("main.xml".to_owned(), text.into_bytes())]);
    Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap()
}

/// The image of the sky is the model's, and the light that falls on the ground is the model's within 0.3 %; the horizon of the image is
/// a ramp of 0.35 degrees.
#[test]
fn a_sky_is_that_of_hosek_and_wilkie() {
    let sun = DVec3::new(0.6, 0.0, 0.8);
    let scene = scene(
        "<emitter type='sunsky'><vector name='sun_direction' x='0.6' y='0' z='0.8'/><float name='sun_scale' value='0'/>\
         <float name='turbidity' value='4'/><float name='sky_scale' value='2'/><rgb name='albedo' value='0.1 0.2 0.3'/></emitter>",
    );
    assert_eq!(warnings(&scene), Vec::<String>::new());
    let sky = Sky::new(sun, 4.0, [0.1, 0.2, 0.3]);
    for towards in [
        Vec3::Z,
        Vec3::new(0.6, 0.0, 0.8),
        Vec3::new(0.6, 0.64, 0.48),
        Vec3::new(-0.96, 0.0, 0.28),
        Vec3::new(0.0, -0.995, 0.099_874_92),
    ] {
        let (found, expected) = (
            scene.lights.background(towards).to_rgb(),
            sky.radiance(towards.as_dvec3()),
        );
        for (found, expected) in found.into_iter().zip(expected) {
            assert!(
                (f64::from(found) / (2.0 * expected) - 1.0).abs() < 5e-3,
                "{towards}: {found}, {expected}"
            );
        }
    }
    assert!(
        scene
            .lights
            .background(Vec3::new(0.6, 0.79, -0.02).normalize())
            .is_black()
    );
    let cosine = |direction: Vec3| f64::from(direction.z.max(0.0));
    let found = integrate_sphere(|direction| f64::from(scene.lights.background(direction)[1]) * cosine(direction));
    let above = |direction: Vec3| direction.z > 0.0;
    let expected = integrate_sphere(|direction| match above(direction) {
        true => 2.0 * sky.radiance(direction.as_dvec3())[1] * cosine(direction),
        false => 0.0,
    });
    assert!((found / expected - 1.0).abs() < 3e-3, "{found}, {expected}");
}

/// Irradiance by the part of the background that is brighter than any sky.
fn sun_of(scene: &Scene) -> Option<(Vec3, f64)> {
    let mut seen = None;
    for step in 0..4_000 {
        let choice = (f64::from(step) + 0.5) / 4_000.0;
        let u = DVec2::new((f64::from(step) * 0.618_034) % 1.0, (f64::from(step) * 0.754_878) % 1.0);
        let light = scene.lights.sample_direct(&scene.geometry, Vec3::ZERO, choice, u);
        seen = seen.or(light.filter(|light| light.radiance[0] > 100.0).map(|light| light.wi));
    }
    let towards: Vec3 = seen?;
    Some((towards, f64::from(scene.lights.background(towards)[1])))
}

/// The sun stands where it is put or where the time has it, with the irradiance of its model over the solid angle of its disc; scenes of old
/// have +y up and the north along -z.
#[test]
fn a_sun_stands_where_it_belongs() {
    let at = "<vector name='sun_direction' x='0.6' y='0.64' z='0.48'/>";
    let (towards, radiance) = sun_of(&scene(&format!("<emitter type='sunsky'>{at}</emitter>"))).unwrap();
    assert!(towards.angle_between(Vec3::new(0.6, 0.64, 0.48)) < 0.004_7);
    let solid_angle = 2.0 * std::f64::consts::PI * (1.0 - libm::cos(0.2679_f64.to_radians()));
    let expected = sun_irradiance(libm::asin(0.48), 3.0)[1] / solid_angle;
    assert!((radiance / expected - 1.0).abs() < 1e-2, "{radiance}, {expected}");

    let tokyo = "<emitter type='sunsky'/>";
    let (new, _) = sun_of(&scene(tokyo)).unwrap();
    assert!(
        new.angle_between(Vec3::new(0.051_37, 0.691_73, 0.720_32)) < 0.005,
        "{new}"
    );
    let (before, _) = sun_of(&old(tokyo)).unwrap();
    assert!(
        before.angle_between(Vec3::new(-0.691_73, 0.720_32, 0.051_37)) < 0.005,
        "{before}"
    );
    let turned = "<emitter type='sunsky'><transform name='toWorld'><rotate x='1' angle='90'/></transform></emitter>";
    let (turned, _) = sun_of(&old(turned)).unwrap();
    assert!(
        turned.angle_between(Vec3::new(-0.691_73, -0.051_37, 0.720_32)) < 0.005,
        "{turned}"
    );
}

/// Measured in a map of 512 x 256 texels that Mitsuba 0.6 made of this emitter: radiances of the sky by column and row, and the
/// irradiance of the sun, whose texels hold 0.1 % of sky.
#[test]
fn a_sky_and_a_sun_of_old_are_those_of_mitsuba_0_6() {
    let morning =
        old("<emitter type='sunsky'><float name='hour' value='9'/><float name='turbidity' value='5'/></emitter>");
    for ([column, row], expected) in [
        ([0.0, 7.0], [0.045_410_76, 0.062_740_97, 0.102_871_54]),
        ([128.0, 85.0], [0.237_244_93, 0.268_422_16, 0.303_066_52]),
        ([256.0, 85.0], [0.055_854_91, 0.085_332_74, 0.144_458_89]),
        ([384.0, 42.0], [0.028_307_23, 0.048_341_95, 0.090_715_7]),
    ] {
        let (phi, theta): (f32, f32) = (TAU * (column + 0.5) / 512.0, PI * (row + 0.5) / 256.0);
        let ((sin_phi, cos_phi), (sin_theta, cos_theta)) = (libm::sincosf(phi), libm::sincosf(theta));
        let towards = Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi);
        let found = morning.lights.background(towards).to_rgb();
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 5e-3, "{towards}: {found}, {expected}");
        }
    }
    let (towards, _) = sun_of(&morning).unwrap();
    let solid_angle = 2.0 * std::f64::consts::PI * (1.0 - libm::cos(0.2679_f64.to_radians()));
    let radiance = morning.lights.background(towards).to_rgb();
    for (radiance, expected) in radiance.into_iter().zip([1.104_077, 0.871_232, 0.667_209]) {
        let found = f64::from(radiance) * solid_angle;
        assert!((found / expected - 1.0).abs() < 5e-3, "{found}, {expected}");
    }
    let at = "<vector name='sunDirection' x='0.48' y='0.8' z='0.36'/>";
    let [disc, point] = ["", "<float name='sunRadiusScale' value='0'/>"]
        .map(|radius| old(&format!("<emitter type='sun'>{at}{radius}</emitter>")));
    let irradiance = sun_of(&disc).unwrap().1 * solid_angle;
    let light = point
        .lights
        .sample_direct(&point.geometry, Vec3::ZERO, 0.5, DVec2::splat(0.5))
        .unwrap();
    assert!(light.delta && (f64::from(light.radiance[1]) / irradiance - 1.0).abs() < 1e-3);
}

#[test]
fn what_a_sky_does_not_do_is_said() {
    let night = scene("<emitter type='sunsky'><vector name='sun_direction' x='0.6' y='0' z='-0.8'/></emitter>");
    assert!(warnings(&night)[0].contains("below the horizon"));
    assert!(night.lights.background(Vec3::Z).is_black());
    let both = scene(
        "<emitter type='sunsky'><vector name='sun_direction' x='0.6' y='0' z='0.8'/><float name='hour' value='9'/></emitter>",
    );
    assert!(warnings(&both)[0].contains("`hour`: it is left out: `sun_direction`"));
    let timed = scene("<emitter type='timed_sunsky'/>");
    assert!(warnings(&timed)[0].contains("middle of the window of time"));
    for (wrong, expected) in [
        ("<float name='turbidity' value='11'/>", "allowed: 1 to 10"),
        ("<vector name='sun_direction' x='0' y='0' z='0'/>", "it has no length"),
        ("<rgb name='albedo' value='2'/>", "above 1"),
        ("<float name='sun_scale' value='1e30'/>", "the sun is brighter"),
        ("<float name='sky_scale' value='1e30'/>", "the sky is brighter"),
    ] {
        let faults = load(&format!("<emitter type='sunsky'>{wrong}</emitter>{SENSOR}{BALL}"), None).unwrap_err();
        assert!(faults.to_string().contains(expected), "{wrong}: {faults}");
    }
}

#[test]
fn environments_add_up() {
    let sky = "<emitter type='sunsky'><float name='sun_scale' value='0'/></emitter>";
    let [alone, both] = [sky.to_owned(), format!("{sky}{LIGHT}{LIGHT}")].map(|lights| scene(&lights));
    assert_eq!(warnings(&both), Vec::<String>::new());
    for direction in [Vec3::Z, -Vec3::Z, Vec3::new(0.6, 0.0, 0.8)] {
        let [alone, both] = [&alone, &both].map(|scene| scene.lights.background(direction)[2]);
        assert!((both - alone - 2.0).abs() < 1e-6, "{direction}: {alone}, {both}");
    }
}

/// A profile shines along the axis of its light, in candela times its scale.
#[test]
fn a_profile_of_a_lamp_is_read() {
    let profile = "TILT=NONE\n1 1000 1 3 1 1 2 0 0 0 1 1 20\n0 45 90\n0\n100 50 0\n";
    let text = format!(
        "<scene version='3.0.0'>{SENSOR}{BALL}<emitter type='goniometric'><string name='filename' value='lamp.ies'/>\
         <float name='scale' value='2'/><transform name='to_world'><lookat origin='1 2 10' target='1 2 3' up='0 1 0'/></transform></emitter></scene>"
    );
    let files = BTreeMap::from([
        ("main.xml".to_owned(), text.into_bytes()),
        ("lamp.ies".to_owned(), profile.as_bytes().to_vec()),
    ]);
    let scene = Scene::load(&files, "main.xml", &BTreeMap::new(), &Limits::default()).unwrap();
    assert_eq!(warnings(&scene), Vec::<String>::new());
    let light = |at: Vec3| scene.lights.sample_direct(&scene.geometry, at, 0.5, DVec2::splat(0.5));
    let below = light(Vec3::new(1.0, 2.0, 8.0)).unwrap().radiance[0];
    assert!((below - 200.0 / 4.0).abs() < 1e-2, "{below}");
    let aside = light(Vec3::new(3.0, 2.0, 8.0)).unwrap().radiance[0];
    assert!((aside - 100.0 / 8.0).abs() < 1e-2, "{aside}");
    assert!(light(Vec3::new(1.0, 2.0, 12.0)).is_none());
}

#[test]
fn a_beam_is_a_narrow_spot() {
    let scene = scene(
        "<emitter type='collimated'><rgb name='power' value='3'/>\
         <transform name='to_world'><lookat origin='0 0 0' target='1 2 3' up='0 1 0'/></transform></emitter>",
    );
    assert!(warnings(&scene)[0].contains("it opens by 0.1 degrees"));
    let u = DVec2::splat(0.4);
    let start = scene.lights.sample_emission(&scene.geometry, 0.5, u, u).unwrap();
    assert!((start.flux[0] - 3.0).abs() < 1e-3, "{start:?}");
    assert!(start.ray.direction.angle_between(Vec3::new(1.0, 2.0, 3.0)) < 1e-3);
}
