//! Light through portals, by several integrators.
//!
//! Pixels are compared by their means over iterations: a difference may be [`DEVIATIONS`] of its standard errors, and [`BIAS`] besides. With
//! some 200 pixels compared and 31 degrees of freedom all of them together fail by chance with a probability below 1 %. Seeds are fixed.

use super::{IntegratorSettings, Unobserved, render_iteration};
use crate::random::Sampling;
use crate::scene::{Limits, Scene};
use crate::settings::{BdptSettings, LightSettings, PathSettings, PppmSettings, VcmSettings};
use std::collections::BTreeMap;
use std::fmt::Write;

const DEVIATIONS: f64 = 5.0;
/// What the kernels of photons may blur.
const BIAS: f64 = 0.01;
const ITERATIONS: u32 = 32;
/// Standard error that a mean over the image may have, for the test to notice anything.
const NOISE: f64 = 0.02;

/// A grey rectangle.
fn plate(reflectance: f32, corners: [[f32; 3]; 4]) -> String {
    let mut text = format!("Material \"diffuse\" \"rgb reflectance\" [{reflectance} {reflectance} {reflectance}]\n");
    writeln!(
        text,
        "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point3 P\" {}",
        points(corners)
    )
    .expect("memory takes it");
    text
}

fn points(corners: [[f32; 3]; 4]) -> String {
    let numbers: Vec<String> = corners.iter().flatten().map(f32::to_string).collect();
    format!("[{}]", numbers.join(" "))
}

/// The rectangle at the height `y`, so that as a portal it lets light down, and as a lamp shines down.
fn above([x0, x1]: [f32; 2], y: f32, [z0, z1]: [f32; 2]) -> [[f32; 3]; 4] {
    [[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]
}

/// A square image of all directions, uneven and with two bright spots about +y, as a file.
fn sky() -> Vec<u8> {
    let mut bytes = b"PF\n8 8\n-1\n".to_vec();
    for texel in 0..64_u8 {
        // From the lowest row on, whose middle is +y.
        let value = match texel {
            3 | 21 => 6.0,
            _ => 0.3 + 0.1 * f32::from(texel % 5),
        };
        bytes.extend([value, 0.9 * value, 0.8 * value].map(f32::to_le_bytes).concat());
    }
    bytes
}

fn load(world: &str) -> Scene {
    let text = format!(
        "LookAt 0.3 1.1 3.6 0 0.7 0 0 1 0\nCamera \"perspective\" \"float fov\" 50\nPixelFilter \"box\"\n\
         Film \"rgb\" \"integer xresolution\" 4 \"integer yresolution\" 4\nWorldBegin\n{world}"
    );
    let files = BTreeMap::from([
        ("main.pbrt".to_owned(), text.into_bytes()),
        ("sky.pfm".to_owned(), sky()),
    ]);
    let scene = Scene::load(&files, "main.pbrt", &BTreeMap::new(), &Limits::default());
    let scene = scene.unwrap_or_else(|faults| panic!("{faults}"));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    scene
}

/// A grey floor and back wall with a block on it.
fn corner() -> String {
    let ground = plate(0.6, above([-2.0, 2.0], 0.0, [-2.0, 2.0]));
    let back = [[-2.0, 0.0, -1.0], [2.0, 0.0, -1.0], [2.0, 1.8, -1.0], [-2.0, 1.8, -1.0]];
    let block = "AttributeBegin Translate 0.3 0.4 0.2 Material \"conductor\" \"float roughness\" 0.3\n\
        Shape \"sphere\" \"float radius\" 0.4 AttributeEnd\n";
    ground + &plate(0.4, back) + block
}

/// Mean and squared standard error of each pixel.
fn pixels(scene: &Scene, settings: &IntegratorSettings, seed: u64) -> Vec<[f64; 2]> {
    let count = f64::from(ITERATIONS);
    let mut sums = vec![[0.0; 2]; 16];
    for iteration in 1..=ITERATIONS {
        let rendered = render_iteration(scene, settings, seed, iteration, &Unobserved).expect("it renders");
        for (sum, pixel) in sums.iter_mut().zip(rendered.pixels) {
            let value = f64::from(pixel.luminance());
            *sum = [sum[0] + value, sum[1] + value * value];
        }
    }
    sums.into_iter()
        .map(|[sum, squares]| {
            let mean = sum / count;
            [mean, (squares / count - mean * mean).max(0.0) / (count - 1.0)]
        })
        .collect()
}

fn compare(label: &str, found: &[[f64; 2]], expected: &[[f64; 2]]) {
    let (mut sum, mut variance, mut largest) = (0.0, 0.0, 0.0_f64);
    for ([mean, error], [truth, uncertainty]) in found.iter().zip(expected) {
        let difference = ((mean - truth).abs() - BIAS * truth).max(0.0);
        let deviations = difference / (error + uncertainty).sqrt().max(f64::MIN_POSITIVE);
        assert!(deviations < DEVIATIONS, "{label}: {mean}, {truth}, {deviations}");
        largest = largest.max(deviations);
        sum += truth;
        variance += error + uncertainty;
    }
    let noise = variance.sqrt() / sum;
    println!("{label}: largest deviation {largest:.2}, noise {:.2} %", 100.0 * noise);
    assert!(noise < NOISE, "{label}: too noisy: {noise}");
}

fn path(samples: u32) -> IntegratorSettings {
    IntegratorSettings::Path(PathSettings {
        samples,
        sampling: Sampling::Independent,
        max_depth: Some(4),
    })
}

fn integrators() -> Vec<IntegratorSettings> {
    let (sampling, max_depth, sigma1) = (Sampling::Independent, Some(4), Some(0.03));
    vec![
        path(128),
        IntegratorSettings::Light(LightSettings {
            samples: 128,
            photons: 16_000,
            sampling,
            max_depth,
        }),
        IntegratorSettings::Bdpt(BdptSettings {
            samples: 128,
            photons: 512,
            sampling,
            max_depth,
            ..BdptSettings::default()
        }),
        IntegratorSettings::Vcm(VcmSettings {
            samples: 128,
            photons: 2_000,
            sampling,
            max_depth,
            sigma1,
            ..VcmSettings::default()
        }),
        IntegratorSettings::Pppm(PppmSettings {
            samples: 128,
            photons: 8_000,
            sampling,
            max_depth,
            sigma1,
            ..PppmSettings::default()
        }),
    ]
}

/// A lamp in the place of the portal is the reference, which the camera sees as well.
#[test]
fn a_portal_before_an_even_sky_is_a_lamp() {
    let opening = above([-0.6, 0.5], 1.9, [-0.7, 0.6]);
    let portal = format!(
        "LightSource \"infinite\" \"rgb L\" [3 3 3] \"point3 portal\" {}\n",
        points(opening)
    );
    let lamp = format!(
        "AttributeBegin AreaLightSource \"diffuse\" \"rgb L\" [3 3 3]\n{}AttributeEnd\n",
        plate(0.0, opening)
    );
    let [portal, lamp] = [portal, lamp].map(|light| load(&(corner() + &light)));
    let expected = pixels(&lamp, &path(512), 1);
    for settings in &integrators()[..3] {
        compare(settings.name(), &pixels(&portal, settings, 2), &expected);
    }
}

/// A room whose only window is the portal, under an uneven sky, is what it is without the portal.
#[test]
fn a_portal_in_the_only_window_changes_nothing() {
    let (wide, deep) = ([-1.5, 1.5], [-1.0, 4.0]);
    let window = above([-0.5, 0.7], 2.0, [-0.4, 0.8]);
    let wall = |x: f32| [[x, 0.0, -1.0], [x, 0.0, 4.0], [x, 2.0, 4.0], [x, 2.0, -1.0]];
    let end = |z: f32| [[-1.5, 0.0, z], [1.5, 0.0, z], [1.5, 2.0, z], [-1.5, 2.0, z]];
    let room: String = [
        above(wide, 0.0, deep),
        above([-1.5, -0.5], 2.0, deep),
        above([0.7, 1.5], 2.0, deep),
        above([-0.5, 0.7], 2.0, [-1.0, -0.4]),
        above([-0.5, 0.7], 2.0, [0.8, 4.0]),
        wall(-1.5),
        wall(1.5),
        end(-1.0),
        end(4.0),
    ]
    .map(|corners| plate(0.7, corners))
    .concat();
    let sky = |portal: &str| format!("{room}LightSource \"infinite\" \"string filename\" \"sky.pfm\" {portal}\n");
    let open = load(&sky(""));
    let portal = load(&sky(&format!("\"point3 portal\" {}", points(window))));
    let expected = pixels(&open, &path(256), 1);
    let found = pixels(&portal, &path(128), 2);
    compare("path", &found, &expected);
    compare("bdpt", &pixels(&portal, &integrators()[2], 2), &expected);
    let errors = |pixels: &[[f64; 2]]| pixels.iter().map(|[_, error]| error).sum::<f64>();
    assert!(
        errors(&found) < errors(&expected),
        "half as many paths are less noisy with the portal"
    );
}

/// Two portals without walls about them, one with an obstacle before it, and an even sky that has none.
#[test]
fn integrators_agree_where_portals_cut_the_light() {
    let image = "LightSource \"infinite\" \"string filename\" \"sky.pfm\" \"point3 portal\"";
    let upright = [[-1.2, 0.2, 1.5], [-1.2, 0.2, 0.1], [-1.2, 1.4, 0.1], [-1.2, 1.4, 1.5]];
    let scene = load(&format!(
        "{}{}{image} {}\n{image} {}\nLightSource \"infinite\" \"rgb L\" [0.03 0.03 0.03]\n",
        corner(),
        plate(0.5, above([0.0, 2.0], 2.4, [-0.9, 2.0])),
        points(above([-0.6, 0.5], 1.9, [-0.7, 0.6])),
        points(upright),
    ));
    let expected = pixels(&scene, &path(256), 1);
    for settings in &integrators()[1..] {
        compare(settings.name(), &pixels(&scene, settings, 2), &expected);
    }
}
