//! Integrators against radiance that can be written down.
//!
//! The mean of the image over many iterations is compared with the closed form by a z-test with false-alarm rate
//! `FALSE_ALARMS`; seeds are fixed, so a test that passes once passes always.

use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings, SppmSettings,
};
use photonfarm_tests::render::{self, mean_luminance};
use photonfarm_tests::scenes::{self, View};
use photonfarm_tests::statistics::{Moments, ZTest};

/// Probability with which a comparison of equal means fails.
const FALSE_ALARMS: f64 = 1e-4;

fn load(shapes: &str, fov: f32, origin: &str, target: &str) -> Scene {
    let view = View {
        origin,
        target,
        up: "0, 1, 0",
        fov,
        resolution: [8, 8],
    };
    scenes::seen(&view, shapes).expect("the scene loads")
}

/// Holds the mean radiance of the image against `expected`, which the kernels' bias may miss by the share `bias`.
fn check(scene: &Scene, settings: &IntegratorSettings, iterations: u32, expected: f64, bias: f64) {
    let mut moments = Moments::default();
    for image in render::iterations(scene, settings, 11, iterations) {
        moments.push(&[mean_luminance(&image.expect("the iteration renders").pixels)]);
    }
    let mean = moments.mean()[0];
    let nearest = expected * (mean / expected).clamp(1.0 - bias, 1.0 + bias);
    let test = ZTest::compare(&moments, &Moments::exact(&[nearest]), FALSE_ALARMS);
    println!(
        "{}: {mean} for {expected}, noise {:.3} %",
        settings.name(),
        100.0 * test.relative_noise
    );
    assert!(test.passes(), "{settings:?}: {mean} for {expected}: {test:?}");
    assert!(test.relative_noise < 0.01, "the test has power: {test:?}");
}

fn path(max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Path(PathSettings {
        samples: 64,
        sampling: Sampling::Independent,
        max_depth,
    })
}

fn by_photons(sigma1: f32, max_depth: Option<u32>) -> PppmSettings {
    PppmSettings {
        photons: 20_000,
        samples: 4,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        max_depth,
        ..Default::default()
    }
}

fn pppm(sigma1: f32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Pppm(by_photons(sigma1, max_depth))
}

/// Its iterations go on from each other, but given the radius each has the mean that it would have alone, so that their mean is
/// compared as if they were independent (a martingale).
fn sppm(sigma1: f32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Sppm(SppmSettings(by_photons(sigma1, max_depth)))
}

fn pcf(sigma1: f32, photons: u32, max_depth: Option<u32>) -> IntegratorSettings {
    IntegratorSettings::Pcf(PcfSettings {
        photons,
        samples: 4,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        theta1: 10.0,
        lookup_vertex: LookupVertex::Fixed(1),
        max_depth,
        ..Default::default()
    })
}

/// Inside a sphere that emits `Le` and reflects the share `rho`, radiance is `Le / (1 - rho)` everywhere: here 1 / (1 - 0.5).
/// The disc of radius sigma holds the cap of a sphere of radius 1 whose area differs by a share below sigma^2.
fn check_sphere(outside: &str) {
    let sphere = r#"<shape type="sphere">
        <boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter>
    </shape>"#;
    let scene = load(&format!("{sphere}{outside}"), 60.0, "0.1, 0.2, -0.3", "0, 0, 1");
    check(&scene, &path(None), 64, 2.0, 0.0);
    check(&scene, &pppm(0.1, None), 64, 2.0, 0.01);
    check(&scene, &sppm(0.1, None), 64, 2.0, 0.01);
    check(&scene, &pcf(0.1, 20_000, None), 64, 2.0, 0.01);
}

#[test]
fn uniform_sphere() {
    check_sphere("");
}

/// A sun outside is 80 million times as strong: its light stays outside, and the lamp inside must be found all the same.
#[test]
fn uniform_sphere_with_a_sun_outside() {
    check_sphere(
        r#"<emitter type="directional">
            <vector name="direction" value="0, -1, 0"/><rgb name="irradiance" value="1e9"/>
        </emitter>"#,
    );
}

/// A room whose walls emit 0.4 and reflect 0.8 shows 2 everywhere, 1.28 of it by photons. The image shows an edge and the walls up to 0.3
/// from it. Within the radius of 0.2 the disc loses 2 / (3 pi) of its area to the edge, and the other wall adds a third by area, of whose
/// light half comes from above: an error of -4.5 % of 1.28 over two thirds of the image. Were the other wall's photons left out, it
/// would be -9 % of the image.
#[test]
fn edge_of_a_room() {
    let shapes = r#"<shape type="cube">
        <boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="0.4"/></emitter>
    </shape>"#;
    let scene = load(shapes, 20.0, "0, 0, 0", "1, -1, 0");
    check(&scene, &path(None), 64, 2.0, 0.0);
    let expected = 2.0 - 1.28 * 0.045 * 2.0 / 3.0;
    check(&scene, &pppm(0.2, None), 64, expected, 0.01);
}

/// Under the middle of a disc of radius `R` at height `h` irradiance is `pi Le R^2 / (R^2 + h^2)`, so a diffuse floor shows
/// `rho Le R^2 / (R^2 + h^2)`: here 0.6 * 3 * 0.25 / (0.25 + 1). Within 0.05 of the middle it changes by less than 1 %.
#[test]
fn floor_under_a_disc() {
    let shapes = r#"<shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf>
    </shape>
    <shape type="disk">
        <transform name="to_world">
            <scale value="0.5"/><rotate x="1" angle="90"/><translate y="1"/>
        </transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="3"/></emitter>
    </shape>"#;
    let scene = load(shapes, 0.2, "0, 0.9, 3", "0, 0, 0");
    let expected = 0.6 * 3.0 * 0.25 / 1.25;
    check(&scene, &path(Some(2)), 64, expected, 0.0);
    check(&scene, &pppm(0.05, Some(2)), 64, expected, 0.0);
    check(&scene, &sppm(0.05, Some(2)), 64, expected, 0.0);
    check(&scene, &pcf(0.05, 400_000, Some(2)), 64, expected, 0.01);
}
