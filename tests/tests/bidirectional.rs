//! Light tracing, bidirectional path tracing and vertex connection and merging against `path`, path length by path length.
//!
//! The image with `max_depth` n less the image with n - 1, of the same seed, holds the paths of n edges and nothing else.
//! Means over the image are compared by t-tests with independent numbers, and over independent scrambles of Sobol' points. Each
//! comparison of equal estimators fails by chance with probability `FALSE_ALARMS`; seeds are fixed, so a test that passes once
//! passes always. Each check also proves that it would notice an estimate that is off by a share that it states.

use photonfarm_core::integrator::{Unobserved, render_iteration};
use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    BdptSettings, IntegratorSettings, LightSettings, PathSettings, Technique, VcmSettings,
};
use photonfarm_tests::render::luminance_by_length;
use photonfarm_tests::scenes;
use photonfarm_tests::statistics::{Moments, ZTest, student_quantile};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Probability with which a comparison of equal estimators fails.
const FALSE_ALARMS: f64 = 1e-5;

/// Path lengths that are compared are up to this number of edges.
const LONGEST: u32 = 4;

/// Observations of an estimate: iterations, or seeds.
const OBSERVATIONS: u32 = 32;

const PINHOLE: &str = r#"<sensor type="perspective"><float name="fov" value="50"/>VIEW</sensor>"#;
const THIN_LENS: &str = r#"<sensor type="thinlens"><float name="fov" value="50"/>
    <float name="aperture_radius" value="0.3"/><float name="focus_distance" value="3.5"/>VIEW</sensor>"#;
const ORTHOGRAPHIC: &str = r#"<sensor type="orthographic">VIEW</sensor>"#;

/// A delta light has caustics that `path` does not find.
const LIGHTS: [(&str, bool, &str); 7] = [
    (
        "area",
        false,
        r#"<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/>
            <translate x="0.2" y="1.9" z="0.3"/></transform><emitter type="area"><rgb name="radiance" value="9, 8, 6"/></emitter></shape>"#,
    ),
    (
        "sphere",
        false,
        r#"<shape type="sphere"><point name="center" x="-0.4" y="1.5" z="0.4"/><float name="radius" value="0.2"/>
            <emitter type="area"><rgb name="radiance" value="12, 9, 8"/></emitter></shape>"#,
    ),
    (
        "point",
        true,
        r#"<emitter type="point"><point name="position" x="0.3" y="1.6" z="0.5"/><rgb name="intensity" value="3, 3, 2"/></emitter>"#,
    ),
    (
        "spot",
        true,
        r#"<emitter type="spot"><float name="cutoff_angle" value="40"/><rgb name="intensity" value="9, 9, 7"/>
            <transform name="to_world"><lookat origin="0.5, 2, 1" target="0, 0.3, 0" up="0, 0, 1"/></transform></emitter>"#,
    ),
    (
        "projector",
        true,
        r#"<emitter type="projector"><float name="fov" value="60"/><float name="scale" value="2"/>
            <texture type="checkerboard" name="irradiance"><rgb name="color0" value="1, 0.8, 0.3"/><rgb name="color1" value="0.2, 0.3, 1"/></texture>
            <transform name="to_world"><lookat origin="0.5, 2, 1" target="0, 0.3, 0" up="0, 0, 1"/></transform></emitter>"#,
    ),
    (
        "directional",
        true,
        r#"<emitter type="directional"><vector name="direction" x="-0.4" y="-1" z="-0.6"/><rgb name="irradiance" value="2, 2, 2"/></emitter>"#,
    ),
    (
        "constant",
        false,
        r#"<emitter type="constant"><rgb name="radiance" value="0.5, 0.6, 0.9"/></emitter>"#,
    ),
];

const GLASS: &str = r#"<shape type="sphere"><point name="center" x="0.5" y="0.4" z="0.4"/><float name="radius" value="0.4"/>
    <bsdf type="dielectric"/></shape>"#;

/// A ball of 10 x 5 quadrangles with interpolated normals.
fn coarse_ball() -> String {
    let mut text = String::new();
    let (around, down) = (10, 5);
    for row in 0..=down {
        for column in 0..around {
            let theta = std::f64::consts::PI * f64::from(row) / f64::from(down);
            let phi = std::f64::consts::TAU * f64::from(column) / f64::from(around);
            let (x, y, z) = (theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
            writeln!(text, "v {x} {y} {z}\nvn {x} {y} {z}").expect("memory takes it");
        }
    }
    for row in 0..down {
        for column in 0..around {
            let at = |row: u32, column: u32| 1 + row * around + column % around;
            let corners = [
                at(row, column),
                at(row, column + 1),
                at(row + 1, column + 1),
                at(row + 1, column),
            ];
            let [a, b, c, d] = corners.map(|i| format!("{i}//{i}"));
            if row > 0 {
                writeln!(text, "f {a} {b} {c}").expect("memory takes it");
            }
            if row + 1 < down {
                writeln!(text, "f {a} {c} {d}").expect("memory takes it");
            }
        }
    }
    text
}

/// A corner of a room with a coarse smooth ball and a rough metal block.
fn room(sensor: &str, light: &str, more: &str) -> Scene {
    // The scale of an orthographic camera is half the width of what it sees.
    let scale = if sensor == ORTHOGRAPHIC {
        r#"<scale x="1.3" y="1.3" z="1"/>"#
    } else {
        ""
    };
    let view = format!(
        r#"<transform name="to_world">{scale}<lookat origin="0.3, 1.1, 3.6" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film>"#
    );
    let xml = format!(
        r#"<scene version="3.0.0">
            {}{light}{more}
            <shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform>
                <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.6, 0.5"/></bsdf></bsdf></shape>
            <shape type="rectangle"><transform name="to_world"><scale value="2"/><translate y="1" z="-1"/></transform>
                <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.3, 0.5, 0.7"/></bsdf></bsdf></shape>
            <shape type="cube"><transform name="to_world"><scale value="0.3"/><rotate y="1" angle="30"/><translate x="-0.9" y="0.3" z="0.3"/></transform>
                <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></shape>
            <shape type="obj"><string name="filename" value="ball.obj"/>
                <transform name="to_world"><scale value="0.35"/><translate x="-0.1" y="0.4" z="-0.4"/></transform>
                <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf></shape>
        </scene>"#,
        sensor.replace("VIEW", &view)
    );
    let files = BTreeMap::from([
        ("scene.xml".to_owned(), xml.clone().into_bytes()),
        ("ball.obj".to_owned(), coarse_ball().into_bytes()),
    ]);
    scenes::load(&files, "scene.xml", &[]).unwrap_or_else(|faults| panic!("{faults}\n{xml}"))
}

/// Mean luminance of each path length in one iteration; `settings` makes settings of a `max_depth`.
fn lengths(scene: &Scene, seed: u64, iteration: u32, settings: &dyn Fn(u32) -> IntegratorSettings) -> Vec<f64> {
    luminance_by_length(scene, seed, iteration, LONGEST, settings).expect("it renders")
}

fn truth(scene: &Scene) -> Moments {
    let mut moments = Moments::default();
    for iteration in 1..=48 {
        moments.push(&lengths(scene, 1, iteration, &|depth| {
            IntegratorSettings::Path(PathSettings {
                samples: 32,
                sampling: Sampling::Independent,
                max_depth: Some(depth),
            })
        }));
    }
    moments
}

/// Observations of path lengths: over iterations of one job, or over the first iterations of many under Sobol' sampling.
fn observe(
    scene: &Scene,
    sampling: Sampling,
    observations: u32,
    settings: &dyn Fn(u32, Sampling) -> IntegratorSettings,
) -> Moments {
    let mut moments = Moments::default();
    for i in 1..=observations {
        let (seed, iteration) = match sampling {
            Sampling::Independent => (2, i),
            Sampling::Sobol => (u64::from(1_000 + i), 1),
        };
        moments.push(&lengths(scene, seed, iteration, &|depth| settings(depth, sampling)));
    }
    moments
}

/// Holds an estimate against the truth, and proves that it would notice an estimate that is off by the share `noticed`.
fn check(label: &str, estimate: &Moments, truth: &Moments, noticed: f64) {
    let test = ZTest::compare(estimate, truth, FALSE_ALARMS);
    // Standard errors of few observations are uncertain themselves.
    let lengths = estimate.mean().len() as f64;
    let threshold = student_quantile(FALSE_ALARMS / lengths, OBSERVATIONS as usize - 1);
    println!(
        "{label}: largest |z| {:.2} of {:.2}, noise {:.2} %, difference {:+.2} %",
        test.largest,
        threshold,
        100.0 * test.relative_noise,
        100.0 * test.relative_difference
    );
    assert!(test.largest <= threshold, "{label}: {test:?}");
    assert!(
        threshold * test.relative_noise < noticed,
        "{label}: too noisy to notice {noticed}: {test:?}"
    );
}

fn bdpt(depth: u32, sampling: Sampling) -> IntegratorSettings {
    IntegratorSettings::Bdpt(BdptSettings {
        photons: 256,
        samples: 4,
        sampling,
        max_depth: Some(depth),
        ..Default::default()
    })
}

fn vcm(depth: u32, sampling: Sampling) -> IntegratorSettings {
    IntegratorSettings::Vcm(VcmSettings {
        photons: 256,
        samples: 4,
        sampling,
        sigma1: Some(0.05),
        max_depth: Some(depth),
        ..Default::default()
    })
}

fn light(depth: u32, sampling: Sampling) -> IntegratorSettings {
    IntegratorSettings::Light(LightSettings {
        photons: 2_000,
        samples: 4,
        sampling,
        max_depth: Some(depth),
    })
}

/// Lights that the camera sees itself are left out: its rays find them whatever the method.
fn every_light(name: &str, sensor: &str) {
    let scattered = |moments: &Moments| moments.components(1..LONGEST as usize);
    for (kind, delta, emitter) in LIGHTS {
        let scene = room(sensor, emitter, if delta { "" } else { GLASS });
        let expected = scattered(&truth(&scene));
        for sampling in [Sampling::Independent, Sampling::Sobol] {
            for (method, settings) in [("bdpt", bdpt as fn(_, _) -> _), ("vcm", vcm)] {
                let found = scattered(&observe(&scene, sampling, OBSERVATIONS, &settings));
                check(
                    &format!("{name}, {kind}, {method}, {sampling:?}"),
                    &found,
                    &expected,
                    0.15,
                );
            }
        }
        // Light tracing finds nothing that the camera sees in glass.
        let scene = room(sensor, emitter, "");
        let found = scattered(&observe(&scene, Sampling::Sobol, OBSERVATIONS, &light));
        check(
            &format!("{name}, {kind}, light"),
            &found,
            &scattered(&truth(&scene)),
            0.25,
        );
    }
}

#[test]
fn every_light_through_a_pinhole() {
    every_light("pinhole", PINHOLE);
}

#[test]
fn every_light_through_a_lens() {
    every_light("thin lens", THIN_LENS);
}

#[test]
fn every_light_by_parallel_rays() {
    every_light("orthographic", ORTHOGRAPHIC);
}

/// BSDFs that are made of others: a ball with holes, a tilted pane before it, bumpy metal, and coats. Light passes through the holes and the pane
/// by chance only, and the tilted normals are another matter for light paths than for camera paths.
const COMPOSED: &str = r#"
    <shape type="sphere"><point name="center" x="0.5" y="0.4" z="0.4"/><float name="radius" value="0.4"/>
        <bsdf type="mask"><float name="opacity" value="0.6"/>
            <bsdf type="twosided"><bsdf type="roughplastic"><float name="alpha" value="0.2"/>
                <rgb name="diffuse_reflectance" value="0.6, 0.3, 0.2"/></bsdf></bsdf></bsdf></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="25"/><translate x="0.4" y="0.5" z="1"/></transform>
        <bsdf type="thindielectric"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.6"/><rotate x="1" angle="-90"/><translate x="0.2" y="0.01" z="1"/></transform>
        <bsdf type="normalmap">
            <texture name="normalmap" type="checkerboard"><rgb name="color0" value="0.7, 0.4, 0.9"/><rgb name="color1" value="0.35, 0.6, 0.9"/>
                <transform name="to_uv"><scale x="5" y="5"/></transform></texture>
            <bsdf type="blendbsdf"><float name="weight" value="0.5"/>
                <bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>
                <bsdf type="plastic"/></bsdf>
        </bsdf></shape>
    <shape type="sphere"><point name="center" x="-0.5" y="1.1" z="-0.5"/><float name="radius" value="0.25"/>
        <bsdf type="coating"><float name="thickness" value="0.2"/><rgb name="sigma_a" value="0.1, 0.5, 1"/>
            <bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="0.25"/></bsdf></bsdf></shape>"#;

#[test]
fn materials_made_of_others_and_every_lobe() {
    let scattered = |moments: &Moments| moments.components(1..LONGEST as usize);
    let composed = room(PINHOLE, LIGHTS[0].2, COMPOSED);
    let lobes = scenes::named("lobes", 8).expect("the scene loads");
    for (name, scene) in [("composed", composed), ("lobes", lobes)] {
        let expected = scattered(&truth(&scene));
        for (method, settings) in [("bdpt", bdpt as fn(_, _) -> _), ("vcm", vcm)] {
            // Mirrors beside rough surfaces make the first noisier than the other scenes.
            let found = scattered(&observe(&scene, Sampling::Independent, 3 * OBSERVATIONS, &settings));
            check(&format!("{name}, {method}"), &found, &expected, 0.15);
        }
    }
}

/// Each technique alone, in full, finds all paths of up to three edges: lights and lens can both be hit here.
#[test]
fn each_technique_alone_finds_all_paths() {
    let scene = room(THIN_LENS, LIGHTS[0].2, "");
    let expected = truth(&scene);
    for edges in 1..=3 {
        for s in 0..=edges + 1 {
            let t = edges + 1 - s;
            // Nothing connects a light with the lens directly.
            if (s, t) == (1, 1) {
                continue;
            }
            let photons = if t == 0 { 40_000 } else { 2_000 };
            let noticed = match (s, t) {
                (_, 0) => 0.7,
                (0, _) => 0.4,
                _ => 0.35,
            };
            let found = observe(&scene, Sampling::Independent, OBSERVATIONS, &|depth, sampling| {
                IntegratorSettings::Bdpt(BdptSettings {
                    photons: if depth == edges { photons } else { 1 },
                    samples: if t == 0 { 1 } else { 16 },
                    sampling,
                    light_vertices: Some(s),
                    camera_vertices: Some(t),
                    weighted: false,
                    max_depth: Some(depth),
                })
            });
            let length = edges as usize;
            let only = |moments: &Moments| moments.components(length - 1..length);
            check(&format!("s = {s}, t = {t}"), &only(&found), &only(&expected), noticed);
        }
    }
}

/// Groups of techniques, and numbers of light paths below, at and above that of camera paths.
#[test]
fn groups_of_techniques_and_numbers_of_paths_have_one_mean() {
    use Technique::{Connect, Merge, NextEvent};
    let scene = room(THIN_LENS, LIGHTS[0].2, GLASS);
    let expected = truth(&scene);
    let groups: [(&str, &[Technique]); 4] = [
        ("photon mapping from both sides", &[Merge]),
        ("path tracing", &[NextEvent]),
        ("without light tracing", &[NextEvent, Connect, Merge]),
        ("next event and merging", &[NextEvent, Merge]),
    ];
    for (label, techniques) in groups {
        let found = observe(&scene, Sampling::Independent, OBSERVATIONS, &|depth, sampling| {
            IntegratorSettings::Vcm(VcmSettings {
                photons: 2_000,
                samples: 4,
                sampling,
                sigma1: Some(0.06),
                techniques: techniques.to_vec(),
                max_depth: Some(depth),
                ..Default::default()
            })
        });
        check(label, &found, &expected, 0.3);
    }
    for photons in [64, 256, 1_024] {
        for settings in [bdpt as fn(_, _) -> _, vcm] {
            let found = observe(&scene, Sampling::Independent, OBSERVATIONS, &|depth, sampling| {
                let mut settings = settings(depth, sampling);
                match &mut settings {
                    IntegratorSettings::Bdpt(settings) => settings.photons = photons,
                    IntegratorSettings::Vcm(settings) => settings.photons = photons,
                    _ => unreachable!("one of the two"),
                }
                settings
            });
            check(&format!("{photons} light paths"), &found, &expected, 0.3);
        }
    }
}

/// `vcm` without merging is `bdpt`, to the last bit.
#[test]
fn without_merging_vertex_connection_and_merging_is_bidirectional_path_tracing() {
    let scene = room(PINHOLE, LIGHTS[0].2, GLASS);
    let render = |settings| {
        render_iteration(&scene, &settings, 3, 2, &Unobserved)
            .expect("it renders")
            .pixels
    };
    let all = VcmSettings::default();
    let techniques = all
        .techniques
        .iter()
        .copied()
        .filter(|it| *it != Technique::Merge)
        .collect();
    let unmerged = IntegratorSettings::Vcm(VcmSettings { techniques, ..all });
    assert!(render(unmerged) == render(IntegratorSettings::Bdpt(BdptSettings::default())));
}
