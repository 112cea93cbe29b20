//! The photon integrators against `path`.
//!
//! Means over blocks of pixels are compared by z-tests. Each comparison fails by chance with probability
//! `FALSE_ALARMS`; seeds are fixed, so a test that passes once passes always. Sampling is independent where the noise is
//! measured over the iterations of one job; under Sobol' sampling, where these depend on each other, it is measured over seeds.

use photonfarm_core::random::Sampling;
use photonfarm_core::scene::Scene;
use photonfarm_core::settings::{
    DirectionSampler, IntegratorSettings, LookupVertex, PathSettings, PcfSettings, PppmSettings,
};
use photonfarm_tests::statistics::{Moments, ZTest};
use photonfarm_tests::{render, scenes};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Probability with which a comparison of equal estimators fails.
const FALSE_ALARMS: f64 = 1e-4;

/// Pixels across and down.
const SIZE: usize = 24;

/// Pixels of a block, across and down.
const BLOCK: usize = 6;

fn load(name: &str) -> Scene {
    scenes::named(name, SIZE).expect("the scene loads")
}

/// Means of luminance over blocks of pixels, over iterations `1..=iterations`.
fn measure(scene: &Scene, settings: &IntegratorSettings, seed: u64, iterations: u32) -> Moments {
    let mut moments = Moments::default();
    for image in render::iterations(scene, settings, seed, iterations) {
        let image = image.expect("the iteration renders");
        let mut blocks = vec![0.0; (SIZE / BLOCK) * (SIZE / BLOCK)];
        for (index, pixel) in image.pixels.iter().enumerate() {
            let (x, y) = (index % SIZE / BLOCK, index / SIZE / BLOCK);
            blocks[y * (SIZE / BLOCK) + x] += f64::from(pixel.luminance()) / (BLOCK * BLOCK) as f64;
        }
        moments.push(&blocks);
    }
    moments
}

/// The same over the first iterations of `seeds` jobs.
fn measure_over_seeds(scene: &Scene, settings: &IntegratorSettings, seeds: std::ops::Range<u64>) -> Moments {
    let mut moments = Moments::default();
    for seed in seeds {
        let one = measure(scene, settings, seed, 1);
        moments.push(one.mean());
    }
    moments
}

/// Holds an estimate against the truth: they agree, the noise of a block is below the share `noise`, and the mean of the image is off by less
/// than 2 %.
fn check_means(settings: &IntegratorSettings, estimate: &Moments, truth: &Moments, noise: f64) {
    let test = ZTest::compare(estimate, truth, FALSE_ALARMS);
    println!("{}: {test:?}", settings.name());
    assert!(test.passes(), "{settings:?}: {test:?}");
    assert!(test.relative_noise < noise, "the test has power: {test:?}");
    assert!(test.relative_difference.abs() < 0.02, "{test:?}");
}

fn reference(scene: &Scene, max_depth: u32) -> Moments {
    short_reference(scene, max_depth, 160)
}

fn short_reference(scene: &Scene, max_depth: u32, iterations: u32) -> Moments {
    let settings = PathSettings {
        samples: 16,
        sampling: Sampling::Independent,
        max_depth: Some(max_depth),
    };
    measure(scene, &IntegratorSettings::Path(settings), 1, iterations)
}

fn pppm(sigma1: f32, max_depth: u32) -> IntegratorSettings {
    let sigma1 = Some(sigma1);
    IntegratorSettings::Pppm(PppmSettings {
        photons: 40_000,
        samples: 2,
        sampling: Sampling::Independent,
        sigma1,
        max_depth: Some(max_depth),
        ..Default::default()
    })
}

fn pcf(sigma1: f32, theta1: f32, lookup_vertex: LookupVertex, max_depth: u32) -> IntegratorSettings {
    IntegratorSettings::Pcf(PcfSettings {
        photons: 80_000,
        samples: 2,
        sampling: Sampling::Independent,
        sigma1: Some(sigma1),
        theta1,
        lookup_vertex,
        max_depth: Some(max_depth),
        ..Default::default()
    })
}

/// Compares an integrator with `path`: at the bandwidth of `settings` the z-test must pass.
///
/// `wider` is the same with the bandwidth `ratio` times as large; its whole-image bias is large enough to be seen
/// above the noise. Boundary bias shrinks in proportion to the bandwidth and all other bias faster, so the bias left in
/// `settings` is at most the measured one over `ratio`; it must lie below the noise of a block.
fn check(
    scene: &Scene,
    truth: &Moments,
    settings: &IntegratorSettings,
    wider: &IntegratorSettings,
    ratio: f64,
) -> ZTest {
    let estimate = measure(scene, settings, 2, 100);
    let test = ZTest::compare(&estimate, truth, FALSE_ALARMS);
    let bias = ZTest::compare(&measure(scene, wider, 3, 20), truth, FALSE_ALARMS)
        .relative_difference
        .abs()
        / ratio;
    println!(
        "{}: largest |z| {:.2} of {:.2}; noise of a block {:.2} %, bias at most about {:.2} %, image mean {:+.2} %",
        settings.name(),
        test.largest,
        test.threshold,
        100.0 * test.relative_noise,
        100.0 * bias,
        100.0 * test.relative_difference,
    );
    assert!(test.passes(), "{settings:?}: {test:?}");
    assert!(
        bias < test.relative_noise,
        "{settings:?}: bias {bias} against noise {}",
        test.relative_noise
    );
    test
}

/// A lookup vertex with the bandwidth it is tested at: sigma in scene units, theta in degrees.
type Lookup = (LookupVertex, f32, f32);

fn check_all(name: &str, max_depth: u32, lookups: &[Lookup]) {
    let scene = load(name);
    check_against(&scene, &reference(&scene, max_depth), max_depth, lookups);
}

fn check_against(scene: &Scene, truth: &Moments, max_depth: u32, lookups: &[Lookup]) {
    check(scene, truth, &pppm(0.01, max_depth), &pppm(0.08, max_depth), 8.0);
    for &(lookup, sigma1, theta1) in lookups {
        let wider = pcf(4.0 * sigma1, 4.0 * theta1, lookup, max_depth);
        check(scene, truth, &pcf(sigma1, theta1, lookup, max_depth), &wider, 4.0);
    }
}

const MIRROR_GLASS_DEPTH: u32 = 8;

/// The reference of two tests.
static MIRROR_GLASS: LazyLock<Moments> = LazyLock::new(|| reference(&load("mirror-glass"), MIRROR_GLASS_DEPTH));

#[test]
fn diffuse_box_agrees_with_path_tracing() {
    check_all(
        "diffuse-box",
        6,
        &[(LookupVertex::Auto, 0.03, 8.0), (LookupVertex::Fixed(2), 0.05, 12.0)],
    );
}

#[test]
fn mirror_and_glass_agree_with_path_tracing() {
    check_against(
        &load("mirror-glass"),
        &MIRROR_GLASS,
        MIRROR_GLASS_DEPTH,
        &[
            (LookupVertex::Auto, 0.04, 10.0),
            (LookupVertex::Fixed(1), 0.04, 10.0),
            (LookupVertex::Fixed(2), 0.04, 10.0),
        ],
    );
}

/// A coated floor is a mirror and diffuse at once: the room, a caustic and the lamp are seen in it, and light reaches walls by way of its
/// mirror. Each integrator splits it into lobes in its own way.
#[test]
fn coated_surfaces_agree_with_path_tracing() {
    const DEPTH: u32 = 8;
    let scene = load("coated");
    let truth = short_reference(&scene, DEPTH, 64);
    let photons = match pppm(0.01, DEPTH) {
        IntegratorSettings::Pppm(s) => IntegratorSettings::Pppm(PppmSettings { photons: 15_000, ..s }),
        other => other,
    };
    let cones = |lookup, nested| match pcf(0.04, 10.0, lookup, DEPTH) {
        IntegratorSettings::Pcf(s) => IntegratorSettings::Pcf(PcfSettings {
            photons: 25_000,
            nested,
            ..s
        }),
        other => other,
    };
    for settings in [
        photons,
        cones(LookupVertex::Auto, false),
        cones(LookupVertex::Auto, true),
        cones(LookupVertex::Fixed(2), false),
    ] {
        check_means(&settings, &measure(&scene, &settings, 2, 40), &truth, 0.06);
    }
}

/// Every lobe by itself: photons and cones are gathered on the rough ones, and paths go on from the glossy ones.
#[test]
fn every_lobe_agrees_with_path_tracing() {
    const DEPTH: u32 = 6;
    let scene = load("lobes");
    let truth = short_reference(&scene, DEPTH, 48);
    for settings in [pppm(0.01, DEPTH), pcf(0.04, 10.0, LookupVertex::Auto, DEPTH)] {
        check_means(&settings, &measure(&scene, &settings, 2, 30), &truth, 0.06);
    }
}

#[test]
fn point_light_agrees_with_path_tracing() {
    check_all(
        "point-light",
        6,
        &[(LookupVertex::Auto, 0.03, 8.0), (LookupVertex::Fixed(2), 0.05, 12.0)],
    );
}

#[test]
fn environment_light_agrees_with_path_tracing() {
    check_all("environment", 8, &[(LookupVertex::Auto, 0.04, 10.0)]);
}

/// Camera connections aim at the camera: at a lens, which has an extent, and against parallel rays. Aimed elsewhere they
/// would be many times as noisy.
fn check_camera_connections(scene: &Scene) {
    use DirectionSampler::{Bsdf, Camera};
    let truth = reference(scene, 4);
    for samplers in [vec![Camera], vec![Bsdf, Camera]] {
        let at = |scale: f32| {
            IntegratorSettings::Pcf(PcfSettings {
                photons: 40_000,
                samples: 2,
                sampling: Sampling::Independent,
                sigma1: Some(0.03 * scale),
                theta1: 8.0 * scale,
                lookup_vertex: LookupVertex::Fixed(1),
                samplers: samplers.clone(),
                max_depth: Some(4),
                ..Default::default()
            })
        };
        let test = check(scene, &truth, &at(1.0), &at(4.0), 4.0);
        assert!(test.relative_noise < 0.03, "{test:?}");
    }
}

#[test]
fn a_lens_has_camera_connections() {
    let text = std::fs::read_to_string(scenes::folder().join("diffuse-box.xml")).expect("the scene is there");
    let pinhole = "<sensor type=\"perspective\">";
    let lens = "<sensor type='thinlens'><float name='aperture_radius' value='0.4'/>\
                <float name='focus_distance' value='4'/>";
    assert!(text.contains(pinhole));
    let files = BTreeMap::from([("main.xml".to_owned(), text.replace(pinhole, lens).into_bytes())]);
    check_camera_connections(&scenes::load(&files, "main.xml", &[("res", SIZE as u32)]).expect("the scene loads"));
}

#[test]
fn an_orthographic_camera_has_camera_connections() {
    check_camera_connections(&load("orthographic"));
}

/// The numbers that jobs use by default: points of a Sobol' sequence, whose estimates have the same mean.
#[test]
fn low_discrepancy_numbers_agree_with_independent_ones() {
    const DEPTH: u32 = MIRROR_GLASS_DEPTH;
    let scene = load("mirror-glass");
    let with = |settings: IntegratorSettings| {
        let mut fields = serde_json::to_value(&settings).unwrap();
        fields["sampling"] = serde_json::to_value(Sampling::Sobol).unwrap();
        serde_json::from_value::<IntegratorSettings>(fields).unwrap()
    };
    let path = IntegratorSettings::Path(PathSettings {
        samples: 16,
        max_depth: Some(DEPTH),
        ..Default::default()
    });
    for settings in [path, pppm(0.01, DEPTH), pcf(0.04, 10.0, LookupVertex::Auto, DEPTH)] {
        let settings = with(settings);
        let estimate = measure_over_seeds(&scene, &settings, 100..124);
        check_means(&settings, &estimate, &MIRROR_GLASS, 0.05);
    }
}

/// A coarse globe of quadrilaterals, each two triangles, with the normals of the sphere that it stands for, as OBJ.
fn globe(center: [f64; 3], radius: f64) -> String {
    const RINGS: usize = 6;
    const SPOKES: usize = 9;
    let mut text = String::new();
    for ring in 0..=RINGS {
        for spoke in 0..SPOKES {
            let (theta, phi) = (
                std::f64::consts::PI * ring as f64 / RINGS as f64,
                std::f64::consts::TAU * spoke as f64 / SPOKES as f64,
            );
            let n = [theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()];
            let [x, y, z] = [0, 1, 2].map(|i| center[i] + radius * n[i]);
            text += &format!("v {x:.7} {y:.7} {z:.7}\nvn {:.7} {:.7} {:.7}\n", n[0], n[1], n[2]);
        }
    }
    for ring in 0..RINGS {
        for spoke in 0..SPOKES {
            let at = |ring: usize, spoke: usize| ring * SPOKES + spoke % SPOKES + 1;
            let corners = [
                at(ring, spoke),
                at(ring + 1, spoke),
                at(ring + 1, spoke + 1),
                at(ring, spoke + 1),
            ];
            for (face, missing) in [([0, 1, 2], ring == RINGS - 1), ([0, 2, 3], ring == 0)] {
                let [a, b, c] = face.map(|i| corners[i]);
                if !missing {
                    text += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
                }
            }
        }
    }
    text
}

/// Interpolated normals differ from the true ones by up to fifteen degrees here. Paths from the camera and from the lights must
/// still see one and the same surface, of glass and diffuse.
#[test]
fn a_coarse_mesh_with_smooth_normals_agrees_with_path_tracing() {
    const DEPTH: u32 = 8;
    let text = std::fs::read_to_string(scenes::folder().join("mirror-glass.xml")).expect("the scene is there");
    let begin = text.find("<shape type=\"sphere\">").expect("the scene has spheres");
    let balls = r#"<shape type="obj"><string name="filename" value="glass.obj"/><ref id="glass"/></shape>
        <shape type="obj"><string name="filename" value="clay.obj"/><ref id="ochre"/></shape></scene>"#;
    let files = BTreeMap::from([
        ("main.xml".to_owned(), (text[..begin].to_owned() + balls).into_bytes()),
        ("glass.obj".to_owned(), globe([0.42, 0.42, 0.3], 0.38).into_bytes()),
        ("clay.obj".to_owned(), globe([-0.42, 0.45, -0.3], 0.45).into_bytes()),
    ]);
    let scene = scenes::load(&files, "main.xml", &[("res", SIZE as u32)]).expect("the scene loads");
    let truth = reference(&scene, DEPTH);
    for settings in [pppm(0.01, DEPTH), pcf(0.03, 8.0, LookupVertex::Auto, DEPTH)] {
        check_means(&settings, &measure(&scene, &settings, 2, 60), &truth, 0.05);
    }
}
