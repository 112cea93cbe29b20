//! A photon or a cone counts on the side of a surface that it came from or leaves to, and not through a thin wall.

use photonfarm_core::integrator::{Iteration, Unobserved, render_iteration};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings, SppmSettings,
};
use photonfarm_tests::render::{self, mean_luminance};
use photonfarm_tests::scenes::{self, View};
use photonfarm_tests::statistics::Moments;

/// First radius [scene units]: hundreds of times the thickness of the walls.
const RADIUS: f32 = 0.3;

/// Standard errors that a mean may miss its expectation by: one in 15,000 does by chance.
const DEVIATIONS: f64 = 4.0;

fn photons() -> PppmSettings {
    PppmSettings {
        photons: 20_000,
        samples: 4,
        sampling: Sampling::Independent,
        sigma1: Some(RADIUS),
        ..Default::default()
    }
}

fn cones() -> PcfSettings {
    PcfSettings {
        photons: 20_000,
        samples: 4,
        sampling: Sampling::Independent,
        sigma1: Some(RADIUS),
        theta1: 18.0,
        lookup_vertex: LookupVertex::Fixed(1),
        ..Default::default()
    }
}

fn integrators() -> [IntegratorSettings; 5] {
    [
        IntegratorSettings::Path(PathSettings::default()),
        IntegratorSettings::Pppm(photons()),
        IntegratorSettings::Sppm(SppmSettings(photons())),
        IntegratorSettings::Pcf(cones()),
        IntegratorSettings::Pcf(PcfSettings {
            surface_test: true,
            ..cones()
        }),
    ]
}

/// A scene of `shapes` seen from `origin`, looking at the middle, in a field of view of `fov` degrees.
fn seen_from(origin: &str, fov: f32, shapes: &str) -> Scene {
    let view = View {
        origin,
        target: "0, 0, 0",
        up: "0, 1, 0",
        fov,
        resolution: [12, 12],
    };
    scenes::seen(&view, shapes).expect("the scene loads")
}

/// The first `count` iterations.
fn iterations(scene: &Scene, settings: &IntegratorSettings, count: u32) -> Vec<Iteration> {
    let iterations = render::iterations(scene, settings, 7, count);
    iterations.collect::<Result<_, _>>().expect("the iterations render")
}

/// Walls in the plane z = 0, and behind them a lamp that shines away from them, at another wall: all light comes to them from there.
/// In front there is nothing, so that their front is black.
#[test]
fn the_dark_side_of_a_thin_wall_is_black() {
    let behind = r#"<shape type="rectangle">
            <transform name="to_world"><scale value="0.3"/><rotate y="1" angle="180"/><translate z="-0.5"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
            <emitter type="area"><rgb name="radiance" value="20"/></emitter>
        </shape>
        <shape type="rectangle">
            <transform name="to_world"><scale value="2"/><translate z="-1.5"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
        </shape>"#;
    let grey = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>"#;
    for (wall, shape) in [
        (
            "sheet",
            format!(r#"<shape type="rectangle"><bsdf type="twosided">{grey}</bsdf></shape>"#),
        ),
        ("one-sided sheet", format!(r#"<shape type="rectangle">{grey}</shape>"#)),
        (
            "slab",
            format!(
                r#"<shape type="cube">
                    <transform name="to_world"><scale x="1" y="1" z="0.0005"/></transform>{grey}
                </shape>"#
            ),
        ),
    ] {
        let shapes = format!("{shape}{behind}");
        let lit = seen_from("3, 0, -1.2", 14.0, &shapes);
        for (view, origin) in [("from before it", "0, 0, 4"), ("along it", "4, 0, 0.5")] {
            let scene = seen_from(origin, 4.0, &shapes);
            for settings in integrators() {
                let label = format!("{wall} {view}, {settings:?}");
                for image in iterations(&scene, &settings, 3) {
                    let bright = image.pixels.iter().filter(|pixel| pixel.max_component() > 0.0).count();
                    assert_eq!(bright, 0, "{label}: pixels that are not black");
                    assert_eq!(image.counts.records_counted, 0, "{label}");
                    // Light from behind that were counted, though it is thrown away, would shrink the radius.
                    for statistics in image.statistics.chunks(2) {
                        assert_eq!(statistics, [RADIUS * RADIUS, 0.0], "{label}");
                    }
                }
                if wall != "one-sided sheet" && settings.name() != "path" {
                    let image = &iterations(&lit, &settings, 1)[0];
                    assert!(image.counts.records_counted > 1_000, "{label}: there is light behind");
                }
            }
        }
    }
}

/// Two rooms share a wall one thousandth thick. Walls of one emit 1 and reflect half: it shows 1 / (1 - 0.5) everywhere. Those of the other emit 0.2
/// and reflect 0.8: 0.2 / (1 - 0.8).
#[test]
fn each_side_of_a_thin_wall_has_its_own_light() {
    let room = |z: f32, reflectance: f32, radiance: f32| {
        format!(
            r#"<shape type="cube">
                <boolean name="flip_normals" value="true"/>
                <transform name="to_world"><translate z="{z}"/></transform>
                <bsdf type="diffuse"><rgb name="reflectance" value="{reflectance}"/></bsdf>
                <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter>
            </shape>"#
        )
    };
    let rooms = room(-1.0005, 0.5, 1.0) + &room(1.0005, 0.8, 0.2);
    for (origin, expected) in [("0, 0.1, -1.5", 2.0), ("0, 0.1, 1.5", 1.0)] {
        let scene = seen_from(origin, 14.0, &rooms);
        for settings in integrators() {
            let mut moments = Moments::default();
            for image in iterations(&scene, &settings, 12) {
                moments.push(&[mean_luminance(&image.pixels)]);
            }
            let (mean, error) = (moments.mean()[0], moments.squared_error()[0].sqrt());
            println!("{}: {mean:.4} +- {error:.4} for {expected}", settings.name());
            let reach = 0.01 * expected + DEVIATIONS * error;
            assert!((mean - expected).abs() < reach, "{settings:?}: {mean} for {expected}");
            assert!(reach < 0.1 * expected, "{settings:?}: the test has power: {error}");
        }
    }
}

/// A black wall stands on a floor; a lamp lights the floor behind it. Before it the floor is black, but a cone that lies behind the wall within the
/// kernel's disc is on the same floor and on the same side: no test of sides tells it from one before the wall. What creeps under
/// is the light of the part of the disc behind the wall, whose mean over the floor is about in proportion to the radius: a quarter of the
/// radius has a quarter of it. Photons come to the floor by a bounce at least, and black walls have none.
#[test]
fn what_creeps_under_a_wall_shrinks_with_the_kernel() {
    let shapes = r#"<shape type="rectangle">
            <transform name="to_world"><scale value="3"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>
        </shape>
        <shape type="cube">
            <transform name="to_world"><scale x="0.0005" y="3" z="1"/><translate z="1"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
        </shape>
        <shape type="rectangle">
            <transform name="to_world">
                <scale value="0.3"/><rotate y="1" angle="180"/><translate x="-0.8" z="1.5"/>
            </transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
            <emitter type="area"><rgb name="radiance" value="20"/></emitter>
        </shape>"#;
    let scene = seen_from("3, 0, 3", 14.0, shapes);
    let leak = |settings: &IntegratorSettings| {
        let mut moments = Moments::default();
        for seed in 1..=30 {
            let image = render_iteration(&scene, settings, seed, 1, &Unobserved).expect("the iteration renders");
            moments.push(&[mean_luminance(&image.pixels)]);
        }
        (moments.mean()[0], moments.squared_error()[0].sqrt())
    };
    assert_eq!(leak(&IntegratorSettings::Pppm(photons())).0, 0.0);
    let wide = |sigma1| {
        leak(&IntegratorSettings::Pcf(PcfSettings {
            sigma1: Some(sigma1),
            ..cones()
        }))
    };
    let ((wide, wide_error), (narrow, narrow_error)) = (wide(0.24), wide(0.06));
    let ratio = narrow / wide;
    let error = ratio * ((wide_error / wide).powi(2) + (narrow_error / narrow).powi(2)).sqrt();
    println!("{wide:.5} +- {wide_error:.5} and {narrow:.5} +- {narrow_error:.5}: ratio {ratio:.3} +- {error:.3}");
    assert!(
        (ratio - 0.25).abs() < 0.03 + DEVIATIONS * error && error < 0.01,
        "{ratio} +- {error}"
    );
}
