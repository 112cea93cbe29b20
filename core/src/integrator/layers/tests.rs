mod mattes;
mod windows;

use super::*;
use crate::film::Node;
use crate::integrator::{INTEGRATORS, Unobserved, render_iteration, render_with_layers};
use crate::scene::Limits;
use std::collections::BTreeMap;

/// Pixels across and down.
const SIZE: u32 = 12;

fn load(objects: &str, more: &str) -> Scene {
    let xml = format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
            <rfilter type="box"/></film></sensor>{objects}{more}</scene>"#
    );
    let files = BTreeMap::from([("scene.xml".to_owned(), xml.into_bytes())]);
    Scene::load(&files, "scene.xml", &BTreeMap::new(), &Limits::default()).unwrap()
}

/// A ball of glass above a floor and before a grey wall.
const ROOM: &str = r#"
    <shape type="rectangle" id="wall"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.25, 0.75"/></bsdf></shape>
    <shape type="sphere"><float name="radius" value="0.5"/><bsdf type="dielectric"/></shape>"#;

/// One lamp of each kind, two of them without a name.
const LAMPS: &str = r#"
    <shape type="rectangle" id="panel"><transform name="to_world"><scale value="0.4"/><rotate x="1" angle="90"/>
        <translate y="1.2"/></transform><emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>
    <emitter type="point" id="bulb"><point name="position" x="1" y="1" z="1.5"/><rgb name="intensity" value="1, 2, 1"/></emitter>
    <emitter type="spot"><transform name="to_world"><lookat origin="-1, 1, 2" target="0, 0, -1" up="0, 1, 0"/></transform>
        <rgb name="intensity" value="6, 3, 6"/></emitter>
    <emitter type="directional"><vector name="direction" x="0.3" y="-0.2" z="-1"/><rgb name="irradiance" value="0.4"/></emitter>
    <emitter type="constant" id="sky"><rgb name="radiance" value="0.2, 0.3, 0.5"/></emitter>
    <emitter type="sun" id="day"><vector name="sun_direction" x="0.2" y="0.5" z="1"/><float name="sun_scale" value="1e-4"/></emitter>"#;

fn layers(names: &[&str]) -> Layers {
    Layers::parse(names).unwrap()
}

fn render(scene: &Scene, layers: &Layers, settings: &IntegratorSettings, iteration: u32) -> Vec<Spectrum> {
    render_remembering(scene, layers, &Memory::default(), settings, iteration)
}

fn render_remembering(
    scene: &Scene,
    layers: &Layers,
    memory: &Memory,
    settings: &IntegratorSettings,
    iteration: u32,
) -> Vec<Spectrum> {
    render_with_layers(scene, (layers, memory), settings, 7, iteration, &[], &Unobserved)
        .unwrap()
        .pixels
}

/// The average of the first iterations.
fn average(scene: &Scene, layers: &Layers, settings: &IntegratorSettings, iterations: u32) -> Image {
    let [width, height] = layers.stacked(scene.film.resolution);
    let memory = Memory::default();
    let iteration = |leaf: u32| render_remembering(scene, layers, &memory, settings, leaf + 1);
    let node = |leaf: u32| Node::leaf(leaf, width, height, &iteration(leaf)).unwrap();
    Image::average(&(0..iterations).map(node).collect::<Vec<_>>()).unwrap()
}

fn path() -> IntegratorSettings {
    INTEGRATORS[0].read(Default::default()).unwrap()
}

/// Those of all integrators whose iterations stand alone.
fn independent() -> impl Iterator<Item = IntegratorSettings> {
    INTEGRATORS
        .into_iter()
        .filter(|it| it.statistics_per_pixel == 0)
        .map(|integrator| {
            let photons = integrator.setting("photons");
            let given = photons.map(|setting| (setting.name.to_owned(), 20_000.into()));
            integrator.read(given.into_iter().collect()).unwrap()
        })
}

/// Asserts that the layers of an iteration add up to its picture, pixel by pixel, and gives the sum of each layer over its pixels.
fn assert_parts_add_up(scene: &Scene, parts: &Layers, settings: &IntegratorSettings) -> Vec<Spectrum> {
    let size = (SIZE * SIZE) as usize;
    let stack = render(scene, parts, settings, 1);
    let (picture, planes) = stack.split_at(size);
    let mean = picture.iter().copied().sum::<Spectrum>().luminance() / size as f32;
    assert!(mean > 0.01, "{}", settings.name());
    for (pixel, whole) in picture.iter().enumerate() {
        let sum: Spectrum = planes.chunks_exact(size).map(|plane| plane[pixel]).sum();
        // Rounding of sums of some thousand numbers of 24 bits.
        let tolerance = 1e-4 * (whole.luminance() + mean);
        let apart = sum.zip(*whole, |a, b| (a - b).abs()).max_component();
        let name = settings.name();
        assert!(apart < tolerance, "{name}, pixel {pixel}: {sum:?} of {whole:?}");
    }
    let planes = planes.chunks_exact(size);
    planes.map(|plane| plane.iter().copied().sum()).collect()
}

#[test]
fn lamps_add_up_to_the_picture_whatever_the_integrator() {
    let scene = load(ROOM, LAMPS);
    assert_eq!(scene.lamps[..3], ["panel", "bulb", "lamp-3"]);
    let each = layers(&["lamp:panel", "lamp:bulb", "lamp:lamp-3+lamp-4", "lamp:sky", "lamp:*"]);
    for settings in independent() {
        let sums = assert_parts_add_up(&scene, &each, &settings);
        assert!(sums.iter().all(|sum| !sum.is_black()), "{}: {sums:?}", settings.name());
    }
}

#[test]
fn paths_add_up_to_the_picture_whatever_the_integrator() {
    let parts = [
        "seen=L E",
        "direct=L [DG] E",
        "caustic=L S+ D E",
        "mirror=L S+ E",
        "others=L (S* [DG] . .* | S+ G) E",
    ];
    let (scene, each) = (load(ROOM, LAMPS), layers(&parts));
    for settings in independent() {
        for (part, sum) in parts.iter().zip(assert_parts_add_up(&scene, &each, &settings)) {
            // Light paths do not find a pinhole through glass.
            let found = settings.name() != "light" || !part.starts_with("mirror");
            assert_eq!(!sum.is_black(), found, "{}: {part}", settings.name());
        }
    }
}

/// Paths of one surface are all that a limit of two edges leaves: of the same random numbers, so that the bits agree.
#[test]
fn direct_light_is_what_paths_of_two_edges_bring() {
    let scene = load(ROOM, LAMPS);
    for name in ["path", "bdpt", "light"] {
        let integrator = crate::integrator::Integrator::find(name).unwrap();
        let read = |given: &[(&str, u32)]| {
            let given = given.iter().map(|(name, value)| ((*name).to_owned(), (*value).into()));
            integrator.read(given.collect()).unwrap()
        };
        let all = render(&scene, &layers(&["short=L .? E"]), &read(&[]), 1);
        let short = render(&scene, &Layers::default(), &read(&[("max_depth", 2)]), 1);
        let mean = short.iter().copied().sum::<Spectrum>().luminance() / short.len() as f32;
        for (found, expected) in all[short.len()..].iter().zip(&short) {
            let apart = found.zip(*expected, |a, b| (a - b).abs()).max_component();
            assert!(apart <= 1e-5 * mean, "{name}: {found:?}, not {expected:?}");
        }
    }
}

/// What each method finds of a set of paths is the same on average as what path tracing finds: here the light that a ball of glass throws
/// on the wall, and what is seen in the ball.
#[test]
fn integrators_agree_on_what_comes_along_which_paths() {
    let lamp = r#"<shape type="rectangle"><transform name="to_world"><scale value="0.8"/><rotate x="1" angle="135"/>
        <translate y="2.5" z="2.5"/></transform><emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>"#;
    let scene = load(ROOM, lamp);
    let asked = layers(&["caustic=L S+ D E", "seen=L .* D S+ E"]);
    let size = (SIZE * SIZE) as usize;
    let means = |settings: &IntegratorSettings, iterations: u32| -> Vec<[f64; 2]> {
        let sums: Vec<[f64; 2]> = (1..=iterations)
            .map(|iteration| {
                let stack = render(&scene, &asked, settings, iteration);
                [1, 2].map(|plane| {
                    let pixels = &stack[plane * size..][..size];
                    pixels.iter().map(|pixel| f64::from(pixel.luminance())).sum::<f64>() / size as f64
                })
            })
            .collect();
        (0..2)
            .map(|plane| {
                let n = f64::from(iterations);
                let mean = sums.iter().map(|sum| sum[plane]).sum::<f64>() / n;
                let variance = sums.iter().map(|sum| (sum[plane] - mean).powi(2)).sum::<f64>() / (n - 1.0);
                [mean, (variance / n).sqrt()]
            })
            .collect()
    };
    let truth = means(&path(), 200);
    // Light paths do not find a pinhole through glass, and without media `surfaces` is path tracing with fewer samples.
    for settings in independent()
        .skip(1)
        .filter(|settings| !["light", "surfaces"].contains(&settings.name()))
    {
        let iterations = if settings.name() == "bdpt" { 200 } else { 64 };
        let found = means(&settings, iterations);
        for (plane, ([mean, error], [expected, noise])) in found.into_iter().zip(&truth).enumerate() {
            // Four standard errors, and what kernels of some hundredths of the scene blur over edges.
            let allowed = 4.0 * error.hypot(*noise) + 0.04 * expected;
            assert!(
                *expected > 1e-3 && 4.0 * error.hypot(*noise) < 0.25 * expected,
                "{}: {mean}, {error}",
                settings.name()
            );
            assert!(
                (mean - expected).abs() < allowed,
                "{}, layer {plane}: {mean} ({error}), not {expected} ({noise})",
                settings.name()
            );
        }
    }
}

#[test]
fn the_picture_is_that_without_layers() {
    let scene = load(ROOM, LAMPS);
    let all = layers(&["alpha", "albedo", "normal", "depth", "position", "halves", "lamp:panel"]);
    for settings in independent() {
        let alone = render_iteration(&scene, &settings, 7, 2, &Unobserved).unwrap().pixels;
        assert!(
            render(&scene, &all, &settings, 2)[..alone.len()] == alone,
            "{}",
            settings.name()
        );
    }
}

#[test]
fn surfaces_are_those_that_the_camera_sees() {
    // The wall fills the picture: within 1 / sqrt(n) of a pixel's footprint all values are known.
    let wall = r#"<shape type="rectangle"><transform name="to_world"><scale value="9"/><translate z="-1"/></transform>
        <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.25, 0.75"/></bsdf></bsdf></shape>"#;
    let scene = load(wall, r#"<emitter type="constant"/>"#);
    let asked = layers(&["alpha", "albedo", "normal", "depth", "position"]);
    let iterations = 64;
    let stack = average(&scene, &asked, &path(), iterations);
    let channels: BTreeMap<String, Vec<f32>> = asked
        .channels(&stack)
        .unwrap()
        .into_iter()
        .map(|channel| (channel.name, channel.samples))
        .collect();
    let near = |name: &str, pixel: usize, expected: f32, tolerance: f32| {
        let found = channels[name][pixel];
        assert!(
            (found - expected).abs() <= tolerance,
            "{name} of pixel {pixel}: {found}, not {expected}"
        );
    };
    let half_width = 5.0 * 20.0_f32.to_radians().tan();
    let footprint = 2.0 * half_width / SIZE as f32;
    for pixel in [0, 5, 77, 143] {
        let place = |index: usize| (index as f32 + 0.5) * footprint - half_width;
        let (x, y) = (place(pixel % SIZE as usize), -place(pixel / SIZE as usize));
        near("A", pixel, 1.0, 0.0);
        for (channel, expected) in [("albedo.R", 0.5), ("albedo.G", 0.25), ("albedo.B", 0.75)] {
            near(channel, pixel, expected, 1e-5);
        }
        for (channel, expected) in [
            ("normal.X", 0.0),
            ("normal.Y", 0.0),
            ("normal.Z", 1.0),
            ("position.Z", -1.0),
        ] {
            near(channel, pixel, expected, 1e-5);
        }
        // Stratified points: the mean lies far nearer to the middle than a tenth of the pixel.
        near("position.X", pixel, x, 0.1 * footprint);
        near("position.Y", pixel, y, 0.1 * footprint);
        near("depth.Z", pixel, (x * x + y * y + 25.0).sqrt(), 0.1 * footprint);
    }
}

#[test]
fn what_no_surface_fills_is_zero() {
    let scene = load(ROOM, r#"<emitter type="constant"/>"#);
    let asked = layers(&["alpha", "depth"]);
    let behind = Scene {
        sensor: load("<shape type='sphere'/>", "").sensor,
        ..load("<shape type='sphere'><float name='radius' value='0.1'/></shape>", "")
    };
    let corner = |scene: &Scene| -> Vec<f32> {
        let stack = average(scene, &asked, &path(), 1);
        asked
            .channels(&stack)
            .unwrap()
            .iter()
            .map(|channel| channel.samples[0])
            .collect()
    };
    assert!(corner(&scene).iter().all(|value| *value > 0.9));
    assert_eq!(corner(&behind), [0.0, 0.0]);
}

#[test]
fn halves_are_the_odd_and_the_even_iterations() {
    let scene = load(ROOM, LAMPS);
    let asked = layers(&["halves"]);
    for iterations in [1, 2, 5] {
        let stack = average(&scene, &asked, &path(), iterations);
        let channels = asked.channels(&stack).unwrap();
        let names: Vec<&str> = channels.iter().map(|channel| channel.name.as_str()).collect();
        assert_eq!(
            names,
            ["half_a.R", "half_a.G", "half_a.B", "half_b.R", "half_b.G", "half_b.B"]
        );
        for (first, channel) in [(1, &channels[1]), (2, &channels[4])] {
            let alone: Vec<Vec<Spectrum>> = (first..=iterations)
                .step_by(2)
                .map(|iteration| render(&scene, &Layers::default(), &path(), iteration))
                .collect();
            for (pixel, found) in channel.samples.iter().enumerate() {
                let sum: f32 = alone.iter().map(|image| image[pixel].to_rgb()[1]).sum();
                let expected = sum / alone.len().max(1) as f32;
                assert!((found - expected).abs() <= 1e-5 * expected, "{found}, not {expected}");
            }
        }
        let picture = asked.picture(stack).unwrap();
        assert_eq!([picture.width, picture.height], [SIZE; 2]);
        assert_eq!(picture.pixels.len(), (SIZE * SIZE) as usize);
    }
}

#[test]
fn names_that_no_layer_has_are_refused() {
    let refused = |names: &[&str]| Layers::parse(names).unwrap_err();
    for name in [
        "",
        "albedos",
        "lamp:",
        "lamp:a+",
        "lamp:*+a",
        "lamp",
        "Albedo",
        "=L E",
        "a b=L E",
        "depth=L E",
    ] {
        assert_eq!(refused(&[name]), LayerError::Unknown(name.to_owned()), "{name}");
    }
    let error = refused(&["caustic=L S+ X E"]).to_string();
    assert!(
        error.starts_with("layer `caustic=L S+ X E`: column 6: expected"),
        "{error}"
    );
    assert_eq!(refused(&["albedo", "albedo"]), LayerError::Twice("albedo".into()));
    assert_eq!(refused(&["lamp:a.b", "lamp:a b"]), LayerError::Twice("lamp_a_b".into()));
    assert_eq!(refused(&["depth"; MAX_LAYERS + 1]), LayerError::TooMany(MAX_LAYERS + 1));
    let long = format!("lamp:{}", "x".repeat(NAME_BYTES));
    assert_eq!(refused(&[&long]), LayerError::Long(long.len()));
    let scene = load(ROOM, LAMPS);
    let error = layers(&["lamp:bulb+moon"]).check_scene(&scene).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("no lamp `moon`; it has: panel, bulb, lamp-3"),
        "{error}"
    );
    let sppm = crate::integrator::Integrator::find("sppm")
        .unwrap()
        .read(Default::default())
        .unwrap();
    assert!(layers(&["depth"]).check_integrator(&sppm).is_err());
    assert!(layers(&[]).check_integrator(&sppm).is_ok());
}

/// The bounds of media are no surfaces, and where there is nothing else, alpha is the share of light that the medium keeps back.
#[test]
fn what_bounds_media_is_looked_through() {
    let fog = r#"<shape type="cube"><transform name="to_world"><scale x="9" y="9"/></transform><bsdf type="null"/>
        <medium name="interior" type="homogeneous"><float name="sigma_t" value="0.5"/></medium></shape>"#;
    let ball = r#"<shape type="sphere"><float name="radius" value="0.5"/></shape><emitter type="constant"/>"#;
    let layers = layers(&["alpha", "depth"]);
    let stack = render(&load(ball, fog), &layers, &path(), 1);
    let size = (SIZE * SIZE) as usize;
    let [alpha, depth] = [1, 2].map(|layer| &stack[layer * size..][..size]);
    // Of a distance of 4, through a slab that is 2 thick, along rays at an angle below 29 degrees.
    let mut seen = 0;
    for (alpha, depth) in alpha.iter().zip(depth).map(|(alpha, depth)| (alpha[0], depth[0])) {
        if depth > 0.0 {
            seen += 1;
            assert!(alpha == 1.0 && (3.4..4.1).contains(&depth), "{alpha}, {depth}");
        } else {
            let [least, most] = [1.0_f32, 1.0 / 0.87].map(|slant| 1.0 - (-slant).exp());
            assert!((least - 1e-4..most).contains(&alpha), "{alpha}");
        }
    }
    assert!((1..size).contains(&seen));
}
